"""Nonparametric forces: smooth curves over position, velocity or time, and forces at one place of the stroke alone.

A curve has many B-splines, and a penalty on its second differences whose weight follows from the data that are fitted
(`estimation.smoothing`). It is refitted inside the simulator with all that is free beside it.
"""

from __future__ import annotations

import contextlib
import functools
import itertools
import math
from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass
from types import MappingProxyType
from typing import Final, NamedTuple

import numpy as np

from valve_sim.identification.estimation.budget import OutOfTimeError
from valve_sim.identification.estimation.descent import WHOLE, Effort
from valve_sim.identification.estimation.parallel import run_parallel
from valve_sim.identification.estimation.result import Fit
from valve_sim.identification.estimation.smoothing import Smoothness
from valve_sim.identification.estimation.solver import fit
from valve_sim.identification.plants.protocol import Array, ForceMap, Nuisance
from valve_sim.identification.plants.root_mean_square import root_mean_square
from valve_sim.identification.selection.hypotheses import NEAR, Search
from valve_sim.identification.selection.periods import Period, likely_periods
from valve_sim.identification.selection.residual_tests import adequacy
from valve_sim.identification.selection.table import DECISIVE, Hypothesis
from valve_sim.model import SimulationError
from valve_sim.model.effects import basis

PLACES: Final = 8
"""Over so many places of the stroke a force at one of them alone is tried."""
PERIOD_STEP: Final = 0.01
"""Step of a difference quotient, in standard deviations of a period."""
WAVE_PARAMETERS: Final = 3
"""Of a wave, at the least: an amplitude, a phase and a period."""
AT_ONCE: Final = 3
"""So many periods are fitted before it is asked whether one makes the residual white, which ends the search."""
NOTHING: Final[Mapping[str, float]] = MappingProxyType({})
OVER_TIME: Final = "t"
"""A curve over this follows anything in the strokes that it is fitted to: that they come out white says nothing."""
POINTS_AN_INTERVAL: Final = 6
"""Points between two knots of a curve in reports."""


@dataclass(frozen=True)
class Unexplained:
    """A residual that no named effect explains, as the force map that explains most of it.

    Attributes:
        force_rms: N, over the range of the variable. where: it is strongest, in words. variable: as in `ForceMap`.
        at: (n,) places, SI. force: (n,) the curve there, N, or N·s/m of a damping. stderr: (n,) of it, from the
            covariance of the curve with that of its weights; empty where it is not known.
        gain: of the score S against the model without it.
    """

    force_rms: float
    where: str
    variable: str
    at: tuple[float, ...]
    force: tuple[float, ...]
    gain: float
    stderr: tuple[float, ...] = ()


class NonparametricFit(NamedTuple):
    """A nonparametric force, and the fit with it."""

    choice: ForceMap
    fit: Fit


def fit_curves(search: Search, base: Fit) -> list[NonparametricFit]:
    """Smooth curves beside a fit, but for one over time, which follows anything, and for waves."""
    choices = [one for one in base.problem.plant.force_maps if not one.end and one.variable != OVER_TIME]
    return _fitted_each(search, choices, lambda choice: [_beside(choice, base, base.nuisances)])


def fit_maps(
    search: Search, base: Fit, known: Sequence[NonparametricFit] = (), explaining: Fit | None = None
) -> list[NonparametricFit]:
    """Force maps on top of a fit, best score first; those for which the time was too short are left out.

    Where none makes the residual white, errors of the commands' stamps are estimated beside each, too: what they leave
    behind in every stroke is easily taken for a force over time.

    Args:
        search: that is told what is being tried. base: the fit.
        known: those of `fit_curves` beside the base, where they are at hand.
        explaining: effects that explain all with so few parameters that no wave can do better, nor anything with
            errors of the stamps: these are left out, and so is a curve that cannot come near.
    """
    beside = _Beside(base)
    found = _fitted_maps(search, beside, base, known, explaining)
    if found and explaining is None and not any(adequacy(entry.fit).is_white for entry in found):
        with contextlib.suppress(OutOfTimeError):
            if timed := beside.timed:
                found += _fitted_maps(search, beside, timed)
    return sorted(found, key=lambda entry: entry.fit.score)


class _Beside:
    """A fit, the same with errors of the commands' stamps, and the periods of forces over time beside both."""

    def __init__(self, base: Fit) -> None:
        self.base = base
        self._periods: dict[str, list[list[Period]]] = {}

    @functools.cached_property
    def timed(self) -> Fit | None:
        """With errors of the stamps estimated along; None where they are estimated anyway, or cannot be."""
        if set(self.base.problem.plant.timing_errors) <= set(self.base.nuisances):
            return None
        with contextlib.suppress(SimulationError):
            return _with_timing(self.base)
        return None

    def periods(self, choice: ForceMap, base: Fit) -> list[Period]:
        """Likely periods beside one of both fits; over time, where a scan is long, both are scanned at once."""
        if choice.unit != "s":
            return likely_periods(choice, base)[0]
        both = [self.base] if self.timed is None else [self.base, self.timed]
        if choice.variable not in self._periods:
            self._periods[choice.variable] = likely_periods(choice, *both)
        return self._periods[choice.variable][both.index(base)]


def _with_timing(base: Fit) -> Fit:
    """The same model with errors of the commands' stamps estimated along."""
    nuisances = (*base.nuisances, *base.problem.plant.timing_errors)
    return fit(base.problem, base.free, base.values, nuisances=nuisances, fixed=_held(base))


def _held(base: Fit) -> dict[str, float]:
    """What a fit holds."""
    estimated = {*base.free, *(nuisance.name for nuisance in base.nuisances)}
    return {name: value for name, value in base.values.items() if name not in estimated}


def explains_all(base: Fit, best: Fit) -> bool:
    """Whether a model with a white residual frees so few parameters that no wave is decisively better, beside a fit."""
    further = len(best.free) - len(base.free) - WAVE_PARAMETERS
    is_white = bool(best.free) and adequacy(best).is_white
    return is_white and further * math.log(best.problem.effective_samples) <= DECISIVE


def _fitted_maps(
    search: Search,
    beside: _Beside,
    base: Fit,
    known: Sequence[NonparametricFit] = (),
    explaining: Fit | None = None,
) -> list[NonparametricFit]:
    """Every force map beside what a fit estimates."""
    # The score is χ² and what the parameters cost.
    goal = math.inf if explaining is None else (explaining.score + NEAR) * base.problem.variance_inflation

    def fitted(choice: ForceMap) -> list[NonparametricFit]:
        if choice.end:
            return _periodic(choice, base, beside.periods(choice, base))
        return [_beside(choice, base, base.nuisances, effort=Effort(goal=goal))]

    done = [entry.choice for entry in known]
    maps = [one for one in base.problem.plant.force_maps if one not in done and not (one.end and explaining)]
    long = [choice for choice in maps if choice.end and choice.unit == "s"]
    found = [*known, *_fitted_each(search, [choice for choice in maps if choice not in long], fitted)]
    # What was given up is fitted by half, which nobody should look at.
    found = [entry for entry in found if entry.fit.reach <= goal]
    # Hundreds of periods fit into a recording, so they are tried last.
    if any(entry.choice.variable != OVER_TIME and adequacy(entry.fit).is_white for entry in found):
        return found
    return [*found, *_fitted_each(search, long, fitted)]


def _fitted_each(
    search: Search, choices: Sequence[ForceMap], fitted: Callable[[ForceMap], list[NonparametricFit]]
) -> list[NonparametricFit]:
    """Fits of many force maps in parallel; those for which the time is too short are noted as untried."""

    def in_time(choice: ForceMap) -> list[NonparametricFit]:
        try:
            return fitted(choice)
        except (OutOfTimeError, SimulationError):
            return []

    found = run_parallel(in_time, choices, lambda choice: search.say(f"a force over {choice.variable}", 0.9))
    search.untried.extend(
        f"a force over {choice.variable}" for choice, fits in zip(choices, found, strict=True) if not fits
    )
    return list(itertools.chain(*found))


def _beside(
    choice: ForceMap,
    base: Fit,
    nuisances: Sequence[Nuisance],
    start: Mapping[str, float] = NOTHING,
    effort: Effort = WHOLE,
) -> NonparametricFit:
    free, fixed = (*base.free, *choice.free), {**_held(base), **choice.held}
    smooth = _smooth(choice)
    for nuisance in nuisances:
        fixed.pop(nuisance.name, None)
    values = {**base.values, **start}
    found = fit(base.problem, free, values, nuisances=nuisances, fixed=fixed, effort=effort, prior=smooth)
    return NonparametricFit(choice, found)


def _periodic(choice: ForceMap, base: Fit, periods: Sequence[Period]) -> list[NonparametricFit]:
    """A force that repeats itself, with the period of the best fit; the period is estimated along."""
    found: list[NonparametricFit] = []
    for number, period in enumerate(periods):
        if number % AT_ONCE == 0 and any(adequacy(entry.fit).is_white for entry in found):
            break
        length = Nuisance(
            choice.end, period.sigma, choice.unit, step=PERIOD_STEP * period.sigma, mean=choice.low + period.length,
            is_of_machine=True,
        )  # fmt: skip
        with contextlib.suppress(SimulationError):
            least = min((entry.fit.chi2 for entry in found), default=math.inf)
            effort = Effort(goal=least + NEAR * base.problem.variance_inflation)
            with_period = choice.with_period(period.length)
            entry = _beside(with_period, base, (*base.nuisances, length), period.wave, effort)
            fitted = choice.with_period(entry.fit.values[choice.end] - choice.low)
            found.append(NonparametricFit(fitted, entry.fit))
    return sorted(found, key=lambda entry: entry.fit.score)[:1]


def fit_local_forces(search: Search, best: Hypothesis) -> list[NonparametricFit]:
    """A force at one place alone instead of each member of a hypothesis, best score first.

    It has as few parameters as the simplest effects. Where it does as well as a named effect, the data show a force
    at one place only, and the named effect is not established for the rest of the stroke (on the campaign: a ripple or
    a vibration of half a millinewton that lifts the pilot plunger off its seat, as a constant force would).

    Raises:
        OutOfTimeError: the time is used up.
    """
    maps = search.problem.plant.force_maps
    places = [one for choice in maps if choice.variable == "x" for one in choice.at_one_place(PLACES)]

    rests = {member: search.fit(best.without(member)) for member in best.effects}

    def fitted(instead: tuple[str, ForceMap]) -> list[NonparametricFit]:
        member, choice = instead
        rest = rests[member]
        free = (*rest.free, *choice.free)
        try:
            held = fit(rest.problem, free, rest.values, nuisances=rest.nuisances, fixed=choice.held)
        except SimulationError:
            return []
        return [NonparametricFit(choice, held)]

    found = run_parallel(fitted, list(itertools.product(best.effects, places)))
    return sorted(itertools.chain(*found), key=lambda entry: entry.fit.score)


def on_top(choice: ForceMap, base: Fit) -> Fit:
    """A force map with all else fixed, so that it shows the residual and trades nothing with friction or mass."""
    return fit(base.problem, choice.free, {}, fixed={**base.values, **choice.held}, prior=_smooth(choice))


def describe(choice: ForceMap, result: Fit, base: Fit) -> Unexplained:
    """A fitted force map in words: how large, and where it acts."""
    at, force = _curve(choice, result)
    shapes = _shapes(choice, at)[:, [choice.coefficients.index(name) for name in choice.free]]
    own = [result.free.index(name) for name in choice.free]
    covariance = result.covariance[np.ix_(own, own)] if result.smooth is None else result.covariance_of_curve()
    variances = np.einsum("ij,jk,ik->i", shapes, covariance, shapes)
    return Unexplained(
        root_mean_square(force), where(choice, result), choice.variable, tuple(at.tolist()),
        tuple(force.tolist()), base.score - result.score, tuple(np.sqrt(np.maximum(variances, 0.0)).tolist()),
    )  # fmt: skip


def where(choice: ForceMap, result: Fit) -> str:
    """Where a fitted force map acts, in words."""
    at, force = _curve(choice, result)
    strong = np.flatnonzero(np.abs(force) >= 0.5 * np.max(np.abs(force)))
    low, high = at[max(0, strong[0] - 1)], at[min(len(at) - 1, strong[-1] + 1)]
    scale, unit = (1e3, "mm") if choice.unit == "m" else (1e3, "ms") if choice.unit == "s" else (1.0, "m/s")
    words = f"{choice.variable[0]} {scale * low:.3g} to {scale * high:.3g} {unit}"
    if choice.end:
        return f"{words}, again every {scale * (choice.high - choice.low):.4g} {unit}"
    return words + (f", times {choice.variable[2:]}" if len(choice.variable) > 1 else "")


def _smooth(choice: ForceMap) -> Smoothness:
    return Smoothness(choice.free, choice.least, repeats=bool(choice.end))


def _shapes(choice: ForceMap, at: Array) -> Array:
    return basis(at, choice.low, choice.high, len(choice.coefficients), periodic=bool(choice.end))


def _curve(choice: ForceMap, result: Fit) -> tuple[Array, Array]:
    """Places along a fitted force map, and the curve there."""
    at = np.linspace(choice.low, choice.high, POINTS_AN_INTERVAL * (len(choice.coefficients) - 3) + 1)
    return at, _shapes(choice, at) @ np.array([result.values[name] for name in choice.coefficients])
