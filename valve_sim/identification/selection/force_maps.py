"""Nonparametric forces: smooth curves over position, velocity or time, and forces at one place of the stroke alone.

A curve has many B-splines, and a penalty on its second differences whose weight follows from the data that are fitted
(`estimation.smoothing`). It is refitted inside the simulator with all that is free beside it.
"""

from __future__ import annotations

from collections.abc import Callable, Sequence
from dataclasses import dataclass
from typing import Final, NamedTuple

import numpy as np

from valve_sim.identification.estimation.parallel import run_parallel
from valve_sim.identification.estimation.result import Fit
from valve_sim.identification.estimation.smoothing import Smoothness
from valve_sim.identification.estimation.solver import fit
from valve_sim.identification.plants.protocol import Array, ForceMap
from valve_sim.model import SimulationError
from valve_sim.model.effects import basis

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
    choices = [one for one in base.problem.plant.force_maps if one.variable != OVER_TIME]
    return _fitted_each(choices, base, say)


def fit_maps(base: Fit, known: Sequence[NonparametricFit], say: Progress) -> list[NonparametricFit]:
    """All force maps on top of a fit, the best evidence first: what something unnamed looks like."""
    done = [entry.choice for entry in known]
    maps = [one for one in base.problem.plant.force_maps if one not in done]
    found = [*known, *_fitted_each(maps, base, say)]
    return sorted(found, key=lambda entry: -entry.fit.log_evidence)


def _held(base: Fit) -> dict[str, float]:
    """The values that a fit keeps fixed."""
    estimated = {*base.names}
    return {name: value for name, value in base.values.items() if name not in estimated}


def _fitted_each(choices: Sequence[ForceMap], base: Fit, say: Progress) -> list[NonparametricFit]:
    """Fits of many force maps in parallel, but for those that cannot be simulated."""

    def attempted(choice: ForceMap) -> NonparametricFit | None:
        try:
            return _beside(choice, base)
        except SimulationError:
            return None

    found = run_parallel(attempted, choices, lambda choice: say(f"a force over {choice.variable}", 0.9))
    return [entry for entry in found if entry is not None]


def _beside(choice: ForceMap, base: Fit) -> NonparametricFit:
    """A force map beside all that a fit frees."""
    found = fit(
        base.problem, (*base.free, *choice.free), base.values, nuisances=base.nuisances,
        fixed={**_held(base), **choice.held}, prior=Smoothness(choice.free, choice.least),
    )  # fmt: skip
    return NonparametricFit(choice, found)


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


def _shapes(choice: ForceMap, at: Array) -> Array:
    return basis(at, choice.low, choice.high, len(choice.coefficients))


def _curve(choice: ForceMap, result: Fit) -> tuple[Array, Array]:
    """Places along a fitted force map, and the curve there."""
    at = np.linspace(choice.low, choice.high, POINTS_AN_INTERVAL * (len(choice.coefficients) - 3) + 1)
    return at, _shapes(choice, at) @ np.array([result.values[name] for name in choice.coefficients])
