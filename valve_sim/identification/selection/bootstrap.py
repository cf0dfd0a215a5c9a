"""The false-alarm probability of the search: a bootstrap of the whole search on noise, theory, eqs. (49) and (50).

A catalogue of some twenty effects, each with its shapes, finds something in any noise. How much is estimated from the
residual of the best model: it is cut into blocks, and each block is multiplied by a random number, which keeps size,
colour and quantisation (block wild bootstrap; Shao, J. Am. Stat. Assoc. 105, 2010, p. 218). All effects are then fitted
to it, linearly about the declared model: one Gauss–Newton step, together with dampings, clock offset and stamps. The
largest gain of S over all effects and shapes is what the search finds in that noise. The search goes on to a second
effect only where the first was decisive, so that the first effect is enough.
"""

from __future__ import annotations

import math
from collections.abc import Iterator
from typing import Final, NamedTuple

import numpy as np

from valve_sim.identification.estimation.result import Fit
from valve_sim.identification.plants.protocol import Array, EffectChoice, perturbed
from valve_sim.model import SimulationError

RESAMPLES: Final = 2000
BLOCK: Final = 64
"""Samples multiplied by one number: many correlation times of the whitened residual."""
SHAPES: Final = (1.0, 0.2, 5.0)
"""In prior scales of a parameter that shapes an effect but does not switch it on."""
MOVES_NOTHING: Final = 1e-6
"""Standard deviations, over all samples: a direction that changes the residual by less is ignored."""
SMALLEST_SHARE: Final = 1e-8
"""Share of the squared norm of an effect's strongest direction that a further one must have."""


class FalseAlarm(NamedTuple):
    """How much the search finds in noise alone.

    Attributes:
        probability: that it finds as much as it found here. gain: what it found, in S. usual: the 99 % quantile of
            what it finds in noise. resamples: how many were tried.
    """

    probability: float
    gain: float
    usual: float
    resamples: int


NOT_ASKED: Final = FalseAlarm(1.0, 0.0, 0.0, 0)
"""Where the time was too short for the bootstrap."""


def false_alarm(base: Fit, best: Fit, seed: int = 0) -> FalseAlarm:
    """Bootstrap the search.

    Args:
        base: without effects, its nuisances those of `best`.
        best: the fit whose residual is white.
        seed: of the random numbers, so that a diagnosis repeats.
    """
    gain = base.score - best.score
    random = np.random.default_rng(seed)
    largest = np.zeros(RESAMPLES)
    weights = random.standard_normal((RESAMPLES, -(-len(best.residuals) // BLOCK)))
    outside = _Outside(base)
    for effect in base.problem.plant.effects.values():
        if effect.is_declared_value:
            # What noise does to it, its tolerance takes up: its column is one of the base's.
            continue
        price = len(effect.free_names()) * math.log(base.problem.effective_samples)
        for directions in _directions(base, effect):
            basis = outside.basis(directions)
            found = weights @ _by_block(basis * best.residuals[:, None])
            gains = np.sum(np.square(found), axis=1) / base.problem.variance_inflation - price
            largest = np.maximum(largest, gains)
    probability = (1.0 + float(np.count_nonzero(largest >= gain))) / (1.0 + RESAMPLES)
    return FalseAlarm(probability, gain, float(np.quantile(largest, 0.99)), RESAMPLES)


class _Outside:
    """Projection onto what is orthogonal to the base fit's parameters and nuisances, with the nuisances' priors."""

    def __init__(self, base: Fit) -> None:
        priors = np.zeros((len(base.nuisances), base.jacobian.shape[1]))
        for row, nuisance in enumerate(base.nuisances):
            priors[row, len(base.free) + row] = 1.0 / nuisance.sigma
        columns = np.vstack([base.jacobian, priors])
        size = np.sqrt(np.sum(np.square(columns), axis=0))
        self._samples = len(base.jacobian)
        self._fitted, _ = np.linalg.qr(columns[:, size > 0.0] / size[size > 0.0])

    def basis(self, directions: Array) -> Array:
        """(n, q) → (n, p ≤ q): orthonormal but for the part along nuisances with priors."""
        padded = np.vstack([directions, np.zeros((len(self._fitted) - self._samples, directions.shape[1]))])
        left = padded - self._fitted @ (self._fitted.T @ padded)
        axes, sizes, _ = np.linalg.svd(left, full_matrices=False)
        is_there = (sizes > MOVES_NOTHING) & (sizes**2 > SMALLEST_SHARE * sizes[0] ** 2)
        return np.asarray(axes[: self._samples, is_there])


def _directions(base: Fit, effect: EffectChoice) -> Iterator[Array]:
    """For each shape of an effect, (n, switches): change of the residual for a small value of each switch."""
    has_shape = any(parameter.off is None for parameter in effect.parameters)
    for shape in SHAPES if has_shape else SHAPES[:1]:
        columns = []
        for switch in effect.parameters:
            if switch.off is None:
                continue
            values = {
                effect.free_name(parameter): min(max(shape * parameter.prior_scale, parameter.lower), parameter.upper)
                if parameter.off is None
                else perturbed(parameter, parameter.off)
                if parameter is switch
                else parameter.off
                for parameter in effect.parameters
            }
            try:
                columns.append(base.problem.residuals({**base.values, **values}) - base.residuals)
            except SimulationError:
                continue
        if columns:
            yield np.column_stack(columns)


def _by_block(products: Array) -> Array:
    """(n, p) → (blocks, p) sums over blocks."""
    return np.asarray(np.add.reduceat(products, np.arange(0, len(products), BLOCK), axis=0))
