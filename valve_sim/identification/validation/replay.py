"""Replay validation: does a declared valve under the recorded commands reproduce the measurement?

Nothing of the valve is estimated, only errors of each recording, within their priors: the offset between the clocks of
commands and samples and, where the evidence is for it, an error of each command's stamp (theory, eq. (26)). Tolerances
of declared values widen the band within which the measurement is expected.

The motion is simulated in pieces, and only what is judged of it is kept: a whole row of what the model has at each
sample would be most of the memory of a long recording.
"""

from __future__ import annotations

import math
from collections.abc import Callable, Iterable, Iterator, Mapping, Sequence
from contextlib import suppress
from dataclasses import dataclass, replace
from typing import Final, NamedTuple

import numpy as np
from numpy.typing import NDArray

from valve_sim.files.channels import CHANNELS
from valve_sim.identification.fit.columns import Columns, columns_of
from valve_sim.identification.fit.problem import Problem
from valve_sim.identification.fit.recordings import fit_recording
from valve_sim.identification.plants.protocol import READABLE_UNITS, Array
from valve_sim.identification.plants.recording_errors import CLOCK_SIGMA, ErringRecording
from valve_sim.identification.plants.valve import ValvePlant
from valve_sim.identification.plants.valve_pieces import cuts
from valve_sim.identification.plants.valve_sensors import response_to
from valve_sim.model import EXACT, TOLERANCE, Drive, Event, EventKind, Response, SimulationError, Valve, ValveError
from valve_sim.model.runs import Run
from valve_sim.model.simulation import commands_of
from valve_sim.recordings import SensorEvent, Signal, StrokePart, Trace, events_from_sensors, find_stroke_parts
from valve_sim.recordings.checking import check_traces

NOISE_FACTOR: Final = 3.0
"""The default tolerance, in standard deviations of what is predicted."""
FINEST_TOLERANCE: Final = 0.15e-6
"""m: three times the repeatability of the paper's laser, for recordings without noise."""
FINEST_CURRENT: Final = 0.1e-3
"""A: the same of a current, three steps of a converter of 15 bits over 1 A."""
FINEST_PRESSURE: Final = 1e3
"""Pa: the same of a pressure, a step of a converter of 16 bits over 70 MPa."""
MARGIN: Final = 1e-3
"""s around the model's motion that still counts as moving, so that a valve that is late there is seen."""
MICRO: Final = 1e6

_ARRIVALS: Final[Mapping[str, tuple[EventKind, ...]]] = {
    "pilot_reaches_main": (EventKind.PICKED_UP, EventKind.HELD_AT_GAP),
    "reaches_stop": (EventKind.REACHED_STOP, EventKind.BOUNCED_AT_STOP),
    "main_seats": (EventKind.MAIN_SEATED,),
    "reaches_seat": (EventKind.SEATED, EventKind.BOUNCED_AT_SEAT),
}

Progress = Callable[[str, float], None]
STILL_SPEED: Final = 1e-5
"""m/s: below it the model rests; a pilot plunger that nothing holds down creeps at nanometres a second."""


class Errors(NamedTuple):
    """Measured less predicted position of the pilot plunger, m, current of the coil, A, or outlet pressure, Pa.

    Attributes:
        samples: how many there are that are not left out.
        rmse: over all of them.
        moving_rmse: over those in which the model moves, 1 ms around included; nan where it does not move.
        maximum: the largest absolute error.
        tolerance: of `judged`.
    """

    samples: int
    rmse: float
    moving_rmse: float
    maximum: float
    tolerance: float

    @property
    def judged(self) -> float:
        """The error that is compared with the tolerance: a long rest must not hide a wrong motion."""
        return self.rmse if math.isnan(self.moving_rmse) else max(self.rmse, self.moving_rmse)

    @property
    def is_within(self) -> bool:
        """Whether it is within the tolerance."""
        return self.judged <= self.tolerance


class Arrival(NamedTuple):
    """When the plungers arrived somewhere, s after the stroke's command, both by the stamps of the samples.

    `measured` is from the data alone, as `info` has it. `model` is when the sensor would have stamped the model's
    arrival; nan: it never arrives.
    """

    kind: str
    sensor: str
    measured: float
    stderr: float
    model: float


class StrokeCheck(NamedTuple):
    """One stroke replayed."""

    name: str
    errors: Errors
    arrivals: tuple[Arrival, ...]


class Allowed(NamedTuple):
    """The default tolerance.

    Attributes:
        variance: (n,) of what is predicted, noise included. finest: the least tolerance.
    """

    variance: Array
    finest: float

    def of(self, chosen: slice, moving: NDArray[np.bool_]) -> float:
        """The tolerance of some samples: NOISE_FACTOR standard deviations, over all of them or those that move."""
        variances, largest = self.variance[chosen], 0.0
        for own in (variances, variances[moving[chosen]]):
            largest = max(largest, float(np.mean(own)) if len(own) else 0.0)
        return max(NOISE_FACTOR * math.sqrt(largest), self.finest)


def _rms(values: Array) -> float:
    """Root of the mean square; nan where there are none."""
    return float(np.sqrt(np.mean(np.square(values)))) if len(values) else math.nan


Part = tuple[str, slice, tuple[Arrival, ...]]
"""A part of a recording: its name, its samples, and arrivals in it."""


class Compared(NamedTuple):
    """A measured signal beside what a model shows of it.

    Attributes:
        measured: the signal. shown: (n,) the same by the model. moving: (n,) whether the model moves.
        allowed: the tolerance. left_out: (n,) what is no measurement; None: all of them are.
    """

    measured: Signal
    shown: Array
    moving: NDArray[np.bool_]
    allowed: Allowed | float
    left_out: NDArray[np.bool_] | None = None

    def errors(self, chosen: slice = slice(None)) -> Errors:
        """Measured less shown over the chosen samples that are not left out."""
        left, moves = self.measured.values[chosen] - self.shown[chosen], self.moving[chosen]
        if self.left_out is not None:
            is_kept = ~self.left_out[chosen]
            left, moves = left[is_kept], moves[is_kept]
        tolerance = self.allowed.of(chosen, self.moving) if isinstance(self.allowed, Allowed) else self.allowed
        return Errors(len(left), _rms(left), _rms(left[moves]), float(np.max(np.abs(left), initial=0.0)), tolerance)

    def checks(self, parts: Iterable[Part]) -> tuple[StrokeCheck, ...]:
        """Those of the parts that have samples which are not left out."""
        found = (StrokeCheck(name, self.errors(chosen), arrivals) for name, chosen, arrivals in parts)
        return tuple(own for own in found if own.errors.samples)


@dataclass(frozen=True)
class Replay:
    """One recording replayed, or one signal of it.

    Attributes:
        source: of what was measured. title, unit: of what is judged: of a valve the position, m, or where none was
            recorded the current, A, or pressure, Pa.
        measured: what is judged. predicted: (n,) the same by the model.
        noise: standard deviation of the sensor, in `unit`.
        errors: over the whole recording. strokes: one by one, or parts of it.
        clock_offset: s, by which samples are stamped late; nan where all columns share a clock.
    """

    source: str
    title: str
    unit: str
    measured: Signal
    predicted: Array
    noise: float
    errors: Errors
    strokes: tuple[StrokeCheck, ...]
    clock_offset: float = math.nan

    @property
    def readable(self) -> tuple[float, str]:
        """Factor from SI and name of the unit in which people read the errors."""
        return READABLE_UNITS.get(self.unit, (1.0, self.unit))

    @property
    def passed(self) -> bool:
        """Whether every stroke, and the recording as a whole, is within the tolerance."""
        return all(errors.is_within for errors in (self.errors, *(stroke.errors for stroke in self.strokes)))

    @property
    def tolerance(self) -> float:
        """The tolerance of the recording as a whole; by default each stroke has its own."""
        return self.errors.tolerance


@dataclass(frozen=True)
class Validation:
    """Recordings replayed against one declared machine.

    Attributes:
        replays: one for each recording, or for each of its signals.
    """

    replays: tuple[Replay, ...]

    @property
    def passed(self) -> bool:
        """Whether all are within their tolerance."""
        return all(replay.passed for replay in self.replays)


def validate(
    traces: Sequence[Trace],
    valve: Valve,
    tolerance: float | None = None,
    *,
    current_tolerance: float | None = None,
    pressure_tolerance: float | None = None,
    progress: Progress | None = None,
) -> Validation:
    """Replay recordings on a declared valve.

    A stroke passes when the root mean square of its error, over all its samples and over those in which the model
    moves, is within the tolerance.

    Args:
        traces: measured strokes.
        valve: the declared valve.
        tolerance: m, of recordings with positions; default, of each stroke, NOISE_FACTOR times the standard deviation
            of what is predicted, by the sensor's noise and the tolerances of declared values; at least
            FINEST_TOLERANCE. current_tolerance: A, of those without; at least FINEST_CURRENT. pressure_tolerance: Pa,
            of the outlet's pressure, which is judged by itself; at least FINEST_PRESSURE.
        progress: told what is being done, and the fraction done.

    Raises:
        ValveError: the tolerance is not above 0.
        SimulationError: the valve cannot be simulated.
        TraceError: a recording has columns that cannot be used, say with NaN in them.
    """
    check_traces(traces)
    if tolerance is not None and not 0.0 < tolerance < math.inf:
        raise ValveError(f"--tolerance-um {MICRO * tolerance:g}: expected a length above 0")
    if current_tolerance is not None and not 0.0 < current_tolerance < math.inf:
        raise ValveError(f"--tolerance-ma {1e3 * current_tolerance:g}: expected a current above 0")
    if pressure_tolerance is not None and not 0.0 < pressure_tolerance < math.inf:
        raise ValveError(f"--tolerance-kpa {1e-3 * pressure_tolerance:g}: expected a pressure above 0")
    given = {"position": tolerance, "current": current_tolerance, "outlet_pressure": pressure_tolerance}
    replays = []
    for index, trace in enumerate(traces):
        if progress is not None:
            progress(f"replaying {trace.source}", index / len(traces))
        for part in _parts(trace, valve):
            replays.append(replay_trace(part, valve, given[part.primary_signal]))
    return Validation(tuple(replays))


def replay_trace(trace: Trace, valve: Valve, tolerance: float | None = None) -> Replay:
    """Replay one recording on a valve as it is declared; arguments as in `validate`.

    Raises:
        SimulationError: the valve cannot be simulated.
    """
    # Before there is a prediction: each of them needs as much memory, for a moment, as that of a long recording.
    seen: dict[StrokePart, Sequence[SensorEvent]] = dict.fromkeys(find_stroke_parts(trace), ())
    seen |= {found.stroke: found.events for found in events_from_sensors(trace, valve.parameters.pilot_gap)}
    plant = ValvePlant([_judged(trace)], replace(valve, tolerances=EXACT))
    problem = Problem(plant).condensed()
    errors = Columns() if problem.is_long else columns_of(plant, {}, {})
    nuisances = fit_recording(problem.with_columns(errors), {}, learns=True).values
    recording = ErringRecording(trace, 0, valve)
    drive, offset = recording.drive(nuisances), recording.lateness(nuisances)
    times = trace.sample_times
    start = min(float(drive.times.min(initial=math.inf)), float(times[0])) - CLOCK_SIGMA
    kind, _, finest = _JUDGED[trace.primary_signal]
    left_out = problem.without_outliers(nuisances).left_out(0)
    noise, measured = problem.noises[kind].sigma, trace.primary_samples
    del problem, plant  # of a long recording what they hold is large
    motion = motion_of(replace(valve, tolerances=EXACT), trace, drive, times, start, offset)
    shown, variance = motion.shown, np.full(len(times), noise**2)
    if tolerance is None:
        for moved in _within_tolerances(trace, valve):
            with suppress(SimulationError):
                variance += np.square(motion_of(moved, trace, drive, times, start, offset).shown - shown)
    if trace.has_positions:
        shown += recording.zero(nuisances)
    allowed = Allowed(variance, finest) if tolerance is None else tolerance
    compared = Compared(measured, shown, _moving(times, motion.is_moving), allowed, left_out)
    strokes = compared.checks(_strokes(trace, seen, motion.events, offset))
    title, unit = CHANNELS[trace.primary_signal].title, _JUDGED[trace.primary_signal].unit
    return Replay(trace.source, title, unit, measured, shown, noise, compared.errors(), strokes, offset)


class _Judged(NamedTuple):
    """What a trace is judged by: kind of its channel, SI unit, and the finest tolerance in it."""

    kind: str
    unit: str
    finest: float


_JUDGED: Final = {
    "position": _Judged("position", "m", FINEST_TOLERANCE),
    "current": _Judged("current", "A", FINEST_CURRENT),
    "outlet_pressure": _Judged("pressure", "Pa", FINEST_PRESSURE),
}


def _parts(trace: Trace, valve: Valve) -> list[Trace]:
    """The trace as it is judged: by positions or current, and beside these by the outlet's pressure."""
    if valve.gas is None or trace.outlet_pressure is None or trace.primary_signal == "outlet_pressure":
        return [trace]
    nothing = np.empty(0)
    pressure = replace(
        trace, source=f"{trace.source}, outlet pressure", times=nothing, pilot_position=nothing, main_position=None,
        coil_current=None, zero_error=0.0,
    )  # fmt: skip
    return [replace(trace, outlet_pressure=None), pressure]


def _judged(trace: Trace) -> Trace:
    """The trace less a current beside positions.

    The declared coil resistance is an assumption, and would pull at the clock offset.
    """
    return replace(trace, coil_current=None) if trace.has_positions else trace


def _within_tolerances(trace: Trace, valve: Valve) -> Iterator[Valve]:
    """The valve, with one of its declared values after another off by its tolerance; none where all are exact."""
    if valve.tolerances.is_exact:
        return
    plant = ValvePlant([_judged(trace)], valve)
    for own in plant.nuisances:
        if own.is_of_machine:
            yield replace(plant.with_values({own.name: own.mean + own.sigma}), tolerances=EXACT)


def _moving(times: Array, is_moving: NDArray[np.bool_]) -> NDArray[np.bool_]:
    """(n,) samples no further than MARGIN from one in which the model moves."""
    edges = np.flatnonzero(np.diff(np.concatenate([[False], is_moving, [False]])))
    if not len(edges):
        return is_moving
    # From the first to the last sample of each motion, none of which need be held one by one.
    firsts, lasts = times[edges[::2]], times[edges[1::2] - 1]
    after = np.minimum(np.searchsorted(lasts, times), len(lasts) - 1)
    before = np.maximum(np.searchsorted(firsts, times, side="right") - 1, 0)
    distance = np.minimum(np.abs(firsts[after] - times), np.abs(lasts[before] - times))
    return np.asarray(is_moving | (distance <= MARGIN))


def _strokes(
    trace: Trace, seen: Mapping[StrokePart, Sequence[SensorEvent]], events: Sequence[Event], offset: float
) -> Iterator[Part]:
    """Every stroke; of samples and events each looks at its own alone.

    Args:
        trace: what was measured. seen: its strokes, and arrivals in them.
        events: of the model. offset: by how much samples are stamped late, s.
    """
    when = np.array([event.time for event in events])
    for stroke, found in seen.items():
        first, last = np.searchsorted(trace.sample_times, [stroke.start, stroke.stop])
        if first < last:
            own = events[slice(*np.searchsorted(when, [stroke.start, stroke.stop]))]
            arrivals = tuple(_arrival(event, stroke, own, offset) for event in found)
            yield stroke.name, slice(first, last), arrivals


def _arrival(event: SensorEvent, stroke: StrokePart, events: Sequence[Event], offset: float) -> Arrival:
    """What the sensors saw beside what the model has of a stroke's events."""
    modelled = (found.time + offset - stroke.start for found in events if found.kind in _ARRIVALS[event.kind])
    return Arrival(event.kind, event.sensor, event.after_command, event.stderr, next(modelled, math.nan))


class Motion(NamedTuple):
    """What a replay needs of a response.

    Attributes:
        shown: (n,) what is judged: position, m, current, A, or outlet pressure, Pa. is_moving: (n,) whether it moves.
        events: what happened, in order.
    """

    shown: Array
    is_moving: NDArray[np.bool_]
    events: tuple[Event, ...]


def motion_of(valve: Valve, trace: Trace, drive: Drive, times: Array, start: float, offset: float) -> Motion:
    """The motion at (n,) stamps of samples, s, of a valve that rests until a start, s; arguments: see `response_to`.

    Raises:
        SimulationError: the valve cannot be simulated.
    """

    def taken(own: slice) -> Array:
        return np.maximum(times[own] - offset, start)

    if valve.gas is not None or valve.after_effects("sensor_delay")[0]:
        return _whole(response_to(valve, trace, drive, taken(slice(None)), start, offset), trace.primary_signal)
    shown, is_moving = np.empty(len(times)), np.empty(len(times), dtype=bool)
    events, commands = list[Event](), commands_of(drive)
    stepped = Run(valve, start, tolerance=TOLERANCE)  # as `simulate` has it
    is_position = trace.primary_signal == "position"
    for cut in cuts(times, times, drive, (offset, 0.0)):
        rows, new = stepped.rows(commands[cut.commands], cut.end, taken(cut.positions))
        events += new
        is_moving[cut.positions] = np.abs(rows[:, 2]) > STILL_SPEED
        shown[cut.positions] = rows[:, 0 if is_position else 8]
    return Motion(shown, is_moving, tuple(events))


def _whole(response: Response, judged: str) -> Motion:
    shown = {
        "position": response.pilot_position, "current": response.coil_current,
        "outlet_pressure": response.outlet_pressure,
    }[judged]  # fmt: skip
    assert shown is not None
    return Motion(shown, np.abs(response.pilot_velocity) > STILL_SPEED, response.events)
