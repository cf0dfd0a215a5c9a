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
    rest = max(REST_SIGMAS * sigma, REST_SHARE * span)
    levels = _levels(volts, rest, max(LEVEL_SIGMAS * sigma, LEVEL_SHARE * span))
    middles = 0.5 * (levels[1:] + levels[:-1])
    numbers = _without_short(np.searchsorted(middles, volts))
    starts = np.flatnonzero(np.diff(numbers)) + 1
    steps = [float(times[0]), *(_crossing(times, volts, levels, numbers, start) for start in starts.tolist())]
    found = levels[numbers[np.concatenate([[0], starts])]]
    highest = float(np.abs(levels).max())
    found = np.where(np.abs(found) < ZERO_SHARE * highest, 0.0, found)
    return np.maximum.accumulate(np.array(steps)), found


def _noise(values: Array) -> float:
    """Standard deviation of white noise, from second differences: steps are too few to count."""
    if len(values) < 4:
        return 0.0
    return float(MAD_TO_SIGMA * np.median(np.abs(np.diff(values, 2))) / np.sqrt(6.0))


def _levels(volts: Array, rest: float, distance: float) -> Array:
    """Values at which the voltage rests (stays within `rest`), ascending, at least half of `distance` apart."""
    if len(volts) < SHORTEST_LEVEL:
        return np.unique(volts)
    windows = np.lib.stride_tricks.sliding_window_view(volts, SHORTEST_LEVEL)
    resting = np.sort(np.median(windows, axis=1)[np.ptp(windows, axis=1) <= rest])
    if not len(resting):
        return np.unique(volts[[0, -1]])
    groups = np.split(resting, np.flatnonzero(np.diff(resting) > 0.5 * distance) + 1)
    medians = [float(np.median(group)) for group in groups if len(group) >= SHORTEST_LEVEL] or [float(resting[0])]
    levels = [medians[0]]
    for level in medians[1:]:
        if level - levels[-1] > 0.5 * distance:
            levels.append(level)
    return np.array(levels)


def _without_short(numbers: NDArray[np.intp]) -> NDArray[np.intp]:
    """Levels sample by sample, where runs of less than `SHORTEST_LEVEL` go to the run that follows them."""
    starts = np.concatenate([[0], np.flatnonzero(np.diff(numbers)) + 1])
    lengths = np.diff(np.concatenate([starts, [len(numbers)]]))
    keep = lengths >= SHORTEST_LEVEL
    keep[-1] |= not keep.any()
    result = np.empty_like(numbers)
    before = 0
    for end, number in zip((starts + lengths)[keep].tolist(), numbers[starts[keep]].tolist(), strict=True):
        result[before:end] = number
        before = end
    result[before:] = result[before - 1]
    return result


def _crossing(times: Array, volts: Array, levels: Array, numbers: NDArray[np.intp], start: int) -> float:
    """When the voltage crossed the middle between the levels before and after sample `start`."""
    before, after = levels[numbers[start - 1]], levels[numbers[start]]
    middle = 0.5 * (before + after)
    window = np.arange(max(start - SHORTEST_LEVEL, 1), min(start + 2 * SHORTEST_LEVEL, len(volts)))
    is_over = (volts[window] - middle) * (after - before) >= 0.0
    first = int(window[np.argmax(is_over)]) if is_over.any() else start
    low, high = volts[first - 1], volts[first]
    share = (middle - low) / (high - low) if high != low else 1.0
    return float(times[first - 1] + np.clip(share, 0.0, 1.0) * (times[first] - times[first - 1]))
