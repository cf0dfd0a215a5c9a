"""Derivatives of what the sensors show by parameters of the valve, its commands and its clocks, in one run."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from typing import Final, NamedTuple

import numpy as np
from numpy.typing import ArrayLike, NDArray

from valve_sim.core import layout
from valve_sim.core.plan import entry
from valve_sim.core.simulation import TOLERANCE, check_geometry, check_outcome, commands_of, most_steps, start_of
from valve_sim.core.valve import Valve
from valve_sim.model.drives import Drive
from valve_sim.model.errors import ParameterError
from valve_sim.model.parameters import closest

Array = NDArray[np.float64]
_FEW: Final = 4
_LANES: Final = 8
"""Directions are carried by the processor's vectors: four, or a multiple of eight."""


@dataclass(frozen=True)
class Directions:
    """How the input of a run changes with k parameters: its derivatives by them.

    Attributes:
        numbers: (k, m) of the valve's numbers, in the order of `Valve.plan().parameters`.
        command_times: (k, c) of the commands' times. command_volts: (k, c) of their voltages.
        sample_times: (k,) of all sample times: −1 for a clock whose samples are stamped late.
    """

    numbers: Array
    command_times: Array
    command_volts: Array
    sample_times: Array

    @classmethod
    def of(cls, valve: Valve, drive: Drive, names: Sequence[str]) -> Directions:
        """The directions of single parameters, "pilot_damping" or "coulomb_friction.force".

        Raises:
            ParameterError: the valve has no such parameter.
        """
        known = valve.plan().parameters
        numbers = np.zeros((len(names), len(known)))
        for row, name in enumerate(names):
            if name not in known:
                raise ParameterError(f"{name}: no such parameter; did you mean {closest(name, known)}?")
            numbers[row, known.index(name)] = 1.0
        nothing = np.zeros((len(names), len(drive.times)))
        return cls(numbers, nothing, nothing, np.zeros(len(names)))


class Sloped(NamedTuple):
    """A run with its derivatives.

    Attributes:
        positions: (n,) m, of the pilot plunger as shown. currents: (n,) normalised current u.
        of_positions: (n, k) m over the unit of each parameter. of_currents: (n, k) likewise.
    """

    positions: Array
    currents: Array
    of_positions: Array
    of_currents: Array


def run_sloped(
    valve: Valve,
    drive: Drive,
    sample_times: ArrayLike,
    directions: Directions,
    *,
    tolerance: float = TOLERANCE,
    with_currents: bool = False,
) -> Sloped:
    """A run from rest and its derivatives along k directions.

    Args:
        valve: what is simulated. drive: the commanded voltage. sample_times: (n,) s, ascending.
        directions: what the derivatives are taken by. tolerance: relative error of one step.
        with_currents: whether the current is asked for; its arrays are empty otherwise.

    Raises:
        SimulationError: the run could not be carried to its end.
    """
    count = len(directions.numbers)
    width = _FEW if count <= _FEW else -(-count // _LANES) * _LANES
    known = valve.plan().parameters
    free = tuple(name for name, column in zip(known, directions.numbers.T, strict=True) if column.any())
    plan, times = valve.plan(free, width), np.ascontiguousarray(sample_times, dtype=np.float64)
    tangents = np.zeros((layout.SIZE, width))
    tangents[layout.NUMBERS : layout.NUMBERS + len(known), :count] = directions.numbers.T
    tangents[layout.LATE, :count] = directions.sample_times
    moves = np.zeros((len(drive.times), 2, width))
    moves[:, 0, :count], moves[:, 1, :count] = directions.command_times.T, directions.command_volts.T
    columns = 2 if with_currents else 1
    rows, slopes = np.empty((len(times), columns)), np.empty((len(times), columns, width))
    block = plan.block(valve.numbers(), tolerance, start_of(drive, times), tangents)
    check_geometry(block)
    commands = commands_of(drive)
    end = float(times[-1]) if len(times) else -np.inf
    outcome = entry("drive")(
        block.ctypes.data, tangents.ctypes.data, commands.ctypes.data, len(commands), end,
        most_steps(end - block[layout.TIME]), times.ctypes.data, len(times), rows.ctypes.data, columns,
        slopes.ctypes.data, moves.ctypes.data, block.ctypes.data, 0,
    )  # fmt: skip
    check_outcome(outcome)
    shown = slopes[:, :, :count]
    return Sloped(rows[:, 0], rows[:, 1:].ravel(), shown[:, 0], shown[:, 1:].reshape(-1, count))
