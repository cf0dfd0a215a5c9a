"""The valve as a plant: traces in, what its sensors would show out."""

from __future__ import annotations

import functools
import itertools
import math
from collections.abc import Mapping, Sequence
from dataclasses import replace
from typing import Any, Final

import numpy as np
from numpy.typing import NDArray

from valve_sim.identification.plants.protocol import (
    Advice,
    Array,
    Channel,
    EffectChoice,
    Experiment,
    ForceMap,
    Nuisance,
)
from valve_sim.identification.plants.recording_errors import (
    clock_offset,
    drive_with,
    reading_errors,
    stamp_errors,
    stroke_groups,
    zero_with,
)
from valve_sim.model import CATALOGUE, DECLARED, Drive, Parameter, SimulationError, Valve
from valve_sim.model.core_types import EVENT_RECORD
from valve_sim.model.effects import FORCE_MAP_KNOTS, FORCE_MAP_VARIABLES, new_record
from valve_sim.model.simulation import Samples, new_states, rated_current, run_record
from valve_sim.traces import Signal, Trace

FIT_TOLERANCE: Final = 1e-8
"""Of one step while fitting: a thousandth of the noise at most."""
STAMPS: Final = math.sqrt(2.0) * 1e-9
"""s: a sample and the command before it are stamped in whole nanoseconds each."""
AT_COMMAND: Final = 1e-8
"""s: a sample this near a command may be before or after it, for rounded stamps."""
SETTLING: Final = 0.3
"""The part of each interval between commands that is never taken for quiet, at its beginning."""
JITTERED: Final = 0.01
"""Relative scatter of a current's sampling interval beyond which its samples are taken to be timed by arrival."""
STILL: Final = 6.0
"""Standard deviations within which a still sensor stays."""
PULSE_VOLTS: Final = (7.5, 9.0, 11.0, 14.0)
"""V: the range in which such a valve is driven."""
PULSE_DURATIONS: Final = (3e-3, 4e-3, 5e-3, 8e-3, 30e-3)
"""s: pulses of 3 to 5 ms lift the valve partly, longer ones fully."""
ADVICE: Final = Advice(
    "one stroke at one voltage cannot tell an effect from damping",
    "Record next: eight strokes with their releases at 7.5 to 14 V, about 30 ms on and 30 ms off, in one bag at 20 kHz",
    "Record next: strokes at voltages not used yet, a peak-and-hold stroke, and pulses of 3 to 5 ms",
)
PULSE_START, PULSE_RECORDING = 5e-3, 70e-3
"""s: when a pulse begins, and when its recording ends."""

_NO_EVENTS: Final = np.empty(0, EVENT_RECORD)
_NO_TIMES: Final = np.empty(0)


class ValvePlant:
    """The valve behind one or more traces.

    Args:
        traces: the measured data; each has its own clock offset.
        valve: the declared valve; effects that it has on already stay on as they are, unless freed.
    """

    def __init__(self, traces: Sequence[Trace], valve: Valve) -> None:
        is_instant = valve.parameters.coil_time_constant == 0.0
        self.traces = tuple(_with_usable_current(trace, is_instant=is_instant) for trace in traces)
        self.valve = valve
        self._declared = valve.declared()
        self._amperes = valve.parameters.reference_voltage / valve.parameters.coil_resistance
        self._sources = [(index, kind) for index, trace in enumerate(self.traces) for kind in _kinds(trace)]
        self._channels = [_channel(index, self.traces[index], kind) for index, kind in self._sources]
        self._effects = {
            name: EffectChoice(name, entry.parameters, entry.confused_with)
            for name, entry in CATALOGUE.items()
            if entry.named and name not in valve.effects
        }

    @property
    def channels(self) -> Sequence[Channel]:
        """Pilot position and, where recorded, coil current, trace by trace."""
        return self._channels

    @property
    def base(self) -> Sequence[str]:
        """The dampings."""
        return ("pilot_damping", "main_damping")

    @property
    def nuisances(self) -> Sequence[Nuisance]:
        """A clock offset for each trace; errors of commands that were read from a voltage, and of a sensor's zero."""
        traces = [(trace, index, self._channels_of(index)) for index, trace in enumerate(self.traces)]
        offsets = [clock_offset(index, channels) for _, index, channels in traces]
        return (*offsets, *(nuisance for of_trace in traces for nuisance in reading_errors(*of_trace)))

    @property
    def timing_errors(self) -> Sequence[Nuisance]:
        """An error for each command that was recorded as it was sent: the voltage changes later than its stamp says."""
        return tuple(
            nuisance
            for index, trace in enumerate(self.traces)
            for nuisance in stamp_errors(trace, index, self._channels_of(index))
        )

    @property
    def effects(self) -> Mapping[str, EffectChoice]:
        """The catalogue, less the effects that the declared valve has on."""
        return self._effects

    @property
    def force_maps(self) -> Sequence[ForceMap]:
        """Curves over position, velocity and time, and such curves times v or u²."""
        fastest = max(_fastest(trace) for trace in self.traces)
        longest = max(float(trace.times[-1]) for trace in self.traces)
        spans = {
            "x": (0.0, self.valve.parameters.stroke, "m"),
            "v": (-fastest, fastest, "m/s"),
            "t": (0.0, longest, "s"),
        }
        maps = []
        for index, variable in enumerate(FORCE_MAP_VARIABLES):
            low, high, unit = spans[variable[0]]
            fixed = {"force_map.variable": float(index), "force_map.low": low, "force_map.high": high}
            maps.append(
                ForceMap(variable, tuple(f"force_map.{knot}" for knot in FORCE_MAP_KNOTS), fixed, low, high, unit)
            )
        return maps

    @property
    def experiments(self) -> Sequence[Experiment]:
        """Single pulses, from those that lift the valve partly to full strokes, sampled as the first trace is."""
        interval = float(np.median(np.diff(self.traces[0].times)))
        times = np.arange(0.0, PULSE_RECORDING, interval)
        return [
            Experiment(
                f"{volts:g} V for {1e3 * duration:g} ms",
                functools.partial(self._recorded, volts, duration, times),
                ((0.0, volts), (duration, 0.0)),
            )
            for volts, duration in itertools.product(PULSE_VOLTS, PULSE_DURATIONS)
        ]

    @property
    def advice(self) -> Advice:
        """Releases, several voltages and short pulses tell effects apart (measured on surrogate data)."""
        return ADVICE

    def _recorded(self, volts: float, duration: float, times: Array, values: Mapping[str, float]) -> ValvePlant:
        """A pulse recorded from a valve of these values, without noise."""
        drive = Drive.of([PULSE_START, PULSE_START + duration], [volts, 0.0])
        trace = Trace("an experiment", drive, times, np.zeros_like(times))
        (position,) = ValvePlant([trace], self.valve).predict(values)
        return ValvePlant([replace(trace, pilot_position=position)], self.valve)

    def _channels_of(self, trace: int) -> tuple[int, ...]:
        return tuple(channel for channel, (index, _) in enumerate(self._sources) if index == trace)

    def parameter(self, name: str) -> Parameter:
        """Unit and range of a declared parameter or of `<effect>.<parameter>`.

        Raises:
            KeyError: there is none.
        """
        effect, dot, parameter = name.partition(".")
        return CATALOGUE[effect].parameter(parameter) if dot else DECLARED[name]

    def declared(self, name: str) -> float:
        """The declared value, or the one at which an effect changes nothing."""
        effect, dot, parameter = name.partition(".")
        if not dot:
            return self._declared[name]
        if effect in self.valve.effects:
            return self.valve.effects[effect][parameter]
        return CATALOGUE[effect].parameter(parameter).neutral

    def with_values(self, values: Mapping[str, float]) -> Valve:
        """The valve that freed values describe; nuisances are left out."""
        effects = {name: dict(parameters) for name, parameters in self.valve.effects.items()}
        declared = {}
        for name, value in values.items():
            effect, dot, parameter = name.partition(".")
            if dot:
                effects.setdefault(effect, CATALOGUE[effect].neutral_values())[parameter] = float(value)
            elif name in self._declared:
                declared[name] = float(value)
        return Valve(self.valve.with_values(**declared).parameters, effects)

    def predict(self, values: Mapping[str, float]) -> list[Array]:
        """What each channel would show, in its unit.

        Raises:
            SimulationError: the simulation could not be carried to its end.
        """
        record = self.record(values)
        shown: list[Array] = []
        for index, trace in enumerate(self.traces):
            shown.extend(self._predict_trace(record, index, trace, values))
        return shown

    def record(self, values: Mapping[str, float]) -> Any:
        """The compiled core's record of the valve that freed values describe."""
        effects = {name: dict(parameters) for name, parameters in self.valve.effects.items()}
        declared = dict(self._declared)
        for name, value in values.items():
            effect, dot, parameter = name.partition(".")
            if dot:
                effects.setdefault(effect, {})[parameter] = value
            elif name in declared:
                declared[name] = value
        return new_record(declared, effects)

    def _predict_trace(self, record: Any, index: int, trace: Trace, values: Mapping[str, float]) -> list[Array]:
        drive = drive_with(trace, index, values)
        offset = values.get(f"clock_offset[{index}]", 0.0)
        times = trace.times - offset
        current_times = trace.coil_current.times - offset if trace.coil_current is not None else _NO_TIMES
        rows = np.empty((len(times), 1))
        currents = np.empty(len(current_times))
        start = min(float(drive.times[0]), float(times[0]))
        state = new_states(np.empty(1), start)
        run_record(record, state, drive, Samples(times, rows, current_times, currents), _NO_EVENTS, FIT_TOLERANCE)
        shown = [rows[:, 0] + zero_with(index, values)]
        if trace.coil_current is not None:
            if record[0]["coil_resistance"] <= 0.0:
                raise SimulationError("coil_resistance: found 0 Ω, which leaves the current infinite")
            shown.append(currents * rated_current(record))
        return shown


def still_mask(trace: Trace) -> NDArray[np.bool_]:
    """(n,) where the pilot plunger is known to be still: the ends of the intervals between commands.

    The quiet end of an interval begins where readings stay within `STILL` standard deviations of its last ones.
    """
    data, times = trace.pilot_position, trace.times
    quiet = np.zeros(len(data), dtype=bool)
    bends = np.abs(np.diff(data, 2)) if len(data) > 2 else np.zeros(1)
    edges = np.searchsorted(times, np.concatenate([[-np.inf], trace.drive.times, [np.inf]]))
    resting = [bends[max(0, b - (b - a) // 4) : b - 2] for a, b in itertools.pairwise(edges)]
    spread = [1.4826 * float(np.median(piece)) for piece in resting if len(piece) > 10]
    sigma = float(np.median(spread)) if spread else 0.0
    width = STILL * max(sigma, 1e-9) + _coarse_step(data)
    for index, (start, stop) in enumerate(itertools.pairwise(edges)):
        if stop - start < 20:
            continue
        tail = data[stop - max(10, (stop - start) // 8) : stop]
        level = float(np.median(tail))
        moved = np.flatnonzero(np.abs(data[start:stop] - level) > width)
        first = start + (int(moved[-1]) + 1 if len(moved) else 0)
        if index > 0 or len(moved):
            first = max(first + (stop - first) // 10, start + int(SETTLING * (stop - start)))
        quiet[first:stop] = True
    return quiet


def _position_resolution(trace: Trace) -> float:
    """By how much a position and its prediction differ for numerical reasons alone, m.

    Stamps of samples and of commands are whole nanoseconds, and a plunger moves on meanwhile; a step of the integrator
    is accurate to its tolerance, of a full stroke; a float has 16 digits.
    """
    reach = float(np.max(np.abs(trace.pilot_position), initial=0.0))
    return math.hypot(STAMPS * _fastest(trace), FIT_TOLERANCE * reach, float(np.finfo(np.float64).eps) * reach)


def _fastest(trace: Trace) -> float:
    """A speed that the plunger hardly ever exceeds, m/s, from the positions."""
    stride = max(1, len(trace.times) // 2000)
    speed = np.abs(np.diff(trace.pilot_position[::stride]) / np.diff(trace.times[::stride]))
    return max(float(np.quantile(speed, 0.995)), 0.05)


def _coarse_step(data: Array) -> float:
    levels = np.unique(np.round(data, 12))
    return float(np.median(np.diff(levels))) if 1 < len(levels) < 0.5 * len(data) else 0.0


def _with_usable_current(trace: Trace, *, is_instant: bool) -> Trace:
    """The trace, less a current timed by its arrival; of a coil without a time constant also less ambiguous samples.

    Such a current jumps with the command, and rounded stamps do not say on which side of the jump a sample is.
    """
    trace = without_jittered_current(trace)
    if not is_instant or trace.coil_current is None:
        return trace
    times, values = trace.coil_current
    commands = np.concatenate([[-np.inf], trace.drive.times, [np.inf]])
    after = np.searchsorted(commands, times)
    is_clear = np.minimum(times - commands[after - 1], commands[after] - times) > AT_COMMAND
    return replace(trace, coil_current=Signal(times[is_clear], values[is_clear]))


def without_jittered_current(trace: Trace) -> Trace:
    """The trace, less a current whose times are those of its arrival: they scatter, and would bias the clock offset."""
    if trace.coil_current is None or len(trace.coil_current.times) < 3:
        return trace
    steps = np.diff(trace.coil_current.times)
    usual = float(np.median(steps))
    scatter = float(np.median(np.abs(steps - usual)))
    return replace(trace, coil_current=None) if scatter > JITTERED * usual else trace


def _kinds(trace: Trace) -> tuple[str, ...]:
    return ("position",) if trace.coil_current is None else ("position", "current")


def _channel(index: int, trace: Trace, kind: str) -> Channel:
    if kind == "position":
        return Channel(
            f"{trace.source}: pilot_position", kind, trace.times, trace.pilot_position, still_mask(trace),
            stroke_groups(trace, trace.times), recording=index, resolution=_position_resolution(trace),
        )  # fmt: skip
    assert trace.coil_current is not None
    times, data = trace.coil_current
    largest = float(np.max(np.abs(data), initial=0.0))
    return Channel(
        f"{trace.source}: coil_current", kind, times, data, _settled(trace, times), stroke_groups(trace, times), "A",
        role="actuation", recording=index, drifts=True, resolution=FIT_TOLERANCE * largest,
    )  # fmt: skip


def _settled(trace: Trace, times: Array) -> NDArray[np.bool_]:
    """(n,) the last third of each interval between commands, where the current has settled."""
    edges = np.concatenate([[times[0]], trace.drive.times, [times[-1]]])
    index = np.clip(np.searchsorted(edges, times, side="right") - 1, 0, len(edges) - 2)
    start, stop = edges[index], edges[index + 1]
    return np.asarray((times - start > (2.0 / 3.0) * (stop - start)) | (index == 0))
