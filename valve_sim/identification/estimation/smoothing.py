"""Smooth curves in a fit: penalised B-splines, their weights by restricted maximum likelihood.

The second differences of a curve's coefficients c have a Gaussian prior, D c ~ N(0, 1/w), with weights w that may
change along the curve, so that a narrow bump needs no ripples beside it: w = H λ, H hat functions. A small ρ only
decides where the data say nothing. The criterion then is

    χ²(z) + cᵀ S c,    S = Dᵀ diag(H λ) D + ρ 1

(Eilers and Marx 1996). λ minimises −2 ln of the restricted likelihood of the linearised fit, theory, eq. (50), which
integrates over all that is fitted (Wood 2011):

    R(λ) = min over z of [χ²(z) + cᵀ S c] + ln det(A + S) − Σ ln w

with A the information without S. Logarithms of neighbouring
weights differ by N(0, τ²): without that, weights run to their ends and a curve becomes a chain of straight pieces whose
errors seem small. One weight for all of the curve is found among many; from there each follows its own way downhill.
Each step of Gauss–Newton chooses them anew, from a curve that is nearly straight on.

The covariance of a curve is that of all weights that the data leave possible, not of the best alone: the penalty makes
the curve a Gaussian process, whose bands hold the bias of smoothing (Wahba 1983, Nychka 1988), and what the variance
of the weights adds (Kass and Steffey 1989; Wood, Pya and Säfken 2016) is summed along the axes of their posterior.
"""

from __future__ import annotations

import functools
import math
from dataclasses import dataclass, replace
from typing import Final, NamedTuple

import numpy as np
from numpy.typing import NDArray

from valve_sim.identification.estimation.gram import information_less
from valve_sim.identification.plants.protocol import Array

WEIGHTS: Final = tuple(10.0 ** (0.5 * half) for half in range(-8, 21))
"""λ that are tried: second differences from 10 µN to 100 N, or N·s/m."""
RIDGE: Final = 1e-4
"""ρ: each coefficient is within ±100 N, or N·s/m, where nothing else determines it."""
HATS: Final = 16
"""So many weights along a curve."""
DIFFERS: Final = 3.0
"""τ: standard deviation of the difference of two neighbouring weights' natural logarithms."""
FIRST_WEIGHT: Final = 1e4
"""λ to begin with: of a curve that is nearly straight."""
LARGEST_CHANGE: Final = 30.0
"""Of a weight from one step of Gauss–Newton to the next, as a factor."""
MOST_UPDATES: Final = 40
"""Of the weights in one step of Gauss–Newton."""
LARGEST_UPDATE: Final = 3.0
"""Of the natural logarithm of a weight."""
SMALLEST_UPDATE: Final = 0.01
"""Share of an update below which none is tried."""
CURVATURE: Final = 1e-3
"""Least curvature of R along a weight's logarithm, for an update."""
DIFFERENCE: Final = 0.25
"""Step of a difference quotient along a weight's logarithm."""
WIDEST: Final = 4.0
"""Standard deviation of the logarithm of a weight that the data do not determine."""
ALONG: Final = np.linspace(-3.0, 3.0, 9)
"""Places along an axis of the weights' posterior, in standard deviations."""
HELD: Final = 1e12
"""Information on a coefficient that is held at the least value: it counts as known there."""
SETTLED: Final = 0.05
"""Weights have settled when none changes by more than this share."""
LEAST, MOST = math.log(WEIGHTS[0]), math.log(WEIGHTS[-1])
_STEPS: Final = np.diff(np.eye(HATS), axis=0)
NEIGHBOURS: Final[Array] = 2.0 * _STEPS.T @ _STEPS / DIFFERS**2
"""(HATS, HATS) second derivatives of what differences of neighbouring weights' logarithms add to R."""


@dataclass(frozen=True)
class Smoothness:
    """The prior of a curve in a fit.

    Attributes:
        names: of the coefficients, in order; all are freed. least: value of each.
        weights: λ, 1/N² or (m/(N·s))², evenly spaced along the curve.
        log_weights: ln of the prior density of the weights' logarithms times the volume that the data leave them.
    """

    names: tuple[str, ...]
    least: float
    weights: tuple[float, ...] = (FIRST_WEIGHT,) * HATS
    log_weights: float = 0.0

    @functools.cached_property
    def precision(self) -> Array:
        """(K, K) S."""
        return _Roughness.of(len(self.names)).precision(np.array(self.weights))

    def chosen(self, information: Array, gradient: Array, at: Array, where: NDArray[np.int64]) -> Smoothness:
        """This curve with weights that go to those of the greatest restricted likelihood.

        Args:
            information: (m, m) A of all that is fitted, without S. gradient: (m,) half of that of χ² where the fit is.
            at: (m,) where the fit is. where: (K,) indices of the coefficients among them.
        """
        curve = self._about(information, gradient, at, where)
        common = curve.common_weight()
        best, before = np.exp(_settled(curve, np.full(HATS, math.log(common)))), np.array(self.weights)
        # A curve that is far from the best of its weights would be led astray by what is linearised about it.
        weights = np.clip(best, before / LARGEST_CHANGE, before * LARGEST_CHANGE)
        return replace(self, weights=tuple(weights.tolist()), log_weights=curve.log_weights(np.log(weights)))

    def log_density(self, at: Array) -> float:
        """Ln of the prior density of (K,) coefficients, the weights integrated over about these."""
        spread = float(np.linalg.slogdet(self.precision)[1]) - len(at) * math.log(2.0 * math.pi)
        return 0.5 * (spread - float(at @ self.precision @ at)) + self.log_weights

    @np.errstate(over="ignore", invalid="ignore")
    def covariance(self, information: Array, gradient: Array, at: Array, where: NDArray[np.int64]) -> Array:
        """(K, K) covariance of the coefficients, that of their weights included; arguments as those of `chosen`."""
        curve = self._about(information, gradient, at, where)
        logs = np.log(np.array(self.weights))
        best = curve.best(logs)
        covariance = best.covariance.copy()
        for axis in _axes(curve, logs):
            places = [curve.best(place) for place in np.clip(logs + ALONG[:, None] * axis, LEAST, MOST)]
            costs = np.nan_to_num([place.objective for place in places], nan=np.inf)
            shares = np.exp(-0.5 * (costs - costs.min()))
            for place, share in zip(places, shares / shares.sum(), strict=True):
                apart = place.fitted - best.fitted
                further = share * (place.covariance - best.covariance + np.outer(apart, apart))
                # Weights of which the linearised fit is nowhere near the data say nothing of the band.
                if np.all(np.isfinite(further)):
                    covariance += further
        return covariance

    def _about(self, information: Array, gradient: Array, at: Array, where: NDArray[np.int64]) -> _Quadratic:
        """χ² about where the fit is; what is held at the least value counts as known."""
        roughness = _Roughness.of(len(where))
        curve = _Quadratic.of(information, gradient, at, where, roughness)
        is_held = (at[where] <= self.least) & (gradient[where] > 0.0)
        return curve._replace(information=curve.information + np.diag(np.where(is_held, HELD, 0.0) + RIDGE))


def _settled(curve: _Quadratic, logs: Array) -> Array:
    """Logarithms of the weights that follow from these, downhill by steps that are nearly Newton's."""
    best = curve.best(logs)
    for _ in range(MOST_UPDATES):
        determined, bends = curve.shares(logs, best)
        slope = bends - determined + NEIGHBOURS @ logs
        normal = np.diag(0.5 * (determined + bends) + CURVATURE) + NEIGHBOURS
        step = np.clip(-np.linalg.solve(normal, slope), -LARGEST_UPDATE, LARGEST_UPDATE)
        share = 1.0
        while share > SMALLEST_UPDATE:
            updated = np.clip(logs + share * step, LEAST, MOST)
            lower = curve.best(updated)
            if lower.objective < best.objective:
                break
            share *= 0.5
        else:
            break
        moved = float(np.max(np.abs(updated - logs)))
        logs, best = updated, lower
        if moved < SETTLED:
            break
    return logs


def _axes(curve: _Quadratic, logs: Array) -> Array:
    """(m, HATS) one standard deviation along each axis of the posterior of the weights' logarithms."""

    def slope(at: Array) -> Array:
        determined, bends = curve.shares(at, curve.best(at))
        return np.asarray(bends - determined + NEIGHBOURS @ at)

    steps = DIFFERENCE * np.eye(HATS)
    hessian = np.array([slope(logs + step) - slope(logs - step) for step in steps]) / (2.0 * DIFFERENCE)
    if not np.all(np.isfinite(hessian)):
        # The curve is so far from what is linearised that its bends overflow: then nothing is known of the weights.
        return WIDEST * np.eye(HATS)
    # R is −2 ln of a likelihood.
    sizes, axes = np.linalg.eigh(0.25 * (hessian + hessian.T))
    deviations = 1.0 / np.sqrt(np.maximum(sizes, 0.0) + WIDEST**-2)
    return np.asarray((axes * deviations).T)


class _Roughness(NamedTuple):
    """Second differences D (d, K) of a curve's coefficients, and hat functions H (d, HATS) along them."""

    differences: Array
    hats: Array

    @classmethod
    @functools.cache
    def of(cls, count: int) -> _Roughness:
        at = np.linspace(0.0, HATS - 1.0, count - 2)
        hats = np.maximum(0.0, 1.0 - np.abs(at[:, None] - np.arange(HATS)))
        return cls(np.diff(np.eye(count), 2, axis=0), hats)

    def precision(self, weights: Array) -> Array:
        """(K, K) S: theory, eq. (49)."""
        return self.weighted(self.hats @ weights) + RIDGE * np.eye(self.differences.shape[1])

    def weighted(self, rows: Array) -> Array:
        """(K, K) Dᵀ diag(rows) D."""
        return np.asarray(self.differences.T @ (self.differences * rows[:, None]))


class _Best(NamedTuple):
    """The best curve of some weights, these taken for known.

    Attributes:
        fitted: (K,) its coefficients. covariance: (K, K) of them.
        objective: R of these weights with what their differences add, but for a constant.
    """

    fitted: Array
    covariance: Array
    objective: float


class _Quadratic(NamedTuple):
    """χ² of a linearised fit as a function of a curve's coefficients, all else at its best: cᵀ A c − 2 tᵀ c.

    The ridge of S, which no weight changes, is in A.
    """

    information: Array
    target: Array
    roughness: _Roughness

    @classmethod
    def of(
        cls, information: Array, gradient: Array, at: Array, where: NDArray[np.int64], roughness: _Roughness
    ) -> _Quadratic:
        rest = np.setdiff1d(np.arange(len(at)), where)
        # The rest has units of its own: a nuisance may be known 10¹⁶ times as well as another.
        scale = 1.0 / np.sqrt(np.maximum(np.diag(information)[rest], np.finfo(float).tiny))
        mixed = information[np.ix_(where, rest)] * scale
        right = np.column_stack([mixed.T, scale * gradient[rest]])
        solved = np.linalg.lstsq(information[np.ix_(rest, rest)] * np.outer(scale, scale), right, rcond=1e-13)[0]
        own = information_less(information[np.ix_(where, where)], mixed @ solved[:, :-1])
        slope = gradient[where] - mixed @ solved[:, -1]
        return cls(own, own @ at[where] - slope, roughness)

    def common_weight(self) -> float:
        """The one weight for all of the curve of the least R."""
        weights = np.array(WEIGHTS)
        bends = self.roughness.weighted(self.roughness.hats @ np.ones(HATS))
        normals = self.information + weights[:, None, None] * bends
        scales = 1.0 / np.sqrt(np.diagonal(normals, axis1=1, axis2=2))
        normals *= scales[:, :, None] * scales[:, None, :]
        targets = scales * self.target
        fitted = np.sum(targets * np.linalg.solve(normals, targets[:, :, None])[:, :, 0], axis=1)
        volumes = np.linalg.slogdet(normals)[1] - 2.0 * np.sum(np.log(scales), axis=1)
        return float(weights[np.argmin(volumes - fitted - self._rank * np.log(weights))])

    @property
    def _rank(self) -> int:
        """Of the second differences."""
        return len(self.roughness.hats)

    def best(self, logs: Array) -> _Best:
        """The curve of the least cᵀ (A + S) c − 2 tᵀ c with these logarithms of weights."""
        rows = self.roughness.hats @ np.exp(logs)
        normal = self.information + self.roughness.weighted(rows)
        scale = 1.0 / np.sqrt(np.diag(normal))
        scales = scale[:, None] * scale
        normal *= scales
        covariance = np.linalg.inv(normal) * scales
        fitted = covariance @ self.target
        volume = float(np.linalg.slogdet(normal)[1] - 2.0 * np.sum(np.log(scale)))
        certain = float(np.mean(np.log(rows))) * self._rank
        criterion = volume - certain - float(self.target @ fitted)
        return _Best(fitted, covariance, criterion + 0.5 * float(logs @ NEIGHBOURS @ logs))

    def log_weights(self, logs: Array) -> float:
        """Ln of prior density times volume of the weights' logarithms: even in level, a walk in differences."""
        determined, bends = self.shares(logs, self.best(logs))
        # R and what the differences add to it are −2 ln of a density.
        half = 0.5 * (np.diag(0.5 * (determined + bends) + CURVATURE) + NEIGHBOURS)
        walk = -0.25 * float(logs @ NEIGHBOURS @ logs) - (HATS - 1) * math.log(DIFFERS * math.sqrt(2.0 * math.pi))
        volume = 0.5 * HATS * math.log(2.0 * math.pi) - 0.5 * float(np.linalg.slogdet(half)[1])
        return walk - math.log(MOST - LEAST) + min(volume, HATS * math.log(MOST - LEAST))

    def shares(self, logs: Array, best: _Best) -> tuple[Array, Array]:
        """(HATS,) how many bends the data determine about each weight, and what these add to the penalty.

        The slope of R along the logarithms is the latter less the former: theory, eq. (51).
        """
        differences, hats = self.roughness
        weights = np.exp(logs)
        spread = np.sum((differences @ best.covariance) * differences, axis=1)
        determined = hats.T @ np.maximum(1.0 / (hats @ weights) - spread, 0.0)
        return weights * determined, weights * (hats.T @ (differences @ best.fitted) ** 2)
