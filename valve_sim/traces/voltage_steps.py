"""Commands out of a measured voltage: where it stepped, and to which level."""

from __future__ import annotations

from typing import TYPE_CHECKING

import numpy as np

from valve_sim.traces.errors import TraceError
from valve_sim.traces.strokes import MAD_TO_SIGMA

if TYPE_CHECKING:
    from numpy.typing import NDArray

    Array = NDArray[np.float64]

LEVEL_SIGMAS = 10.0
"""Levels nearer to each other than this many standard deviations of the noise are one."""
REST_SIGMAS = 6.0
REST_SHARE = 0.002
"""A voltage rests while `SHORTEST_LEVEL` samples stay within this much of the noise or the span: a ramp does not."""
LEVEL_SHARE = 0.04
"""Levels nearer than this share of the whole span are one: ripple and droop are no commands."""
SHORTEST_LEVEL = 3
"""Samples; what is shorter is the way from one level to the next."""
SMALLEST_SPAN = 0.05
"""V; a voltage that stays within this was never switched."""
ZERO_SHARE = 0.03
"""Levels below this share of the highest are 0 V: what is left is the probe's offset."""


def find_steps(times: Array, volts: Array, source: str) -> tuple[Array, Array]:
    """Return when a measured voltage changed its level, and to which, piecewise constant.

    Levels are the values at which the voltage rests; a step is dated where the voltage crosses the middle between two
    levels, by a straight line between the samples on either side.

    Args:
        times: s, strictly ascending, shape (n,).
        volts: V, finite, shape (n,).
        source: For messages: file and column or topic.

    Returns:
        Times, s, shape (k,), the first being the first sample's, and levels, V, shape (k,).

    Raises:
        TraceError: The voltage never changes.
    """
    span = float(np.ptp(volts)) if len(volts) else 0.0
    sigma = _noise(volts)
    if span < max(SMALLEST_SPAN, 2.0 * LEVEL_SIGMAS * sigma) and span < 0.5 * float(np.abs(volts).max(initial=0.0)) + (
        SMALLEST_SPAN
    ):
        raise TraceError(
            f"{source}: the voltage stays between {volts.min(initial=np.inf):.4g} and {volts.max(initial=-np.inf):.4g} "
            "V: no step in it, so no command; name the coil's voltage, and check unit: and scale:"
        )
    level_of, levels = _levels(
        volts, max(REST_SIGMAS * sigma, REST_SHARE * span), max(LEVEL_SIGMAS * sigma, LEVEL_SHARE * span)
    )
    at = np.flatnonzero(level_of >= 0)
    places = np.flatnonzero(np.diff(level_of[at])) + 1
    found = levels[level_of[at[np.concatenate([[0], places])]]]
    edges = [
        _crossing(times[last : first + 1], volts[last : first + 1], 0.5 * (before + after))
        for last, first, before, after in zip(at[places - 1], at[places], found[:-1], found[1:], strict=True)
    ]
    highest = float(np.abs(levels).max())
    found = np.where(np.abs(found) < ZERO_SHARE * highest, 0.0, found)
    return np.array([float(times[0]), *edges]), found


def _noise(values: Array) -> float:
    """Standard deviation of white noise, from second differences: steps are too few to count."""
    if len(values) < 4:
        return 0.0
    return float(MAD_TO_SIGMA * np.median(np.abs(np.diff(values, 2))) / np.sqrt(6.0))


def _levels(volts: Array, rest: float, distance: float) -> tuple[NDArray[np.intp], Array]:
    """Return each sample's level (-1 on the way from one to the next) and the levels, V, ascending.

    Args:
        volts: Shape (n,).
        rest: V; `SHORTEST_LEVEL` samples within it rest.
        distance: V; two levels are at least half of it apart.
    """
    count = len(volts)
    if count < SHORTEST_LEVEL:
        return np.zeros(count, dtype=np.intp), volts[:1]
    windows = np.lib.stride_tricks.sliding_window_view(volts, SHORTEST_LEVEL)
    middle, is_still = np.median(windows, axis=1), np.ptp(windows, axis=1) <= rest
    if not is_still.any():
        return np.zeros(count, dtype=np.intp), np.array([float(np.median(volts))])
    resting = np.sort(middle[is_still])
    groups = np.split(resting, np.flatnonzero(np.diff(resting) > 0.5 * distance) + 1)
    levels = np.array([float(np.median(group)) for group in groups])
    borders = 0.5 * (levels[1:] + levels[:-1])
    level_of = np.full(count, -1, dtype=np.intp)
    for place in range(SHORTEST_LEVEL):
        level_of[place : count - SHORTEST_LEVEL + 1 + place][is_still] = np.searchsorted(borders, middle[is_still])
    return level_of, levels


def _crossing(times: Array, volts: Array, middle: float) -> float:
    """When the voltage first crossed the middle, by a straight line, between a resting sample and the next one."""
    is_over = (volts - middle) * np.sign(volts[-1] - volts[0]) >= 0.0
    first = max(1, int(np.argmax(is_over)))
    low, high = volts[first - 1], volts[first]
    share = (middle - low) / (high - low) if high != low else 1.0
    return float(times[first - 1] + np.clip(share, 0.0, 1.0) * (times[first] - times[first - 1]))
