"""Derivatives of a trace to anything that its valve, its commands and its clocks depend on, in one run."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from typing import Any, Final

import numpy as np

from valve_sim.model.core_types import EVENT_RECORD
from valve_sim.model.effects.record import VALVE_RECORD
from valve_sim.model.linearised import FIRST_CONDITION, PARAMETERS, SHAPES, SLOPES_RECORD
from valve_sim.model.simulation import Array, Drive, Samples, run_record
from valve_sim.model.variational import CONTACTS, LANES, STAGES, TILE_RECORD

_PLACES: Final = {name: place for place, name in enumerate(PARAMETERS)}
_FIRST: Final = len(PARAMETERS)
"""Where the numbers of terms begin."""
_BY_FORCE: Final = np.ones(FIRST_CONDITION)
_BY_FORCE[[_PLACES[name] for name in (*CONTACTS, "coil_resistance", "sensor_delay")]] = 0.0
_SHAPES: Final = [_PLACES[name] for name in SHAPES]
_FOREIGN: Final = ("temperature_rate", "sensor_time_constant")
_SWITCHES: Final = (
    *_FOREIGN, "coil_time_constant", "eddy_time_constant", "residual_current", "restitution_stop", "restitution_seat",
)  # fmt: skip
_NO_EVENTS: Final = np.empty(0, EVENT_RECORD)
assert VALVE_RECORD.names is not None
assert VALVE_RECORD.names[: len(PARAMETERS)] == PARAMETERS


@dataclass(frozen=True)
class Tangent:
    """How the model moves with one parameter: derivatives of all that a run is made of to it.

    Attributes:
        numbers: (`NUMBERS`,) of the valve's record, see `numbers_of`.
        command_times: (c,) of the commands' times. command_volts: (c,) of their voltages.
        sample_time: of all sample times: −1 for a clock whose samples are stamped late.
    """

    numbers: Array
    command_times: Array
    command_volts: Array
    sample_time: float = 0.0


def numbers_of(record: Any) -> Array:
    """The numbers of a (1,) VALVE_RECORD that a derivative can be taken to."""
    return np.concatenate([record.view(np.float64)[: len(PARAMETERS)], record["term_parameters"].ravel()])


def has_sensitivities(record: Any, numbers: Array) -> bool:
    """Whether `run_tangents` knows the derivative along a direction of the record's numbers.

    Left to difference quotients are a coil that heats, a slow sensor, and what is off at 0 and works otherwise
    on either side of it.
    """
    if not np.isfinite(numbers).all() or any(record[name][0] != 0.0 for name in _FOREIGN):
        return False
    return not any(numbers[_PLACES[name]] != 0.0 and record[name][0] == 0.0 for name in _SWITCHES)


def rated_slope(record: Any, numbers: Array) -> float:
    """The derivative of `rated_current` along a direction of the record's numbers."""
    voltage, resistance = record["reference_voltage"][0], record["coil_resistance"][0]
    by_voltage, by_resistance = numbers[_PLACES["reference_voltage"]], numbers[_PLACES["coil_resistance"]]
    return float((by_voltage - by_resistance * voltage / resistance) / resistance)


def run_tangents(
    record: Any, state: Any, drive: Drive, samples: Samples, tangents: Sequence[Tangent], tolerance: float
) -> tuple[Array, Array]:
    """Run a trace and its variational equations.

    Args:
        record: (1,) VALVE_RECORD. state: (1,) STATE_RECORD, advanced. drive: the commanded voltage.
        samples: what is written down, as in `run_record`.
        tangents: one for each parameter.
        tolerance: relative error of one step of the plain trace, which the derivatives follow.

    Returns:
        (n, k) of the positions as shown, m over the parameter's unit; (m, k) of the normalised currents.

    Raises:
        SimulationError: the run could not be carried to its end.
    """
    tiles = _tiles(tangents)
    commands = np.zeros((2, len(tiles), len(drive.times), LANES))
    for place, tangent in enumerate(tangents):
        tile, lane = divmod(place, LANES)
        commands[0, tile, :, lane] = tangent.command_times
        commands[1, tile, :, lane] = tangent.command_volts
    slopes = np.zeros(STAGES + 2, SLOPES_RECORD)
    moved = np.unique(np.concatenate([tile["row_number"][: tile["row_count"]] for tile in tiles]))
    asked = np.zeros(FIRST_CONDITION, dtype=np.int64)
    asked[moved] = 1
    slopes["asked"] = asked[_FIRST:].reshape(slopes["asked"].shape[1:])
    slopes["asks_shapes"] = asked[_SHAPES].any()
    outputs = tuple(np.empty((len(times), len(tiles), LANES)) for times in (samples.times, samples.current_times))
    vary = (tiles, slopes, (commands[0], commands[1]), outputs)
    run_record(record, state, drive, samples, _NO_EVENTS, tolerance, vary)
    positions, currents = (output.reshape(len(output), len(tiles) * LANES) for output in outputs)
    return positions[:, : len(tangents)], currents[:, : len(tangents)]


def _tiles(tangents: Sequence[Tangent]) -> Any:
    """Parameters in tiles of lanes."""
    groups = [tangents[first : first + LANES] for first in range(0, len(tangents), LANES)]
    tiles = np.zeros(len(groups), TILE_RECORD)
    for tile, group in zip(tiles, groups, strict=True):
        numbers, count = np.array([tangent.numbers for tangent in group]), len(group)
        rows = np.flatnonzero(np.any(numbers * _BY_FORCE, axis=0))
        tile["row_count"] = len(rows)
        tile["row_number"][: len(rows)] = rows
        tile["row"][: len(rows), :count] = numbers[:, rows].T
        for name in CONTACTS:
            tile[name][:count] = numbers[:, _PLACES[name]]
        tile["current_time"][:count] = [tangent.sample_time for tangent in group]
        tile["position_time"][:count] = tile["current_time"][:count] - numbers[:, _PLACES["sensor_delay"]]
    return tiles
