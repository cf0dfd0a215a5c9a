"""Where motion bends a coil's current: at a stop its slope jumps, where the moving mass changes its curvature does.

No model is used. Around every sample a cubic is fitted, and beside it one that may bend there; the bend that is
plainest tells the time. A current that motion does not bend, or that is sampled too coarsely, shows none.
"""

from __future__ import annotations

import math
from typing import TYPE_CHECKING, Final, NamedTuple

import numpy as np

if TYPE_CHECKING:
    from numpy.typing import NDArray

    Array = NDArray[np.float64]

HALF_WIDTHS: Final = {1: 0.5e-3, 2: 1.2e-3}
"""s, to each side of a bend of the slope and of the curvature, that is looked at."""
FEWEST: Final = 7
"""Samples to each side."""
PLAIN: Final = 10.0
"""Standard errors of a bend that is one."""
AS_PLAIN: Final = 0.5
"""Share of the plainest bend's standard errors that an earlier one has, of a contact before it."""
BETTER: Final = 3.0
"""By this factor a bend must lower the variance of what is left: a smooth curve is no cubic either."""
SHARPEST: Final = 0.05
"""Of the interval between samples: the least standard error, of a bend that takes a part of it."""
EVEN: Final = 0.02
"""Relative scatter of sampling intervals that are taken for equal."""
STEPS: Final = 41
"""Places between two samples to each side, of which the best one is the bend's."""


class Bend(NamedTuple):
    """A bend of a current: time, s, and its standard error, s."""

    time: float
    stderr: float


def find_bends(times: Array, current: Array, *, closes: bool) -> tuple[Bend | None, Bend | None]:
    """Where the plungers were halted, and where before that they were slowed; None where nothing shows.

    Args:
        times: of one part of a stroke, s, ascending, shape (n,). current: A, shape (n,).
        closes: whether the current dies away.
    """
    sign = 1.0 if current.sum() >= 0.0 else -1.0
    # Motion towards the core takes current away, so that its end gives some back; away from the core it is reversed.
    direction = -sign if closes else sign
    halted = _bend(times, direction * current, 1)
    if halted is None:
        return None, None
    before = int(np.searchsorted(times, halted.time - HALF_WIDTHS[2] / 2.0))
    return halted, _bend(times[:before], direction * current[:before], 2)


def _bend(times: Array, values: Array, order: int) -> Bend | None:
    """The plainest upward bend of a derivative, 1: of the slope, 2: of the curvature."""
    if len(times) < 2 * FEWEST + 1:
        return None
    interval = float(np.median(np.diff(times)))
    half = max(FEWEST, round(HALF_WIDTHS[order] / interval))
    if half * interval > 2.0 * HALF_WIDTHS[order] or len(times) <= 2 * half + 2:
        return None
    windows = np.lib.stride_tricks.sliding_window_view(values, 2 * half + 1)
    spans = times[2 * half :] - times[: -2 * half]
    is_even = np.abs(spans / (2 * half * interval) - 1.0) < EVEN
    plainness, gain = _plainness(windows, np.arange(-half, half + 1) / half, order)
    plainness[~is_even | (gain < BETTER)] = 0.0
    if plainness.max() < PLAIN:
        return None
    # A plunger that bounces meets the stop again: the first of those that are about as plain is when it arrived.
    plain = np.flatnonzero(plainness >= max(PLAIN, AS_PLAIN * float(plainness.max())))
    best = int(plain[0]) + int(np.argmax(plainness[plain[0] : plain[0] + half]))
    wide, narrow = (
        _refined(times[inside], values[inside], order)
        for inside in (slice(best + half - own, best + half + own + 1) for own in (half, max(FEWEST, half // 2)))
    )
    # A current is no cubic: what that makes of the time is seen by looking at less of it.
    error = math.hypot(narrow.stderr, narrow.time - wide.time, SHARPEST * interval)
    return Bend(wide.time, error)


def _plainness(windows: Array, place: Array, order: int) -> tuple[Array, Array]:
    """(k,) standard errors of the bend in the middle of each window, and by what factor it lowers the variance."""
    smooth = np.vander(place, 4, increasing=True)
    hinge = np.maximum(place, 0.0) ** order
    own = hinge - smooth @ np.linalg.lstsq(smooth, hinge, rcond=None)[0]
    residual = windows - windows @ np.linalg.pinv(smooth).T @ smooth.T
    size = residual @ own / float(own @ own)
    before = np.einsum("ij,ij->i", residual, residual)
    after = np.maximum(before - size**2 * float(own @ own), np.finfo(float).tiny)
    sigma = np.sqrt(after / (len(place) - 5))
    return size * np.sqrt(float(own @ own)) / sigma, before / after


def _refined(times: Array, values: Array, order: int) -> Bend:
    """The bend between samples: the place that leaves least, and how sharply it is the least."""
    middle, interval = times[len(times) // 2], times[1] - times[0]
    scale = times[-1] - middle
    places = middle + np.linspace(-2.0, 2.0, STEPS) * interval
    left = np.empty(STEPS)
    for index, place in enumerate(places.tolist()):
        shifted = (times - place) / scale
        design = np.column_stack([np.vander(shifted, 4), np.maximum(shifted, 0.0) ** order])
        left[index] = np.sum(np.square(values - design @ np.linalg.lstsq(design, values, rcond=None)[0]))
    best = int(np.argmin(left))
    variance = left[best] / (len(times) - 6)
    time = float(places[best])
    if 0 < best < STEPS - 1:
        around = slice(max(0, best - 3), best + 4)
        curvature, slope, _ = np.polyfit(places[around] - places[best], left[around], 2)
        if curvature > 0.0:
            time += float(np.clip(-slope / (2.0 * curvature), -interval, interval))
            return Bend(time, float(np.sqrt(variance / curvature)))
    return Bend(time, float(interval))
