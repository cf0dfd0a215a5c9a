"""Rao's score test of every effect that a fit leaves out: what one Gauss–Newton step with it would gain.

An effect's sensitivity is one simulation with a little of it on. What the fit's own parameters and nuisances can do of
it is projected out, so that the squared projection of the residual on the rest is the gain of χ² that a refit gives, to
first order. It costs one simulation for each effect and shape: enough to say that nothing is left to be found, and the
linear fits of the bootstrap.
"""

from __future__ import annotations

import math
from collections.abc import Iterator
from typing import Final, NamedTuple

import numpy as np

from valve_sim.identification.estimation.gram import gram, orthonormal, sum_squares
from valve_sim.identification.estimation.result import Fit
from valve_sim.identification.plants.protocol import RELEASED, SMALL_MOVE, Array, EffectChoice, perturbed
from valve_sim.model import Parameter, SimulationError

SHAPES: Final = (1.0, 0.2, 5.0)
"""In prior scales of a parameter that shapes an effect but does not switch it on."""
SIZES: Final = (SMALL_MOVE, 1.0)
"""In prior scales of a switch: near off, and large enough for a contact that only rebounds above a speed."""
MOVES_NOTHING: Final = 1e-6
"""Standard deviations, over all samples: a direction that changes the residual by less is ignored."""
SMALLEST_SHARE: Final = 1e-8
"""Share of the squared norm of an effect's strongest direction that a further one must have."""


def score_gains(result: Fit) -> dict[str, float]:
    """By how much each effect that is not in a fit would lower its score S, to first order; largest over its shapes."""
    problem, outside = result.problem, Outside(result)
    gains: dict[str, float] = {}
    for name, effect in problem.plant.effects.items():
        if set(effect.free_names()) & set(result.free):
            continue
        if effect.is_declared_value:
            gains[name] = sum(_released(result, parameter) for parameter in effect.free_names())
            continue
        price = len(effect.free_names()) * math.log(problem.effective_samples)
        found = [outside.gain(directions) for size in SIZES for directions in directions_of(result, effect, size)]
        gains[name] = max(found, default=0.0) / problem.variance_inflation - price
        if any(own.same_as in effect.free_names() for own in result.nuisances):
            # The same thing as a declared value, so that its own direction hardly leaves that of the nuisance.
            gains[name] = max(gains[name], sum(_released(result, parameter) for parameter in effect.free_names()))
    return gains


class Release(NamedTuple):
    """A declared value taken for wrong.

    Attributes:
        deviation: of its estimate, in tolerances. share: of its deviation that the data show beside its tolerance.
        price: in S, of the wider prior, theory, eq. (82). tolerance: of it, in `unit`.
    """

    deviation: float
    share: float
    price: float
    tolerance: float
    unit: str


def release_of(result: Fit, name: str) -> Release | None:
    """What it takes to release a declared value; None of what has no tolerance, or where the data say nothing."""
    row = next(
        (row for row, nuisance in enumerate(result.nuisances) if name in (nuisance.name, nuisance.same_as)), None
    )
    if row is None:
        return None
    index, inflation = len(result.free) + row, result.problem.variance_inflation
    variance, sigma = result.covariance[index, index] / inflation, result.nuisances[row].sigma
    share = max(1.0 - variance / sigma**2, 0.0)
    if share == 0.0:
        return None
    price = 2.0 * math.log(RELEASED)
    return Release(float(result.deviations[row]), share, price, sigma, result.nuisances[row].unit)


def _released(result: Fit, name: str) -> float:
    """What S gains where a declared value is taken for wrong: its tolerance no longer holds it, theory, eq. (82)."""
    found = release_of(result, name)
    if found is None:
        return -math.inf
    # χ² falls by the square of how far the value that the data alone would have is off, in standard errors of the
    # difference between it and the declared one.
    return found.deviation**2 / found.share / result.problem.variance_inflation - found.price


class Outside:
    """Projection onto what is orthogonal to a fit's parameters and nuisances, with the nuisances' priors."""

    def __init__(self, base: Fit) -> None:
        priors = np.zeros((len(base.nuisances), base.jacobian.shape[1]))
        for row, nuisance in enumerate(base.nuisances):
            priors[row, len(base.free) + row] = 1.0 / nuisance.sigma
        columns = np.vstack([base.jacobian, priors])
        size = np.sqrt(np.sum(np.square(columns), axis=0))
        self._residuals = np.concatenate([base.residuals, base.deviations])
        self._samples = len(base.jacobian)
        self._fitted = orthonormal(columns[:, size > 0.0] / size[size > 0.0])

    def basis(self, directions: Array) -> Array:
        """(n, q) → (n, p ≤ q): orthonormal but for the part along nuisances with priors."""
        return self._axes(directions)[: self._samples]

    def gain(self, directions: Array) -> float:
        """By how much χ² falls where the fit may move along (n, q) directions, too."""
        return sum_squares(gram(self._axes(directions), self._residuals))

    def distance(self, direction: Array) -> float:
        """Standard deviations by which an (n,) change of the residual exceeds what the fit may follow."""
        return math.sqrt(sum_squares(self._left(direction[:, None])))

    def _axes(self, directions: Array) -> Array:
        axes, sizes, _ = np.linalg.svd(self._left(directions), full_matrices=False)
        is_there = (sizes > MOVES_NOTHING) & (sizes**2 > SMALLEST_SHARE * sizes[0] ** 2)
        return np.asarray(axes[:, is_there])

    def _left(self, directions: Array) -> Array:
        padded = np.vstack([directions, np.zeros((len(self._fitted) - self._samples, directions.shape[1]))])
        return np.asarray(padded - self._fitted @ (self._fitted.T @ padded))


def directions_of(base: Fit, effect: EffectChoice, size: float = SMALL_MOVE) -> Iterator[Array]:
    """For each shape of an effect, (n, switches): change of the residual for some prior scales of each switch."""
    has_shape = any(parameter.off is None for parameter in effect.parameters)
    for shape in SHAPES if has_shape else SHAPES[:1]:
        columns = []
        for switch in effect.parameters:
            if switch.off is None:
                continue
            try:
                columns.append(
                    base.problem.residuals({**base.values, **switched_on(effect, switch, size, shape)}) - base.residuals
                )
            except SimulationError:
                continue
        if columns:
            yield np.column_stack(columns)


def switched_on(effect: EffectChoice, switch: Parameter, size: float, shape: float = 1.0) -> dict[str, float]:
    """An effect of which one switch is moved by so many prior scales and the others are off; shapes in theirs."""

    def value(parameter: Parameter) -> float:
        if parameter.off is None:
            return min(max(shape * parameter.prior_scale, parameter.lower), parameter.upper)
        return perturbed(parameter, parameter.off, size) if parameter is switch else parameter.off

    return {effect.free_name(parameter): value(parameter) for parameter in effect.parameters}
