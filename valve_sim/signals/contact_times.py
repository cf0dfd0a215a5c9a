"""When a sampled motion first gets to a level: the posterior of that time, from the samples on both sides of it.

Before the contact, at the time τ, the motion is a Gaussian process: at τ it is at the level, with a velocity and an
acceleration that are about those of a body that was moved there by a smooth force, and on the way its acceleration
changes as a Wiener process does. After τ it rests at the level, perhaps after a bounce, or goes on with another
velocity and acceleration. The likelihood of τ is that of the samples under this process and the sensor's noise
(Rasmussen and Williams, Gaussian Processes for Machine Learning, 2006, eq. 2.30). It is normalised between the last
sample that is certainly before the contact and the first that is certainly not. The posterior's mean and standard
deviation hold at any rate: of dense samples the noise decides, and where there are too few to show the motion the time
may be anywhere between two of them.

Way is measured in half the way to the level, time in what that half took. The motion's numbers are of these units, in
which valves are alike: those of test/plants pass 1.0 to 1.3 at the contact, and their acceleration is 0 to 1 there.
"""

from __future__ import annotations

import math
from typing import TYPE_CHECKING, Final, NamedTuple

import numpy as np

if TYPE_CHECKING:
    from numpy.typing import NDArray

    Array = NDArray[np.float64]


class _Normal(NamedTuple):
    """A prior: mean and standard deviation."""

    mean: float
    sigma: float


VELOCITY: Final = _Normal(1.2, 0.4)
"""At the contact."""
ACCELERATION: Final = _Normal(0.5, 0.8)
"""Just before the contact."""
STEP: Final = _Normal(-0.1, 0.5)
"""By which the velocity changes at the contact, where the motion goes on: of a mass that takes another one along."""
NEXT_ACCELERATION: Final = _Normal(0.5, 1.5)
"""By which the acceleration changes there."""
CHANGE: Final = 1.5
"""Standard deviation of the acceleration's change in a unit of time."""
REBOUND: Final = 0.2
"""Standard deviation of the velocity just after a contact at which the motion ends."""
BOUNCE: Final = 0.1
"""Share of the way by which a body may be thrown back."""
BOUNCES: Final = 0.02
"""Prior probability that it was."""
REST: Final = 1e-6
"""m; a body at rest may be this far from where it usually rests."""
FINEST: Final = 1e-9
"""m; noise that is assumed where there is none."""
CERTAIN: Final = 4.0
"""Standard deviations of the noise: a sample further than that from a level is off it."""
NEAREST: Final = 12
"""Samples before and after those that may be on either side of the contact."""
MOST: Final = 48
"""Of those, that are used one by one; of more, means of groups."""
PLACES: Final = 24
"""Times at which the likelihood is computed, spread over where it is not negligible."""
NEGLIGIBLE: Final = 12.0
"""Logarithm of the largest likelihood over one that is."""
PASSES: Final = 6
"""Largest number of times that these places are drawn together."""
RATIO: Final = 1.4
"""Between the units of time that are tried where samples do not tell it."""


class PositionNoise(NamedTuple):
    """Noise of a position: standard deviation, m; correlation of neighbours; standard error of levels of rest, m."""

    sigma: float
    correlation: float
    level: float


class Contact(NamedTuple):
    """When a motion got to a level, s, and the standard error of that, s."""

    time: float
    stderr: float


def contact_time(times: Array, way: Array, length: float, noise: PositionNoise, beyond: float = 0.0) -> Contact | None:
    """When a motion first gets to a level; None if it does not, or was there from the first sample on.

    Args:
        times: s, ascending, shape (n,).
        way: from where the motion, or this part of it, begins towards the level, m, shape (n,).
        length: where the level is on this way, m.
        noise: of the way.
        beyond: how far the motion may go on from there until the next contact, m; 0: it ends at the level.
    """
    margin = CERTAIN * noise.sigma + REST
    close = np.flatnonzero(way >= length - margin)
    if len(close) == 0 or close[0] == 0:
        return None
    near = int(close[0])
    low, high = near - 1, _surely_after(times, way, length, noise.sigma, near)
    if beyond == 0.0:
        # What bounces off between two samples is first seen a little before the level.
        low = min(low, max(int(np.argmax(way >= (1.0 - BOUNCE) * length)) - 1, 0))
    units = _units(times, way, length, near)
    size = math.ceil((high - low) / MOST)
    began = np.flatnonzero(way[:low] < 0.0)
    first = max(int(began[-1]) + 1 if len(began) else 0, low - NEAREST * size)
    ends = (times[high:] > times[high] + units[-1]) | (beyond > 0.0 and way[high:] > length + beyond - margin)
    last = min(high + NEAREST * size, high + int(np.argmax(ends)) if ends.any() else len(times))
    goes_on = beyond > 0.0 and bool(way[high] > length + margin)
    # Where it rests what comes later says nothing of when it came.
    chosen = slice(first, max(last, high + 1) if goes_on else high + 1)
    seen = _grouped(times[chosen], size), _grouped(way[chosen] - length, size)
    motion = _Motion(*seen, float(times[near]), units, 0.5 * length, noise, size, goes_on)
    return motion.contact(float(times[low]), float(times[high]))


def _surely_after(times: Array, way: Array, length: float, sigma: float, near: int) -> int:
    """The first sample that is certainly not before the contact."""
    at = near - 1 - int(np.argmax(way[near - 1 :: -1] < length - 3.0 * CERTAIN * sigma))
    speed = (way[near] - way[at]) / (times[near] - times[at])
    until = times[near] + 4.0 * CERTAIN * sigma / speed if speed > 0.0 else math.inf
    beyond = way[near:] > length + CERTAIN * sigma + REST
    passed = near + int(np.argmax(beyond)) if beyond.any() else len(way) - 1
    return min(passed, int(np.searchsorted(times, until)), len(way) - 1)


def _units(times: Array, way: Array, length: float, near: int) -> Array:
    """(k,) s, what the second half of the way may have taken, evenly spread on a logarithmic scale."""
    below = np.flatnonzero(way[:near] < 0.5 * length)
    at = int(below[-1]) if len(below) else 0
    longest = float(times[near] - times[at])
    shortest = max(float(times[near - 1] - times[min(at + 1, near - 1)]), 0.1 * float(times[near] - times[near - 1]))
    count = max(1, round(math.log(longest / shortest, RATIO)))
    return shortest * (longest / shortest) ** ((np.arange(count) + 0.5) / count)


def _grouped(values: Array, size: int) -> Array:
    """Means of so many neighbours each."""
    count = len(values) // size * size
    return np.asarray(values[:count].reshape(-1, size).mean(axis=1))


class _Motion(NamedTuple):
    """Samples about a contact and what is known of the motion.

    Attributes:
        times: s, (n,). away: from the level, m, (n,). near: time of the first sample that may rest at the level, s.
        units: of time, s, (k,). unit: of the way, m. noise: of a sample. size: samples in a group.
        goes_on: whether the motion goes on beyond the level.
    """

    times: Array
    away: Array
    near: float
    units: Array
    unit: float
    noise: PositionNoise
    size: int
    goes_on: bool

    def contact(self, low: float, high: float) -> Contact:
        """Mean and standard deviation of the posterior between two times, s."""
        for _ in range(PASSES):
            step = (high - low) / PLACES
            places: Array = np.asarray(low + step * (np.arange(PLACES) + 0.5), dtype=np.float64)
            likelihood = np.logaddexp.reduce([self._log_likelihood(places, float(unit)) for unit in self.units], axis=0)
            likelihood -= likelihood.max()
            kept = np.flatnonzero(likelihood > -NEGLIGIBLE)
            if kept[-1] - kept[0] > PLACES // 3:
                break
            low, high = max(low, float(places[kept[0]]) - step), min(high, float(places[kept[-1]]) + step)
        weights = np.exp(likelihood) / np.sum(np.exp(likelihood))
        time = float(weights @ places)
        return Contact(time, math.sqrt(float(weights @ np.square(places - time)) + step**2 / 12.0))

    def _log_likelihood(self, places: Array, unit: float) -> Array:
        """(p,) of a contact at each place, s, where half the way took so many s."""
        since = (self.times - places[:, None]) / unit
        before, after = np.minimum(since, 0.0), np.maximum(since, 0.0)
        moving = since if self.goes_on else before
        bend = np.square(moving) / 2.0
        mean = VELOCITY.mean * moving + ACCELERATION.mean * bend
        covariance = VELOCITY.sigma**2 * _outer(moving) + ACCELERATION.sigma**2 * _outer(bend)
        covariance += CHANGE**2 * _wiener(-before)
        own, together = (max(self.noise.sigma, FINEST) / self.unit) ** 2 / self.size, self.noise.level
        index = np.arange(len(self.times))
        colour = self.noise.correlation ** (self.size * np.abs(index[:, None] - index))
        covariance += own * colour
        prior: Array = np.zeros(len(places))
        if self.goes_on:
            bend = np.square(after) / 2.0
            mean += STEP.mean * after + NEXT_ACCELERATION.mean * bend
            covariance += STEP.sigma**2 * _outer(after) + NEXT_ACCELERATION.sigma**2 * _outer(bend)
            covariance += CHANGE**2 * _wiener(after)
        else:
            bounced = (since > 0.0) & (self.times < self.near)
            rests = np.where(since > 0.0, (REST / self.unit) ** 2, 0.0) + np.where(bounced, (2.0 * BOUNCE) ** 2, 0.0)
            covariance[:, index, index] += rests
            prior = np.asarray(np.where(bounced.any(axis=1), math.log(BOUNCES), 0.0), dtype=np.float64)
            covariance += REBOUND**2 * _outer(after)
            together = math.hypot(together, REST)
        covariance += (together / self.unit) ** 2
        root = np.linalg.cholesky(covariance)
        white = np.linalg.solve(root, (self.away / self.unit - mean)[:, :, None])[:, :, 0]
        spread = np.log(np.diagonal(root, axis1=1, axis2=2))
        return np.asarray(prior - np.sum(0.5 * np.square(white) + spread, axis=1))


def _outer(values: Array) -> Array:
    """(p, n, n) products of (p, n) values."""
    return np.asarray(values[:, :, None] * values[:, None, :])


def _wiener(since: Array) -> Array:
    """(p, n, n) covariance of a way whose acceleration has been a Wiener process since so long, (p, n)."""
    shorter = np.minimum(since[:, :, None], since[:, None, :])
    longer = np.maximum(since[:, :, None], since[:, None, :])
    cube = shorter * shorter * shorter / 120.0
    return np.asarray(cube * (longer * (10.0 * longer - 5.0 * shorter) + shorter * shorter))
