"""What has no name, as a picture: a smooth force over position, velocity or time, refitted inside the simulator."""

from __future__ import annotations

from dataclasses import dataclass
from typing import Final

import numpy as np

from valve_sim.identification.fit.fitter import Fitter, Tried
from valve_sim.identification.plants.protocol import Array, ForceMap
from valve_sim.model.effects import basis

POINTS_AN_INTERVAL: Final = 6
"""Points between two knots of a curve in reports."""


@dataclass(frozen=True)
class Unexplained:
    """A residual that no named effect explains, as the smooth force that explains most of it.

    Attributes:
        variable: what it is a function of, as in `ForceMap`.
        at: (n,) places, SI. force: (n,) the curve there, N, or N·s/m of a damping. stderr: (n,) of it.
        gain: −2 ln of the evidence falls by so much against the model without it.
    """

    variable: str
    at: tuple[float, ...]
    force: tuple[float, ...]
    gain: float
    stderr: tuple[float, ...] = ()


def curve_name(own: ForceMap) -> str:
    """The name under which a plant's curve is fitted."""
    return f"curve({own.variable})"


def unexplained(fitter: Fitter, base: Tried, fitted: dict[str, Tried]) -> tuple[Unexplained, ...]:
    """All smooth forces beside the declared model, the one that explains most of what it leaves first.

    Args:
        fitter: of the problem. base: the declared model. fitted: curves that were fitted already, by name.
    """
    found = []
    for own in fitter.problem.plant.force_maps:
        name = curve_name(own)
        tried = fitted.get(name)
        if tried is None:
            fit = fitter.fit_curve(name, (), base.values)
            tried = None if fit is None else fitter.weighed((), fit, spreads=False)
        if tried is not None:
            found.append(_described(own, fitter, tried, base))
    return tuple(sorted(found, key=lambda one: -one.gain))


def _described(own: ForceMap, fitter: Fitter, tried: Tried, base: Tried) -> Unexplained:
    frees = fitter.curves[curve_name(own)].frees
    count = len(frees)
    at = np.linspace(own.low, own.high, POINTS_AN_INTERVAL * (count - 3) + 1)
    shapes = basis(at, own.low, own.high, count) @ _ways(own, fitter)
    result = tried.result
    places = [result.names.index(one.name) for one in frees]
    force, covariance = shapes @ result.coordinates[places], result.covariance
    variances = np.einsum("ij,jk,ik->i", shapes, covariance[np.ix_(places, places)], shapes)
    return Unexplained(
        own.variable, tuple(at.tolist()), tuple(force.tolist()), 2.0 * (tried.plain - base.plain),
        tuple(np.sqrt(np.maximum(variances, 0.0)).tolist()),
    )  # fmt: skip


def _ways(own: ForceMap, fitter: Fitter) -> Array:
    """(c, c) how the coefficients of the splines move with each number that a curve frees."""
    frees = fitter.curves[curve_name(own)].frees
    names = own.coefficients[: len(frees)]
    return np.array([[one.slopes.get(name, 0.0) for one in frees] for name in names])
