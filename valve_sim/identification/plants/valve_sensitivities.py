"""What the sensors of a recorded valve show, with derivatives by the model's variational equations.

What a run is made of (the valve's numbers, commands, clocks) follows from the values by simple rules, so that a
difference quotient of these rules is exact to seven digits and costs no simulation; what the valve makes of it is the
model's to differentiate.
"""

from __future__ import annotations

from collections.abc import Iterator, Mapping, Sequence
from typing import NamedTuple

import numpy as np
from numpy.typing import NDArray

from valve_sim.identification.plants.protocol import Array, Direction, Piece
from valve_sim.identification.plants.recording_errors import ErringRecording
from valve_sim.identification.plants.valve_model import ValveModel, switches_of
from valve_sim.identification.plants.valve_pieces import Course, Intervals
from valve_sim.identification.plants.valve_sensors import averaged, rated_current_of
from valve_sim.model import Drive, Valve
from valve_sim.model.core.gas import PREFIX
from valve_sim.model.runs import Directions
from valve_sim.recordings import Trace


class MovingValve(NamedTuple):
    """The valve that values of a fit describe, and how it moves along k directions.

    Attributes:
        values: of the fit. directions: along which they move.
        ahead: the values a step along those directions that are of a recording, by their numbers.
        valve: what is simulated. numbers: (n,) of it. slopes: (k, n) derivatives of these.
        rated: its rated current, A; nan where no current is asked for. of_rated: (k,) derivatives of that.
        known: (k,) whether each direction has derivatives.
    """

    values: Mapping[str, float]
    directions: Sequence[Direction]
    ahead: Mapping[int, Mapping[str, float]]
    valve: Valve
    numbers: Array
    slopes: Array
    rated: float
    of_rated: Array
    known: NDArray[np.bool_]


def moving_valve(
    model: ValveModel, values: Mapping[str, float], directions: Sequence[Direction], *, has_current: bool
) -> MovingValve:
    """The valve at some values; arguments: see a plant's `sensitivities`, without directions those of its `predict`.

    Raises:
        SimulationError: the coil has no resistance.
    """
    own = [{name: by for name, by in one.slopes.items() if model.has(name)} for one in directions]
    # Of effects that only directions have, neutral ones.
    asked = {name for slopes in own for name in slopes if name in model.of_effects} - values.keys()
    if asked:
        values = {**values, **{name: model.declared(name) for name in sorted(asked)}}
    ahead = {
        row: _moved(values, one)
        for row, (one, slopes) in enumerate(zip(directions, own, strict=True))
        if len(slopes) < len(one.slopes)
    }
    valve = model.simulated(values)
    numbers, rated = valve.numbers(), rated_current_of(valve) if has_current else np.nan
    slopes, of_rated = np.zeros((len(directions), len(numbers))), np.zeros(len(directions))
    known, is_finite = np.ones(len(directions), dtype=bool), np.isfinite(numbers)
    places = {name: place for place, name in enumerate(valve.names)}
    for row, (freed, direction) in enumerate(zip(own, directions, strict=True)):
        plain = model.plain_slopes(freed, values) if freed else {}
        if all([name in places and not model.is_watched(name) for name in plain]):
            for name, by in plain.items():
                slopes[row, places[name]] = by
                known[row] &= is_finite[places[name]]
            continue
        other = model.simulated(_moved(values, direction))
        there = other.numbers()
        differs = there != numbers  # otherwise both may be infinite, while their effect is off
        slopes[row, differs] = (there[differs] - numbers[differs]) / direction.step
        if has_current:
            of_rated[row] = (rated_current_of(other) - rated) / direction.step
        is_switched = any(a == 0.0 != b for a, b in zip(switches_of(valve), switches_of(other), strict=True))
        known[row] = np.isfinite(slopes[row]).all() and not is_switched
    slopes[~known] = 0.0
    return MovingValve(values, directions, ahead, valve, numbers, slopes, rated, of_rated, known)


def _moved(values: Mapping[str, float], direction: Direction) -> dict[str, float]:
    """The values a step further along a direction."""
    there = dict(values)
    for name, slope in direction.slopes.items():
        there[name] = there.get(name, 0.0) + direction.step * slope
    return there


def shown(at: MovingValve, recordings: Sequence[ErringRecording], *, is_whole: bool = True) -> Iterator[Piece]:
    """What each channel of some recordings shows, with derivatives; of a long one piece by piece.

    Args:
        is_whole: whether a channel is one piece; else no sensor averages, and no gas flows.

    Raises:
        SimulationError: the simulation could not be carried to its end.
    """
    channel = 0
    for recording in recordings:
        trace = recording.trace
        drive, late, zero = recording.drive(at.values), recording.lateness(at.values), recording.zero(at.values)
        along, zeros = _directions(at, recording, drive) if at.directions else (None, np.zeros(0))
        course = Course(at.valve, at.numbers, trace, drive, late, along, _intervals(at, recording))
        for piece in (course.whole(),) if is_whole else course.pieces():
            found = piece.shown
            if trace.has_positions:
                columns = averaged(trace, found.of_positions)
                columns = columns + zeros if zeros.any() else columns
                yield Piece(channel, piece.positions.start or 0, averaged(trace, found.positions) + zero, columns)
            if trace.coil_current is not None:
                columns = _rated(at, found.currents, found.of_currents)
                yield Piece(
                    channel + trace.has_positions, piece.currents.start or 0, at.rated * found.currents, columns
                )
            if trace.outlet_pressure is not None:
                place = channel + trace.has_positions + (trace.coil_current is not None)
                yield Piece(place, 0, found.pressures, found.of_pressures)
        channel += trace.has_positions + (trace.coil_current is not None) + (trace.outlet_pressure is not None)


def _intervals(at: MovingValve, recording: ErringRecording) -> Intervals | None:
    """What differs of the valve by interval between the commands of a recording; None where nothing does."""
    differing = recording.differing(at.values, at.valve.effects)
    if differing is None:
        return None
    factors = differing.factors(at.values)
    if not at.directions:
        return Intervals(differing.fields, factors)
    slopes = np.zeros((len(at.directions), *factors.shape))
    for row, there in at.ahead.items():
        if differing.is_moved_by(at.directions[row].slopes):
            slopes[row] = (differing.factors(there) - factors) / at.directions[row].step
    return Intervals(differing.fields, factors, slopes, at.slopes)


def _directions(at: MovingValve, recording: ErringRecording, drive: Drive) -> tuple[Directions, Array]:
    """How a run of a recording moves, and (k,) how its sensor's zero does; drive: as it took effect."""
    count, commands = len(at.directions), len(drive.times)
    times, volts = np.zeros((2, count, commands))
    late, zeros = np.zeros((2, count))
    for row, there in at.ahead.items():
        slopes, step = at.directions[row]
        if recording.is_driven_by(slopes):
            moved = recording.drive(there)
            times[row] = (moved.times - drive.times) / step
            volts[row] = (moved.volts - drive.volts) / step
        late[row] = (recording.lateness(there) - recording.lateness(at.values)) / step
        zeros[row] = (recording.zero(there) - recording.zero(at.values)) / step
    return Directions(_without_measured(at, recording.trace), times, volts, -late), zeros


def _without_measured(at: MovingValve, trace: Trace) -> Array:
    """Derivatives of the valve's numbers without moves of declared pressures where a recording has measured ones."""
    if at.valve.gas is None:
        return at.slopes
    measured = {
        "outlet_pressure": trace.outlet_start, "inlet_pressure": trace.inlet_pressure,
        "demand_pressure": trace.demand_pressure,
    }  # fmt: skip
    kept = at.slopes.copy()
    kept[:, [at.valve.names.index(PREFIX + name) for name, found in measured.items() if found is not None]] = 0.0
    return kept


def _rated(at: MovingValve, currents: Array, derivatives: Array) -> Array:
    """(m, k) derivatives of currents in A, from those of normalised ones, which are overwritten.

    A new array this large would take as long as the model does.
    """
    derivatives *= at.rated
    for column in np.flatnonzero(at.of_rated):
        derivatives[:, column] += at.of_rated[column] * currents
    return derivatives
