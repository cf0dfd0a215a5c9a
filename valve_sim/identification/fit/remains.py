"""Where in the motion a fit leaves most of what it leaves."""

from __future__ import annotations

import math
from typing import Final, NamedTuple

import numpy as np
from numpy.typing import NDArray
from scipy.ndimage import uniform_filter1d

from valve_sim.identification.fit.fitter import Tried
from valve_sim.identification.fit.left_out import left_by, response_in_motion
from valve_sim.identification.plants.protocol import Array, Channel, primary_channels

PLACES: Final = 5
"""Parts of the range of the response, rising and falling."""
MOST_OF_IT: Final = 2.0
"""Share of the squares over the share of the samples, from which a place is one."""
SMOOTHED: Final = 9
"""Samples over which a motion is averaged, to tell rising from falling."""


class Place(NamedTuple):
    """Where most of it is left: the range of the response, in its unit, while it rises or falls."""

    low: float
    high: float
    is_rising: bool


def place_of(tried: Tried) -> Place | None:
    """The part of the motion in which a fit leaves most; None where that is no more than elsewhere."""
    gaussian = tried.fit.gaussian
    problem = gaussian.model.problem
    places, channels = problem.rows.places, problem.plant.channels
    rows = np.flatnonzero(response_in_motion(problem))
    squares = np.square(left_by(gaussian)[rows])
    values, rises = np.zeros(len(rows)), np.zeros(len(rows), dtype=bool)
    for index in primary_channels(problem.plant):
        own = places.channel[rows] == index
        values[own], rises[own] = _motion(channels[index], places.time[rows[own]])
    low, high = float(np.min(values)), float(np.max(values))
    if not high > low or not np.sum(squares) > 0.0:
        return None
    part = np.minimum((PLACES * (values - low) / (high - low)).astype(int), PLACES - 1) + PLACES * rises
    left = np.bincount(part, squares, 2 * PLACES)
    usual = np.bincount(part, minlength=2 * PLACES) / len(part)
    worst = int(np.argmax(left))
    if left[worst] < MOST_OF_IT * usual[worst] * math.fsum(left):
        return None
    edges = low + (high - low) * np.array([worst % PLACES, worst % PLACES + 1]) / PLACES
    return Place(float(edges[0]), float(edges[1]), worst >= PLACES)


def _motion(channel: Channel, times: Array) -> tuple[Array, NDArray[np.bool_]]:
    """What a channel shows at some times, and whether it rises."""
    shown = uniform_filter1d(channel.data, min(SMOOTHED, len(channel.data)))
    at = np.minimum(np.searchsorted(channel.times, times), len(shown) - 1)
    return shown[at], (np.gradient(shown) > 0.0)[at]
