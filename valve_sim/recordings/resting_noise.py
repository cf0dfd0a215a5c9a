"""The noise of a position sensor at rest, and its steps, found without knowing when the plunger rests."""

from __future__ import annotations

import math
from typing import TYPE_CHECKING, Final, NamedTuple

import numpy as np

if TYPE_CHECKING:
    from numpy.typing import NDArray

    Array = NDArray[np.float64]

MAD_TO_SIGMA: Final = 1.4826
"""Median absolute deviation of a normal distribution to its standard deviation."""
PLACE: Final = 16
"""Readings from which the noise at one place is estimated."""
FEWEST_PLACES: Final = 8
"""Places from which noise is told from motion."""
QUIETEST: Final = 0.1
"""Share of the places that are at rest, at least; what is seen at the others may be motion."""
MOVES: Final = 2.5
"""Noise by first differences over that by second ones, beyond which it is motion; of noise whose neighbours have a
correlation of 0.9 it is 1.2."""
LEAST: Final = 1e-10
"""m; less noise is rounding, or how a simulation creeps."""
ON_GRID: Final = 0.9
"""Share of the readings that lie on the grid of a coarse sensor; spikes need not."""
NEAR_GRID: Final = 0.02
"""Steps within which a reading lies on the grid: chance would put one in 25 there."""
FINEST_STEP: Final = 1e-7
"""Of the range of readings; what is closer is one level, off by how a number is rounded."""
MIDDLE: Final = 0.995
"""Quantile of readings at the end of that range: spikes lie beyond."""
READ_AGAIN: Final = 3
"""Readings of the usual level of a sensor with uneven steps: levels of a motion are read once or twice."""
FEW_LEVELS: Final = 2
"""Levels between which nobody can tell a step from a motion."""
ENOUGH: Final = 20_000
"""Readings, spread over a recording, that show its sensor's steps."""
GAPS: Final = (0.05, 0.1, 0.25, 0.5)
"""Quantiles of the gaps between different readings, of which one is the step: spikes make smaller gaps, motion larger
ones."""
SURE: Final = 6.0
"""Standard deviations that differences of two readings do not reach by chance."""
SMALLEST: Final = 0.1e-6
"""m; noise that is assumed where there is less, so that rounding is no finding."""
BY_CHANCE: Final = 1e-3
"""Expected number, in a whole recording, of rows of equal readings that noise makes and the sensor is blamed for."""
HIDDEN: Final = 0.5
"""Probability of the likeliest reading at rest, above which a sensor's steps hide its noise: it repeats lawfully. One
that rests between two steps shows both, with a likeliest one of 0.6; elsewhere it shows one of them."""


class RestingNoise(NamedTuple):
    """The noise of a sensor at rest.

    Attributes:
        sigma: A robust standard deviation, no larger than the true one, m; 0 where it is not known, or hidden by steps.
        step: By which readings are rounded, m; 0 where no step is seen.
    """

    sigma: float
    step: float

    @property
    def likeliest(self) -> float:
        """The largest probability that any one reading has at rest; 1 where no noise is seen."""
        return math.erf(self.step / (math.sqrt(8.0) * self.sigma)) if self.sigma > 0.0 else 1.0

    @property
    def is_hidden(self) -> bool:
        """Whether equal readings say nothing, because the sensor shows no noise at rest."""
        return self.likeliest >= HIDDEN

    @property
    def seen(self) -> float:
        """A difference of two readings that is more than noise, m."""
        return 3.0 * self.step + SURE * self.sigma + SMALLEST

    def longest_row(self, count: int) -> float:
        """The length of a row of equal readings of which noise makes `BY_CHANCE` in so many readings."""
        if not 0.0 < self.likeliest < 1.0:
            return math.inf if self.likeliest else 0.0
        return 1.0 + math.log(BY_CHANCE / count) / math.log(self.likeliest)


def step_of(readings: Array) -> float:
    """Return the step by which readings, shape (n,), of a sensor are rounded, in their unit; 0 where none is seen.

    Steps of a curved sensor behind a converter, as of a thermistor, differ: then it is the median of those between
    levels, where most of these are read again and again.
    """
    some = np.sort(readings[:: max(1, len(readings) // ENOUGH)])
    if not len(some):
        return 0.0
    low, high = np.quantile(some, (1.0 - MIDDLE, MIDDLE))
    first = np.flatnonzero(np.diff(some, prepend=-np.inf) > FINEST_STEP * (high - low or some[-1] - some[0]))
    levels, counts = some[first], np.diff(np.append(first, len(some)))
    gaps = np.diff(levels)
    if not len(gaps):
        return 0.0
    often = levels[np.argmax(counts)]
    for step in np.quantile(gaps, GAPS, method="lower").tolist():
        steps = (levels - often) / step
        is_on = np.abs(steps - np.round(steps)) < NEAR_GRID
        if counts[is_on].sum() >= ON_GRID * len(some):
            return float(step)
    is_read_again = len(levels) > FEW_LEVELS and 2 * len(levels) <= len(some) and np.median(counts) >= READ_AGAIN
    return float(np.median(gaps)) if is_read_again else 0.0


def resting_noise(positions: Array, step: float) -> RestingNoise:
    """Return the noise at rest of a sensor with a known step, from the differences of positions, shape (n,).

    Second differences show a part of coloured noise. The noise is not known where the plunger is so rarely at rest that
    the quietest places are of motion, too: then first differences are much larger.
    """
    places = (len(positions) - 2) // PLACE
    if places < FEWEST_PLACES:
        return RestingNoise(0.0, step)

    def quietest(order: int) -> float:
        found = np.abs(np.diff(positions, order))[: places * PLACE].reshape(places, PLACE)
        return float(np.quantile(np.median(found, axis=1), QUIETEST))

    changes, sigma = quietest(1) / math.sqrt(2.0), quietest(2) / math.sqrt(6.0)
    return RestingNoise(MAD_TO_SIGMA * sigma if max(changes / MOVES, LEAST) <= sigma else 0.0, step)
