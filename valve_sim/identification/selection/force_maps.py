"""Nonparametric forces: smooth curves over position, velocity or time, and forces at one place of the stroke alone.

A curve has many B-splines, and a penalty on its second differences whose weight follows from the data that are fitted
(`estimation.smoothing`). It is refitted inside the simulator with all that is free beside it.
"""

from __future__ import annotations

import contextlib
import itertools
import math
from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass
from types import MappingProxyType
from typing import Final, NamedTuple

import numpy as np

from valve_sim.identification.estimation.descent import WHOLE, SolverOptions
from valve_sim.identification.estimation.parallel import run_parallel
from valve_sim.identification.estimation.result import Fit
from valve_sim.identification.estimation.smoothing import Smoothness
from valve_sim.identification.estimation.solver import fit
from valve_sim.identification.plants.protocol import Array, ForceMap, Nuisance
from valve_sim.identification.selection.periods import Period, likely_periods
from valve_sim.identification.selection.residual_tests import adequacy
from valve_sim.model import SimulationError
from valve_sim.model.effects import basis

PERIOD_STEP: Final = 0.01
"""Step of a difference quotient, in standard deviations of a period."""
NEAR: Final = 100.0
"""Difference of χ² by which a wave that is begun may lag behind the best, and is still fitted to its end."""
AT_ONCE: Final = 3
"""So many periods are fitted before it is asked whether one makes the residual white, which ends the search."""
NOTHING: Final[Mapping[str, float]] = MappingProxyType({})
OVER_TIME: Final = "t"
"""A curve over this follows anything in the strokes that it is fitted to: that they come out white says nothing."""
POINTS_AN_INTERVAL: Final = 6
"""Points between two knots of a curve in reports."""


Progress = Callable[[str, float], None]


@dataclass(frozen=True)
class Unexplained:
    """A residual that no named effect explains, as the force map that explains most of it.

    Attributes:
        variable: what it is a function of, as in `ForceMap`.
        at: (n,) places, SI. force: (n,) the curve there, N, or N·s/m of a damping. stderr: (n,) of it, from the
            covariance of the curve with that of its weights; empty where it is not known.
        gain: −2 ln of the evidence falls by so much against the model without it.
    """

    variable: str
    at: tuple[float, ...]
    force: tuple[float, ...]
    gain: float
    stderr: tuple[float, ...] = ()


class NonparametricFit(NamedTuple):
    """A nonparametric force, and the fit with it."""

    choice: ForceMap
    fit: Fit


def competing_curves(base: Fit, say: Progress) -> list[NonparametricFit]:
    """Smooth curves beside a fit that stand for something unnamed; not over time, where a curve follows anything."""
    choices = [one for one in base.problem.plant.force_maps if not one.end and one.variable != OVER_TIME]
    return _fitted_each(choices, lambda choice: [_beside(choice, base)], say)


def fit_maps(base: Fit, known: Sequence[NonparametricFit], say: Progress) -> list[NonparametricFit]:
    """All force maps on top of a fit, the best evidence first: what something unnamed looks like.

    Args:
        base: the fit. known: those of `competing_curves` beside it. say: told what is being tried.
    """
    done = [entry.choice for entry in known]
    maps = [one for one in base.problem.plant.force_maps if one not in done]
    # Hundreds of periods fit into a recording, so waves over time are tried where nothing else explains it.
    long = [choice for choice in maps if choice.end and choice.unit == "s"]
    found = [*known, *_fitted_each([choice for choice in maps if choice not in long], lambda one: _any(one, base), say)]
    if not any(entry.choice.variable != OVER_TIME and adequacy(entry.fit).is_white for entry in found):
        found += _fitted_each(long, lambda one: _any(one, base), say)
    return sorted(found, key=lambda entry: -entry.fit.log_evidence)


def _any(choice: ForceMap, base: Fit) -> list[NonparametricFit]:
    return _periodic(choice, base, likely_periods(choice, base)[0]) if choice.end else [_beside(choice, base)]


def _held(base: Fit) -> dict[str, float]:
    """The values that a fit keeps fixed."""
    estimated = {*base.names}
    return {name: value for name, value in base.values.items() if name not in estimated}


def _fitted_each(
    choices: Sequence[ForceMap], fitted: Callable[[ForceMap], list[NonparametricFit]], say: Progress
) -> list[NonparametricFit]:
    """Fits of many force maps in parallel, but for those that cannot be simulated."""

    def attempted(choice: ForceMap) -> list[NonparametricFit]:
        try:
            return fitted(choice)
        except SimulationError:
            return []

    found = run_parallel(attempted, choices, lambda choice: say(f"a force over {choice.variable}", 0.9))
    return list(itertools.chain(*found))


def _beside(
    choice: ForceMap, base: Fit, further: tuple[Nuisance, ...] = (), start: Mapping[str, float] = NOTHING,
    effort: SolverOptions = WHOLE,
) -> NonparametricFit:  # fmt: skip
    """A force map beside all that a fit frees, and beside further nuisances."""
    fixed = {**_held(base), **choice.held}
    for nuisance in further:
        fixed.pop(nuisance.name, None)
    found = fit(
        base.problem, (*base.free, *choice.free), {**base.values, **start}, nuisances=(*base.nuisances, *further),
        fixed=fixed, effort=effort, prior=_smooth(choice),
    )  # fmt: skip
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
            effort = SolverOptions(goal=least + NEAR)
            entry = _beside(choice.with_period(period.length), base, (length,), period.wave, effort)
            fitted = choice.with_period(entry.fit.values[choice.end] - choice.low)
            found.append(NonparametricFit(fitted, entry.fit))
    return sorted(found, key=lambda entry: -entry.fit.log_evidence)[:1]


def describe(choice: ForceMap, result: Fit, base: Fit) -> Unexplained:
    """A fitted force map, and how well it is known."""
    at, force = _curve(choice, result)
    shapes = _shapes(choice, at)[:, [choice.coefficients.index(name) for name in choice.free]]
    own = [result.free.index(name) for name in choice.free]
    covariance = result.covariance[np.ix_(own, own)] if result.smooth is None else result.covariance_of_curve()
    variances = np.einsum("ij,jk,ik->i", shapes, covariance, shapes)
    return Unexplained(
        choice.variable, tuple(at.tolist()), tuple(force.tolist()), 2.0 * (result.log_evidence - base.log_evidence),
        tuple(np.sqrt(np.maximum(variances, 0.0)).tolist()),
    )  # fmt: skip


def _smooth(choice: ForceMap) -> Smoothness:
    return Smoothness(choice.free, choice.least, repeats=bool(choice.end))


def _shapes(choice: ForceMap, at: Array) -> Array:
    return basis(at, choice.low, choice.high, len(choice.coefficients), periodic=bool(choice.end))


def _curve(choice: ForceMap, result: Fit) -> tuple[Array, Array]:
    """Places along a fitted force map, and the curve there."""
    at = np.linspace(choice.low, choice.high, POINTS_AN_INTERVAL * (len(choice.coefficients) - 3) + 1)
    return at, _shapes(choice, at) @ np.array([result.values[name] for name in choice.coefficients])
