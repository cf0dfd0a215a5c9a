"""The search over named effects: every candidate is refitted inside the simulator.

A hypothesis is a set of effects, with or without errors in each command's stamp. Every fit is a row of `FitLog`, and
the best row of a hypothesis is its fit, so that asking twice costs nothing.
"""

from __future__ import annotations

import contextlib
import itertools
import math
from collections.abc import Callable, Iterable, Iterator, Mapping, Sequence
from typing import Final

import numpy as np

from valve_sim.identification.estimation.budget import OutOfTimeError
from valve_sim.identification.estimation.descent import TRIAL, WHOLE, Effort
from valve_sim.identification.estimation.parallel import run_parallel
from valve_sim.identification.estimation.problem import Problem
from valve_sim.identification.estimation.result import Fit
from valve_sim.identification.estimation.solver import fit
from valve_sim.identification.plants.protocol import (
    EffectChoice,
    from_internal,
    internal_bounds,
    internal_scale,
    strokes_of_plant,
)
from valve_sim.identification.selection.starts import (
    effect_starts,
    robust_cost,
    start_nearby,
    starts_from_declared,
    starts_of_other_shapes,
)
from valve_sim.identification.selection.table import FitLog, Hypothesis, Row
from valve_sim.model import SimulationError

ANNEALING: Final = (100.0, 20.0, 5.0)
"""σ: scales of the Cauchy loss, theory, eq. (30), that lead a fit with impacts out of local minima."""
RIVALS: Final = 4
"""Of fits side by side, those that cannot come near this many best are given up."""
NEAR, NEAR_SHARE = 100.0, 0.05
"""How near to the last of these: a difference of S, or a share of what its χ² has beyond noise, the larger of both."""
KEPT: Final = 16
"""Of so many of the best fits the Jacobian is kept."""
SCATTER: Final = (1.0, 3.0, 3.0, 10.0, 10.0, 30.0)
"""Standard errors by which the starts of a polish are scattered."""

Progress = Callable[[str, float], None]


class Search:
    """Fits hypotheses to one problem, and logs the fits.

    Args:
        problem: training data, with the budget of fits to them.
        progress: told what is being tried, and the fraction done.

    Attributes:
        log: every fit, a row each.
        untried: what was to be tried when the time was used up, or cannot be simulated, in words.
    """

    def __init__(self, problem: Problem, progress: Progress | None = None) -> None:
        self.problem = problem
        self.log = FitLog()
        self._progress = progress or (lambda what, fraction: None)
        self.untried: list[str] = []
        self._annealed: set[Hypothesis] = set()
        self._polished: set[Hypothesis] = set()
        self._on_trial: set[Hypothesis] = set()
        self._impossible: set[Hypothesis] = set()
        self._costs: dict[frozenset[tuple[str, float]], float] = {}

    def is_tried(self, hypothesis: Hypothesis) -> bool:
        """Whether a hypothesis was fitted, and not only begun when the time was used up, or cannot be simulated."""
        return hypothesis in self._impossible or (hypothesis in self.log and hypothesis not in self._on_trial)

    def say(self, what: str, fraction: float) -> None:
        """Report progress."""
        self._progress(what, fraction)

    def fit(self, hypothesis: Hypothesis, *, anneal: bool = False) -> Fit:
        """The best fit of a hypothesis, from several starts.

        Raises:
            OutOfTimeError: the time is used up; what was fitted by then is kept.
            SimulationError: the machine cannot be simulated from any start.
        """
        if hypothesis not in self.log:
            self._begin(hypothesis, WHOLE)
            self._end(hypothesis, math.inf)
        if anneal and hypothesis not in self._annealed:
            self._annealed.add(hypothesis)
            self._append(hypothesis, "annealed", dict(self.log[hypothesis].values), Effort(ANNEALING))
        return self.log[hypothesis]

    def fit_each(
        self, hypotheses: Sequence[Hypothesis], fractions: tuple[float, float], rival: Hypothesis | None = None
    ) -> None:
        """Fit hypotheses of equal size in parallel: they start from smaller ones, not from each other.

        All make a few iterations; then those that cannot come near the best few any more are given up. What cannot be
        simulated from any start is left out, and said to be untried.

        Args:
            hypotheses: what to fit.
            fractions: of the diagnosis that are done before and after.
            rival: that was fitted before, and which one of them is to replace: what cannot come near it is given up.
        """
        before, after = fractions
        settled = ({*self.log.best} - self._on_trial) | self._impossible
        new = [hypothesis for hypothesis in dict.fromkeys(hypotheses) if hypothesis not in settled]
        done = {hypothesis: index / len(new) for index, hypothesis in enumerate(new)}
        self.log.expect(new)
        try:
            trial = Effort(most=TRIAL)
            run_parallel(
                lambda h: self._try(h, trial), new, lambda h: self.say(str(h), before + (after - before) * done[h])
            )
            begun = [hypothesis for hypothesis in new if hypothesis not in self._impossible]
            limit = self._limit(begun)
            if rival is not None:
                limit = min(limit, self._near(self.log[rival]))
            run_parallel(lambda h: self._end(h, limit), begun)
        except OutOfTimeError:
            self.untried.extend(str(hypothesis) for hypothesis in new if not self.is_tried(hypothesis))
            raise
        finally:
            # Here, not where it is found out: which of them is first there is a matter of chance.
            self.untried.extend(str(hypothesis) for hypothesis in new if hypothesis in self._impossible)
        self.log.drop_derivatives(KEPT)

    def fit_pointed_at(self, hypotheses: Sequence[Hypothesis], fractions: tuple[float, float]) -> None:
        """Fit hypotheses of one effect each, from where the plant points at alone."""
        effects = self.problem.plant.effects
        self._fit_from(hypotheses, lambda effect: effects[effect].start, WHOLE, fractions)

    def fit_nearby(self, hypotheses: Sequence[Hypothesis], limit: float, fractions: tuple[float, float]) -> None:
        """Fit hypotheses of one effect each from near off alone, and give up what cannot come to a score S any more.

        For where another effect explains all that there is: what may stand in its place has to do so, too.
        """
        effects = self.problem.plant.effects
        # The score is χ² and what the parameters cost.
        effort = Effort(goal=limit * self.problem.variance_inflation, is_near=True)
        self._fit_from(hypotheses, lambda effect: start_nearby(effects[effect]), effort, fractions)

    def begin_from_declared(self, hypotheses: Sequence[Hypothesis], fractions: tuple[float, float]) -> list[Hypothesis]:
        """Begin hypotheses of one effect each from where all else is as declared: the best few that explain much there.

        Returns:
            those begun; of each only this start was tried.
        """
        before, after = fractions
        effects, starts = self.problem.plant.effects, []
        for index, hypothesis in enumerate(hypotheses):
            self.say(str(hypothesis), before + (after - before) * index / len(hypotheses))
            found = starts_from_declared(self._cost, effects[hypothesis.effects[0]], {})
            starts += [(self._cost(start), hypothesis, start) for start in found]
        begun = sorted(starts, key=lambda one: one[0])[:RIVALS]
        self.log.expect([hypothesis for _, hypothesis, _ in begun])
        for _, hypothesis, start in begun:
            self._on_trial.add(hypothesis)
            self._append(hypothesis, "as declared", start)
        return [hypothesis for _, hypothesis, _ in begun if hypothesis in self.log]

    def leave_strokes_out(self, hypothesis: Hypothesis) -> None:
        """Fit again from where the best fit goes if strokes are left out, each in turn.

        A main plunger that lifts in the model and not in the data, or the other way round, holds all values where it
        does so, and no derivative shows that it might not.
        """
        free, nuisances = self.free_names(hypothesis), self.problem.plant.nuisances
        for recording, group in strokes_of_plant(self.problem.plant):
            others = self.problem.without_stroke(recording, group)
            with contextlib.suppress(SimulationError):
                left = fit(others, free, self.log[hypothesis].values, nuisances=nuisances)
                self._append(hypothesis, "a stroke left out", left.values)

    def fit_beside(
        self, best: Hypothesis, hypotheses: Sequence[Hypothesis], limit: float, fractions: tuple[float, float]
    ) -> None:
        """Fit hypotheses of one effect each, from near off and from where another, which explains all, left all else.

        What may stand in its place has to come to a score S as well, and is given up where it cannot any more. The
        declared model is no place to start from: refitted without what explains all it may be far off.
        """
        before, after = fractions
        effects, own = self.problem.plant.effects, self.free_names(best)
        warm = {name: value for name, value in self.log[best].values.items() if name not in own or name in self._base}
        goal = limit * self.problem.variance_inflation  # the score is χ² and what the parameters cost
        done = {hypothesis: index / len(hypotheses) for index, hypothesis in enumerate(hypotheses)}
        self.log.expect(hypotheses)

        def work(hypothesis: Hypothesis) -> None:
            self._on_trial.add(hypothesis)
            effect = effects[hypothesis.effects[0]]
            start = warm if effect.is_declared_value else {**warm, **start_nearby(effect)}
            self._append(hypothesis, "beside the best", start, Effort(goal=goal, most=TRIAL))
            if hypothesis in self.log:
                self._continue(hypothesis, limit)
            else:
                self._impossible.add(hypothesis)
            self._on_trial.discard(hypothesis)

        try:
            run_parallel(work, hypotheses, lambda h: self.say(str(h), before + (after - before) * done[h]))
        finally:
            self._on_trial.discard(best)
            self.untried.extend(str(one) for one in hypotheses if not self.is_tried(one) or one in self._impossible)
        self.log.drop_derivatives(KEPT)

    def _fit_from(
        self,
        hypotheses: Sequence[Hypothesis],
        start_of: Callable[[str], Mapping[str, float]],
        effort: Effort,
        fractions: tuple[float, float],
    ) -> None:
        """Fit hypotheses of one effect each, from one start each beside the declared model's values."""
        before, after = fractions
        warm = self.fit(Hypothesis(())).values
        self.log.expect(hypotheses)
        for index, hypothesis in enumerate(hypotheses):
            self.say(str(hypothesis), before + (after - before) * index / len(hypotheses))
            (effect,) = hypothesis.effects
            self._append(hypothesis, "one start", {**warm, **start_of(effect)}, effort)
            if hypothesis not in self.log:
                self._impossible.add(hypothesis)
                self.untried.append(str(hypothesis))

    def _limit(self, hypotheses: Sequence[Hypothesis]) -> float:
        """The score S that is near enough to those of the best few."""
        if len(hypotheses) <= RIVALS:
            return math.inf
        return self._near(sorted((self.log[one] for one in hypotheses), key=lambda found: found.score)[RIVALS - 1])

    def _near(self, rival: Fit) -> float:
        """The score S that is near enough to that of a fit."""
        beyond_noise = rival.chi2 / self.problem.variance_inflation - self.problem.effective_samples
        return rival.score + max(NEAR, NEAR_SHARE * beyond_noise)

    def _try(self, hypothesis: Hypothesis, effort: Effort) -> None:
        """Begin a hypothesis, or note that it cannot be simulated."""
        try:
            self._begin(hypothesis, effort)
        except SimulationError:
            self._impossible.add(hypothesis)

    def _begin(self, hypothesis: Hypothesis, effort: Effort) -> None:
        """Fit a hypothesis from each start."""
        for start, found in self._fits(hypothesis, effort):
            self.log.append(Row(hypothesis, start, found))
            if not found.converged:
                self._on_trial.add(hypothesis)
        if hypothesis not in self.log:
            raise SimulationError(f"{hypothesis}: the model cannot be simulated from any start of the fit")

    def _end(self, hypothesis: Hypothesis, limit: float) -> None:
        """Go on with fits as below; then try more shapes."""
        self._continue(hypothesis, limit)
        self._try_shapes(hypothesis, limit)
        self._on_trial.discard(hypothesis)

    def _continue(self, hypothesis: Hypothesis, limit: float) -> None:
        """Go on with fits that have not converged and may come near a score S, the best first."""
        begun = [row.fit for row in self.log.rows_of(hypothesis) if not row.fit.converged]
        for found in sorted(begun, key=lambda one: one.chi2):
            goal = self._goal(hypothesis, limit)
            if found.reach <= min(goal, self.log[hypothesis].chi2):
                self._append(hypothesis, "continued", found, Effort(goal=goal, made=TRIAL))

    def _try_shapes(self, hypothesis: Hypothesis, limit: float) -> None:
        """Start from other shapes of the effect that is added, where its shape was lost."""
        if not hypothesis.effects:
            return
        effect, smaller = self._origin(hypothesis)
        if _has_lost_its_shape(self.log[hypothesis], effect):
            warm = self.fit(smaller).values
            for start in starts_of_other_shapes(effect):
                self._append(hypothesis, "shapes", {**warm, **start}, Effort(goal=self._goal(hypothesis, limit)))

    def _goal(self, hypothesis: Hypothesis, limit: float) -> float:
        """χ² with which a hypothesis would have a score S."""
        best = self.log[hypothesis]
        return best.chi2 + (limit - best.score) * self.problem.variance_inflation

    def polish(self, hypothesis: Hypothesis) -> Fit:
        """Fit again from around the best fit: contacts that come and go make shallow local minima near the global one.

        The starts are scattered by a few standard errors, with a seed of their own, so that a diagnosis repeats.
        """
        best = self.fit(hypothesis, anneal=True)
        if hypothesis in self._polished:
            return best
        self._polished.add(hypothesis)
        random = np.random.default_rng(len(hypothesis.effects))
        plant = self.problem.plant
        for spread in SCATTER:
            best = self.log[hypothesis]
            start = dict(best.values)
            for name in best.free:
                parameter = plant.parameter(name)
                index = best.free.index(name)
                error = min(math.sqrt(float(best.covariance[index, index])), internal_scale(parameter))
                at = float(best.coordinates[index]) + spread * error * float(random.standard_normal())
                lower, upper = internal_bounds(parameter)
                start[name] = from_internal(parameter, min(max(at, lower), upper))
            self._append(hypothesis, "scattered", start)
        return self.log[hypothesis]

    def refit(self, hypothesis: Hypothesis, start: Mapping[str, float]) -> Fit:
        """Fit once more, from these values; the best fit of the hypothesis."""
        self.fit(hypothesis)
        self._append(hypothesis, "from a larger model", start)
        return self.log[hypothesis]

    def score(self, hypothesis: Hypothesis) -> float:
        """S of a hypothesis."""
        return self.fit(hypothesis).score

    def best(self, hypotheses: Iterable[Hypothesis]) -> Hypothesis:
        """The hypothesis of the lowest score."""
        return min(hypotheses, key=self.score)

    def free_names(self, hypothesis: Hypothesis) -> tuple[str, ...]:
        """What a hypothesis frees."""
        plant = self.problem.plant
        return (*plant.base, *itertools.chain(*(plant.effects[name].free_names() for name in hypothesis.effects)))

    def _append(
        self, hypothesis: Hypothesis, kind: str, start: Mapping[str, float] | Fit, effort: Effort = WHOLE
    ) -> None:
        for found in self._attempt(hypothesis, start, effort):
            self.log.append(Row(hypothesis, kind, found))

    def _fits(self, hypothesis: Hypothesis, effort: Effort) -> Iterator[tuple[str, Fit]]:
        """Fits from each start, with its kind; a smaller hypothesis that was fitted gives initial values."""
        if not hypothesis.effects:
            plain = Hypothesis(())
            starts: list[tuple[str, Mapping[str, float]]] = (
                [("declared model", self.log[plain].values)] if plain in self.log else [("declared", {})]
            )
            if plain not in self.log and self._base:
                tripled = {name: 3.0 * self.problem.plant.declared(name) for name in self._base}
                starts.append(("declared, tripled", tripled))
            for kind, start in starts:
                yield from ((kind, found) for found in self._attempt(hypothesis, start, effort))
            return
        untimed = hypothesis._replace(timing=False)
        if hypothesis.timing and untimed in self.log:
            start = self.log[untimed].values
            yield from (("untimed", found) for found in self._attempt(hypothesis, start, effort))
        effect, smaller = self._origin(hypothesis)
        warm = self.fit(smaller).values
        begun = [("sizes", {**warm, **start}) for start in effect_starts(self._cost, effect, warm)]
        kept = {name: warm[name] for name in self.free_names(smaller) if name not in self._base}
        begun += [("as declared", start) for start in starts_from_declared(self._cost, effect, kept)]
        begun += [("by the plant", {**warm, **effect.start})] if effect.start else []
        for kind, start in begun:
            yield from ((kind, found) for found in self._attempt(hypothesis, start, effort))

    def _origin(self, hypothesis: Hypothesis) -> tuple[EffectChoice, Hypothesis]:
        """The effect that makes a hypothesis of the best smaller one, and that."""
        known = [name for name in hypothesis.effects if hypothesis.without(name) in self.log]
        added = min(known, key=lambda name: self.score(hypothesis.without(name))) if known else hypothesis.effects[-1]
        return self.problem.plant.effects[added], hypothesis.without(added)

    def _cost(self, values: Mapping[str, float]) -> float:
        """By which starts are ranked; those of a hypothesis with errors of the stamps are those without, once more."""
        key = frozenset(values.items())
        if key not in self._costs:
            self._costs[key] = robust_cost(self.problem, values)
        return self._costs[key]

    @property
    def _base(self) -> Sequence[str]:
        return self.problem.plant.base

    def _attempt(self, hypothesis: Hypothesis, start: Mapping[str, float] | Fit, effort: Effort) -> Iterator[Fit]:
        plant = self.problem.plant
        nuisances = (*plant.nuisances, *(plant.timing_errors if hypothesis.timing else ()))
        if hypothesis in self.log:
            # What does not come to the best of its rows is of no use.
            effort = effort._replace(goal=min(effort.goal, self.log[hypothesis].chi2))
        try:
            yield fit(self.problem, self.free_names(hypothesis), start, nuisances=nuisances, effort=effort)
        except SimulationError:
            return


def _has_lost_its_shape(result: Fit, effect: EffectChoice) -> bool:
    """Whether a parameter that shapes an effect has run to a bound, where its gradient vanishes.

    A Stribeck velocity does, and stiction is then plain friction.
    """
    return any(
        parameter.off is None and result.on_bound(effect.free_name(parameter)) is not None
        for parameter in effect.parameters
    )
