"""What the sensors of a recorded valve show: channels of a trace, and what the model would show in their place."""

from __future__ import annotations

import itertools
import math
from collections.abc import Sequence
from dataclasses import replace
from typing import Any, Final, NamedTuple

import numpy as np
from numpy.typing import NDArray

from valve_sim.identification.plants.protocol import Array, Channel, Contacts, Role
from valve_sim.model import Drive, ParameterError, Response, SimulationError, Valve, simulate
from valve_sim.model.core_types import EventKind
from valve_sim.model.drives import Supply
from valve_sim.model.gas.parameters import GAS
from valve_sim.model.runs import Directions, Run, Shown
from valve_sim.model.simulation import commands_of
from valve_sim.recordings import Signal, Trace, stroke_numbers
from valve_sim.recordings.measured_input import AT_COMMAND
from valve_sim.recordings.resting_noise import step_of

FIT_TOLERANCE: Final = 1e-8
"""Of one step while fitting: a thousandth of the noise at most."""
GAS_TOLERANCE: Final = 3e-10
"""Of one step while fitting a valve with gas: pressures are then within 1e-7 of themselves, and difference quotients of
them over 10 µs of a clock within 0.1 %."""
STAMPS: Final = math.sqrt(2.0) * 1e-9
"""s: a sample and the command before it are stamped in whole nanoseconds each."""
SETTLING: Final = 0.3
"""The part of each interval between commands that is never taken for quiet, at its beginning."""
JITTERED: Final = 0.01
"""Relative scatter of a current's sampling interval beyond which its samples are taken to be timed by arrival."""
FASTEST_UNSEEN: Final = 1.0
"""m/s, above what plungers of such valves reach: where no position shows it."""
ROUNDING: Final = 2.0**-24 / math.sqrt(3.0)
"""Relative standard deviation of a number in single precision, as `sensor_msgs/BatteryState` has it, at its largest."""
PRESSURE_RESOLUTION: Final = 1e-6
"""Relative error of a simulated outlet pressure: a valve with gas is stepped with a looser tolerance."""
LEAST_PRESSURE: Final = GAS["inlet_pressure"].lower
"""Pa: a sensor's noise may show less than that of an empty tank."""
STILL: Final = 6.0
"""Standard deviations within which a still sensor stays."""
EQUAL: Final = 2.0
"""Standard deviations within which a pressure at rest stays; what is left of its slow rise is not noise."""

USUAL_SPEED: Final = 0.3
"""m/s, of an impact at the stop."""
EVENTS_EACH: Final = 64
"""Events of a run for which there is room, for each of its commands."""
FAINTEST: Final = 0.02
"""Momentum of a contact, over that of all that moves at `USUAL_SPEED`, that no sensor's mount feels."""

NO_TIMES: Final = np.empty(0)
NO_SIGNAL: Final = Signal(NO_TIMES, NO_TIMES)


def still_mask(
    drive: Drive, readings: Signal, within: float = STILL, left_out: NDArray[np.bool_] | None = None
) -> NDArray[np.bool_]:
    """(n,) where what is read is known to be still: the ends of the intervals between commands.

    The quiet end of an interval begins where readings stay within so many standard deviations of their second
    differences (2.4 times the noise, if that is white) of the interval's last ones.

    Args:
        drive: the commands. readings: with what is left out on lines between its neighbours, or still too.
        within: so many standard deviations. left_out: (n,) readings that say nothing of the noise; None: none.
    """
    times, data = readings
    quiet = np.zeros(len(data), dtype=bool)
    edges = np.searchsorted(times, np.concatenate([[-np.inf], drive.times, [np.inf]]))
    ends = (slice(max(0, b - (b - a) // 4), b) for a, b in itertools.pairwise(edges))
    resting = (data[end] if left_out is None else data[end][~left_out[end]] for end in ends)
    spread = [1.4826 * float(np.median(np.abs(np.diff(piece, 2)))) for piece in resting if len(piece) > 12]
    sigma = float(np.median(spread)) if spread else 0.0
    width = within * max(sigma, 1e-9) + step_of(data if left_out is None else data[~left_out])
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
    """Difference of a position and its prediction for numerical reasons alone, m.

    Stamps of samples and of commands are whole nanoseconds, and a plunger moves on meanwhile; a step of the integrator
    is accurate to its tolerance, of a full stroke; a float has 16 digits.
    """
    reach = float(np.abs(trace.usable_position).max())
    return math.hypot(STAMPS * fastest_motion(trace), FIT_TOLERANCE * reach, float(np.finfo(np.float64).eps) * reach)


def fastest_motion(trace: Trace) -> float:
    """The largest speed of the plunger but for outliers, m/s, from the positions."""
    if not trace.has_positions:
        return FASTEST_UNSEEN
    stride = max(1, len(trace.times) // 2000)
    speed = np.abs(np.diff(trace.usable_position[::stride]) / np.diff(trace.times[::stride]))
    return max(float(np.quantile(speed, 0.995)), 0.05)


def with_usable_current(trace: Trace, *, jumps: bool) -> Trace:
    """The trace, less a current timed by its arrival; of a current that may jump also less ambiguous samples.

    It jumps with the command, where the coil has no time constant or eddy currents lie beside its flux, and rounded
    stamps do not say on which side of the jump a sample is.
    """
    trace = without_jittered_current(trace) if trace.has_positions else trace
    if not jumps or trace.coil_current is None:
        return trace
    times, values = trace.coil_current
    commands = np.concatenate([[-np.inf], trace.drive.times, [np.inf]])
    after = np.searchsorted(commands, times)
    is_clear = np.minimum(times - commands[after - 1], commands[after] - times) > AT_COMMAND
    return replace(trace, coil_current=Signal(times[is_clear], values[is_clear]))


def without_pressure(trace: Trace) -> Trace:
    """The trace as a valve without gas explains it.

    Raises:
        ParameterError: nothing else was recorded of it.
    """
    if trace.primary_signal == "outlet_pressure":
        raise ParameterError(
            f"{trace.source}: holds the outlet's pressure alone, and the valve declares no gas; give a parameter file "
            "with the group gas"
        )
    return replace(trace, inlet_pressure=None, outlet_pressure=None, demand_pressure=None)


def without_jittered_current(trace: Trace) -> Trace:
    """The trace, less a current whose times are those of its arrival: they scatter, and would bias the clock offset."""
    if trace.coil_current is None or len(trace.coil_current.times) < 3:
        return trace
    times = trace.coil_current.times
    intervals = np.diff(times)
    usual = float(np.median(intervals))
    scatter = float(np.median(np.abs(intervals - usual)))
    return replace(trace, coil_current=None) if scatter > JITTERED * usual else trace


def channels_of(index: int, trace: Trace) -> list[Channel]:
    """Pilot position, coil current and outlet pressure, where recorded, of the recording of this number.

    Without positions the current is the machine's response; beside them it shows the actuator.
    """
    found = []
    if trace.has_positions:
        left_out = trace.left_out.any if trace.left_out.any.any() else None
        still = still_mask(trace.drive, trace.primary_samples, left_out=left_out)
        found.append(
            Channel(
                f"{trace.source}: pilot_position", "position", trace.times, trace.usable_position, still,
                stroke_numbers(trace.drive, trace.times), recording=index, source=trace.source, drifts=True,
                resolution=_position_resolution(trace), left_out=left_out,
            )
        )  # fmt: skip
    if trace.coil_current is not None:
        is_beside = trace.coil_current.times is trace.times
        strokes = found[0].group if is_beside else stroke_numbers(trace.drive, trace.coil_current.times)
        found.append(_current_channel(index, trace, strokes))
    if trace.outlet_pressure is not None:
        found.append(_pressure_channel(index, trace))
    return found


def _pressure_channel(index: int, trace: Trace) -> Channel:
    assert trace.outlet_pressure is not None
    times, data = trace.outlet_pressure
    still = still_mask(trace.drive, trace.outlet_pressure, EQUAL)
    return Channel(
        f"{trace.source}: outlet_pressure", "pressure", times, data, still,
        stroke_numbers(trace.drive, times), "Pa", recording=index, source=trace.source, drifts=True,
        resolution=PRESSURE_RESOLUTION * float(np.abs(data).max()),
    )  # fmt: skip


def _current_channel(index: int, trace: Trace, strokes: NDArray[np.integer]) -> Channel:
    role: Role = "actuation" if trace.has_positions else "response"
    assert trace.coil_current is not None
    times, data = trace.coil_current
    is_single = bool((data == data.astype(np.float32)).all())
    return Channel(
        f"{trace.source}: coil_current", "current", times, data, _settled(trace.drive, trace.coil_current), strokes,
        "A", role=role, recording=index, source=trace.source, drifts=True,
        resolution=(ROUNDING if is_single else FIT_TOLERANCE) * float(np.abs(data).max()),
    )  # fmt: skip


class Recorded(NamedTuple):
    """A valve with the pressures that a recording of it measured, and all that is commanded to it.

    Attributes:
        valve: what is simulated. commands: see `commands_of`. start: s, until when it rests.
    """

    valve: Valve
    commands: Array
    start: float


def recorded(valve: Valve, trace: Trace, drive: Drive, offset: float) -> Recorded:
    """A valve as a trace recorded it, which rests until the first command or sample; arguments: see `shown_by`."""
    firsts = [trace.sample_times[:1]]
    if trace.outlet_pressure is not None:
        firsts.append(trace.outlet_pressure.times[:1])
    start = min(float(drive.times[0]), *(float(own[0]) - offset for own in firsts if len(own)))
    if valve.gas is not None and trace.outlet_start is not None:
        valve = replace(valve, gas=valve.gas._replace(outlet_pressure=max(trace.outlet_start, LEAST_PRESSURE)))
    supply = None if valve.gas is None else supply_of(trace, offset)
    return Recorded(valve, commands_of(drive, supply, start), start)


def run_from_rest(of: Recorded, directions: Directions | None = None, numbers: Array | None = None) -> Run:
    """A run of a recorded valve.

    Args:
        directions: along which derivatives are carried. numbers: of the valve, in place of its own.
    """
    tolerance = FIT_TOLERANCE if of.valve.gas is None else GAS_TOLERANCE
    if directions is not None:
        directions = directions.among(of.commands)
    elif of.valve.gas is None:
        directions = Directions.none(len(of.commands))
    return Run(of.valve, of.start, tolerance=tolerance, directions=directions, numbers=numbers)


def shown_by(
    valve: Valve,
    trace: Trace,
    drive: Drive,
    offset: float,
    directions: Directions | None = None,
    room: int = 0,
    numbers: Array | None = None,
) -> Shown:
    """What the sensors of a valve show at the samples of a trace.

    Args:
        valve: what is simulated. trace: whose sample times count. drive: when the voltage changes, s.
        offset: s by which samples are stamped late. directions: along which derivatives are carried.
        room: for so many events. numbers: of the valve, where they are known already.

    Raises:
        SimulationError: the simulation could not be carried to its end.
    """
    times = trace.times - offset
    current_times, pressure_times = (
        NO_TIMES if own is None else own.times - offset for own in (trace.coil_current, trace.outlet_pressure)
    )
    end = max(float(own[-1]) for own in (times, current_times, pressure_times) if len(own))
    of = recorded(valve, trace, drive, offset)
    run = run_from_rest(of, directions, numbers if of.valve is valve else None)
    return run.piece(of.commands, end, times, current_times, pressure_times, room=room)


def as_it_began(valve: Valve, trace: Trace) -> Valve:
    """The valve with the pressures at its first command: of tank, demand and outlet, where they are known."""
    if valve.gas is None:
        return valve
    at = float(trace.drive.times[0])
    known: dict[str, float] = {} if trace.outlet_start is None else {"outlet_pressure": trace.outlet_start}
    if trace.inlet_pressure is not None:
        known["inlet_pressure"] = float(np.interp(at, *trace.inlet_pressure))
    if trace.demand_pressure is not None:
        times, pressures = trace.demand_pressure
        known["demand_pressure"] = float(pressures[max(0, int(np.searchsorted(times, at, side="right")) - 1)])
    least: dict[str, Any] = {name: max(pressure, LEAST_PRESSURE) for name, pressure in known.items()}
    return replace(valve, gas=valve.gas._replace(**least)) if least else valve


def supply_of(trace: Trace, offset: float) -> Supply | None:
    """The measured pressures of tank and demand of a valve with gas; None where there are none."""
    inlet, demand = trace.inlet_pressure or NO_SIGNAL, trace.demand_pressure or NO_SIGNAL
    if not (len(inlet.times) or len(demand.times)):
        return None
    return Supply(
        inlet.times - offset,
        np.maximum(inlet.values, LEAST_PRESSURE),
        demand.times - offset,
        np.maximum(demand.values, LEAST_PRESSURE),
    )


def response_to(valve: Valve, trace: Trace, drive: Drive, times: Array, start: float, offset: float) -> Response:
    """The response of a valve to the pressures of a trace, as far as they were measured, and to a voltage.

    Args:
        valve: rests closed until `start`, s. trace: of which samples are stamped late by `offset`, s.
        drive: the voltage. times: (n,) s, at which the response is given.

    Raises:
        SimulationError: the valve cannot be simulated.
    """
    supply = None if valve.gas is None else supply_of(trace, offset)
    valve = as_it_began(valve, trace)
    return simulate(valve, drive, times, start_time=start, supply=supply)


def with_declared_sensor(valve: Valve, traces: Sequence[Trace]) -> Valve:
    """The declared valve with the low-pass of its position sensor that the traces declare; without one, as it is.

    Raises:
        ParameterError: the traces declare different ones, or the valve declares another.
    """
    bandwidths = {trace.bandwidth for trace in traces if len(trace.times)}
    if not bandwidths - {math.inf}:
        return valve
    bandwidth, *others = sorted(bandwidths)
    if others:
        other = next(trace for trace in traces if trace.bandwidth != bandwidth)
        raise ParameterError(
            f"{other.source}: its sensor has not the {bandwidth:g} Hz of the other recordings; "
            "use recordings of one sensor"
        )
    declared = valve.effects.get("sensor_bandwidth", {}).get("cutoff_frequency", bandwidth)
    if declared != bandwidth:
        raise ParameterError(
            f"{traces[0].source}: its map declares sensor.bandwidth {bandwidth:g} Hz, and the valve "
            f"effects.sensor_bandwidth.cutoff_frequency {declared:g} Hz; take one of them out"
        )
    return replace(valve, effects={**valve.effects, "sensor_bandwidth": {"cutoff_frequency": bandwidth}})


def averaged(trace: Trace, positions: Array) -> Array:
    """(n,) or (n, k) what a sensor shows that averages its last readings, of what it sees at each of them."""
    count = min(trace.averaging, len(positions))
    if count <= 1:
        return positions
    # Before the recording the sensor has seen what it saw first.
    before = np.repeat(positions[:1], count, axis=0)
    sums = np.cumsum(np.concatenate([before, positions]), axis=0)
    return np.asarray((sums[count:] - sums[:-count]) / count)


def rated_current_of(valve: Valve) -> float:
    """The coil current at u = 1, A.

    Raises:
        SimulationError: the coil has no resistance.
    """
    voltage, resistance = valve.after_effects("reference_voltage", "coil_resistance")
    if resistance <= 0.0:
        raise SimulationError("coil_resistance: found 0 Ω, which leaves the current infinite")
    return voltage / resistance


def contacts(valve: Valve, trace: Trace, drive: Drive, offset: float) -> Contacts:
    """When plungers of a valve meet the body, and with which momentum; arguments: see `shown_by`.

    Raises:
        SimulationError: the simulation could not be carried to its end.
    """
    room = EVENTS_EACH * (len(drive.times) + 1)
    times, numbers, _, speeds = shown_by(valve, trace, drive, offset, room=room).events.T
    kinds = numbers.astype(np.intp)
    pilot, moving, at_stop, at_seat = valve.after_effects(
        "pilot_mass", "moving_mass", "restitution_stop", "restitution_seat"
    )
    masses = np.zeros(len(EventKind))
    masses[[EventKind.REACHED_STOP, EventKind.BOUNCED_AT_STOP]] = moving
    masses[[EventKind.SEATED, EventKind.BOUNCED_AT_SEAT]] = pilot or moving
    masses[EventKind.MAIN_SEATED], masses[EventKind.HELD_AT_GAP] = moving - pilot, pilot
    bounce = np.zeros(len(EventKind))
    bounce[EventKind.BOUNCED_AT_STOP], bounce[EventKind.BOUNCED_AT_SEAT] = at_stop, at_seat
    momenta = masses[kinds] * np.abs(speeds) * (1.0 + bounce[kinds]) / (moving * USUAL_SPEED)
    places = np.zeros(len(EventKind), dtype=np.int64)
    places[[EventKind.REACHED_STOP, EventKind.BOUNCED_AT_STOP]] = 1
    places[[EventKind.MAIN_SEATED, EventKind.HELD_AT_GAP]] = 2
    felt = momenta > FAINTEST
    return Contacts(times[felt] + offset, momenta[felt], places[kinds][felt])


def followed(valve: Valve, trace: Trace, drive: Drive, offset: float) -> Array:
    """The pilot plunger's positions at the samples by which a trace is judged, m; arguments: see `shown_by`.

    Raises:
        SimulationError: the simulation could not be carried to its end.
    """
    times, of = trace.sample_times - offset, recorded(valve, trace, drive, offset)
    return run_from_rest(of).piece(of.commands, float(times[-1]), times).positions


def _settled(drive: Drive, current: Signal) -> NDArray[np.bool_]:
    """(n,) the last third of each interval between commands, where the current has settled."""
    times, values = current
    edges = np.concatenate([[times[0]], drive.times, [times[-1]]])
    index = np.clip(np.searchsorted(edges, times, side="right") - 1, 0, len(edges) - 2)
    start, stop = edges[index], edges[index + 1]
    late = np.flatnonzero((times - start > (2.0 / 3.0) * (stop - start)) | (index == 0))
    interval = index[late]
    settled = np.zeros(len(times), dtype=bool)
    settled[late] = True
    for own in np.split(late, np.flatnonzero(np.diff(interval)) + 1):
        settled[own[_before_it_leaves(values[own]) :]] = False
    return settled


def _before_it_leaves(readings: Array) -> int:
    """How many readings of a settled current pass before it changes again: the next command's stamp may be late.

    It has left where it stays farther from the first half of the readings than these are from each other.
    """
    if not len(readings):
        return 0
    usual = readings[: (len(readings) + 1) // 2]
    low, high = usual.min(), usual.max()
    is_near = np.maximum(low - readings, readings - high) <= high - low
    return int(np.flatnonzero(is_near)[-1]) + 1
