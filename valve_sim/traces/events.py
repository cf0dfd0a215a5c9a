"""Arrival times of the plungers from the sensors alone: from the positions, and from spikes of the acceleration.

No model is used, so that the model can be judged by them. The paper took both events from the accelerometer: a
small spike when the pilot plunger meets the main plunger, a large one at the stop.
"""

from __future__ import annotations

from typing import TYPE_CHECKING, NamedTuple

import numpy as np

from valve_sim.traces.current_bends import find_bends
from valve_sim.traces.strokes import MAD_TO_SIGMA, find_stroke_parts, sample_noise

if TYPE_CHECKING:
    from collections.abc import Iterator

    from numpy.typing import NDArray

    from valve_sim.traces.strokes import StrokePart
    from valve_sim.traces.trace import Signal, Trace

    Array = NDArray[np.float64]

APPROACH_SHARE = 0.5
"""Part of the way to the gap, counted from there, that the fitted parabola follows."""

STOP_APPROACH_SHARE = 0.2
"""The same for the way from the gap to the stop, where speed and force change faster."""

FEWEST_SAMPLES = 5
"""A parabola has three numbers; with fewer samples than this its error is guesswork."""

ARRIVAL_SIGMAS = 4.0
"""A sample this close to a level may already rest on it."""

GOES_ON = 0.05
"""Share of the last step by which a motion that goes on is beyond the level: at a stop it is not."""

PARABOLA_ERROR = 1e-6
"""s; what a parabola misses of the real motion: at most 0.9 µs on 8 noise-free strokes, 7.5 to 14 V at 20 kHz."""

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
        uncertainty: Standard error of the time, s, from the sensor's noise.
        sensor: "position" or "acceleration"; "current" where no position was recorded.
    """

    kind: str
    time: float
    after_command: float
    uncertainty: float
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
            StrokeEvents(stroke, tuple(event for event in seen if pilot_gap > 0.0 or event.kind not in AT_THE_GAP))
            for stroke, seen in by_current
        )
    levels = _rest_levels(trace.pilot_position, pilot_gap)
    found = []
    for stroke in strokes:
        seen = tuple(_by_position(trace, stroke, levels))
        events = [*seen, *_by_acceleration(trace.acceleration, stroke, seen)]
        found.append(StrokeEvents(stroke, tuple(sorted(events, key=lambda event: event.time))))
    return tuple(found)


class _Levels(NamedTuple):
    """Where a trace's pilot plunger rests and meets the main plunger, and the noise of its position, m."""

    seat: float
    gap: float
    stop: float
    noise: float


def _by_position(trace: Trace, stroke: StrokePart, levels: _Levels) -> Iterator[SensorEvent]:
    window = slice(*np.searchsorted(trace.times, [stroke.start, stroke.stop]))
    times, position = trace.times[window], trace.pilot_position[window]
    seat, gap, stop, noise = levels
    if stroke.kind == "closing" and gap == seat:  # one plunger
        ways = [("reaches_seat", seat, seat + STOP_APPROACH_SHARE * (stop - seat))]
    elif stroke.kind == "closing":
        ways = [
            ("main_seats", gap, gap + STOP_APPROACH_SHARE * (stop - gap)),
            ("reaches_seat", seat, seat + APPROACH_SHARE * (gap - seat)),
        ]
    else:
        ways = [
            ("pilot_reaches_main", gap, gap - APPROACH_SHARE * (gap - seat)),
            ("reaches_stop", stop, stop - STOP_APPROACH_SHARE * (stop - gap)),
        ]
    for kind, level, begin in ways:
        if (kind == "reaches_stop" and stroke.kind == "pulse") or (kind in AT_THE_GAP and gap == seat):
            continue
        arrival = _arrival(times, position, begin, level, noise)
        if arrival is not None:
            yield SensorEvent(kind, arrival[0], arrival[0] - stroke.start, arrival[1], "position")


def _rest_levels(position: Array, pilot_gap: float) -> _Levels:
    """Find seat and stop: the median of the samples near the trace's lowest and highest.

    A valve rests there most of the time, so these samples are many and mostly still. The whole trace is used, so this
    is done once for all strokes.
    """
    noise = sample_noise(position)
    low, high = np.quantile(position, [0.001, 0.999])
    margin = max(0.02 * (high - low), 6 * noise)
    seat = float(np.median(position[position < low + margin]))
    stop = float(np.median(position[position > high - margin]))
    return _Levels(seat, seat + pilot_gap, stop, noise)


def _arrival(times: Array, position: Array, begin: float, level: float, noise: float) -> tuple[float, float] | None:
    """Return when a motion from `begin` first gets to `level`, and the standard error; None if it does not.

    A parabola is fitted to the samples between the two, all of them before the contact, and extrapolated to `level`.
    """
    direction = 1.0 if level > begin else -1.0
    way = direction * (position - begin)
    length = abs(level - begin)
    near = np.flatnonzero(way >= length - ARRIVAL_SIGMAS * noise)
    if len(near) == 0 or near[0] == 0:
        return None
    last = int(near[0])
    outside = np.flatnonzero(way[:last] < 0)
    first = int(outside[-1]) + 1 if len(outside) else 0
    if first == 0 or last - first < FEWEST_SAMPLES:
        return _between_samples(times, way, length, last)
    return _extrapolate(times[first:last], way[first:last], length)


def _between_samples(times: Array, way: Array, length: float, last: int) -> tuple[float, float] | None:
    """Return the crossing where samples are too few for a fit: good to the sample interval.

    Where the motion goes on beyond, by a parabola through the samples around it and the one before; else by a line.
    """
    crossed = np.flatnonzero(way[last - 1 :] >= length)
    after = last - 1 + int(crossed[0]) if len(crossed) else last
    before = after - 1
    if before < 0 or way[after] <= way[before]:
        return None
    share = float(np.clip((length - way[before]) / (way[after] - way[before]), 0.0, 1.0))
    interval = float(times[after] - times[before])
    if before > 0 and way[after] > length + (way[after] - way[before]) * GOES_ON:
        found = _by_parabola(times[before - 1 : after + 1], way[before - 1 : after + 1], length)
        share = share if found is None else found
    return float(times[before] + share * interval), float(interval / np.sqrt(12.0))


def _by_parabola(times: Array, way: Array, length: float) -> float | None:
    """Return which share of the last of two intervals passes before the parabola through their ends is at `length`."""
    since = (times - times[1]) / (times[2] - times[1])
    roots = np.roots(np.polyfit(since, way - length, 2))
    real = [float(root.real) for root in roots if abs(root.imag) < 1e-9 and 0.0 <= root.real <= 1.0]
    return real[0] if len(real) == 1 else None


def _extrapolate(times: Array, way: Array, length: float) -> tuple[float, float] | None:
    """Fit the way, where the noise is, as a parabola of time, and solve it for `length`."""
    origin, scale = times[-1], times[-1] - times[0]
    design = np.vander((times - origin) / scale, 3)
    coefficients, *_ = np.linalg.lstsq(design, way, rcond=None)
    residual = way - design @ coefficients
    variance = float(residual @ residual) / (len(times) - 3)
    roots = np.roots([coefficients[0], coefficients[1], coefficients[2] - length])
    real = np.real(roots[np.abs(np.imag(roots)) < 1e-9])
    if len(real) == 0:
        return None
    root = float(real[np.argmin(np.abs(real))])
    if abs(root) > 1.0:
        return None
    speed = 2 * coefficients[0] * root + coefficients[1]
    at_root = np.vander([root], 3)[0]
    spread = variance * float(at_root @ np.linalg.solve(design.T @ design, at_root))
    return float(origin + root * scale), float(np.hypot(np.sqrt(spread) / abs(speed) * scale, PARABOLA_ERROR))


def _by_current(signal: Signal | None, stroke: StrokePart) -> Iterator[SensorEvent]:
    """Yield the arrivals that bend the current, by the voltage that motion induces."""
    if signal is None:
        return
    inside = slice(*np.searchsorted(signal.times, [stroke.start, stroke.stop]))
    is_closing = stroke.kind == "closing"
    halted, slowed = find_bends(signal.times[inside], signal.values[inside], closes=is_closing)
    kinds = ("reaches_seat", "main_seats") if is_closing else ("reaches_stop", "pilot_reaches_main")
    for kind, bend in ((kinds[1], slowed), (kinds[0], halted)):
        if bend is not None:
            yield SensorEvent(kind, bend.time, bend.time - stroke.start, bend.uncertainty, "current")


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
