"""Laplace's approximation of an evidence: the volume under a Gaussian, and how much of it lies within the ranges.

About the optimum ẑ the criterion C = χ² − 2 ln prior is C(ẑ) + 2 gᵀ d + dᵀ A d, d = z − ẑ, and its integral

    ∫ exp(−C/2) dz  =  exp(−C(ẑ)/2) (2π)^(k/2) |A|^(−1/2) Π share

g is 0 but where a coordinate ends its range. The share of each coordinate is that of its own Gaussian, all others at
their best, within the range: exact where one coordinate is near an end, and the usual approximation where several are
(MacKay, Information Theory, Inference, and Learning Algorithms, 2003, chapters 27 and 28).
"""

from __future__ import annotations

import math
from typing import Final

import numpy as np
from scipy.linalg.lapack import dpotrf, dpotri
from scipy.special import log_ndtr

from valve_sim.identification.plants.protocol import Array

SMALLEST: Final = 1e-13
"""Eigenvalue of the information, scaled to a unit diagonal, below which it is rounding."""
PIVOT: Final = 1e-5
"""Pivot of Cholesky's factor of such a matrix, the square of which is still far above rounding."""
EVEN: Final = 1e-6
"""Information, in inverse squares of a range, that changes nothing within it."""
TINY: Final = 1e-200
"""Smallest divisor."""
FAR: Final = 6.0
"""Standard deviations beyond which an end of a range takes nothing away."""


def log_volume(information: Array, slopes: Array, room: Array) -> float:
    """Ln of the integral of exp(−(2 gᵀ d + dᵀ A d)/2) over the ranges.

    Args:
        information: (k, k) A, priors included. slopes: (k,) g, half the gradient of the criterion.
        room: (k, 2) how far the range goes on below and above the optimum; infinite where it has no end.
    """
    count = len(slopes)
    if count == 0:
        return 0.0
    # What nothing is known of may be anywhere in its range: a Gaussian far wider than that is as even.
    ranges = room.sum(axis=1)
    information = information + np.diag(np.where(np.isfinite(ranges), EVEN / np.square(np.maximum(ranges, TINY)), 0.0))
    scale = 1.0 / np.sqrt(np.maximum(np.diag(information), TINY))
    log_determinant, variances = _inverted(information * np.outer(scale, scale))
    volume = 0.5 * count * math.log(2.0 * math.pi) - 0.5 * log_determinant + float(np.sum(np.log(scale)))
    sigmas = np.sqrt(variances) * scale
    near = np.flatnonzero(~(room.min(axis=1) > FAR * sigmas))
    return volume + sum(
        _log_share(sigma, slope, below, above)
        for sigma, slope, (below, above) in zip(
            sigmas[near].tolist(), slopes[near].tolist(), room[near].tolist(), strict=True
        )
    )


def _inverted(normal: Array) -> tuple[float, Array]:
    """Ln of the determinant of a positive (k, k) matrix of unit diagonal, and the (k,) diagonal of its inverse.

    By Cholesky's factor, which takes a tenth of the time; by eigenvalues where rounding shows in it.
    """
    factor, failed = dpotrf(normal, lower=1)
    pivots = np.diag(factor)
    if not failed and float(pivots.min()) > PIVOT:
        inverse, _ = dpotri(factor, lower=1)
        return 2.0 * float(np.sum(np.log(pivots))), np.diag(inverse).copy()
    sizes, directions = np.linalg.eigh(normal)
    sizes = np.maximum(sizes, SMALLEST)
    return float(np.sum(np.log(sizes))), np.einsum("ij,j,ij->i", directions, 1.0 / sizes, directions)


def _log_share(sigma: float, slope: float, below: float, above: float) -> float:
    """Ln of ∫ exp(−g d − d²/(2 σ²)) dd from −below to above, over √(2π) σ."""
    # At an end of the range the gradient points outwards: the Gaussian's centre lies beyond it.
    is_held = (below == 0.0 and slope > 0.0) or (above == 0.0 and slope < 0.0)
    centre = -slope * sigma**2 if is_held else 0.0
    low, high = (-below - centre) / sigma, (above - centre) / sigma
    return 0.5 * (centre / sigma) ** 2 + _log_between(low, high)


def _log_between(low: float, high: float) -> float:
    """Ln of the probability that a standard normal number lies between the two."""
    if low > 0.0:
        low, high = -high, -low
    top, bottom = float(log_ndtr(high)), float(log_ndtr(low))
    return top + math.log1p(-math.exp(min(bottom - top, -1e-15))) if math.isfinite(bottom) else top
