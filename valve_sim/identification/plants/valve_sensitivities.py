"""Derivatives of what the sensors of a recorded valve show, by the model's variational equations.

What a run is made of (the valve's numbers, commands, clocks) follows from the values by simple rules, so that a
difference quotient of these rules is exact to seven digits and costs no simulation; what the valve makes of it is the
model's to differentiate.
"""

from __future__ import annotations

from collections.abc import Iterator, Mapping, Sequence
from typing import Final, NamedTuple

import numpy as np
from numpy.typing import NDArray

from valve_sim.identification.plants.protocol import Array, Direction, Piece, Sensitivities
from valve_sim.identification.plants.recording_errors import (
    IntervalFactors,
    drive_with,
    is_of_recording,
    lateness_with,
    zero_with,
)
from valve_sim.identification.plants.valve_model import ValveModel
from valve_sim.identification.plants.valve_pieces import Intervals, WholeRun, run_in_pieces, whole_run
from valve_sim.identification.plants.valve_sensors import amperes, averaged, rated_current_of, shown_by
from valve_sim.model import CATALOGUE, Drive, Valve
from valve_sim.model.core.gas import PREFIX
from valve_sim.model.runs import Directions, Shown
from valve_sim.recordings import Trace


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
    values, moved = _with_all(model, values, directions)
    valve, slopes, rated, known = _slopes_of(model, values, moved, directions)
    columns: list[Array] = []
    seen: list[Array] = []
    if not known.any():
        return Sensitivities([], known)
    for index, trace in enumerate(traces):
        own = _without_measured(valve, slopes, trace)
        at, moving, zeros = _moving_recording((trace, index), (values, moved), directions, (own, model.valve))
        along = Directions(*moving)
        factors = differing[index].of(values)
        if factors is None:
            shown: Shown | WholeRun = shown_by(valve, trace, at.drive, at.lateness, along)
        else:
            by = np.zeros((len(directions), *factors.shape))
            for row, (there, direction) in enumerate(zip(moved, directions, strict=True)):
                changed = differing[index].of(there) if any(map(is_of_recording, direction.slopes)) else None
                if changed is not None:
                    by[row] = (changed - factors) / direction.step
            intervals = Intervals(differing[index].fields(values), factors, by, slopes)
            shown = whole_run(run_in_pieces(valve, trace, at.drive, at.lateness, along, intervals))
        if trace.has_positions:
            positions = averaged(trace, shown.of_positions)
            columns.append(positions + zeros if zeros.any() else positions)
            seen.append(averaged(trace, shown.positions) + at.zero)
        if trace.coil_current is not None:
            seen.append(rated[0] * shown.currents)
            columns.append(_rated(rated, shown.currents, shown.of_currents))
        if trace.outlet_pressure is not None:
            assert isinstance(shown, Shown)
            columns.append(shown.of_pressures)
            seen.append(shown.pressures)
    return Sensitivities(columns, known, seen)


def _with_all(
    model: ValveModel, values: Mapping[str, float], directions: Sequence[Direction]
) -> tuple[dict[str, float], list[dict[str, float]]]:
    """The values with neutral ones of effects that only directions have, and these a step along each direction."""
    asked = {name for direction in directions for name in direction.slopes if "." in name and not is_of_recording(name)}
    whole = {**values, **{name: model.declared(name) for name in sorted(asked - values.keys())}}
    return whole, [_moved(whole, direction) for direction in directions]


_SWITCHES: Final = (
    "coil_time_constant", "eddy_time_constant", "residual_current", "restitution_stop", "restitution_seat",
    "stop_compliance", "sensor_time_constant", "release_voltage",
)  # fmt: skip
"""Numbers that are off at 0 and act differently on either side of it: difference quotients are needed there."""
_WATCHED: Final = frozenset({*_SWITCHES, "reference_voltage", "coil_resistance"})
"""These, and what the rated current follows from: effects change what is declared of them."""


def _is_watched(name: str) -> bool:
    """Whether a value may change a switch, or the rated current."""
    effect, _, _ = name.partition(".")
    return not _WATCHED.isdisjoint(CATALOGUE[effect].changes if effect in CATALOGUE else (name,))


def _switches_of(valve: Valve) -> Array:
    return np.array(valve.after_effects(*_SWITCHES))


def _slopes_of(
    model: ValveModel,
    values: Mapping[str, float],
    moved: Sequence[Mapping[str, float]],
    directions: Sequence[Direction],
) -> tuple[Valve, Array, tuple[float, Array], NDArray[np.bool_]]:
    """The valve, and how it moves along directions.

    Returns:
        the valve; (k, n) derivatives of its numbers; its rated current, A, and (k,) derivatives of that; (k,) whether
        each direction has derivatives.
    """
    valve: Valve = model.simulated(values)
    numbers, switches, rated = valve.numbers(), _switches_of(valve), rated_current_of(valve)
    slopes, of_rated = np.zeros((len(directions), len(numbers))), np.zeros(len(directions))
    known = np.ones(len(directions), dtype=bool)
    places = {name: place for place, name in enumerate(valve.names)}
    for row, (there, direction) in enumerate(zip(moved, directions, strict=True)):
        if all(map(is_of_recording, direction.slopes)):
            continue
        plain = model.plain_slopes(direction.slopes, values)
        if all(own in places and not _is_watched(own) for own in plain):
            for name, slope in plain.items():
                slopes[row, places[name]] = slope
            known[row] = np.isfinite(numbers[[places[name] for name in plain]]).all()
            continue
        other: Valve = model.simulated(there)
        there_numbers = other.numbers()
        differs = there_numbers != numbers  # otherwise both may be infinite, while their effect is off
        slopes[row, differs] = (there_numbers[differs] - numbers[differs]) / direction.step
        of_rated[row] = (rated_current_of(other) - rated) / direction.step
        is_switched = (switches == 0.0) & (_switches_of(other) != 0.0)
        known[row] = np.isfinite(slopes[row]).all() and not is_switched.any()
    slopes[~known] = 0.0
    return valve, slopes, (rated, of_rated), known


def _without_measured(valve: Valve, slopes: Array, trace: Trace) -> Array:
    """Derivatives of a valve's numbers without moves of declared pressures where a recording has measured ones."""
    measured = {
        "outlet_pressure": trace.outlet_start, "inlet_pressure": trace.inlet_pressure,
        "demand_pressure": trace.demand_pressure,
    }  # fmt: skip
    own = [PREFIX + name for name, found in measured.items() if found is not None]
    if valve.gas is None or not own:
        return slopes
    parameters, kept = valve.names, slopes.copy()
    kept[:, [parameters.index(name) for name in own]] = 0.0
    return kept


def pieces(
    model: ValveModel, traces: Sequence[Trace], values: Mapping[str, float], directions: Sequence[Direction]
) -> Iterator[Piece] | None:
    """What the channels of all traces show, and derivatives, piece by piece; arguments as of `sensitivities`.

    Returns:
        None where a derivative is not known, or where a gas flows.

    Raises:
        SimulationError: the simulation could not be carried to its end.
    """
    if model.valve.gas is not None:
        return None  # its pressures are recorded, too, and one of them may drive it
    values, moved = _with_all(model, values, directions)
    valve, slopes, rated, known = _slopes_of(model, values, moved, directions)
    if not known.all():
        return None
    return _pieces(valve, traces, (values, moved), directions, (slopes, model.valve, rated))


def _pieces(
    valve: Valve,
    traces: Sequence[Trace],
    places: tuple[Mapping[str, float], Sequence[Mapping[str, float]]],
    directions: Sequence[Direction],
    moving: tuple[Array, Valve, tuple[float, Array]],
) -> Iterator[Piece]:
    channel, (slopes, declared, rated) = 0, moving
    for index, trace in enumerate(traces):
        at, recording, zeros = _moving_recording((trace, index), places, directions, (slopes, declared))
        along = Directions(*recording) if directions else None
        for piece in run_in_pieces(valve, trace, at.drive, at.lateness, along):
            if trace.has_positions:
                shown, columns = piece.shown.positions + at.zero, piece.shown.of_positions + zeros
                yield Piece(channel, piece.positions.start, shown, columns)
            for shown in amperes(valve, trace, piece.shown.currents):
                columns = _rated(rated, piece.shown.currents, piece.shown.of_currents)
                yield Piece(channel + trace.has_positions, piece.currents.start, shown, columns)
        channel += trace.has_positions + (trace.coil_current is not None)


def _moving_recording(
    recording: tuple[Trace, int],
    places: tuple[Mapping[str, float], Sequence[Mapping[str, float]]],
    directions: Sequence[Direction],
    slopes_and_valve: tuple[Array, Valve],
) -> tuple[_Recording, tuple[Array, Array, Array, Array], Array]:
    """What a recording adds to a run, and how that and the run's input move along directions; (k,) the sensor's zero.

    Args:
        recording: trace and index. places: the values, and these moved along each direction.
        slopes_and_valve: of the valve's numbers along the directions; the valve as declared.
    """
    (trace, index), (values, moved), (slopes, valve) = recording, places, slopes_and_valve
    at = _recording(trace, index, values, valve)
    theirs = [
        _recording(trace, index, there, valve) if any(map(is_of_recording, direction.slopes)) else None
        for direction, there in zip(directions, moved, strict=True)
    ]
    return (at, *_moving_run(slopes, at, theirs, directions))


def _rated(rated: tuple[float, Array], currents: Array, derivatives: Array) -> Array:
    """(m, k) derivatives of currents in A, from those of normalised ones, which are overwritten.

    A new array this large would take as long as the model does.

    Args:
        rated: the current at u = 1, A, and (k,) its derivatives.
    """
    derivatives *= rated[0]
    for column in np.flatnonzero(rated[1]):
        derivatives[:, column] += rated[1][column] * currents
    return derivatives


def _moving_run(
    slopes: Array, at: _Recording, theirs: Sequence[_Recording | None], directions: Sequence[Direction]
) -> tuple[tuple[Array, Array, Array, Array], Array]:
    """How a run moves along directions, as `Directions` has it, and (k,) how its sensor's zero does.

    Args:
        theirs: None where no recording changes.
    """
    count, commands = len(directions), len(at.drive.times)
    times, volts = np.zeros((2, count, commands))
    late, zeros = np.zeros((2, count))
    for row, (there, direction) in enumerate(zip(theirs, directions, strict=True)):
        if there is not None:
            times[row] = (there.drive.times - at.drive.times) / direction.step
            volts[row] = (there.drive.volts - at.drive.volts) / direction.step
            late[row] = (there.lateness - at.lateness) / direction.step
            zeros[row] = (there.zero - at.zero) / direction.step
    return (slopes, times, volts, -late), zeros


def _moved(values: Mapping[str, float], direction: Direction) -> dict[str, float]:
    """The values a step further along a direction."""
    there = dict(values)
    for name, slope in direction.slopes.items():
        there[name] = there.get(name, 0.0) + direction.step * slope
    return there


def _recording(trace: Trace, index: int, values: Mapping[str, float], valve: Valve) -> _Recording:
    drive = drive_with(trace, index, values, valve)
    return _Recording(drive, lateness_with(index, values), zero_with(index, values))
