"""Which sets of hypotheses are fitted, in which order: theory, section 8.

    fit {}, and learn the errors of the recordings beside it
    for sizes 0 to 3:
        B = the most probable set of that size
        fit B with each addition that the score test finds promising; with each, where something unnamed acts beside B;
        sets that are nearly as probable as B with what the score test finds beside them
            the best again from other shapes and around; sets within it from where it ended
            its look-alikes; its members swapped
        stop where none is more probable than B, or where a smooth curve explains more than two names
        learn the errors again beside the best; where that explains more: fit again what may come near
        of size 1, and where something is left: let an effect change from stroke to stroke
    fit what is near the best again beside a process, where something unnamed may act
    the force that has no name: beside what is near the best, and in place of all names

Work is counted in simulated strokes, never by a clock, so that a busy machine finds what a quiet one does. What it
would still have fitted when the work is used up is left in the table with the best evidence found.
"""

from __future__ import annotations

import math
from collections.abc import Callable, Iterable, Mapping
from dataclasses import replace
from functools import cached_property
from typing import Final

import numpy as np

from valve_sim.identification.fit import forces
from valve_sim.identification.fit.budget import OutOfWorkError
from valve_sim.identification.fit.descent import Descended
from valve_sim.identification.fit.fitter import Fitter, Tried
from valve_sim.identification.fit.model import Model
from valve_sim.identification.fit.posterior import EVEN, Evidence, Posterior, Set, posterior_of, rivals_of
from valve_sim.identification.fit.problem import Problem
from valve_sim.identification.fit.score_test import log_gains
from valve_sim.identification.fit.starts import Start, polished, robust_cost, starts_of
from valve_sim.identification.plants.effect_titles import titles_of
from valve_sim.model import SimulationError

LARGEST_SET: Final = 4
"""Names in a set: larger ones decided nothing in 153 recordings."""
PROMISING: Final = 0.02
"""Odds to the declared model, by the score test, from which an effect is fitted."""
FURTHER: Final = 0.2
"""The same beside names, which determine what is left: there the score test of so little is as good as a fit."""
IN_PLACE: Final = 0.25
"""Share of what a member gains in ln p, by which another name in its place must gain by the score test to be fitted."""
DOUBTFUL: Final = 0.02
"""Probability of something unnamed, from which it is weighed in all that follows."""
NEAR: Final = 25.0
"""Difference in ln p by which a set may lag behind the best of its size before it is given up."""
REFITTED: Final = 10.0
"""Difference in ln p from the best, within which sets are fitted again beside a process."""
RIVALS: Final = 5.0
"""Difference in ln p from the best set of a size, within which others are added to."""
FORCED: Final = 3
"""Sets that lead, beside which a force without a name is weighed."""
MOST_RIVALS: Final = 4
"""Sets of a size that are added to, the best among them."""
WORTH_LEARNING: Final = 1.0
"""Gain in ln p by newly learned errors of the recordings, from which sets are fitted again with these."""
WORTH_A_CHANGE: Final = 5.0
"""Gain in ln p over all other sets, from which an effect changes over the strokes: odds of one to a hundred and fifty
before the data are asked."""
CHANGES: Final = 5
"""Effects, which by a change over the strokes would explain most to first order, that are fitted so."""
WORTH_KEEPING: Final = 0.1
"""Smallest difference of the criterion by which a fit counts as better."""
TRIAL: Final = 6
"""Linearisations that each start of a set is given before the best of them goes on."""
USUAL_WORK: Final = 100_000.0
"""Simulated strokes that count as the whole in the display of progress where the work has no limit."""

Progress = Callable[[str, float], None]


class Search:
    """Fits sets to one problem, and keeps what they are worth.

    Args:
        problem: data and noise. progress: told what is being tried, and the fraction done.
        held, reads_at_rest: see `Fitter`.

    Attributes:
        tried: by set. begun: sets that were given up. untried: sets that were due when the work was used up.
        impossible: why sets cannot be simulated. forced: ln p of sets with a force that has no name.
    """

    def __init__(
        self, problem: Problem, progress: Progress | None = None, held: Mapping[str, float] | None = None, *,
        reads_at_rest: bool = True,
    ) -> None:  # fmt: skip
        self.rivals = rivals_of(problem.plant)
        self.fitter = Fitter(problem, self.rivals, held, reads_at_rest=reads_at_rest)
        self._say = progress or (lambda what, fraction: None)
        self.tried: dict[Set, Tried] = {}
        self.begun: dict[Set, Tried] = {}
        self.screened: dict[Set, Evidence] = {}
        self.untried: list[Set] = []
        self.impossible: dict[Set, str] = {}
        self.forced: dict[Set, float] = {}
        self._started: dict[Set, list[Start]] = {}

    @property
    def problem(self) -> Problem:
        """Data and noise, with the errors of the recordings."""
        return self.fitter.problem

    # -- the table -----------------------------------------------------------------------------------------------------

    def table(self, raised: float = 0.0) -> dict[Set, Evidence]:
        """The evidence of all that was tried.

        Args:
            raised: ln of the factor by which held-out data raise the odds of something unnamed.
        """
        begun = {names: one.evidence for names, one in self.begun.items()}
        tried = {
            names: one.evidence._replace(forced=self.forced.get(names, -math.inf)) for names, one in self.tried.items()
        }
        found = {**self.screened, **begun, **tried}
        plain = max(one.plain for one in found.values())
        unnamed = max(one.unnamed for one in found.values()) + raised
        bound = {names: Evidence(plain, unnamed, is_fitted=False, is_untried=True) for names in self.untried}
        return {**bound, **found}

    def posterior(self) -> Posterior:
        """The posterior of the training data alone."""
        return posterior_of(self.rivals, self.table())

    def log_weight_of(self, names: Set, tried: Tried) -> float:
        """Ln of prior times evidence, something unnamed beside it included."""
        plain, unnamed = self.rivals.log_prior(names)
        return float(np.logaddexp(plain + tried.plain, unnamed + tried.spread.log_evidence))

    def log_weight(self, names: Set) -> float:
        """The same of a set that was fitted or begun."""
        return self.log_weight_of(names, self.tried[names] if names in self.tried else self.begun[names])

    def unnamed_beside(self, names: Set) -> float:
        """Probability that something unnamed acts beside a set, were it the only one that is possible."""
        return self.rivals.unnamed_beside(names, self.tried[names].evidence)

    def best(self, size: int) -> Set | None:
        """The most probable set of a size; None where none was fitted."""
        return max((names for names in self.tried if len(names) == size), key=self.log_weight, default=None)

    # -- the order -----------------------------------------------------------------------------------------------------

    def fit_declared(self) -> None:
        """Fit the declared model.

        Raises:
            SimulationError: it cannot be simulated from any start.
        """
        self._say("the declared model", 0.0)
        self.tried[()] = self.fitter.fitted_declared()

    def run(self, *, is_full: bool = False) -> None:
        """Search.

        Args:
            is_full: whether every effect is fitted where the declared model leaves nothing to be found, too.

        Raises:
            SimulationError: the declared model cannot be simulated.
        """
        if () not in self.tried:
            self.fit_declared()
        self.forced.clear()
        try:
            for size in range(LARGEST_SET):
                base = self.best(size)
                goes_on = base is not None and not self._is_led_by_curve(base) and self._extend(base, is_full=is_full)
                self._learn_errors()
                if size == 0 and base is not None and self.unnamed_beside(self.best(1) or base) > DOUBTFUL:
                    self._change_over_strokes()
                self._beside_look_alikes(max(self.tried, key=self.log_weight))
                if not goes_on:
                    break
            if self.posterior().unnamed > DOUBTFUL:
                least = max(map(self.log_weight, self.tried)) - REFITTED
                for names in [names for names in self.tried if self.log_weight(names) > least]:
                    self._say(words(names), self._done)
                    self.tried[names] = self.fitter.beside(names, self.tried[names])
            self._weigh_forces()
        except OutOfWorkError:
            return

    def _weigh_forces(self) -> None:
        """What the sets that lead are worth with a force that has no name, and such a force in place of all names."""
        if not self.fitter.curves:
            return
        leading = sorted(self.tried, key=self.log_weight)[-FORCED:]
        near = [names for names in reversed(leading) if forces.is_near(self.tried[names])]
        beside = forces.forces_beside(self.fitter, self.tried[near[0]]) if near else []
        for names in near:
            self._say(f"{words(names)}, and an unmodelled force", self._done)
            self.forced[names] = forces.log_evidence_beside(self.fitter, self.tried[names], beside)
        if leading[-1]:
            # Far from the data a curve has to be fitted.
            goal = self.tried[near[0]].fit.cost + 2.0 * NEAR if near else math.inf
            logs = [one.plain for one in (self.fitted_curves(goal) if near else self.curves).values()]
            alone = float(np.logaddexp.reduce(logs)) - math.log(len(self.fitter.curves)) if logs else -math.inf
            self.forced[()] = max(alone, self.forced.get((), -math.inf))

    def _extend(self, base: Set, *, is_full: bool) -> bool:
        """Add names to a set; whether to go on from there."""
        is_all = self.unnamed_beside(base) < EVEN
        gains = self.gains(base)
        least = math.log(FURTHER if base else PROMISING) if base or not is_full else -math.inf
        promising = [
            name for name, gain in gains.items() if (not is_all or gain > least) and self._may_show(name, gain)
        ]
        if is_all:
            self._screen(base, gains, promising)
        promising.sort(key=lambda name: -gains[name])
        sets = [*(added(base, name) for name in promising), *self._beside_rivals(base)]
        if not sets:
            return False
        self._fit_all(sets)
        if not is_all:
            self._try_beside_plainest(base)
        best = self.best(len(base) + 1)
        if best is None:
            return False
        self._again(base, self.tried[best].values)
        best = self._beside_look_alikes(best)
        self._polish(best)
        for rest in (without(best, member) for member in best):
            if rest in self.tried:
                self._again(rest, self.tried[best].values)
        if self.log_weight(best) < self.log_weight(base):
            return False
        if self.unnamed_beside(best) < EVEN and len(best) > 1:
            self._fit_all([names for member in best for names in self._in_place_of(member, best)])
            self._beside_look_alikes(self.best(len(best)) or best)
        return True

    def _in_place_of(self, member: str, best: Set) -> list[Set]:
        """The best set with another name for one of its members, which the score test finds beside the others."""
        rest = without(best, member)
        if rest in self.impossible:
            return []
        if rest not in self.tried:
            fit = self.fitter.descended(self.fitter.model(rest), self.tried[best].values)
            if fit is None:
                return []
            self.begun.pop(rest, None)
            self.tried[rest] = self.fitter.weighed(rest, fit)
        least = IN_PLACE * (self.log_weight(best) - self.log_weight(rest)) + math.log(FURTHER)
        return [added(rest, name) for name, gain in self.gains(rest).items() if name != member and gain > least]

    def _beside_look_alikes(self, best: Set) -> Set:
        """The best set of a size, when none that looks like it is better."""
        while True:
            self._fit_all(self._look_alikes(best))
            other = self.best(len(best)) or best
            if other == best:
                return best
            best = other

    def _beside_rivals(self, base: Set) -> list[Set]:
        """What the score test finds beside sets that are about as probable as the best of their size."""
        least = self.log_weight(base) - RIVALS
        near = [names for names in self.tried if len(names) == len(base) and self.log_weight(names) > least]
        near = sorted(near, key=self.log_weight)[-MOST_RIVALS:]
        return [
            added(names, name)
            for names in near
            if names != base
            for name, gain in self.gains(names).items()
            if gain > 0.0
        ]

    def _try_beside_plainest(self, base: Set) -> None:
        """Fit what may act beside the set that explains most by itself, and keep it if that is far better.

        (A sensor's delay beside a force leaves more than saturation does, for whose remainder a process makes up. Where
        it is not, more sets that fit well by chance only hide which one predicts.)
        """
        alike = [names for names in self.tried if len(names) == len(base)]
        plainest = max(alike, key=lambda own: self.tried[own].plain)
        if plainest == base:
            return
        known, gains = set(self.tried), self.gains(plainest)
        self._fit_all((added(plainest, name) for name in gains if gains[name] > 0.0), plainly=True)
        new = self.tried.keys() - known
        rest = max((self.log_weight(own) for own in known if len(own) > len(base)), default=-math.inf)
        if max(map(self.log_weight, new), default=math.inf) < rest + NEAR:
            self.begun |= {names: replace(self.tried.pop(names), is_fitted=False) for names in new}

    def _may_show(self, name: str, gain: float) -> bool:
        """Whether the data show a hypothesis at all: of a declared value they may say nothing."""
        return math.isfinite(gain) or not self.fitter.hypotheses[name].is_declared_value

    def _look_alikes(self, best: Set) -> list[Set]:
        known = self.fitter.hypotheses
        return [
            added(without(best, member), other)
            for member in best
            for other in known[member].confused_with
            if other in known and other not in best
        ]

    def gains(self, base: Set) -> dict[str, float]:
        """Ln of the odds of each addition to a fitted set, by the score test."""
        prior = self.rivals.log_prior(base)[0]
        found = log_gains(self.fitter, base, self.tried[base])
        return {name: gain + self.rivals.log_prior(added(base, name))[0] - prior for name, gain in found.items()}

    def _screen(self, base: Set, gains: Mapping[str, float], promising: list[str]) -> None:
        """Note what the score test says of additions that are not fitted."""
        known, prior = self.tried[base], self.rivals.log_prior(base)[0]
        for name in gains.keys() - set(promising):
            names = added(base, name)
            gain = gains[name] + prior - self.rivals.log_prior(names)[0]
            self.screened[names] = Evidence(known.plain + gain, known.spread.log_evidence + gain, is_fitted=False)

    def _fit_all(self, sets: Iterable[Set], *, plainly: bool = False) -> None:
        """Fit sets of one size, the promising first; those that cannot come near the best of them are given up.

        Args:
            sets: of a size. plainly: whether the best is that without something unnamed, though that acts.

        Raises:
            OutOfWorkError: the work is used up; what was due is in `untried`.
        """
        known = {*self.tried, *self.begun, *self.impossible}
        due = [names for names in dict.fromkeys(sets) if names not in known]
        # Beside something unnamed, what does not come near may yet be near.
        spreads = self.unnamed_beside(()) > DOUBTFUL
        budget, starts = self.problem.budget, dict[Set, list[Start]]()
        for names in due:
            if not budget.is_used_up:
                starts[names] = self._started[names] = self._starts(names)
        for names in sorted(starts, key=lambda names: min(one.cost for one in starts[names])):
            if budget.is_used_up:
                break
            self._say(words(names), self._done)
            self._fit_one(names, starts[names], spreads=spreads, plainly=plainly)
        known = {*self.tried, *self.begun, *self.impossible}
        self.untried.extend(names for names in due if names not in known)
        if self.untried:
            raise OutOfWorkError("the work is used up")

    def _fit_one(self, names: Set, starts: list[Start], *, spreads: bool, plainly: bool) -> None:
        """Fit a set, or give it up."""
        best = self.best(len(names))
        explained = best is not None and (plainly or self.unnamed_beside(best) < EVEN)
        goal = math.inf
        if explained:
            goal = min(one.fit.cost for other, one in self.tried.items() if len(other) == len(names)) + 2.0 * NEAR
        model = self.fitter.model(names)
        fits = [self.fitter.descended(model, start.values, most=TRIAL, goal=goal) for start in starts]
        fit = min((one for one in fits if one is not None), key=lambda one: one.cost, default=None)
        if fit is None:
            self.impossible[names] = _why_not(model, starts[0].values)
            return
        if not fit.converged and fit.least < goal:
            fit = self.fitter.descended(model, _values(fit), goal=goal, damping=fit.damping) or fit
        keeps = (fit.converged and fit.cost < goal) or not explained
        found = self.fitter.weighed(names, fit, is_fitted=keeps, spreads=keeps or spreads)
        if not keeps and best is not None and self.log_weight_of(names, found) > self.log_weight(best) - REFITTED:
            # Errors of the recordings that suit it make up for its cost.
            fit, keeps = self.fitter.descended(model, _values(fit)) or fit, True
            found = self.fitter.weighed(names, fit)
        (self.tried if keeps else self.begun)[names] = found

    def _starts(self, names: Set) -> list[Start]:
        """Where fits of a set start: from the best smaller set that was fitted."""
        smaller = [rest for name in names if (rest := without(names, name)) in self.tried]
        rest = max(smaller, key=self.log_weight) if smaller else ()
        if len(rest) != len(names) - 1:
            values = self.tried[()].values
            return [Start(robust_cost(self.fitter.model(names, has_columns=False), values), values)]
        return starts_of(self.fitter, names, rest, self.tried[rest])

    def _again(self, names: Set, values: Mapping[str, float]) -> None:
        """A set once more, from where another one ended."""
        fit = self.fitter.descended(self.fitter.model(names), values)
        if fit is not None and fit.cost < self.tried[names].fit.cost - WORTH_KEEPING:
            self._keep(names, self.fitter.weighed(names, fit))

    def _polish(self, names: Set) -> None:
        """The best set once more from other shapes and from around where it ended."""
        for start in list(polished(self.fitter, names, self.tried[names])):
            fit = self.fitter.descended(self.fitter.model(names), start, goal=self.tried[names].fit.cost)
            if fit is not None and fit.cost < self.tried[names].fit.cost - WORTH_KEEPING:
                self._keep(names, self.fitter.weighed(names, fit))

    def _keep(self, names: Set, tried: Tried) -> None:
        self.tried[names] = tried
        if not names:
            self.fitter.base = tried

    def _learn_errors(self) -> None:
        """Learn the errors again beside the most probable set; fit again what may come near."""
        best = max(self.tried, key=self.log_weight)
        if not best or not self.fitter.learned:
            return
        fitter, fit = self.fitter, self.tried[best].fit
        before = fitter.errors
        if self.unnamed_beside(best) > EVEN:
            fit = fitter.with_modes(best, fit)
        found = fitter.weighed(best, fitter.learn(best, fit))
        gain = self.log_weight_of(best, found) - self.log_weight(best)
        if gain < WORTH_LEARNING or self.rivals.unnamed_beside(best, found.evidence) > EVEN:
            fitter.take(before)
            return
        least = self.log_weight(best) - NEAR - gain
        every = (*self.tried, *self.begun)
        near = [names for names in every if names != best and (not names or self.log_weight(names) > least)]
        self.tried[best] = found
        for names in near:
            known = self.tried[names] if names in self.tried else self.begun.pop(names)
            again = fitter.descended(fitter.model(names), known.values)
            self._keep(names, known if again is None else fitter.weighed(names, again))

    def _change_over_strokes(self) -> None:
        """Let the effect differ from stroke to stroke that then follows them, leaves nothing, and is most probable."""
        fitter, begin = self.fitter, dict[Set, Start]()
        for alone in [names for names in self.tried if len(names) == 1]:
            starts = [self.tried[alone].values, *(start.values for start in self._started[alone])]
            each = [Start(fitter.least_with_change(alone, values, alone[0]), values) for values in starts]
            begin[alone] = min(each, key=lambda start: start.cost)
        most = max(map(self.log_weight, self.tried)) + WORTH_A_CHANGE
        before, best = fitter.errors, None
        promising = [names for names in sorted(begin, key=lambda own: begin[own].cost) if begin[names].cost < math.inf]
        for names in promising[:CHANGES]:
            self._say(f"{words(names)} that changes over the strokes", self._done)
            fit = fitter.with_change(names, begin[names].values, names[0])
            found = None if fit is None else fitter.weighed(names, fit)
            if found is not None and fitter.is_orderly(found):
                weight = self.log_weight_of(names, found)
                if weight > most and self.rivals.unnamed_beside(names, found.evidence) < EVEN:
                    best, most = (names, found, fitter.errors), weight
            fitter.take(before)
        if best is not None:
            self.tried[best[0]] = best[1]
            fitter.take(best[2])

    # -- smooth curves -------------------------------------------------------------------------------------------------

    def _is_led_by_curve(self, base: Set) -> bool:
        """Whether a smooth curve explains more than two names or more, beside which something unnamed acts."""
        if len(base) < 2 or self.unnamed_beside(base) < EVEN:
            return False
        most = max((one.plain for one in self.curves.values()), default=-math.inf)
        return most > self.tried[base].spread.log_evidence + NEAR

    @cached_property
    def curves(self) -> dict[str, Tried]:
        """Smooth curves beside the declared model that stand for something unnamed, by name."""
        return self.fitted_curves()

    def fitted_curves(self, goal: float = math.inf) -> dict[str, Tried]:
        """The same of those that come near a goal for the criterion; not over time, where a curve follows anything."""
        found = {}
        for name in self.fitter.curves:
            if name.startswith("curve(t"):
                continue
            self._say(name, self._done)
            fit = self.fitter.fit_curve(name, (), self.tried[()].values, goal)
            if fit is not None:
                found[name] = self.fitter.weighed((), fit)
        return found

    @property
    def _done(self) -> float:
        """Fraction of the work that is done, or of what a search of pairs usually takes."""
        budget = self.problem.budget
        return min(0.9, budget.spent / min(budget.strokes, USUAL_WORK))


def _values(fit: Descended) -> dict[str, float]:
    return fit.gaussian.model.named(fit.gaussian.z)


def _why_not(model: Model, values: Mapping[str, float]) -> str:
    """Why a set cannot be simulated from a start."""
    try:
        model.linearise(model.at(values))
    except (SimulationError, np.linalg.LinAlgError) as error:
        return str(error)
    return ""


def words(names: Set) -> str:
    """A set in words."""
    return titles_of(names) if names else "the declared model"


def added(names: Set, name: str) -> Set:
    """A set with one name more."""
    return tuple(sorted((*names, name)))


def without(names: Set, name: str) -> Set:
    """A set with one name less."""
    return tuple(other for other in names if other != name)
