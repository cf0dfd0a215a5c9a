"""The strokes of a trace, and their parts: what each voltage step made the valve do.

A stroke begins when the voltage leaves zero, and lasts until it leaves zero again (`begins_stroke`). Its parts are the
steps of the voltage in it: an opening, perhaps a hold, a closing. All other code counts strokes by this module.
"""

from __future__ import annotations

import math
from typing import TYPE_CHECKING, NamedTuple

import numpy as np

from valve_sim.recordings.motion import largest_travel, motion_threshold, travel_ends

if TYPE_CHECKING:
    from collections.abc import Sequence

    from numpy.typing import NDArray

    from valve_sim.model import Drive
    from valve_sim.recordings.trace import Trace

    Array = NDArray[np.float64]
    IntArray = NDArray[np.int64]

FULL_TRAVEL = 0.9
"""An opening that ends below this share of the trace's travel did not reach the stop: a pulse."""

BEFORE_STROKE = 0.25
"""The share of a rest, at its end, that belongs to the next stroke, whose command may be earlier than its stamp."""


class StrokePart(NamedTuple):
    """One voltage step of a stroke and what follows until the next step.

    Attributes:
        kind: "opening", "pulse" (an opening taken back before the stop), "closing" or "hold" (a step that moves nothing
            from where the valve is open, as from peak to hold voltage).
        start: Time of the command, s.
        stop: Time of the next command or the trace's end, s (not in the window).
        volts: The new voltage.
        name: For people: "opening at 0.010 s, 9.0 V".
        moved: Whether the pilot plunger was seen to move.
        stroke: The number of the stroke that it is a part of, from 0 on.
    """

    kind: str
    start: float
    stop: float
    volts: float
    name: str
    moved: bool
    stroke: int = 0


def begins_stroke(before: float, volts: float) -> bool:
    """Whether a stroke begins with this change of the voltage: it leaves zero. Live strokes are cut by it, too."""
    return before == 0.0 and volts != 0.0


def stroke_starts(drive: Drive) -> IntArray:
    """Indices of the commands at which a stroke begins; before the first command the voltage is zero."""
    volts = drive.volts.tolist()
    starts = [begins_stroke(before, after) for before, after in zip([0.0, *volts[:-1]], volts, strict=True)]
    return np.flatnonzero(starts).astype(np.int64)


def stroke_numbers(drive: Drive, times: Array) -> NDArray[np.int32]:
    """(n,) the number of the stroke that each time belongs to, from 0 on; times before the first stroke have 0."""
    starts = drive.times[stroke_starts(drive)]
    return np.maximum(np.searchsorted(starts, times, side="right") - 1, 0).astype(np.int32)


def command_strokes(drive: Drive) -> list[tuple[float, float]]:
    """The interval, s, of each command's stroke: from late in the rest before it to late in the rest after it."""
    later = stroke_starts(drive)[1:]
    rests = drive.times[later] - drive.times[later - 1]
    edges = [-math.inf, *(drive.times[later] - BEFORE_STROKE * rests).tolist(), math.inf]
    strokes = np.searchsorted(later, np.arange(len(drive.times)), side="right").tolist()
    return [(edges[stroke], edges[stroke + 1]) for stroke in strokes]


def find_stroke_parts(trace: Trace) -> tuple[StrokePart, ...]:
    """Return the parts of a trace's strokes in time order; commands that repeat the voltage start none.

    Without positions every part is taken to have moved the valve.
    """
    times, volts = _steps(trace.drive.times, trace.drive.volts)
    if len(times) == 0:
        return ()
    end = np.nextafter(max(float(trace.sample_times[-1]), float(times[-1])), np.inf)
    stops = [*times[1:], end]
    before = [0.0, *volts[:-1]]
    threshold = motion_threshold(trace.kept_position)
    closed, opened = travel_ends(trace.usable_position) if trace.has_positions else (0.0, 0.0)
    numbers = stroke_numbers(trace.drive, np.array(times)).tolist()
    parts = []
    for start, stop, old, new, number in zip(times, stops, before, volts, numbers, strict=True):
        window = trace.usable_position[np.searchsorted(trace.times, start) : np.searchsorted(trace.times, stop)]
        moved = not trace.has_positions or (len(window) > 0 and largest_travel(window) > threshold)
        share = (window - closed) / max(opened - closed, threshold) if len(window) else np.zeros(1)
        kind = (
            _kind(abs(old), abs(new), share, moved=moved) if trace.has_positions else _kind_of_step(abs(old), abs(new))
        )
        name = f"{kind} at {start:.3f} s, {new:.1f} V"
        parts.append(StrokePart(kind, float(start), float(stop), float(new), name, moved, number))
    return tuple(parts)


def _steps(times: Array, volts: Array) -> tuple[Sequence[float], Sequence[float]]:
    """Return the commands that change the voltage; before the first it is 0."""
    changed = np.diff(volts, prepend=0.0) != 0
    return times[changed].tolist(), volts[changed].tolist()


def _kind_of_step(old: float, new: float) -> str:
    """Name a step of the absolute voltage of which no position was seen."""
    if new == 0.0:
        return "closing"
    return "opening" if old == 0.0 else "hold"


def _kind(old: float, new: float, share: Array, *, moved: bool) -> str:
    """Name a step of the absolute voltage by what the pilot plunger did (share: 0 closed, 1 as open as it gets)."""
    was_open = share[0] > FULL_TRAVEL
    if new > old:
        if was_open:
            return "hold"
        return "pulse" if moved and share.max() < FULL_TRAVEL else "opening"
    if new == 0 or (moved and share[-1] < share[0]):
        return "closing"
    return "hold"
