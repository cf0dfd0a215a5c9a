"""Derivatives of what the sensors of a recorded valve show, by the model's variational equations.

What a run is made of (the valve's record, commands, clocks) follows from the values by simple rules, so that a
difference quotient of these rules is exact to seven digits and costs no simulation; what the valve makes of it is the
model's to differentiate.
"""

from __future__ import annotations

from collections.abc import Iterator, Mapping, Sequence
from dataclasses import replace
from typing import Any, NamedTuple

import numpy as np

from valve_sim.identification.plants.interval_factors import IntervalFactors
from valve_sim.identification.plants.protocol import Array, Direction, Piece, Sensitivities
from valve_sim.identification.plants.recording_errors import drive_with, is_of_recording, lateness_with, zero_with
from valve_sim.identification.plants.valve_model import ValveModel
from valve_sim.identification.plants.valve_pieces import Intervals, run_in_pieces, whole_run
from valve_sim.identification.plants.valve_sensors import (
    amperes,
    averaged,
    prepared,
    prepared_with_pressure,
    supply_of,
    tolerance_of,
)
from valve_sim.model import Drive, Valve
from valve_sim.model.gas.record import is_of_gas
from valve_sim.model.sensitivities import (
    PRESSURES_AT,
    Tangents,
    Variations,
    has_sensitivities,
    numbers_of,
    rated_slopes,
    run_tangents,
)
from valve_sim.model.simulation import rated_current
from valve_sim.traces import Trace


class _Recording(NamedTuple):
    """What a recording adds to a run: commands, how late samples are stamped, and a sensor's zero."""

    drive: Drive
    lateness: float
    zero: float


def sensitivities(
    model: ValveModel,
    traces: Sequence[Trace],
    values: Mapping[str, float],
    directions: Sequence[Direction],
    differing: Sequence[IntervalFactors],
) -> Sensitivities:
    """Derivatives of the channels of all traces.

    Args:
        model: the valve. traces: its recordings.
        values: as of a plant's `predict`. directions: along which to differentiate.
        differing: what differs of the valve by interval between the commands of each trace.

    Raises:
        SimulationError: the simulation could not be carried to its end.
    """
    record = model.record(values)
    moved = [_moved(values, direction) for direction in directions]
    slopes = _record_slopes(model, record, moved, directions)
    known = has_sensitivities(record, slopes)
    columns: list[Array] = []
    if not known.any():
        return Sensitivities([], known)
    for index, trace in enumerate(traces):
        at, tangents, zeros = _moving_recording((trace, index), (values, moved), directions, (slopes, model.valve))
        factors = differing[index].of(values)
        if factors is not None:
            by = np.zeros((len(directions), *factors.shape))
            for row, (there, own) in enumerate(zip(moved, directions, strict=True)):
                changed = differing[index].of(there) if any(map(is_of_recording, own.slopes)) else None
                if changed is not None:
                    by[row] = (changed - factors) / own.step
            intervals = Intervals(factors, by, tangents.numbers)
            run = whole_run(run_in_pieces(record, trace, at.drive, at.lateness, Variations(tangents), intervals))
            if trace.has_positions:
                columns.append(averaged(trace, run.of_positions) + zeros)
            if trace.coil_current is not None:
                columns.append(_rated(record, run.currents, run.of_currents, rated_slopes(record, slopes)))
            continue
        tangents = _without_measured(tangents, trace) if is_of_gas(record) else tangents
        order: Any = slice(None)
        if trace.outlet_pressure is None:
            state, samples = prepared(record, trace, at.drive, at.lateness)
        else:
            times = trace.outlet_pressure.times
            state, samples, order = prepared_with_pressure(record, trace, times, at.drive, at.lateness)
        supply, tolerance = supply_of(record, trace, at.lateness), tolerance_of(record)
        positions, currents, pressures = run_tangents(record, state, at.drive, samples, tangents, tolerance, supply)
        count = len(trace.times)
        if trace.has_positions:
            positions = _in_order(positions, order)[:count]
            positions = averaged(trace, positions)
            columns.append(positions + zeros if zeros.any() else positions)
        if trace.coil_current is not None:
            columns.append(_rated(record, samples.currents, currents, rated_slopes(record, slopes)))
        if trace.outlet_pressure is not None:
            columns.append(_in_order(pressures, order)[count:])
    return Sensitivities(columns, known)


def _in_order(rows: Array, order: Any) -> Array:
    """Rows put back from the order in time in which they were shown."""
    if isinstance(order, slice):
        return rows
    found = np.empty_like(rows)
    found[order] = rows
    return found


def _without_measured(tangents: Tangents, trace: Trace) -> Tangents:
    """Directions without moves of declared pressures in place of which a recording has measured ones."""
    measured = (trace.outlet_start is not None, trace.inlet_pressure is not None, trace.demand_pressure is not None)
    own = [place for place, is_measured in zip(PRESSURES_AT, measured, strict=True) if is_measured]
    if not own:
        return tangents
    numbers = tangents.numbers.copy()
    numbers[:, own] = 0.0
    return replace(tangents, numbers=numbers)


def pieces(
    model: ValveModel, traces: Sequence[Trace], values: Mapping[str, float], directions: Sequence[Direction]
) -> Iterator[Piece] | None:
    """What the channels of all traces show, and derivatives, piece by piece; arguments as of `sensitivities`.

    Returns:
        None where a derivative is not known, or where a gas flows.

    Raises:
        SimulationError: the simulation could not be carried to its end.
    """
    record = model.record(values)
    moved = [_moved(values, direction) for direction in directions]
    slopes = _record_slopes(model, record, moved, directions)
    if is_of_gas(record):
        return None  # its pressures are recorded, too, and one of them may drive it
    if directions and not has_sensitivities(record, slopes).all():
        return None
    return _pieces(record, traces, (values, moved), directions, (slopes, model.valve))


def _pieces(
    record: Any,
    traces: Sequence[Trace],
    places: tuple[Mapping[str, float], Sequence[Mapping[str, float]]],
    directions: Sequence[Direction],
    slopes_and_valve: tuple[Array, Valve],
) -> Iterator[Piece]:
    channel, rated = 0, rated_slopes(record, slopes_and_valve[0])
    for index, trace in enumerate(traces):
        at, tangents, zeros = _moving_recording((trace, index), places, directions, slopes_and_valve)
        variations = Variations(tangents) if directions else None
        for piece in run_in_pieces(record, trace, at.drive, at.lateness, variations):
            if trace.has_positions:
                shown, columns = piece.samples.rows[:, 0] + at.zero, piece.of_positions + zeros
                yield Piece(channel, piece.positions.start, shown, columns)
            for shown in amperes(record, trace, piece.samples.currents):
                columns = _rated(record, piece.samples.currents, piece.of_currents, rated)
                yield Piece(channel + trace.has_positions, piece.currents.start, shown, columns)
        channel += trace.has_positions + (trace.coil_current is not None)


def _moving_recording(
    recording: tuple[Trace, int],
    places: tuple[Mapping[str, float], Sequence[Mapping[str, float]]],
    directions: Sequence[Direction],
    slopes_and_valve: tuple[Array, Valve],
) -> tuple[_Recording, Tangents, Array]:
    """What a recording adds to a run, and how that and the run's input move along directions; (k,) the sensor's zero.

    Args:
        recording: trace and index. places: the values, and these moved along each direction.
        slopes_and_valve: of the record's numbers along the directions; the valve as declared.
    """
    (trace, index), (values, moved), (slopes, valve) = recording, places, slopes_and_valve
    at = _recording(trace, index, values, valve)
    theirs = [
        _recording(trace, index, there, valve) if any(map(is_of_recording, direction.slopes)) else None
        for direction, there in zip(directions, moved, strict=True)
    ]
    return (at, *_tangents(slopes, at, theirs, directions))


def _rated(record: Any, currents: Array, derivatives: Array, rated: Array) -> Array:
    """(m, k) derivatives of currents in A, from those of normalised ones, which are overwritten.

    A new array this large would take as long as the model does.
    """
    derivatives *= rated_current(record)
    for column in np.flatnonzero(rated):
        derivatives[:, column] += rated[column] * currents
    return derivatives


def _tangents(
    slopes: Array, at: _Recording, theirs: Sequence[_Recording | None], directions: Sequence[Direction]
) -> tuple[Tangents, Array]:
    """How a run moves along directions, and (k,) how its sensor's zero does; None where no recording changes."""
    count, commands = len(directions), len(at.drive.times)
    times, volts = np.zeros((2, count, commands))
    late, zeros = np.zeros((2, count))
    for row, (there, direction) in enumerate(zip(theirs, directions, strict=True)):
        if there is not None:
            times[row] = (there.drive.times - at.drive.times) / direction.step
            volts[row] = (there.drive.volts - at.drive.volts) / direction.step
            late[row] = (there.lateness - at.lateness) / direction.step
            zeros[row] = (there.zero - at.zero) / direction.step
    return Tangents(slopes, times, volts, -late), zeros


def _record_slopes(
    model: ValveModel, record: Any, moved: Sequence[Mapping[str, float]], directions: Sequence[Direction]
) -> Array:
    """(k, `NUMBERS`) derivatives of the record's numbers along the directions that led to where the values moved."""
    numbers = numbers_of(record)
    slopes = np.zeros((len(directions), len(numbers)))
    for row, (values, direction) in enumerate(zip(moved, directions, strict=True)):
        if not all(map(is_of_recording, direction.slopes)):
            slopes[row] = (numbers_of(model.record(values)) - numbers) / direction.step
    return slopes


def _moved(values: Mapping[str, float], direction: Direction) -> dict[str, float]:
    """The values a step further along a direction."""
    there = dict(values)
    for name, slope in direction.slopes.items():
        there[name] = there.get(name, 0.0) + direction.step * slope
    return there


def _recording(trace: Trace, index: int, values: Mapping[str, float], valve: Valve) -> _Recording:
    drive = drive_with(trace, index, values, valve)
    return _Recording(drive, lateness_with(index, values), zero_with(index, values))
