"""Where motion bends a coil's current: at a stop its slope jumps, where the moving mass changes its curvature does.

No model is used. Around every sample a cubic is fitted, and beside it one that may bend there. Where the bend is the
plainest, two parabolas that meet in it tell its time; what wider and other ones say instead is part of its error. A
current that motion does not bend shows none.
"""

from __future__ import annotations

import math
from typing import TYPE_CHECKING, Final, NamedTuple

import numpy as np

from valve_sim.recordings.motion import sample_noise

if TYPE_CHECKING:
    from numpy.typing import NDArray

    Array = NDArray[np.float64]

HALF_WIDTHS: Final = {1: 0.5e-3, 2: 1.2e-3}
"""s, to each side of a bend of the slope and of the curvature, that is looked at where that are enough samples."""
FEWEST: Final = 4
"""Samples to each side."""
WIDEST: Final = 2.5e-3
"""s, to each side: what is sampled more coarsely shows no bend."""
PLAIN: Final = 6.0
"""Standard errors of a bend that is one."""
LEAST: Final = 0.03
"""Share of the current's range that a bend of the slope changes it by at a half width: eddy currents make less."""
SHARP: Final = 7
"""Samples to each side from which on a rebound is told from the arrival before it."""
AS_PLAIN: Final = 0.5
"""Share of the plainest bend's standard errors that an earlier one has, of a contact before it."""
BETTER: Final = 3.0
"""By this factor a bend must lower the variance of what is left: a smooth curve is no cubic either."""
NOISE: Final = 4
"""Order of the differences that show the current's noise: lower ones show the current itself."""
SHARPEST: Final = 0.05
"""Of the interval between samples: the least standard error, of a bend that takes a part of it."""
EVEN: Final = 0.02
"""Relative scatter of sampling intervals that are taken for equal."""
REACH: Final = 2.0
STEPS: Final = 81
"""Intervals to each side of a sample, and places in them, of which the best one is the bend's."""


class Bend(NamedTuple):
    """A bend of a current: time, s, and its standard error, s."""

    time: float
    stderr: float


def find_bends(times: Array, current: Array) -> tuple[Bend | None, Bend | None]:
    """Where the plungers were halted, and where before that they were slowed; None where nothing shows.

    Args:
        times: of an opening, s, ascending, shape (n,). current: A, shape (n,).
    """
    # Motion towards the core takes current away, so that its end gives some back.
    values = current if current.sum() >= 0.0 else -current
    halted = _bend(times, values, 1)
    if halted is None:
        return None, None
    before = int(np.searchsorted(times, halted.time - HALF_WIDTHS[2] / 2.0))
    return halted, _bend(times[:before], values[:before], 2)


def _bend(times: Array, values: Array, order: int) -> Bend | None:
    """The plainest upward bend of a derivative, 1: of the slope, 2: of the curvature."""
    if len(times) <= 4 * FEWEST:
        return None
    interval = float(np.median(np.diff(times)))
    half = max(FEWEST, round(HALF_WIDTHS[order] / interval))
    if half * interval > WIDEST or len(times) <= 2 * half + 4:
        return None
    windows = np.lib.stride_tricks.sliding_window_view(values, 2 * half + 1)
    spans = times[2 * half :] - times[: -2 * half]
    is_even = np.abs(spans / (2 * half * interval) - 1.0) < EVEN
    place, noise = np.arange(-half, half + 1) / half, sample_noise(values, NOISE)
    size, plainness, gain = _plainness(windows, place, order, noise)
    plainness[~is_even | (gain < BETTER)] = 0.0
    plainness[:2] = plainness[-2:] = 0.0
    if order == 1:
        plainness[size < LEAST * np.ptp(values)] = 0.0
    plain = np.flatnonzero(plainness >= max(PLAIN, AS_PLAIN * float(plainness.max())))
    if not len(plain):
        return None
    if half < SHARP:
        best = int(plain[np.argmax(size[plain])])
    else:
        # A plunger that bounces meets the stop again: the first of those that are about as plain is when it arrived.
        best = int(plain[0]) + int(np.argmax(plainness[plain[0] : plain[0] + half]))
    seen = [
        _refined(times, values, best + half, reach, order, power)
        for reach in (half, half + max(1, half // 4))
        for power in (order + 1, order + 2)
    ]
    apart = max(abs(other.time - seen[0].time) for other in seen)
    return Bend(seen[0].time, math.hypot(seen[0].stderr, apart, SHARPEST * interval))


def _plainness(windows: Array, place: Array, order: int, noise: float) -> tuple[Array, Array, Array]:
    """(k,) size of the bend in the middle of each window, A, that in its errors, and what it lowers the variance by."""
    smooth = np.vander(place, 4, increasing=True)
    hinge = np.maximum(place, 0.0) ** order
    own = hinge - smooth @ np.linalg.lstsq(smooth, hinge, rcond=None)[0]
    residual = windows - windows @ np.linalg.pinv(smooth).T @ smooth.T
    size = residual @ own / float(own @ own)
    before = np.einsum("ij,ij->i", residual, residual)
    after = np.maximum(before - size**2 * float(own @ own), np.finfo(float).tiny)
    # Few samples may happen to lie on a curve.
    sigma = np.maximum(np.sqrt(after / (len(place) - 5)), noise)
    return size, size * np.sqrt(float(own @ own)) / sigma, before / after


def _refined(times: Array, values: Array, at: int, reach: int, order: int, power: int) -> Bend:
    """The bend between samples: the place that leaves least, and how sharply it is the least.

    Before it the current is a polynomial of degree `order` + 1, after it one of degree `power`; the derivatives below
    `order` are the same on both sides.
    """
    inside = slice(max(0, at - reach), at + reach + 1)
    interval = float(np.median(np.diff(times[inside])))
    places = times[at] + np.linspace(-REACH, REACH, STEPS) * interval
    left = np.empty(STEPS)
    for index, place in enumerate(places.tolist()):
        from_there = (times[inside] - place) / (reach * interval)
        after, before = np.maximum(from_there, 0.0), np.minimum(from_there, 0.0)
        design = np.column_stack(
            [
                *(from_there**own for own in range(order)),
                *(before**own for own in range(order, order + 2)),
                *(after**own for own in range(order, power + 1)),
            ]
        )
        rest = values[inside] - design @ np.linalg.lstsq(design, values[inside], rcond=None)[0]
        left[index] = float(rest @ rest)
    best = int(np.argmin(left))
    time = float(places[best])
    if 0 < best < STEPS - 1:
        around = slice(max(0, best - 5), best + 6)
        curvature, slope, _ = np.polyfit(places[around] - places[best], left[around], 2)
        if curvature > 0.0:
            time += float(np.clip(-slope / (2.0 * curvature), -interval, interval))
            variance = left[best] / max(1, len(values[inside]) - power - 4)
            return Bend(time, float(np.sqrt(variance / curvature)))
    return Bend(time, interval)
