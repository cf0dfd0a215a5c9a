"""Smooth curves in a fit: penalised B-splines, their weights by restricted maximum likelihood.

The second differences of a curve's coefficients c have a Gaussian prior, D c ~ N(0, 1/w), with weights w that may
change along the curve, so that a narrow bump needs no ripples beside it: w = H λ, H hat functions. A small ρ only
decides where the data say nothing. The criterion then is

    χ²(z) + cᵀ S c,    S = Dᵀ diag(H λ) D + ρ 1

(Eilers and Marx 1996). λ minimises −2 ln of the restricted likelihood of the linearised fit, theory, eq. (50), which
integrates over all that is fitted (Wood 2011):

    R(λ) = min over z of [χ²(z) + cᵀ S c]/f + ln det(A + S) − Σ ln w

with A the information without S, and f the factor by which slow noise discounts evidence. One weight for all of the
curve is found among many; from there each follows its own way downhill (Wood and Fasiolo 2017). Each step of
Gauss–Newton chooses them anew, from a curve that is nearly straight on.
"""

from __future__ import annotations

import functools
from dataclasses import dataclass, replace
from typing import Final, NamedTuple

import numpy as np
from numpy.typing import NDArray

from valve_sim.identification.plants.protocol import Array

WEIGHTS: Final = tuple(10.0 ** (0.5 * half) for half in range(-8, 21))
"""λ that are tried: second differences from 10 µN to 100 N, or N·s/m."""
RIDGE: Final = 1e-4
"""ρ: each coefficient is within ±100 N, or N·s/m, where nothing else determines it."""
HATS: Final = 8
"""So many weights along a curve."""
FIRST_WEIGHT: Final = 1e4
"""λ to begin with: of a curve that is nearly straight."""
LARGEST_CHANGE: Final = 30.0
"""Of a weight from one step of Gauss–Newton to the next, as a factor."""
MOST_UPDATES: Final = 40
"""Of the weights in one step of Gauss–Newton."""
HELD: Final = 1e12
"""Information on a coefficient that is held at the least value: it counts as known there."""
SETTLED: Final = 0.05
"""Weights have settled when none changes by more than this share."""


@dataclass(frozen=True)
class Smoothness:
    """The prior of a curve in a fit.

    Attributes:
        names: of the coefficients, in order; all are freed. least: value of each.
        weights: λ, 1/N² or (m/(N·s))², evenly spaced along the curve.
        repeats: whether the first coefficient follows the last.
    """

    names: tuple[str, ...]
    least: float
    weights: tuple[float, ...] = (FIRST_WEIGHT,) * HATS
    repeats: bool = False

    @property
    def precision(self) -> Array:
        """(K, K) S."""
        return _Roughness.of(len(self.names), repeats=self.repeats).precision(np.array(self.weights))

    def chosen(
        self, information: Array, gradient: Array, at: Array, where: NDArray[np.int64], inflation: float
    ) -> Smoothness:
        """The same with weights that go to those of the greatest restricted likelihood.

        Args:
            information: (m, m) A of all that is fitted, without S. gradient: (m,) half of that of χ² where the fit is.
            at: (m,) where the fit is. where: (K,) indices of the coefficients among them. inflation: f.
        """
        roughness = _Roughness.of(len(where), repeats=self.repeats)
        curve = _Quadratic.of(information, gradient, at, where, inflation, roughness)
        is_held = (at[where] <= self.least) & (gradient[where] > 0.0)
        curve = curve._replace(information=curve.information + np.diag(np.where(is_held, HELD, 0.0)))
        common = np.full(HATS, min(WEIGHTS, key=lambda weight: curve.criterion(np.full(HATS, weight))))
        best, before = _settled(curve, common), np.array(self.weights)
        # A curve that is far from the best of its weights would be led astray by what is linearised about it.
        weights = np.clip(best, before / LARGEST_CHANGE, before * LARGEST_CHANGE)
        return replace(self, weights=tuple(weights.tolist()))


def _settled(curve: _Quadratic, weights: Array) -> Array:
    """The weights that follow from these, downhill."""
    for _ in range(MOST_UPDATES):
        updated = np.clip(curve.updated(weights), WEIGHTS[0], WEIGHTS[-1])
        moved = float(np.max(np.abs(np.log(updated / weights))))
        weights = updated
        if moved < SETTLED:
            break
    return weights


class _Roughness(NamedTuple):
    """Second differences D (d, K) of a curve's coefficients, and hat functions H (d, HATS) along them."""

    differences: Array
    hats: Array

    @classmethod
    @functools.cache
    def of(cls, count: int, *, repeats: bool) -> _Roughness:
        if repeats:
            differences = np.roll(np.eye(count), -1, axis=1) - 2.0 * np.eye(count) + np.roll(np.eye(count), 1, axis=1)
            # A curve that repeats itself has no place of its own where it would be rougher.
            return cls(differences, np.full((count, HATS), 1.0 / HATS))
        at = np.linspace(0.0, HATS - 1.0, count - 2)
        hats = np.maximum(0.0, 1.0 - np.abs(at[:, None] - np.arange(HATS)))
        return cls(np.diff(np.eye(count), 2, axis=0), hats)

    def precision(self, weights: Array) -> Array:
        """(K, K) S: theory, eq. (49)."""
        rows = self.hats @ weights
        scaled = self.differences * rows[:, None]
        return np.asarray(self.differences.T @ scaled + RIDGE * np.eye(self.differences.shape[1]))


class _Quadratic(NamedTuple):
    """χ²/f of a linearised fit as a function of a curve's coefficients, all else at its best: cᵀ A c − 2 tᵀ c."""

    information: Array
    target: Array
    roughness: _Roughness

    @classmethod
    def of(
        cls, information: Array, gradient: Array, at: Array, where: NDArray[np.int64], inflation: float,
        roughness: _Roughness,
    ) -> _Quadratic:  # fmt: skip
        rest = np.setdiff1d(np.arange(len(at)), where)
        mixed = information[np.ix_(where, rest)]
        right = np.column_stack([mixed.T, gradient[rest]])
        solved = np.linalg.lstsq(information[np.ix_(rest, rest)], right, rcond=1e-13)[0]
        own = information[np.ix_(where, where)] - mixed @ solved[:, :-1]
        slope = gradient[where] - mixed @ solved[:, -1]
        return cls(own / inflation, (own @ at[where] - slope) / inflation, roughness)

    def criterion(self, weights: Array) -> float:
        """R but for a constant."""
        normal, scale = self._normal(weights)
        _, volume = np.linalg.slogdet(normal)
        fitted = float(self.target * scale @ np.linalg.solve(normal, scale * self.target))
        rows = self.roughness.hats @ weights
        # Of second differences that go around, one follows from the others.
        rank = len(self.target) - 1 if len(rows) == len(self.target) else len(rows)
        certain = float(np.mean(np.log(rows))) * rank
        return -fitted + float(volume) - 2.0 * float(np.sum(np.log(scale))) - certain

    def updated(self, weights: Array) -> Array:
        """Weights of a smaller R: theory, eq. (51)."""
        differences, hats = self.roughness
        normal, scale = self._normal(weights)
        variances = np.linalg.inv(normal) * np.outer(scale, scale)
        bends = differences @ variances @ self.target
        certain = 1.0 / (hats @ weights) - np.einsum("ij,jk,ik->i", differences, variances, differences)
        return np.asarray(weights * (hats.T @ np.maximum(certain, 1e-300)) / np.maximum(hats.T @ bends**2, 1e-300))

    def _normal(self, weights: Array) -> tuple[Array, Array]:
        """A + S scaled to a unit diagonal, and the scale."""
        normal = self.information + self.roughness.precision(weights)
        scale = 1.0 / np.sqrt(np.diag(normal))
        return normal * np.outer(scale, scale), scale
