"""Which sets of effects are fitted, in which order: theory, section 8.

    fit {} with and without errors of the commands' stamps
    where {} leaves something unnamed: forget what was learned beside it of the recordings' errors, fit it again
    fit singles from several starts, with errors of the stamps where these gain
    for sizes 1 to 4:
        B = the most probable set of that size, something unnamed beside it included
        if nothing unnamed acts beside B, and no addition gains by the score test: stop
        if something unnamed acts beside two names or more, and a smooth curve explains more than they do: stop
        fit B with each addition, B again from where the best of these ended, and the look-alikes of the best; stop
        where none is more probable than B
        where nothing unnamed acts beside the best: swap each of its members
        learn the recordings' errors beside the best; where this explains more and leaves nothing unnamed: fit again
        with these what may come near, and what now promises something

Work is counted in simulated strokes, never by a clock, so that a busy machine finds what a quiet one does.
What it would still have fitted when the work is used up is left in the table with the best evidence found.
"""

from __future__ import annotations

import functools
import itertools
import math
from collections.abc import Callable, Iterable, Mapping, Sequence
from dataclasses import dataclass
from typing import Final

import numpy as np

from valve_sim.identification.estimation.budget import OutOfWorkError
from valve_sim.identification.estimation.descent import TRIAL, SolverOptions
from valve_sim.identification.estimation.linearised import Linearised
from valve_sim.identification.estimation.parallel import Memo, run_parallel
from valve_sim.identification.estimation.problem import Problem
from valve_sim.identification.estimation.result import Fit
from valve_sim.identification.estimation.solver import fit
from valve_sim.identification.estimation.state_of_recording import with_forgotten_errors, with_learned_errors
from valve_sim.identification.plants.effect_titles import titles_of
from valve_sim.identification.plants.protocol import Array, EffectChoice, Nuisance
from valve_sim.identification.selection.discrepancy import Cell, Discrepancy, Spread, lengths_of
from valve_sim.identification.selection.force_maps import NonparametricFit, competing_curves
from valve_sim.identification.selection.posterior import EVEN, Evidence, Posterior, Set, posterior_of, rivals_of
from valve_sim.identification.selection.score_test import log_gains
from valve_sim.identification.selection.starts import (
    effect_starts,
    robust_cost,
    scattered_starts,
    starts_from_declared,
    starts_of_other_shapes,
)
from valve_sim.model import SimulationError

LARGEST_SET: Final = 4
"""Names in a set: larger ones decided nothing in 153 recordings."""
TANGENT: Final = 0.5
"""Smallest share of a name's gain that the score test predicts where hundreds of ln p are missing."""
PROMISING: Final = 0.02
"""Odds to the set at hand, by the score test, from which an addition is fitted."""
NEAR: Final = 25.0
"""Difference in ln p by which a begun fit may lag behind the best set of its size before it is given up."""
REFITTED: Final = 10.0
"""Difference in ln p from the best, within which sets are fitted again beside a discrepancy."""
SCATTER: Final = (1.0, 3.0, 10.0)
"""Standard errors by which the starts of a polish are scattered."""
WORTH_LEARNING: Final = 5.0
"""Gain in ln p by newly estimated errors of the recordings, from which sets are fitted again with these."""
WORTH_KEEPING: Final = 0.1
"""Smallest difference of χ², or of ln p, by which a fit counts as better."""
BATCH: Final = 4
"""Number of sets that are fitted side by side; the budget is checked between these batches."""
SETTLED: Final = 0.1
"""Largest change of the logarithm of a size at which the sizes of a fit count as converged."""
LINEAR: Final = 0.4
"""τ up to which a discrepancy changes fits so little that one linear step is exact to 0.3 in ln p."""

USUAL_WORK: Final = 100_000.0
"""Simulated strokes that count as the whole in the display of progress where the work has no limit."""

Progress = Callable[[str, float], None]


@dataclass(frozen=True)
class Tried:
    """A set that was fitted.

    Attributes:
        fit: without a discrepancy, with or without errors of the stamps, whichever has more evidence.
        plain: ln p(data | set), both added. beside: the fit beside a discrepancy. spread: of that.
    """

    fit: Fit
    plain: float
    beside: Fit
    spread: Spread

    @property
    def evidence(self) -> Evidence:
        """The evidence of this set, as the posterior takes it."""
        return Evidence(self.plain, self.spread.log_evidence)


class Search:
    """Fits sets to one problem, and keeps what they are worth.

    Attributes:
        tried: by set. untried: sets that were due when the work was used up. impossible: sets that cannot be simulated.
        begun: sets whose fits were given up, because they could not come near others.
        screened: of sets that were not fitted because no addition promised anything, ln p by the score test.
        discrepancy: of the problem. stamps: whether errors of the commands' stamps gain anything.
    """

    def __init__(self, problem: Problem, progress: Progress | None = None) -> None:
        self.problem = problem
        self._say = progress or (lambda what, fraction: None)
        self.tried: dict[Set, Tried] = {}
        self.untried: list[Set] = []
        self.impossible: list[Set] = []
        self.begun: dict[Set, Tried] = {}
        self.screened: dict[Set, float] = {}
        places = problem.rows.places
        self.discrepancy = Discrepancy(places, lengths_of(problem.plant, places))
        self.stamps = bool(problem.plant.timing_errors)
        self.rivals = rivals_of(problem.plant)
        self._cost_of = _costs_of(problem)

    # -- what is known -------------------------------------------------------------------------------------------------

    def table(self, raised: float = 0.0) -> dict[Set, Evidence]:
        """Evidence of all that was fitted, begun, screened or left untried.

        Args:
            raised: ln of the factor by which held-out data raise the odds of something unnamed beside the best.
        """
        found = {names: tried.evidence for names, tried in self.tried.items()}
        base = self.tried[()]
        for names, tried in self.begun.items():
            found.setdefault(names, tried.evidence._replace(is_fitted=False))
        for names, plain in self.screened.items():
            found.setdefault(names, Evidence(plain, base.spread.log_evidence + plain - base.plain, is_fitted=False))
        if self.untried:
            # Of what was not tried it is not known that it leaves anything unnamed.
            unnamed = max(one.spread.log_evidence for one in self.tried.values())
            most = max(unnamed + raised, *(one.plain for one in self.tried.values()))
            bound = Evidence(most, unnamed, is_fitted=False, is_untried=True)
            found.update({names: bound for names in self.untried if names not in found})
        return found

    def posterior(self) -> Posterior:
        """The posterior of all that was tried, from the training data alone and without curves."""
        return posterior_of(self.rivals, self.table())

    def _log_weight(self, names: Set) -> float:
        """Ln of prior times evidence of a fitted set, whatever acts beside it."""
        return self._log_weight_of(names, self.tried[names] if names in self.tried else self.begun[names])

    def _log_weight_of(self, names: Set, tried: Tried) -> float:
        """Ln of prior times evidence of a set by one of its fits."""
        plain, unnamed = self.rivals.log_prior(names)
        return float(np.logaddexp(plain + tried.plain, unnamed + tried.spread.log_evidence))

    def unnamed_beside(self, names: Set) -> float:
        """Probability that something unnamed acts beside a fitted set, were it the only one."""
        return self.rivals.unnamed_beside(names, self.tried[names].evidence)

    def best(self, size: int) -> Set | None:
        """The most probable fitted set of a size."""
        sized = [names for names in self.tried if len(names) == size]
        return max(sized, key=self._log_weight, default=None)

    # -- the search ----------------------------------------------------------------------------------------------------

    def run(self, *, is_full: bool = False) -> None:
        """Fit what the table of this module says, as far as the work goes.

        Args:
            is_full: whether every single is fitted where the declared model leaves nothing to be found, too.

        Raises:
            SimulationError: the declared model cannot be simulated.
        """
        try:
            if () not in self.tried:
                self.fit_declared()
            if self.problem.errors is not None and self.unnamed_beside(()) > EVEN:
                self._forget_errors()
            if is_full:
                self._fit_all([(name,) for name in self._names], ())
            for size in range(LARGEST_SET):
                base = self.best(size)
                if base is None or self._is_led_by_curve(base):
                    break
                goes_on = self._extend(base)
                if self._learn_errors(everything=is_full):
                    goes_on = self._extend(base)
                if not goes_on:
                    break
            self._refit_near()
        except OutOfWorkError:
            pass

    def _is_led_by_curve(self, base: Set) -> bool:
        """Whether a smooth curve explains more than a set of two names or more, beside which something unnamed acts.

        Further names would only imitate it.
        """
        if len(base) < 2 or self.unnamed_beside(base) < EVEN:
            return False
        curves = [Linearised(entry.fit).integrated for entry in self.curves]
        return max(curves, default=-math.inf) > self.tried[base].spread.log_evidence + NEAR

    @functools.cached_property
    def curves(self) -> list[NonparametricFit]:
        """Smooth curves beside the declared model."""
        return competing_curves(self.tried[()].fit, self._say)

    def fit_declared(self) -> None:
        """Fit the declared model, with and without errors of the stamps; whatever work is left.

        Raises:
            SimulationError: it cannot be simulated.
        """
        self._say("the declared model", 0.0)
        self.tried[()] = self._tried(())

    def fit(self, names: Set, *, polish: bool = False) -> Fit:
        """The best fit of a set without a discrepancy, from several starts; polished, from around that, too.

        Raises:
            SimulationError: the machine cannot be simulated from any start.
        """
        if names not in self.tried:
            self.tried[names] = self._tried(names)
        if polish:
            self._polish(names)
        return self.tried[names].fit

    def _forget_errors(self) -> None:
        """Use errors of the recordings that were estimated beside another set than {}, which lacks something."""
        self._go_on_with(with_forgotten_errors(self.problem, self.tried[()].fit.values))
        self.fit_declared()

    def _learn_errors(self, *, everything: bool) -> bool:
        """Learn the recordings' errors beside the most probable set, and fit again with these what may come near.

        Args:
            everything: whether everything is fitted again.

        Returns:
            Whether they explain more and leave nothing unnamed: beside something unnamed large errors imitate that.
        """
        best = max(self.tried, key=self._log_weight)
        if self.problem.errors is None or not best:
            return False
        try:
            result = self._with_learned_errors(best)
        except SimulationError:
            return False
        found = self._weighed(best, [result])
        gain = self._log_weight_of(best, found) - self._log_weight(best)
        if gain < WORTH_LEARNING or self.rivals.unnamed_beside(best, found.evidence) > EVEN:
            return False
        # Others may gain as much.
        least = -math.inf if everything else self._log_weight(best) - NEAR - gain
        near = [names for names in (*self.tried, *self.begun) if self._log_weight(names) > least]
        self._go_on_with(result.problem)
        self.tried[best] = found
        # It says whether stamps err, which is asked for all others.
        self.tried[()] = self._fitted_again(())
        due = [names for names in near if names not in ((), best)]
        self.tried.update(zip(due, run_parallel(self._fitted_again, due), strict=True))
        for names in due:
            self.begun.pop(names, None)
        return True

    def _with_learned_errors(self, names: Set) -> Fit:
        """A fitted set with errors of the recordings as large as they are beside it, those of the machine among them.

        Raises:
            SimulationError: it cannot be simulated with these.
        """
        known = self.tried[names].fit
        stamps = tuple(own for own in known.nuisances if own in self.problem.plant.timing_errors)

        def fitted(problem: Problem, begun: Fit | None) -> Fit:
            start = known if begun is None else begun
            nuisances = (*problem.nuisances, *stamps)
            return fit(problem, known.free, start.values, nuisances=nuisances, effort=SolverOptions(is_near=True))

        return with_learned_errors(self.problem, fitted, known)[1]

    def _go_on_with(self, problem: Problem) -> None:
        """Fit further sets with other errors of the recordings, beside which errors of the stamps are tested again."""
        self.problem, self._cost_of = problem, _costs_of(problem)
        self.stamps = bool(problem.plant.timing_errors)
        self.__dict__.pop("curves", None)

    def _fitted_again(self, names: Set) -> Tried:
        """A set fitted with the errors of the recordings that others have now, from where it ended and from its starts.

        From its starts only the declared model is: all else is compared with it.
        """
        known = self.tried[names] if names in self.tried else self.begun[names]
        done = self._best_of(names, [known.fit.values, *(self._starts(names) if not names else [])], SolverOptions())
        return self._weighed(names, done) if done else known

    def settled(self, result: Fit, sizes: Array | None = None) -> Fit:
        """A fit of this search, made again with the errors of the recordings that suit it.

        Args:
            result: the fit. sizes: (g,) of the errors; default the most probable beside it.
        """
        errors = result.problem.errors
        if errors is None:
            return result
        sizes = Linearised(result).best_sizes if sizes is None else sizes
        if np.max(np.abs(np.log(sizes / errors.sizes)), initial=0.0) < SETTLED:
            return result
        problem = result.problem.with_errors(errors.resized(sizes))
        plain = [own for own in result.nuisances if not own.group]
        nuisances = (*plain, *(own for own in problem.nuisances if own.group))
        try:
            return fit(problem, result.free, result.values, nuisances=nuisances, effort=SolverOptions(is_near=True))
        except SimulationError:
            return result

    def _extend(self, base: Set) -> bool:
        """Fit a set with each addition that may gain, then swap members of the best; whether to go on from there."""
        names = [name for name in self._names if name not in base]
        explains_all = self.unnamed_beside(base) < EVEN
        if explains_all:
            gains = self._gains(base)
            promising = [name for name in names if gains.get(name, -math.inf) > math.log(PROMISING)]
            if not base:
                rivals = self._rivals_of_errors()
                promising += [name for name in names if name not in promising and name in rivals]
                self._screen(gains, promising)
            names = promising
        self._fit_all([_added(base, name) for name in names], base if explains_all else None)
        best = self.best(len(base) + 1)
        if best is None:
            return False
        self._polish(best)
        self._refit_contained(base, best)
        self._fit_look_alikes(best)
        if (explains_all or base) and self._log_weight(best) < self._log_weight(base):
            return False
        if len(best) > 1 and self.unnamed_beside(best) < EVEN:
            self._fit_all(list(self._swapped(best)), best)
        return True

    def _fit_look_alikes(self, best: Set) -> None:
        """Fit the look-alikes of the best set's members, each from the fit of the best set."""
        effects, values = self.problem.plant.effects, self.tried[best].fit.values
        due: dict[Set, str] = {}
        for member in best:
            for other in effects[member].confused_with:
                names = _added(_without(best, member), other)
                if other in self._names and other not in best and names not in self.tried:
                    due[names] = other

        # What lags behind by more cannot come near, whatever the volumes are.
        goal = self.tried[best].fit.chi2 + 4.0 * NEAR

        def fitted(names: Set) -> Tried | None:
            starts = [{**values, **start} for start in effect_starts(self._cost, effects[due[names]], values)]
            # Not the nuisances of the best set: its effects may stand for declared values, which are missing there.
            done = self._best_of(names, starts, SolverOptions(goal=goal))
            return self._weighed(names, done) if done else None

        for names, found in zip(due, run_parallel(fitted, list(due)), strict=True):
            if found is not None and found.fit.chi2_lower_bound <= goal:
                self.tried[names] = found
            elif found is not None:
                self.begun.setdefault(names, found)

    def _refit_contained(self, base: Set, best: Set) -> None:
        """Fit a set again from where a larger one ended: with more free, a fit leaves some local minima."""
        if not set(base) <= set(best):
            return
        done = self._best_of(base, [self.tried[best].fit.values], SolverOptions())
        found = self._weighed(base, done) if done else self.tried[base]
        if found.plain > self.tried[base].plain + WORTH_KEEPING:
            self.tried[base] = found

    def _polish(self, names: Set) -> None:
        """Fit the best set again from other shapes and from around where it ended: contacts make local minima."""
        tried = self.tried[names]
        starts = [
            {**tried.fit.values, **start}
            for name in names
            for start in starts_of_other_shapes(self.problem.plant.effects[name])
        ]
        starts += scattered_starts(tried.fit, SCATTER)
        found = run_parallel(lambda start: self._attempt(names, tried.fit.nuisances, start, SolverOptions()), starts)
        fits = [one for one in found if one is not None and one.chi2 < tried.fit.chi2 - WORTH_KEEPING]
        if fits:
            self.tried[names] = self._weighed(names, [min(fits, key=lambda one: one.chi2)])

    def _rivals_of_errors(self) -> list[str]:
        """Names that would explain as much as those errors of the recordings that act on the machine.

        Beside such an error the tangent of what it imitates shows little: a source that sags takes up what a weak drive
        lacks, but for how both bend. So these names are looked for where the error is not there.
        """
        errors, declared = self.problem.errors, self.tried[()]
        if errors is None or not errors.nuisances:
            return []
        try:
            without = fit_of_declared(self.problem.with_errors(errors.without_varying()), declared.fit)
        except SimulationError:
            return []
        explained = declared.plain - Linearised(without).integrated
        prior = self.rivals.log_prior(())[0]
        return [
            name
            for name, gain in log_gains(without).items()
            if gain + self.rivals.log_prior((name,))[0] - prior > TANGENT * explained + math.log(PROMISING)
        ]

    def _screen(self, gains: Mapping[str, float], promising: Sequence[str]) -> None:
        """Note what the score test says of single effects that are not fitted."""
        prior = self.rivals.log_prior(())[0]
        for name in gains.keys() - set(promising):
            self.screened[(name,)] = self.tried[()].plain + gains[name] + prior - self.rivals.log_prior((name,))[0]

    @functools.cached_property
    def _names(self) -> list[str]:
        """The names of which sets are made: all except declared values that the data do not show."""
        gains, effects = self._gains(()), self.problem.plant.effects
        return [
            name for name, choice in effects.items() if not choice.is_declared or math.isfinite(gains.get(name, 0.0))
        ]

    def _gains(self, base: Set) -> dict[str, float]:
        """Ln of the odds of each addition to a fitted set, by the score test."""
        log_prior = self.rivals.log_prior(base)[0]
        found = log_gains(self.tried[base].fit)
        return {
            name: gain + self.rivals.log_prior(_added(base, name))[0] - log_prior
            for name, gain in found.items()
            if name not in base
        }

    def _swapped(self, best: Set) -> Iterable[Set]:
        for member in best:
            rest = tuple(name for name in best if name != member)
            for name in self._names:
                if name not in best:
                    yield _added(rest, name)

    def _fit_all(self, sets: Sequence[Set], reference: Set | None) -> None:
        """Fit sets, those excepted that are begun and cannot come near the best of them or near a reference.

        Args:
            sets: of one size. reference: a fitted set that explains all there is; None where none does.

        Raises:
            OutOfWorkError: the work is used up; what was due is in `untried`.
        """
        known = {*self.tried, *self.begun, *self.impossible}
        due = [names for names in dict.fromkeys(sets) if names not in known]
        fits: dict[Set, list[Fit]] = {}
        for batch in _batches(due):
            if self.problem.budget.is_used_up:
                self.untried.extend(names for names in due if names not in fits)
                break
            found = run_parallel(self._begun, batch, lambda names: self._say(words(names), self._done))
            fits.update(zip(batch, found, strict=True))
        self.impossible.extend(names for names, own in fits.items() if not own)
        begun = {names: own for names, own in fits.items() if own}
        promise = {names: max(map(_promise, own)) for names, own in begun.items()}
        # A promise may be broken: what is left behind lags behind what was reached.
        reached = [one.log_evidence for own in begun.values() for one in own]
        most = max([*reached, *([self.tried[reference].plain] if reference is not None else [])], default=0.0)
        if reference is None:
            # Beside something unnamed plain evidence orders nothing.
            self._weigh(begun)
            worth = {names: self._log_weight(names) for names in begun}
            most_worth = max(worth.values(), default=0.0)
            kept = [names for names in begun if promise[names] > most - NEAR or worth[names] > most_worth - NEAR]
        else:
            kept = [names for names in begun if promise[names] > most - NEAR]
            self._weigh({names: own for names, own in begun.items() if names not in kept})
        for batch in _batches(kept):
            done = run_parallel(lambda names: self._ended(names, begun[names]), batch)
            self.tried.update(zip(batch, done, strict=True))
        if self.untried:
            raise OutOfWorkError("the work is used up")

    def _weigh(self, begun: Mapping[Set, Sequence[Fit]]) -> None:
        """Note the evidence that unfinished fits of sets have reached."""
        done = run_parallel(lambda names: self._weighed(names, begun[names]), list(begun))
        self.begun.update(zip(begun, done, strict=True))

    @property
    def _done(self) -> float:
        """Fraction of the work that is done, or of what a search of pairs usually takes."""
        budget = self.problem.budget
        return min(0.9, budget.spent / min(budget.strokes, USUAL_WORK))

    # -- fits ----------------------------------------------------------------------------------------------------------

    def _variants(self) -> list[tuple[Nuisance, ...]]:
        """Nuisances without, and with, errors of the commands' stamps where these gain."""
        plant = self.problem.plant
        plain = self.problem.nuisances
        return [plain, (*plain, *plant.timing_errors)] if self.stamps else [plain]

    def _tried(self, names: Set) -> Tried:
        fits = self._begun(names)
        if not fits:
            raise SimulationError(f"{words(names)}: the model cannot be simulated from any start of the fit")
        return self._ended(names, fits)

    def _begun(self, names: Set) -> list[Fit]:
        """The best begun fit of each variant; none where the machine cannot be simulated."""
        # All else is compared with the declared model, which is worth a whole fit from each start.
        return self._best_of(names, self._starts(names), SolverOptions(most=TRIAL) if names else SolverOptions())

    def _best_of(self, names: Set, starts: Sequence[Mapping[str, float]], effort: SolverOptions) -> list[Fit]:
        """The best fit of each variant from several starts; none where the machine cannot be simulated."""
        found = []
        for nuisances in self._variants():
            tried = [self._attempt(names, nuisances, start, effort) for start in starts]
            fits = [one for one in tried if one is not None]
            if fits:
                found.append(min(fits, key=lambda one: one.chi2))
        return found

    def _ended(self, names: Set, begun: Sequence[Fit]) -> Tried:
        """Fits carried to their end, with their evidence."""
        done = []
        for one in begun:
            if one.converged:
                done.append(one)
            else:
                done.append(self._attempt(names, one.nuisances, one, SolverOptions(made=TRIAL)) or one)
        return self._weighed(names, done)

    def _weighed(self, names: Set, done: Sequence[Fit]) -> Tried:
        """Fits with and without errors of the stamps, with their evidence."""
        if not names and len(done) > 1:
            # Without any effect it shows whether stamps err: where they do not, errors of theirs only cost power.
            self.stamps = done[1].log_evidence > done[0].log_evidence - math.log(1.0 / PROMISING)
        # Both are as probable before, whether both were fitted or not: sets are compared.
        prior = -math.log(2.0) if self.problem.plant.timing_errors else 0.0
        # What lies beyond the range of a name is claimed by another name, and is not its evidence.
        allowed = [one for one in done if self._may_be_claimed(names, one)]
        prior, done = (prior, allowed) if allowed else (-math.inf, done)
        models = [Linearised(one) for one in done]
        plains = [model.integrated for model in models]
        best, plain = done[int(np.argmax(plains))], float(np.logaddexp.reduce(plains)) + prior
        spreads = [self.discrepancy.spread(model) for model in models]
        total = float(np.logaddexp.reduce([one.log_evidence + prior for one in spreads]))
        leading = int(np.argmax([one.log_evidence for one in spreads]))
        return Tried(best, plain, done[leading], spreads[leading]._replace(log_evidence=total))

    def _refit_near(self) -> None:
        """Fit the sets near the best again beside a discrepancy, where it changes their fits."""
        if self.posterior().unnamed < PROMISING:
            return
        least = max(map(self._log_weight, self.tried)) - REFITTED
        near = [names for names in self.tried if self._log_weight(names) > least]
        found = run_parallel(self._beside, near, lambda names: self._say(words(names), 0.9))
        self.tried.update(zip(near, found, strict=True))

    def _beside(self, names: Set) -> Tried:
        """A set with its fit beside the most probable discrepancy."""
        tried = self.tried[names]
        for _ in range(2):
            cell = tried.spread.cell
            if cell.size <= LINEAR:
                break
            whitening = self._whitening(cell)
            problem = self.problem.with_whitening(whitening)
            try:
                found = fit(
                    problem, tried.beside.free, tried.beside.values, nuisances=tried.beside.nuisances,
                    effort=SolverOptions(is_near=True),
                )  # fmt: skip
            except SimulationError:
                break
            spread = self.discrepancy.spread(Linearised(found))
            tried = Tried(tried.fit, tried.plain, found, spread)
            if spread.cell == cell:
                break
        return tried

    def _whitening(self, cell: Cell) -> Callable[[np.ndarray], np.ndarray]:
        return lambda rows: self.discrepancy.whiten(rows, cell)

    def _starts(self, names: Set) -> list[Mapping[str, float]]:
        """Where fits of a set start: from the best smaller set that was fitted, and from all else as declared."""
        plant = self.problem.plant
        if not names:
            tripled = {name: 3.0 * plant.declared(name) for name in plant.base}
            return [{}, tripled] if plant.base else [{}]
        smaller = [(name, rest) for name in names if (rest := _without(names, name)) in self.tried]
        added, rest = max(smaller, key=lambda pair: self._log_weight(pair[1])) if smaller else (names[-1], ())
        effect: EffectChoice = plant.effects[added]
        warm = self.tried[rest].fit.values
        starts: list[Mapping[str, float]] = [{**warm, **start} for start in effect_starts(self._cost, effect, warm)]
        free = [*itertools.chain(*(plant.effects[name].free_names() for name in rest))]
        known = {name: warm[name] for name in free}
        starts += starts_from_declared(self._cost, effect, known)
        return starts + ([{**warm, **effect.start}] if effect.start else [])

    def _cost(self, values: Mapping[str, float]) -> float:
        """The cost by which starts are ranked."""
        return self._cost_of(tuple(sorted(values.items())))

    def _attempt(
        self, names: Set, nuisances: Sequence[Nuisance], start: Mapping[str, float] | Fit, effort: SolverOptions
    ) -> Fit | None:
        """A fit from one start; none where the machine cannot be simulated."""
        try:
            return fit(self.problem, self.free_names(names), start, nuisances=nuisances, effort=effort)
        except SimulationError:
            return None

    def _may_be_claimed(self, names: Set, result: Fit) -> bool:
        """Whether the values of a fit are within the range in which an effect bears its name."""
        choices = [self.problem.plant.effects[name] for name in names]
        found = [(own, result.values[choice.free_name(own)]) for choice in choices for own in choice.parameters]
        return all(own.lower <= value <= own.upper for own, value in found)

    def free_names(self, names: Set) -> tuple[str, ...]:
        """The parameters that a set frees."""
        plant = self.problem.plant
        return (*plant.base, *itertools.chain(*(plant.effects[name].free_names() for name in names)))


def fit_of_declared(problem: Problem, begun: Fit | None) -> Fit:
    """The declared model, refitted with errors of the commands' stamps where the evidence is for them.

    Args:
        problem: data and noise. begun: a fit of it that ended nearby, if any.
    """
    plant = problem.plant
    start, effort = ({}, SolverOptions()) if begun is None else (begun.values, SolverOptions(is_near=True))
    best = fit(problem, plant.base, start, nuisances=problem.nuisances, effort=effort)
    if not plant.timing_errors:
        return best
    every = (*problem.nuisances, *plant.timing_errors)
    stamped = fit(problem, plant.base, best.values if begun is None else start, nuisances=every, effort=effort)
    return max(best, stamped, key=lambda one: one.log_evidence)


def _costs_of(problem: Problem) -> Memo[tuple[tuple[str, float], ...], float]:
    """The key by which starts are sorted: names and values in order."""
    return Memo(lambda key: robust_cost(problem, dict(key)))


def words(names: Set) -> str:
    """A set in words."""
    return titles_of(names) if names else "the declared model"


def _promise(result: Fit) -> float:
    """The largest ln p that an unfinished fit may reach."""
    return (
        result.log_evidence
        if result.converged
        else result.log_evidence + 0.5 * max(0.0, result.chi2 - result.chi2_lower_bound)
    )


def _added(names: Set, name: str) -> Set:
    return tuple(sorted((*names, name)))


def _without(names: Set, name: str) -> Set:
    return tuple(other for other in names if other != name)


def _batches(sets: Sequence[Set]) -> Iterable[Sequence[Set]]:
    return (sets[start : start + BATCH] for start in range(0, len(sets), BATCH))
