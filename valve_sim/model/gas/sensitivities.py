"""Derivatives of a trace with respect to parameters of the valve, its commands and its clocks, in one run."""

from __future__ import annotations

from dataclasses import dataclass, replace
from typing import Any, Final

import numpy as np
from numpy.typing import NDArray

from valve_sim.model.core_types import EVENT_RECORD
from valve_sim.model.drives import Drive
from valve_sim.model.effects.record import VALVE_RECORD
from valve_sim.model.gas.flow import density_slope, pressure_at
from valve_sim.model.gas.linearised import FIRST_CONDITION, OF_EFFECTS, PARAMETERS, SHAPES, SLOPES_RECORD
from valve_sim.model.gas.record import GAS_FIELDS, GAS_NUMBERS, GAS_VALVE_RECORD, is_of_gas
from valve_sim.model.gas.step import PRESSURE_COLUMN
from valve_sim.model.gas.supplied import SuppliedCourse, Supply, course_of, run_changes
from valve_sim.model.gas.variational_pressure import INLET
from valve_sim.model.gas.variational_steps import CONTACTS, LANES, NODES, SLOPES, TILE_RECORD
from valve_sim.model.simulation import Array, Samples, delay_and_end, run_course

PLACES: Final = {name: place for place, name in enumerate(PARAMETERS)}
"""Of the numbers of a valve's record among those that derivatives can be taken to."""
_FIRST: Final = len(PARAMETERS)
"""Index of the first number of a term."""
NUMBERS: Final = FIRST_CONDITION
"""How many numbers of a valve's record have derivatives; with gas there are `GAS_FIELDS` after them."""
_OF_TERMS: Final = NUMBERS - _FIRST
_DELAY: Final = PLACES["sensor_delay"]
_CONTACT_PLACES: Final = {PLACES[name]: name for name in CONTACTS}
_BY_FORCE: Final = np.arange(NUMBERS + len(GAS_FIELDS)) < NUMBERS
_BY_FORCE[[*_CONTACT_PLACES, PLACES["coil_resistance"], _DELAY]] = False
_GAS_PLACES: Final = {NUMBERS + GAS_FIELDS.index(name): index for index, name in enumerate(GAS_NUMBERS)}
PRESSURES_AT: Final = tuple(
    NUMBERS + GAS_FIELDS.index(name) for name in ("outlet_pressure", "inlet_pressure", "demand_pressure")
)
"""Indices among the numbers of the outlet's pressure at the start, the tank's, and that behind the demand's orifice."""
_GAS_FIRST: Final = list(GAS_VALVE_RECORD.names or ()).index(GAS_FIELDS[0])
_OF_EFFECTS: Final = [PLACES[name] for name in OF_EFFECTS]
_SHAPES: Final = [PLACES[name] for name in SHAPES]
_FOREIGN: Final = ("temperature_rate", "flux_linkage", "release_voltage")
_SWITCHES: Final = (
    *_FOREIGN, "coil_time_constant", "eddy_time_constant", "residual_current", "restitution_stop", "restitution_seat",
    "motional_share", "sensor_time_constant",
)  # fmt: skip
_OF_PARAMETERS: Final = ("row_count", "row_number", "row", *CONTACTS)
"""Fields of a tile that say how its parameters move the valve's numbers."""
_NO_EVENTS: Final = np.empty(0, EVENT_RECORD)
assert VALVE_RECORD.names is not None
assert (VALVE_RECORD.names[:_FIRST], VALVE_RECORD.names[-1]) == (PARAMETERS, "term_parameters")


@dataclass(frozen=True)
class Tangents:
    """How the input of a run changes with k parameters: its derivatives with respect to them.

    Attributes:
        numbers: (k, n) of the valve's record, see `numbers_of`.
        command_times: (k, c) of the commands' times. command_volts: (k, c) of their voltages.
        sample_times: (k,) of all sample times: −1 for a clock whose samples are stamped late.
    """

    numbers: Array
    command_times: Array
    command_volts: Array
    sample_times: Array


def numbers_of(record: Any) -> Array:
    """The numbers of a (1,) record that derivatives can be taken to: (`NUMBERS`,), with gas its own after them."""
    whole = record.view(np.float64)
    of_gas = whole[_GAS_FIRST : _GAS_FIRST + len(GAS_FIELDS)] if is_of_gas(record) else whole[:0]
    return np.concatenate([whole[:_FIRST], whole[-_OF_TERMS:], of_gas])


def has_sensitivities(record: Any, numbers: Array) -> NDArray[np.bool_]:
    """Whether `run_tangents` knows the derivatives along (k, n) directions of the numbers of a (1,) record.

    Difference quotients are needed for a coil that heats, has its flux modelled or freewheels, and for a parameter that
    is off at 0 and acts differently on either side of it.
    """
    if any(record[name][0] != 0.0 for name in _FOREIGN):
        return np.zeros(len(numbers), dtype=bool)
    off = [PLACES[name] for name in _SWITCHES if record[name][0] == 0.0]
    return np.asarray(np.isfinite(numbers).all(axis=1) & ~numbers[:, off].any(axis=1))


def rated_slopes(record: Any, numbers: Array) -> Array:
    """The derivatives of `rated_current` along (k, n) directions of the record's numbers."""
    voltage, resistance = record["reference_voltage"][0], record["coil_resistance"][0]
    by_voltage, by_resistance = numbers[:, PLACES["reference_voltage"]], numbers[:, PLACES["coil_resistance"]]
    return np.asarray((by_voltage - by_resistance * voltage / resistance) / resistance)


def run_tangents(
    record: Any,
    state: Any,
    drive: Drive,
    samples: Samples,
    tangents: Tangents,
    tolerance: float,
    supply: Supply | None = None,
) -> tuple[Array, Array, Array]:
    """Run a trace and its variational equations.

    Args:
        record: (1,) VALVE_RECORD. state: (1,) STATE_RECORD, advanced. drive: the commanded voltage.
        samples: what is written down, as in `run_course`.
        tangents: of k parameters.
        tolerance: relative error of one step of the plain trace, which the derivatives follow.
        supply: of a valve with gas: pressures in place of declared ones, which then are not to move.

    Returns:
        (n, k) of the positions as shown, m over the parameter's unit; (m, k) of the normalised currents; (n, k) of
        the outlet's pressure, Pa over the unit, where the samples have a column for it, else none.

    Raises:
        SimulationError: the run could not be carried to its end.
    """
    if supply is not None:
        changing = course_of(record, state, drive, supply, delay_and_end(record, samples)[1])
        return Variations(tangents, record, state).run_supplied(record, state, changing, samples, tolerance)
    course = (drive.times, drive.volts, delay_and_end(record, samples)[1])
    return Variations(tangents, record, state).run(record, state, course, samples, tolerance)


class Variations:
    """Derivatives that are carried along a run, which may be made in pieces.

    Args:
        tangents: of k parameters. record, state: of a valve with gas, at the start.
    """

    def __init__(self, tangents: Tangents, record: Any = None, state: Any = None) -> None:
        self._tangents = tangents
        moved = np.flatnonzero(tangents.numbers.any(axis=0))
        self._tiles = _tiles(tangents, moved)
        self._slopes = np.zeros(SLOPES, SLOPES_RECORD)
        of_terms = moved[(moved >= _FIRST) & (moved < NUMBERS)]
        if of_terms.size:
            asked = np.zeros(_OF_TERMS, dtype=np.int64)
            asked[of_terms - _FIRST] = 1
            self._slopes["asked"] = asked.reshape(self._slopes["asked"].shape[1:])
        self._slopes["asks_effects"] = tangents.numbers[:, _OF_EFFECTS].any()
        self._slopes["asks_shapes"] = tangents.numbers[:, _SHAPES].any()
        if record is not None and is_of_gas(record):
            _add_gas(self._tiles, tangents.numbers, record, state)

    def turn(self, numbers: Array) -> None:
        """Go on where parameters move the record by (k, n) others, as where the valve's own numbers change."""
        moved = np.flatnonzero(self._tangents.numbers.any(axis=0) | numbers.any(axis=0))
        self._tangents = replace(self._tangents, numbers=numbers)
        there = _tiles(self._tangents, moved)
        for name in _OF_PARAMETERS:
            self._tiles[name] = there[name]

    def run(
        self,
        record: Any,
        state: Any,
        course: tuple[Array, Array, float],
        samples: Samples,
        tolerance: float,
        first: int = 0,
    ) -> tuple[Array, Array, Array]:
        """One piece of the run, as of `run_course`, whose first command has this number; result as `run_tangents`."""
        own = slice(first, first + len(course[0]))
        changes = (self._tangents.command_times[:, own], self._tangents.command_volts[:, own])
        vary, shown = self._prepared(samples, changes)
        run_course(record, state, course, samples, _NO_EVENTS, tolerance, vary)
        return shown

    def run_supplied(
        self, record: Any, state: Any, course: SuppliedCourse, samples: Samples, tolerance: float
    ) -> tuple[Array, Array, Array]:
        """The whole run of a valve with gas while pressures change; arguments as of `supplied.run_changes`."""
        at, is_command, late = course.commands, course.commands >= 0, self._tangents.sample_times[:, None]
        times, volts = self._tangents.command_times, self._tangents.command_volts
        if not len(times[0]):
            times = volts = np.zeros((len(times), 1))
        changes = np.where(is_command, times[:, at], late), np.where(is_command, volts[:, at], 0.0)
        vary, shown = self._prepared(samples, changes)
        run_changes(record, state, course, samples, _NO_EVENTS, tolerance, vary)
        return shown

    def _prepared(self, samples: Samples, changes: tuple[Array, Array]) -> tuple[Any, tuple[Array, Array, Array]]:
        """What a run takes to carry derivatives along, and these, which it fills in.

        Args:
            changes: (k, c) derivatives of the times of commands and of their voltages.
        """
        count, lanes = len(self._tangents.numbers), len(self._tiles) * LANES
        commands = np.zeros((2, lanes, changes[0].shape[1]))
        commands[:, :count] = changes
        times, volts = np.ascontiguousarray(commands.reshape(2, len(self._tiles), LANES, -1).swapaxes(2, 3))
        pressures = samples.times[: len(samples.times) if samples.rows.shape[1] == PRESSURE_COLUMN + 1 else 0]
        shown = (samples.times, samples.current_times, pressures)
        outputs = tuple(np.empty((len(times), len(self._tiles), LANES)) for times in shown)
        vary = (self._tiles, self._slopes, np.arange(NODES), (times, volts), outputs)
        positions, currents, of_pressure = (output.reshape(len(output), lanes)[:, :count] for output in outputs)
        return vary, (positions, currents, of_pressure)


def _add_gas(tiles: Any, numbers: Array, record: Any, state: Any) -> None:
    """How each parameter moves the numbers of gas, and the density at the start."""
    shape, p = (len(tiles), LANES), record.view(np.recarray)[0]
    by_lane = np.zeros((len(tiles) * LANES, numbers.shape[1]))
    by_lane[: len(numbers)] = numbers
    for place, index in _GAS_PLACES.items():
        tiles["gas"][:, index] = by_lane[:, place].reshape(shape)
    tiles["gas"][:, INLET] -= state["tank_rate"].item() * tiles["current_time"]
    tiles["has_gas"] = tiles["gas"].any(axis=(1, 2)) | tiles["current_time"].any(axis=1)
    pressure = pressure_at.py_func(p, state["density"].item())
    temperature = by_lane[:, NUMBERS + GAS_FIELDS.index("inlet_temperature")]
    change = by_lane[:, PRESSURES_AT[0]] - pressure / p.inlet_temperature * temperature
    tiles["density"] = (density_slope.py_func(p, pressure) * change).reshape(shape)


def _tiles(tangents: Tangents, moved: NDArray[np.int64]) -> Any:
    """Parameters in tiles of lanes; `moved`: the numbers that any of them changes."""
    count = len(tangents.numbers)
    tiles = np.zeros(-(-count // LANES), TILE_RECORD)
    numbers = np.zeros((len(tiles) * LANES, len(moved)))
    numbers[:count] = tangents.numbers[:, moved]
    by_lane = np.ascontiguousarray(numbers.reshape(len(tiles), LANES, -1).swapaxes(1, 2))
    late = np.zeros((len(tiles), LANES))
    late.ravel()[:count] = tangents.sample_times
    tiles["current_time"] = late
    tiles["position_time"] = late
    for column, place in enumerate(moved.tolist()):
        if name := _CONTACT_PLACES.get(place):
            tiles[name] = by_lane[:, column]
        elif place == _DELAY:
            tiles["position_time"] -= by_lane[:, column]
    acts = by_lane.any(axis=2) & _BY_FORCE[moved]
    for tile, act, slopes in zip(tiles, acts, by_lane, strict=True):
        rows = np.flatnonzero(act)
        tile["row_count"] = len(rows)
        tile["row_number"][: len(rows)] = moved[rows]
        tile["row"][: len(rows)] = slopes[rows]
    return tiles
