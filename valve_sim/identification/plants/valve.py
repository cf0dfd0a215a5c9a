"""The valve as a plant: traces in, what its sensors would show out."""

from __future__ import annotations

import copy
import functools
import itertools
import math
from collections.abc import Iterator, Mapping, Sequence
from dataclasses import replace
from pathlib import Path
from typing import Final

import numpy as np
from numpy.typing import NDArray

from valve_sim.files.channels import SIGNALS
from valve_sim.files.parameter_files import save_valve
from valve_sim.identification.plants.estimated_valve import estimated_valve
from valve_sim.identification.plants.protocol import (
    NO_CONTACTS,
    Advice,
    Array,
    Channel,
    Condition,
    Direction,
    EffectChoice,
    Estimate,
    Experiment,
    Followed,
    ForceMap,
    Meaning,
    Nuisance,
    Piece,
    Sensor,
    Wording,
)
from valve_sim.identification.plants.recorded import Prediction, RecordedPlant
from valve_sim.identification.plants.recording_errors import ErringRecording
from valve_sim.identification.plants.stroke_choice import Kind, stroke_kinds
from valve_sim.identification.plants.valve_model import ValveModel
from valve_sim.identification.plants.valve_sensitivities import MovingValve, moving_valve, shown
from valve_sim.identification.plants.valve_sensors import (
    NO_TIMES,
    channels_of,
    contacts,
    fastest_motion,
    followed,
    with_declared_sensor,
    with_usable_current,
    without_pressure,
)
from valve_sim.model import CATALOGUE, Drive, Tag, Valve, simulate
from valve_sim.model.effects import FORCE_MAP_COEFFICIENTS, FORCE_MAP_VARIABLES, is_damping
from valve_sim.recordings import Signal, Trace, stroke_numbers

LOWEST_LEVEL, HIGHEST_LEVEL = 7.5 / 9.0, 14.0 / 9.0
"""Shares of the reference voltage: the range in which such a valve is driven, 7.5 to 14 V where it is 9 V."""
PULSE_LEVELS: Final = (LOWEST_LEVEL, 1.0, 11.0 / 9.0, HIGHEST_LEVEL)
"""Voltages of single pulses, of the reference voltage."""
STROKE_LEVELS: Final = (
    LOWEST_LEVEL, 8.5 / 9.0, 9.5 / 9.0, 10.5 / 9.0, 11.5 / 9.0, 12.5 / 9.0, 13.5 / 9.0, HIGHEST_LEVEL,
)  # fmt: skip
"""Voltages of full strokes, of the reference voltage."""
PULSE_DURATIONS: Final = (3e-3, 4e-3, 5e-3, 8e-3, 30e-3)
"""s: pulses of 3 to 5 ms lift the valve partly, longer ones fully."""
PULSE_START, PULSE_RECORDING = 5e-3, 70e-3
"""s: when a pulse begins, and when its recording ends."""


SHORTEST_SPAN: Final = 1e-6
"""m, of a force map over x, of one plunger that does not move."""
CLOCKS_OF_TABLES: Final = ("time column", "rate")
"""Of traces, `clock` where commands and samples share one."""
GAS_STEP: Final = 2e-5
"""Prior scales. Along the usual step the pressures come to be equal so much later that it is more than the main plunger
takes to open: a clogged orifice was given a twentieth of its standard error."""
OF_CURRENT: Final[Mapping[str, float]] = {"zero": 2e-3, "scale": 5e-3}
"""Scales of the errors of a current's sensor, as shares of the largest current, where they are not those of a position
sensor: a clamp or a shunt is good for 0.5 % and 2 mA of 1 A."""


def volts_at(valve: Valve, levels: Sequence[float], driven: float = math.inf) -> tuple[float, ...]:
    """Voltages at these shares of a valve's reference voltage, V, rounded to 10 mV.

    Args:
        driven: the highest voltage that was recorded, V. Where it is below the reference voltage, the coil or its
            driver may not stand more: the levels are then spread up to that voltage.
    """
    reference = valve.parameters.reference_voltage
    volts = [level * reference for level in levels]
    if 0.0 < driven < reference:
        lowest = LOWEST_LEVEL * driven
        share = (driven - lowest) / ((HIGHEST_LEVEL - LOWEST_LEVEL) * reference)
        volts = [lowest + share * (own - LOWEST_LEVEL * reference) for own in volts]
    return tuple(round(own, 2) for own in volts)


def usable(trace: Trace, valve: Valve) -> Trace:
    """What a recording holds that a valve explains."""
    jumps = valve.parameters.coil_time_constant == 0.0 or "motional_emf" in valve.effects
    return with_usable_current(trace if valve.gas is not None else without_pressure(trace), jumps=jumps)


class ValvePlant(RecordedPlant[ValveModel]):
    """The valve behind one or more traces.

    Args:
        traces: the measured data; each has its own clock offset.
        valve: the declared valve, whose effects stay on as they are, unless freed; or what is known of its values.
        is_watched: whether the traces are strokes of a valve that is watched, or rows of them. Errors of the recordings
            are then what differs from stroke to stroke, by sizes that are the same in all traces: drift and hum of the
            sensor, and what varies of the valve. The sensor's curve, its mount and the source are as they always were.

    Raises:
        ParameterError: the traces declare other bandwidths of the position sensor than each other or the valve.
    """

    def __init__(self, traces: Sequence[Trace], valve: Valve | ValveModel, *, is_watched: bool = False) -> None:
        self._is_watched = is_watched
        model = valve if isinstance(valve, ValveModel) else ValveModel(with_declared_sensor(valve, traces))
        self.traces = tuple(usable(trace, model.valve) for trace in traces)
        super().__init__(model, [own for index, trace in enumerate(self.traces) for own in channels_of(index, trace)])
        self._recordings = [
            ErringRecording(trace, index, self.valve, self.channels_in(index), 0 if is_watched else None)
            for index, trace in enumerate(self.traces)
        ]

    @property
    def valve(self) -> Valve:
        """The declared valve."""
        return self.model.valve

    @property
    def short_step(self) -> float | None:
        """Step of difference quotients of a valve with gas: see `GAS_STEP`."""
        return None if self.valve.gas is None else GAS_STEP

    @functools.cached_property
    def nuisances(self) -> Sequence[Nuisance]:
        """A clock offset for each trace; errors of commands that were read from a voltage, and of a sensor's zero.

        After them the declared values that have a tolerance: of the valve, and so the same in each trace. Of a
        commissioned valve an error for each command's stamp, and what commissioning has left open.
        """
        if (scatter := self.model.scatter) is not None:
            return (*(stamp._replace(sigma=scatter) for stamp in self._stamps), *self.model.nuisances)
        clocks = (error for own in self._recordings for error in (own.clock_offset, own.clock_rate))
        readings = (error for own in self._recordings for error in own.readings)
        return (*clocks, *readings, *self.model.nuisances)

    @property
    def timing_errors(self) -> Sequence[Nuisance]:
        """An error for each command that was recorded as it was sent: the voltage changes later than its stamp says."""
        return self._stamps if self.model.scatter is None else ()

    @property
    def _stamps(self) -> tuple[Nuisance, ...]:
        return tuple(error for own in self._recordings for error in own.stamps)

    @functools.cached_property
    def effects(self) -> Mapping[str, EffectChoice]:
        """The catalogue, less what the declared valve has on, and declared values that may be wrong.

        Without positions less what only a sensor of positions would show.
        """
        if any(trace.has_positions for trace in self.traces):
            return self.model.effects
        of_sensors = {entry.name for entry in CATALOGUE.tagged(Tag.SENSOR)}
        return {name: choice for name, choice in self.model.effects.items() if name not in of_sensors}

    @functools.cached_property
    def force_maps(self) -> Sequence[ForceMap]:
        """Curves over position, velocity and time, and such curves times v or u².

        None by the outlet's pressure alone: it shows when the plungers have moved, and nothing of how. None of a
        commissioned valve with gas, where each of many derivatives takes another simulation of all.
        """
        if self.model.scatter is not None and self.valve.gas is not None:
            return []
        if all(trace.primary_signal == "outlet_pressure" for trace in self.traces):
            return []
        declared = self.valve.parameters
        fastest = max(fastest_motion(trace) for trace in self.traces)
        furthest = max(float(np.max(trace.usable_position, initial=0.0)) for trace in self.traces)
        if not all(trace.has_positions for trace in self.traces):
            furthest = declared.stroke
        spans = {
            "x": (0.0, min(max(furthest, declared.pilot_gap or SHORTEST_SPAN), declared.stroke), "m"),
            "v": (-fastest, fastest, "m/s"),
            "t": (0.0, max(float(trace.sample_times[-1]) for trace in self.traces), "s"),
        }
        return [force_map_over(variable, *spans[variable[0]]) for variable in FORCE_MAP_VARIABLES]

    @functools.cached_property
    def _kinds(self) -> list[list[Kind]]:
        return [stroke_kinds(trace) for trace in self.traces]

    def condition_of(self, recording: int, group: int) -> Condition:
        """The voltages of a stroke's commands, V, and for how long each was held."""
        return tuple(itertools.chain.from_iterable(self._kinds[recording][group]))

    @property
    def driven(self) -> float:
        """The highest voltage that was recorded, V."""
        return max((float(np.max(np.abs(trace.drive.volts), initial=0.0)) for trace in self.traces), default=0.0)

    @property
    def experiments(self) -> Sequence[Experiment]:
        """Single pulses, from those that lift the valve partly to full strokes, sampled as the first trace is."""
        interval = float(np.median(np.diff(self.traces[0].sample_times)))
        times = np.arange(0.0, PULSE_RECORDING, interval)
        return [
            Experiment(
                f"{volts:g} V for {1e3 * duration:g} ms",
                functools.partial(self._recorded, volts, duration, times),
                ((0.0, volts), (duration, 0.0)),
            )
            for volts, duration in itertools.product(volts_at(self.valve, PULSE_LEVELS, self.driven), PULSE_DURATIONS)
        ]

    @property
    def advice(self) -> Advice:
        """Releases, several voltages and short pulses tell effects apart (measured on surrogate data)."""
        lowest, highest = volts_at(self.valve, (LOWEST_LEVEL, HIGHEST_LEVEL), self.driven)
        return Advice(
            "one stroke at one voltage cannot tell an effect from damping",
            f"Record next: eight strokes with their releases at {lowest:g} to {highest:g} V, about 30 ms on and 30 ms "
            "off, in one bag at 20 kHz",
            "Record next: strokes at voltages not used yet, a peak-and-hold stroke, and pulses of 3 to 5 ms",
        )

    def _recorded(self, volts: float, duration: float, times: Array, values: Mapping[str, float]) -> ValvePlant:
        """A pulse recorded from a valve of these values, without noise."""
        drive = Drive.of([PULSE_START, PULSE_START + duration], [volts, 0.0])
        trace = Trace("an experiment", drive, times, np.zeros_like(times))
        seen = "" if self.traces[0].has_positions else SIGNALS[self.traces[0].primary_signal].name
        if seen:
            blank = {"times": times[:0], "pilot_position": times[:0], seen: Signal(times, trace.pilot_position)}
            trace = usable(replace(trace, **blank), self.valve)  # type: ignore[arg-type] # by name
        at = moving_valve(self.model, values, (), has_current=trace.coil_current is not None)
        (piece,) = shown(at, [ErringRecording(trace, 0, self.valve)])
        # Samples at a command, where a current may jump, are not among those of a signal.
        found = {seen: Signal(getattr(trace, seen).times, piece.shown)} if seen else {"pilot_position": piece.shown}
        return ValvePlant([replace(trace, **found)], self.model)

    def with_values(self, values: Mapping[str, float]) -> Valve:
        """The valve that freed values and estimates of declared values describe; its tolerances stay as declared."""
        return self.model.with_values(values)

    def propagated(self, names: Sequence[str], covariance: Array) -> tuple[tuple[str, ...], Array]:
        """Declared scalars and their covariance, from those of what was estimated."""
        return self.model.propagated(names, covariance)

    def estimated(self, estimate: Estimate) -> Valve:
        """The valve with the values of a fit, whose errors are its tolerances."""
        return estimated_valve(self.model, estimate)

    def save_corrected(self, path: Path, estimate: Estimate, effects: Sequence[str], provenance: str) -> bool:
        """Write a parameter file; effects are in it that were estimated."""
        save_valve(path, self.estimated(estimate), provenance)
        return True

    @property
    def wording(self) -> Wording:
        """A valve moves in strokes, and its corrected file is read by ROS 2."""
        return Wording(
            "stroke", "the declared valve with refitted damping", says_exact=True, corrected="a ROS 2 parameter file",
            uses=(
                "valve-sim validate ANOTHER_RECORDING --params {file}{options}",
                "ros2 run valve_sim valve_node --ros-args --params-file {file}",
                "ros2 param load /valve {file}",
            ),
        )  # fmt: skip

    def meaning(self, effect: str, values: Mapping[str, float]) -> Meaning:
        """What the catalogue says of it, with its severity where all of its parameters were estimated."""
        entry = CATALOGUE.get(effect)
        if entry is None:
            return Meaning()
        is_whole = set(values) == {own.name for own in entry.parameters}
        severity = entry.severity_of(values, self.valve.declared()) if is_whole else None
        return Meaning("" if severity is None else str(severity), entry.on_a_real_valve, entry.what_to_do)

    @property
    def travel(self) -> float:
        """The stroke, m."""
        return self.valve.parameters.stroke

    def dampings_at(self, positions: Array) -> NDArray[np.int64]:
        """(n,) 0 where the pilot plunger moves by itself, 1 where it moves the main plunger."""
        return (positions > self.valve.parameters.pilot_gap).astype(np.int64)

    def currents_at(self, times: Array, values: Mapping[str, float]) -> Array:
        """(n,) the simulated current over the rated one at the times of a trace; 1 at those of another sensor."""
        trace = next((trace for trace in self.traces if trace.times is times), None)
        if trace is None:
            return super().currents_at(times, values)
        valve = self.with_values(values)
        rated = valve.parameters.reference_voltage / valve.parameters.coil_resistance
        drive = trace.input(valve.parameters.release_voltage)
        return np.asarray(simulate(valve, drive, times).coil_current / rated)

    def has_one_clock(self, recording: int) -> bool:
        """Whether a recording is a table."""
        return self.traces[recording].clock in CLOCKS_OF_TABLES

    def stroke_voltages(self, values: Mapping[str, float]) -> tuple[float, ...]:
        """Voltages of full strokes at which friction, drag and pull grow differently, V."""
        return volts_at(self.with_values(values), STROKE_LEVELS, self.driven)

    @property
    def follows_positions(self) -> bool:
        """Whether some recording has no positions."""
        return not all(trace.has_positions for trace in self.traces)

    def followed_positions(self, values: Mapping[str, float]) -> list[Followed]:
        """The positions at the samples of the current, or else of the pressure, of each trace without positions.

        Raises:
            SimulationError: the simulation could not be carried to its end.
        """
        valve, found = self.model.simulated(values), []
        for own in self._recordings:
            trace = own.trace
            if not trace.has_positions:
                times = trace.sample_times
                strokes = stroke_numbers(trace.drive, times)
                position = followed(valve, trace, own.drive(values), own.lateness(values))
                found.append(Followed(trace.source, times, strokes, position, np.zeros(len(times))))
        return found

    def prediction(self, values: Mapping[str, float], directions: Sequence[Direction] = ()) -> Prediction:
        """What the sensors show, with derivatives by the model's variational equations."""
        at = self._moving(values, directions)
        return Prediction(at.known, shown(at, self._recordings))

    @property
    def comes_in_pieces(self) -> bool:
        """Whether predictions can be had piece by piece: of every valve it is tried."""
        return True

    def pieces(self, values: Mapping[str, float], directions: Sequence[Direction]) -> Iterator[Piece] | None:
        """Prediction and derivatives, piece by piece; None without derivatives, with gas, or where a sensor averages.

        Raises:
            SimulationError: the simulation could not be carried to its end.
        """
        if self._averages or self.valve.gas is not None:
            return None  # its pressures are recorded, too, and one of them may drive it
        at = self._moving(values, directions)
        return shown(at, self._recordings, is_whole=False) if at.known.all() else None

    def _moving(self, values: Mapping[str, float], directions: Sequence[Direction] = ()) -> MovingValve:
        has_current = any(trace.coil_current is not None for trace in self.traces)
        return moving_valve(self.model, values, directions, has_current=has_current)

    @property
    def _averages(self) -> bool:
        """Whether a sensor averages: what it shows is not of one moment."""
        return any(trace.averaging > 1 for trace in self.traces)

    @property
    def can_be_thinned(self) -> bool:
        """Whether a sample is the same whichever others are shown: not of a valve with gas, or of a mean of several.

        The few strokes of a commissioned valve are compared one by one.
        """
        return self.valve.gas is None and not self._averages and self.model.scatter is None

    def thinned(self, kept: Sequence[NDArray[np.intp]]) -> ValvePlant:
        """This plant with some samples of each channel, of which the first is one."""
        same, numbers = copy.copy(self), iter(kept)
        same._channels = [_thinned(channel, own) for channel, own in zip(self._channels, kept, strict=True)]
        same.traces = tuple(_thinned_trace(trace, numbers) for trace in self.traces)
        pairs = zip(self._recordings, same.traces, strict=True)
        same._recordings = [own.with_samples(trace) for own, trace in pairs]
        return same

    @functools.cached_property
    def varying(self) -> Sequence[Nuisance]:
        """What varies from stroke to stroke, and the resistance of the source; none of a valve with gas."""
        if self.valve.gas is not None:
            return ()
        return tuple(error for own in self._recordings for error in own.varying)

    def changing(self, effect: str) -> Sequence[Nuisance]:
        """How much an effect differs in each stroke; none of a valve with gas, or of a declared value."""
        if self.valve.gas is not None or self._is_watched or effect not in CATALOGUE:
            return ()
        return tuple(error for own in self._recordings for error in own.changes(effect).values())

    def sensors(self, values: Mapping[str, float]) -> dict[int, Sensor]:
        """The sensors of positions and of the current of each trace; of a valve that is watched, those of positions.

        The mount of a position sensor at a valve with gas does not ring.

        Raises:
            SimulationError: the simulation could not be carried to its end.
        """
        found: dict[int, Sensor] = {}
        valve = self.model.simulated(values)
        for index in range(len(self.traces)):
            for place in self.channels_in(index):
                kind = self._channels[place].kind
                if kind == "position":
                    found[place] = self._position_sensor(valve, index, values, next(iter(found), place))
                elif kind == "current" and not self._is_watched:
                    span = float(np.max(np.abs(self._channels[place].data), initial=0.0))
                    found[place] = Sensor(span or 1.0, NO_TIMES, shares=OF_CURRENT, is_true_at_rest=False)
        return found

    def _position_sensor(self, valve: Valve, index: int, values: Mapping[str, float], first: int) -> Sensor:
        """The position sensor of a trace.

        Args:
            valve: as simulated. index: of the trace. values: by name.
            first: the channel of the first trace's positions.
        """
        trace, sheet = self.traces[index], self.valve.tolerances.sensor
        if self._is_watched:
            # A stroke is two intervals, whenever its recording begins.
            shares = {"scale": 0.0, "bend": 0.0}
            return Sensor(self.valve.parameters.stroke, trace.drive.times[1:2], shares=shares, alike=first)
        own = self._recordings[index]
        meet = (
            contacts(valve, trace, own.drive(values), own.lateness(values)) if self.valve.gas is None else NO_CONTACTS
        )
        shares = {"scale": sheet.gain, "bend": sheet.linearity}
        return Sensor(self.valve.parameters.stroke, trace.drive.times, meet, shares)


def _thinned(channel: Channel, kept: NDArray[np.intp]) -> Channel:
    """Some samples of a channel."""
    return replace(
        channel, times=channel.times[kept], data=channel.data[kept], quiet=channel.quiet[kept],
        group=channel.group[kept], left_out=None if channel.left_out is None else channel.left_out[kept],
    )  # fmt: skip


def _thinned_trace(trace: Trace, numbers: Iterator[NDArray[np.intp]]) -> Trace:
    """Some samples of the positions and of the current of a trace."""
    few = trace
    if trace.has_positions:
        own = next(numbers)
        few = replace(few, times=trace.times[own], pilot_position=trace.usable_position[own])
    if trace.coil_current is not None:
        own = next(numbers)
        few = replace(few, coil_current=Signal(trace.coil_current.times[own], trace.coil_current.values[own]))
    return few


def force_map_over(variable: str, low: float, high: float, unit: str) -> ForceMap:
    """A force map with all B-splines between the smallest and the largest value that the data have.

    Args:
        variable: one of FORCE_MAP_VARIABLES. low, high: in `unit`.
    """
    fixed = {
        "force_map.variable": float(FORCE_MAP_VARIABLES.index(variable)),
        "force_map.low": low,
        "force_map.high": high,
    }
    names = tuple(f"force_map.{name}" for name in FORCE_MAP_COEFFICIENTS)
    least = 0.0 if is_damping(variable) else -math.inf
    ends = ("force_map.low", "force_map.high")
    return ForceMap(variable, names, fixed, low, high, unit, "force_map.count", least, ends)
