"""The search over named effects: every candidate is refitted inside the simulator.

A hypothesis is a set of effects, with or without errors in each command's stamp. Every fit is a row of `FitLog`, and
the best row of a hypothesis is its fit, so that asking twice costs nothing.
"""

from __future__ import annotations

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
    to_internal,
)
from valve_sim.identification.selection.table import FitLog, Hypothesis, Row
from valve_sim.model import SimulationError
from valve_sim.model.parameters import Parameter

SMALL, LARGE = 0.05, (0.5, 1.5, 3.0)
"""Starts, in prior scales of a parameter: one near off, which follows the gradient, and some far from it."""
FROM_DECLARED: Final = (0.5, 1.0, 2.0, 4.0, 8.0, 16.0, 32.0)
"""The same where all else is as declared: a strong effect that is left out bends all else away from there."""
BETWEEN: Final = math.sqrt(2.0)
"""Factor by which the best of these is then refined."""
EXPLAINS: Final = 2.0 / 3.0
"""Cost with an effect over that without, both with all else as declared, below which a fit starts from there, too."""
SHAPES: Final = (1.0, 0.2, 5.0)
"""Likewise for parameters that shape an effect but do not switch it."""
ANNEALING: Final = (100.0, 20.0, 5.0)
"""σ: scales of the Cauchy loss, theory, eq. (30), that lead a fit with impacts out of local minima."""
ROBUST: Final = 20.0
"""σ: scale of the cost by which starts are ranked, so that one impact at another time does not decide."""
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

    def fit_each(self, hypotheses: Sequence[Hypothesis], fractions: tuple[float, float]) -> None:
        """Fit hypotheses of equal size in parallel: they start from smaller ones, not from each other.

        All make a few iterations; then those that cannot come near the best few any more are given up. What cannot be
        simulated from any start is left out, and said to be untried.

        Args:
            hypotheses: what to fit.
            fractions: of the diagnosis that are done before and after.
        """
        before, after = fractions
        settled = {*self.log.best, *self._impossible}
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
        last = sorted((self.log[hypothesis] for hypothesis in hypotheses), key=lambda found: found.score)[RIVALS - 1]
        beyond_noise = last.chi2 / self.problem.variance_inflation - self.problem.effective_samples
        return last.score + max(NEAR, NEAR_SHARE * beyond_noise)

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
        """Go on with fits that have not converged and may come near a score S, the best first; then try more shapes."""
        begun = [row.fit for row in self.log.rows_of(hypothesis) if not row.fit.converged]
        for found in sorted(begun, key=lambda one: one.chi2):
            goal = self._goal(hypothesis, limit)
            if found.reach <= min(goal, self.log[hypothesis].chi2):
                self._append(hypothesis, "continued", found, Effort(goal=goal, made=TRIAL))
        self._try_shapes(hypothesis, limit)
        self._on_trial.discard(hypothesis)

    def _try_shapes(self, hypothesis: Hypothesis, limit: float) -> None:
        """Start from other shapes of the effect that is added, where its shape was lost."""
        if not hypothesis.effects:
            return
        effect, smaller = self._origin(hypothesis)
        if _has_lost_its_shape(self.log[hypothesis], effect):
            warm = self.fit(smaller).values
            for shape in SHAPES:
                start = _start(effect, [SMALL] * len(effect.parameters), shape)
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
        begun = [("sizes", {**warm, **start}) for start in effect_starts(self.problem, effect, warm)]
        kept = {name: warm[name] for name in self.free_names(smaller) if name not in self._base}
        begun += [("as declared", start) for start in starts_from_declared(self.problem, effect, kept)]
        begun += [("by the plant", {**warm, **effect.start})] if effect.start else []
        for kind, start in begun:
            yield from ((kind, found) for found in self._attempt(hypothesis, start, effort))

    def _origin(self, hypothesis: Hypothesis) -> tuple[EffectChoice, Hypothesis]:
        """The effect that makes a hypothesis of the best smaller one, and that."""
        known = [name for name in hypothesis.effects if hypothesis.without(name) in self.log]
        added = min(known, key=lambda name: self.score(hypothesis.without(name))) if known else hypothesis.effects[-1]
        return self.problem.plant.effects[added], hypothesis.without(added)

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


def effect_starts(problem: Problem, effect: EffectChoice, warm: Mapping[str, float]) -> list[dict[str, float]]:
    """Where to start an effect's parameters from: near off, and the best of some larger sizes and other shapes."""
    if effect.is_declared_value:
        # Its tolerance has let it move already; there the smaller hypothesis has left it.
        return [{}]
    near = [] if _is_saddle(effect) else [start_near_off(effect)]
    amplitudes = [parameter.off is not None for parameter in effect.parameters]
    choices = [
        _sizes(parameter) if is_amplitude else (1.0,)
        for parameter, is_amplitude in zip(effect.parameters, amplitudes, strict=True)
    ]
    combinations = (
        list(itertools.product(*choices)) if sum(amplitudes) <= 2 else [(size,) * len(choices) for size in LARGE]
    )
    shapes = SHAPES if not all(amplitudes) else SHAPES[:1]
    far = [_start(effect, sizes, shape) for sizes in combinations for shape in shapes]

    def cost(start: Mapping[str, float]) -> float:
        return _robust_cost(problem, {**warm, **start})

    return near + sorted(far, key=cost)[: 1 if near and sum(amplitudes) == 1 else 2]


def starts_from_declared(problem: Problem, effect: EffectChoice, known: Mapping[str, float]) -> list[dict[str, float]]:
    """A start with all but effects as declared, where a further effect explains much from there; else none.

    A model that lacks a strong effect is refitted to dampings of 0 and values that its tolerances make incredible, and
    from there even the true size of the effect does not lead back.

    Args:
        problem: what is fitted. effect: what is added. known: values of the effects that it is added to.
    """
    switches = [parameter for parameter in effect.parameters if parameter.off is not None]
    if effect.is_declared_value or not switches:
        return []
    is_two_sided = len(switches) == 1 and _is_two_sided(switches[0])
    shapes = SHAPES if len(switches) < len(effect.parameters) else SHAPES[:1]

    def start(size: float, shape: float) -> dict[str, float]:
        return {**known, **_start(effect, [size] * len(effect.parameters), shape)}

    def best_of(choices: Iterable[tuple[float, float]]) -> tuple[float, tuple[float, float]]:
        return min((_robust_cost(problem, start(*choice)), choice) for choice in choices)

    signs = (1.0, -1.0) if is_two_sided else (1.0,)
    coarse = best_of(itertools.product([sign * size for sign in signs for size in FROM_DECLARED], shapes))
    most = EXPLAINS * _robust_cost(problem, known)
    size, shape = coarse[1]
    least, choice = min(coarse, best_of([(size / BETWEEN, shape), (size * BETWEEN, shape)]))
    return [start(*choice)] if least < most else []


def _robust_cost(problem: Problem, values: Mapping[str, float]) -> float:
    try:
        residuals = problem.residuals(values)
    except SimulationError:
        return math.inf
    return float(np.sum(np.log1p(np.square(residuals / ROBUST))))


def start_near_off(effect: EffectChoice) -> dict[str, float]:
    """Its parameters where the effect is all but off."""
    return _start(effect, [SMALL] * len(effect.parameters), 1.0)


def start_nearby(effect: EffectChoice) -> dict[str, float]:
    """The same, but far enough from off where the gradient vanishes there."""
    return _start(effect, [LARGE[0] if _is_saddle(effect) else SMALL] * len(effect.parameters), 1.0)


def _has_lost_its_shape(result: Fit, effect: EffectChoice) -> bool:
    """Whether a parameter that shapes an effect has run to a bound, where its gradient vanishes.

    A Stribeck velocity does, and stiction is then plain friction.
    """
    return any(
        parameter.off is None and result.on_bound(effect.free_name(parameter)) is not None
        for parameter in effect.parameters
    )


def _is_saddle(effect: EffectChoice) -> bool:
    """Whether the gradient vanishes where the effect is off, so that a start there would stay."""
    return any(parameter.off is not None and math.isinf(parameter.off) for parameter in effect.parameters)


def _sizes(parameter: Parameter) -> list[float]:
    return [sign * size for size in LARGE for sign in ((1.0, -1.0) if _is_two_sided(parameter) else (1.0,))]


def _is_two_sided(parameter: Parameter) -> bool:
    lower, upper = internal_bounds(parameter)
    return parameter.off is not None and lower < to_internal(parameter, parameter.off) < upper


def _start(effect: EffectChoice, sizes: Sequence[float], shape: float) -> dict[str, float]:
    return {
        effect.free_name(parameter): _start_value(parameter, size, shape)
        for parameter, size in zip(effect.parameters, sizes, strict=True)
    }


def _start_value(parameter: Parameter, size: float, shape: float) -> float:
    if parameter.off is None:
        return min(max(parameter.prior_scale * shape, parameter.lower), parameter.upper)
    lower, upper = internal_bounds(parameter)
    off = to_internal(parameter, parameter.off)
    at = off + size * internal_scale(parameter)
    if not lower <= at <= upper:
        at = off - size * internal_scale(parameter)
    return from_internal(parameter, min(max(at, lower), upper))
