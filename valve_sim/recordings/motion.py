"""How far a position's noise reaches, and from where on it has moved."""

from __future__ import annotations

import math
from typing import TYPE_CHECKING

import numpy as np

from valve_sim.recordings.resting_noise import MAD_TO_SIGMA, step_of

if TYPE_CHECKING:
    from numpy.typing import NDArray

    Array = NDArray[np.float64]

MOTION_SIGMAS = 25.0
"""Noise alone spans 9 sigma in 10⁵ samples; sigma from differences is half the truth for AR(1) noise of 0.7."""

MOTION_STEPS = 3.0
"""Quantisation steps that a resting sensor may flicker over."""

SMALLEST_MOTION = 1e-6
"""m; below the resolution that any of the sensors of the paper resolves at rest."""


def sample_noise(values: Array, order: int = 2) -> float:
    """Return the standard deviation of white noise, from differences of an order, of which few are of motion."""
    if len(values) < order + 2:
        return 0.0
    return float(MAD_TO_SIGMA * np.median(np.abs(np.diff(values, order)))) / math.sqrt(math.comb(2 * order, order))


def motion_threshold(position: Array) -> float:
    """Return the span, m, above which a position has moved; below it may be noise."""
    return MOTION_SIGMAS * sample_noise(position) + MOTION_STEPS * step_of(position) + SMALLEST_MOTION


def medians_of_three(values: Array) -> Array:
    """Return the values, shape (n,), without single outliers, shape (n - 2,); fewer than three as they are."""
    if len(values) < 3:
        return values
    before, here, after = values[:-2], values[1:-1], values[2:]
    larger = np.maximum(before, after)
    return np.asarray(np.maximum(np.minimum(before, after), np.minimum(larger, here)))


def largest_travel(position: Array) -> float:
    """Return the span of a position, m, without single outliers."""
    if not len(position):
        return 0.0
    low, high = travel_ends(position)
    return high - low


def travel_ends(position: Array) -> tuple[float, float]:
    """Return the closed and the open end of a trace's motion, m."""
    middle = medians_of_three(position)
    return float(middle.min()), float(middle.max())
