"""When a sampled motion first gets to a level: where a cubic through the samples before it crosses it."""

from __future__ import annotations

import math
from typing import TYPE_CHECKING, Final, NamedTuple

import numpy as np

from valve_sim.recordings.motion import medians_of_three

if TYPE_CHECKING:
    from numpy.typing import NDArray

    Array = NDArray[np.float64]

CERTAIN: Final = 4.0
"""Standard deviations of the noise: a sample further than that from a level is off it."""
REST: Final = 1e-6
"""m; a body at rest may be this far from where it usually rests."""
LAST: Final = 0.5
"""Share of the way, at its end, that the cubic goes through."""
FEWEST: Final = 2
"""Samples there: fewer show no motion, and the crossing may be anywhere between two samples."""
USUAL: Final = np.array([1.2, 0.25, 0.0])
USUAL_SIGMA: Final = np.array([0.5, 0.5, 0.25])
"""Speed, bend and cubic term there, in units of the last half of the way and of what that took, and how they vary."""
FINEST: Final = 1e-9
"""m; noise that is assumed where there is none."""
CURVED: Final = 0.25
"""Of the last half of the way: how far the motion is off a cubic at its beginning."""


class PositionNoise(NamedTuple):
    """Noise of a position: standard deviation, that of white noise with equal means, and of its levels, m."""

    sigma: float
    together: float
    level: float

    @property
    def of_pairs(self) -> PositionNoise:
        """Of means of two neighbouring samples."""
        together = self.together / math.sqrt(2.0)
        return PositionNoise(min(self.sigma, together), together, self.level)


class Contact(NamedTuple):
    """When a motion got to a level, s, and the standard error of that, s."""

    time: float
    stderr: float


def contact_time(times: Array, way: Array, length: float, noise: PositionNoise) -> Contact | None:
    """When a motion first gets to a level; None if it does not, or was there from the first sample on.

    Args:
        times: s, ascending, shape (n,).
        way: from where the motion, or this part of it, begins towards the level, m, shape (n,).
        length: where the level is on this way, m.
        noise: of the way.
    """
    margin = CERTAIN * noise.sigma + REST
    until = int(np.argmax(way >= length)) or len(way)
    midway = np.count_nonzero(np.abs(way[:until] / length - 0.5) < 0.5 * LAST)
    if midway > FEWEST and LAST * length < 2.0 * CERTAIN * noise.sigma * midway:
        return contact_time(*_of_pairs(times, way), length, noise.of_pairs)
    is_off = np.zeros(len(way), dtype=bool)
    if midway > FEWEST:  # then a single reading that is off is no motion
        read, way = way, medians_of_three(np.concatenate([way[:1], way, way[-1:]]))
        is_off = np.abs(read - way) > margin
        way = np.where(is_off, way, read)
    close = np.flatnonzero(way >= length - margin)
    if len(close) == 0 or close[0] == 0:
        return None
    near = int(close[0])
    low, high = float(times[near - 1]), float(times[near])
    begins = np.flatnonzero(way[:near] < (1.0 - LAST) * length)
    first = int(begins[-1]) + 1 if len(begins) else 0
    start = max(0, min(first, near - 1))
    late = high + margin * (high - float(times[start])) / max(float(way[near] - way[start]), margin)
    if near - first < FEWEST:
        return Contact(0.5 * (low + late), (late - low) / math.sqrt(12.0))
    half, scale = LAST * length, high - float(times[first])
    used = first + np.flatnonzero(~is_off[first:near])
    at, values = (times[used] - high) / scale, way[used]
    # A motion that is no cubic is off it by a power of how far it is from the level.
    spread = np.hypot(max(noise.together, FINEST), CURVED * half * at**4)
    design = np.vander(at, 4, increasing=True) / spread[:, None]
    covariance = np.linalg.inv(design.T @ design + np.diag(np.square([0.0, *(1.0 / USUAL_SIGMA / half)])))
    level, *rest = covariance @ (design.T @ (values / spread) + [0.0, *(USUAL / np.square(USUAL_SIGMA) / half)])
    ahead = (length - level) / max(rest[0], 0.2 * half)
    ahead = (length - level) / max(rest[0] + rest[1] * ahead, 0.2 * half)
    powers = ahead ** np.arange(4)
    slope = max(float(np.arange(1, 4) * rest @ powers[:3]), 0.2 * half)
    error = math.hypot(math.sqrt(float(powers @ covariance @ powers)), noise.level) / slope
    return Contact(float(np.clip(high + ahead * scale, low, late)), float(min(error * scale, late - low)))


def _of_pairs(times: Array, values: Array) -> tuple[Array, Array]:
    """Means of times and values, (n,) each, of every two samples that follow each other, (n // 2,) each."""
    even = len(times) // 2 * 2
    return times[:even].reshape(-1, 2).mean(axis=1), values[:even].reshape(-1, 2).mean(axis=1)
