"""Arrival times of the plungers from the sensors alone: from the positions, and from spikes of the acceleration.

No model is used, so that the model can be judged by them. The paper took both events from the accelerometer: a
small spike when the pilot plunger meets the main plunger, a large one at the stop.
"""

from __future__ import annotations

from typing import TYPE_CHECKING, NamedTuple

import numpy as np

from valve_sim.recordings.contact_times import PositionNoise, contact_time
from valve_sim.recordings.current_bends import find_bends
from valve_sim.recordings.motion import sample_noise
from valve_sim.recordings.resting_noise import MAD_TO_SIGMA, step_of
from valve_sim.recordings.strokes import find_stroke_parts

if TYPE_CHECKING:
    from collections.abc import Iterator, Sequence

    from numpy.typing import NDArray

    from valve_sim.files.channels import Signal
    from valve_sim.recordings.strokes import StrokePart
    from valve_sim.recordings.trace import Trace

    Array = NDArray[np.float64]

FEWEST_SAMPLES = 5
"""Of an acceleration, in which a spike is looked for."""

NEAR_REST = 0.02
"""Share of the travel within which a position may be at one of its ends."""

AT_REST = 4.0
"""Standard deviations of the noise within which it is there."""

COLOURED, MOST_COLOURED = 0.1, 0.95
"""Correlation of neighbouring samples below which noise is taken for white, and the largest that is assumed."""

SPIKE_SIGMAS = 6.0
"""An acceleration above this many standard deviations of the noise is a spike."""

SPIKE_SEARCH = 1e-3
"""s; a spike further than this from the arrival seen by the position belongs to something else."""


AT_THE_GAP = ("pilot_reaches_main", "main_seats")
"""Arrivals that a valve with one plunger has not."""


class SensorEvent(NamedTuple):
    """An arrival seen by a sensor.

    Attributes:
        kind: "pilot_reaches_main" (t1), "reaches_stop" (t2), and on the way back "main_seats", "reaches_seat".
        time: s on the trace's clock.
        after_command: s since the stroke's command.
        stderr: Standard error of `after_command`, s, from the sensor's noise, the interval of its samples, and how
            well the command's time is known. What lag a sensor has is not in it.
        sensor: "position" or "acceleration"; "current" where no position was recorded.
    """

    kind: str
    time: float
    after_command: float
    stderr: float
    sensor: str


class StrokeEvents(NamedTuple):
    """The arrivals of one stroke, in time order."""

    stroke: StrokePart
    events: tuple[SensorEvent, ...]


def events_from_sensors(trace: Trace, pilot_gap: float) -> tuple[StrokeEvents, ...]:
    """Return the arrivals of each stroke that moved.

    Args:
        trace: A measured trace.
        pilot_gap: Where the pilot plunger meets the main plunger, m above its closed rest; 0 of a valve with one
            plunger, which meets none.
    """
    strokes = [stroke for stroke in find_stroke_parts(trace) if stroke.moved and stroke.kind != "hold"]
    if not strokes:
        return ()
    if not trace.has_positions:
        by_current = [(stroke, _by_current(trace.coil_current, stroke)) for stroke in strokes]
        return tuple(
            _of_stroke(trace, stroke, [event for event in seen if pilot_gap > 0.0 or event.kind not in AT_THE_GAP])
            for stroke, seen in by_current
        )
    levels = _rest_levels(trace.kept_position, pilot_gap)
    found = []
    for stroke in strokes:
        seen = tuple(_by_position(trace, stroke, levels))
        events = [*seen, *_by_acceleration(trace.acceleration, stroke, seen)]
        found.append(_of_stroke(trace, stroke, sorted(events, key=lambda event: event.time)))
    return tuple(found)


def _of_stroke(trace: Trace, stroke: StrokePart, events: Sequence[SensorEvent]) -> StrokeEvents:
    """The arrivals of a stroke, whose errors get that of its command."""
    if trace.drive_errors is not None:
        command = int(np.searchsorted(trace.drive.times, stroke.start, side="right")) - 1
        error = float(trace.drive_errors.times[command]) if command >= 0 else 0.0
        events = [event._replace(stderr=float(np.hypot(event.stderr, error))) for event in events]
    return StrokeEvents(stroke, tuple(events))


class _Levels(NamedTuple):
    """Where a trace's pilot plunger rests and meets the main plunger, m, and the noise of its position."""

    seat: float
    gap: float
    stop: float
    noise: PositionNoise


def _by_position(trace: Trace, stroke: StrokePart, levels: _Levels) -> Iterator[SensorEvent]:
    window = slice(*np.searchsorted(trace.times, [stroke.start, stroke.stop]))
    times, position = trace.times[window], trace.usable_position[window]
    seat, gap, stop, noise = levels
    first, second = gap - seat, stop - gap
    if first == 0.0:  # one plunger
        closing, opening = ("reaches_seat", stop - position, second), ("reaches_stop", position - gap, second)
        ways = [closing if stroke.kind == "closing" else opening]
    elif stroke.kind == "closing":
        ways = [("main_seats", stop - position, second), ("reaches_seat", gap - position, first)]
    else:
        ways = [("pilot_reaches_main", position - seat, first), ("reaches_stop", position - gap, second)]
    for kind, way, length in ways:
        if kind == "reaches_stop" and stroke.kind == "pulse":
            continue
        contact = contact_time(times, way, length, noise) if min(length, second) > 0.0 else None
        if contact is not None:
            yield SensorEvent(kind, contact.time, contact.time - stroke.start, contact.stderr, "position")


def _rest_levels(position: Array, pilot_gap: float) -> _Levels:
    """Find seat and stop: the median of the samples near the trace's lowest and highest; and the noise about them.

    A valve rests there most of the time, so these samples are many and mostly still. The whole trace is used, so this
    is done once for all strokes.
    """
    white, step = sample_noise(position), step_of(position)
    low, high = np.quantile(position, [0.001, 0.999])
    margin = max(NEAR_REST * (high - low), 6 * white)
    seat, at_seat = _rest(position, position < low + margin, white)
    stop, at_stop = _rest(position, position > high - margin, white)
    apart = np.concatenate([position[at_seat] - seat, position[at_stop] - stop])
    spread, coarse = MAD_TO_SIGMA * float(np.median(np.abs(apart))), step / np.sqrt(12.0)
    sigma = max(spread, white, coarse)
    changes = np.diff(position)[(at_seat[1:] & at_seat[:-1]) | (at_stop[1:] & at_stop[:-1])]
    correlation = 0.0
    if spread > step and len(changes):
        # Neighbours with correlation r differ by a variance of 2 (1 - r) of theirs.
        change = MAD_TO_SIGMA * float(np.median(np.abs(changes)))
        correlation = min(max(1.0 - change**2 / (2.0 * sigma**2), 0.0), MOST_COLOURED)
        correlation = correlation if correlation > COLOURED else 0.0
    together = float(sigma * np.sqrt((1.0 + correlation) / (1.0 - correlation)))
    fewest = min(np.count_nonzero(at_seat), np.count_nonzero(at_stop))
    error = float(np.hypot(together * np.sqrt(0.5 * np.pi / fewest), coarse))
    return _Levels(seat, seat + pilot_gap, stop, PositionNoise(sigma, together, error))


def _rest(position: Array, near: NDArray[np.bool_], white: float) -> tuple[float, NDArray[np.bool_]]:
    """The level at which a position rests among the samples near it, and which of them do."""
    for _ in range(2):
        level = float(np.median(position[near]))
        apart = np.abs(position - level)
        near = near & (apart <= AT_REST * max(MAD_TO_SIGMA * float(np.median(apart[near])), white))
    return float(np.median(position[near])), near


def _by_current(signal: Signal | None, stroke: StrokePart) -> Iterator[SensorEvent]:
    """Yield the arrivals of an opening that bend the current, by the voltage that motion induces.

    When a valve closes, the current has died away before.
    """
    if signal is None or stroke.kind == "closing":
        return
    inside = slice(*np.searchsorted(signal.times, [stroke.start, stroke.stop]))
    halted, slowed = find_bends(signal.times[inside], signal.values[inside])
    for kind, bend in (("pilot_reaches_main", slowed), ("reaches_stop", halted)):
        if bend is not None:
            yield SensorEvent(kind, bend.time, bend.time - stroke.start, bend.stderr, "current")


def _by_acceleration(signal: Signal | None, stroke: StrokePart, seen: tuple[SensorEvent, ...]) -> Iterator[SensorEvent]:
    """Yield the largest spike near each arrival that the position shows."""
    if signal is None:
        return
    inside = slice(*np.searchsorted(signal.times, [stroke.start, stroke.stop]))
    times, values = signal.times[inside], signal.values[inside]
    if len(times) < FEWEST_SAMPLES:
        return
    # Jerk, not acceleration: it removes the slow attraction of the magnet and keeps the contact.
    change = np.abs(np.diff(values))
    noise = MAD_TO_SIGMA * float(np.median(change))
    for event in seen:
        near = np.flatnonzero(np.abs(times[1:] - event.time) < SPIKE_SEARCH)
        if len(near) == 0:
            continue
        largest = int(near[np.argmax(change[near])])
        if change[largest] <= SPIKE_SIGMAS * noise:
            continue
        interval = float(times[largest + 1] - times[largest])
        time = float(times[largest]) + interval / 2
        yield SensorEvent(event.kind, time, time - stroke.start, float(interval / np.sqrt(12.0)), "acceleration")
