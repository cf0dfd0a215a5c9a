"""One run of a valve, in pieces if need be, with derivatives of what the sensors show if they are asked for."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from typing import Any, Final, NamedTuple

import numpy as np
from numpy.typing import NDArray

from valve_sim.model.core import layout
from valve_sim.model.core.plan import Plan
from valve_sim.model.core.samples import GAS_COLUMNS, ROW_COLUMNS
from valve_sim.model.drives import Drive
from valve_sim.model.errors import ParameterError
from valve_sim.model.parameters import closest
from valve_sim.model.response import Event, events_of
from valve_sim.model.simulation import EVENT_ROOM, TOLERANCE, check_geometry, check_outcome, most_steps
from valve_sim.model.valve import Valve

Array = NDArray[np.float64]
WIDTHS: Final = (0, 16)
"""Directions in one run: the processor's vectors carry them, and each width is compiled. More directions take turns."""
_MOST: Final = WIDTHS[-1]
NO_TIMES: Final = np.empty(0)


@dataclass(frozen=True)
class Directions:
    """How the input of a run changes with k parameters: its derivatives by them.

    Attributes:
        numbers: (k, m) of the valve's numbers, in the order of `Valve.names`.
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
        known = valve.names
        numbers = np.zeros((len(names), len(known)))
        for row, name in enumerate(names):
            if name not in known:
                raise ParameterError(f"{name}: no such parameter; did you mean {closest(name, known)}?")
            numbers[row, known.index(name)] = 1.0
        nothing = np.zeros((len(names), len(drive.times)))
        return cls(numbers, nothing, nothing, np.zeros(len(names)))

    @classmethod
    def none(cls, commands: int) -> Directions:
        """No direction: a run by the code that carries derivatives, where that is compiled anyway.

        Args:
            commands: of the run, how many.
        """
        return cls(np.empty((0, 0)), np.empty((0, commands)), np.empty((0, commands)), np.empty(0))

    def among(self, commands: Array) -> Directions:
        """These directions for a drive whose commands are mixed with changes of pressure, on the clock of the samples.

        Args:
            commands: (c, `driver.CHANGES`), see `simulation.commands_of`.
        """
        is_voltage = ~np.isnan(commands[:, 1])
        if is_voltage.all():
            return self
        late = self.sample_times[:, None]
        times, volts = np.empty((2, len(late), len(commands)))
        times[:, is_voltage], volts[:, is_voltage] = self.command_times, self.command_volts
        times[:, ~is_voltage], volts[:, ~is_voltage] = late, 0.0
        return Directions(self.numbers, times, volts, self.sample_times)


class Shown(NamedTuple):
    """What a run, or a piece of it, shows.

    Attributes:
        positions: (n,) m, of the pilot plunger as shown. currents: (c,) normalised current u.
        of_positions: (n, k) m over the unit of each parameter. of_currents: (c, k) likewise.
        pressures: (p,) Pa, in the outlet of a valve with gas. of_pressures: (p, k) likewise.
        events: (e, 4) those there was room for: s, number of the kind, m, m/s before it.
    """

    positions: Array
    currents: Array
    of_positions: Array
    of_currents: Array
    events: Array
    pressures: Array
    of_pressures: Array


class _Tile(NamedTuple):
    """The block of a valve, tangents in some of the directions, and the code for both."""

    plan: Plan
    block: Array
    tangents: Array
    own: slice


class Run:
    """A valve that rests closed and without current at first, on its way through a drive.

    Args:
        valve: what is simulated. start: s. tolerance: relative error of one step.
        directions: what derivatives are taken by; None: none are.
        numbers: of the valve, in place of its own.

    Raises:
        SimulationError: the gap is not inside the stroke.
    """

    def __init__(
        self, valve: Valve, start: float, *, tolerance: float = TOLERANCE, directions: Directions | None = None,
        numbers: Array | None = None,
    ) -> None:  # fmt: skip
        self._directions = directions
        own = valve.numbers() if numbers is None else np.ascontiguousarray(numbers)
        count = 0 if directions is None else len(directions.numbers)
        self._count, self._tiles = count, list[_Tile]()
        for first in range(0, max(count, 1), _MOST):
            part = slice(first, min(first + _MOST, count))
            width = 0 if directions is None else _MOST
            tangents = np.zeros((layout.SIZE, width))
            if count and directions is not None:
                used = part.stop - part.start
                tangents[layout.NUMBERS : layout.NUMBERS + len(own), :used] = directions.numbers[part].T
                tangents[layout.LATE, :used] = directions.sample_times[part]
            plan = valve.plan(width)
            block = plan.block(own, tolerance, start, tangents if width else None)
            check_geometry(block)
            self._tiles.append(_Tile(plan, block, tangents if width else block, part))

    def piece(
        self, commands: Array, end: float, times: Array, current_times: Array = NO_TIMES,
        pressure_times: Array = NO_TIMES, *, first: int = 0, room: int = 0,
    ) -> Shown:  # fmt: skip
        """Go on with some commands to a time, s.

        Args:
            commands: (c, `driver.CHANGES`), those up to the end, see `simulation.commands_of`. first: number of the
                first of them among those of the run.
            end: s; where it is the time of the last command, the valve may be another one from there on.
            times: (n,) s, ascending, of positions. current_times, pressure_times: (m,), (p,) s, likewise, of currents
                and of the outlet's pressure. All up to the end, positions as much later as the sensor shows them late.
            room: for so many events.

        Raises:
            SimulationError: the run could not be carried to the end.
        """
        times, commands = np.ascontiguousarray(times), np.ascontiguousarray(commands)
        others, at_currents, at_pressures = _both(current_times, pressure_times)
        shown_of = 2 if self._tiles[0].block[layout.DENSITY] else 1
        positions, seen, events = np.empty(len(times)), np.empty((len(others), shown_of)), np.empty((room, 4))
        slopes, of_seen = np.empty((len(times), self._count)), np.empty((len(others), shown_of, self._count))
        for plan, block, tangents, own in self._tiles:
            width, used = int(block[layout.WIDTH]), own.stop - own.start
            is_whole = used == width == self._count
            shown = slopes if is_whole else np.empty((len(times), width))
            shown_others = of_seen if is_whole else np.empty((len(others), shown_of, width))
            moves = np.zeros((len(commands), 2, width))
            if self._directions is not None:
                those = slice(first, first + len(commands))
                moves[:, 0, :used] = self._directions.command_times[own, those].T
                moves[:, 1, :used] = self._directions.command_volts[own, those].T
            block[[layout.COUNT, layout.SAMPLED, layout.SAMPLED_ROWS]] = 0.0
            outcome = plan.entry("drive")(
                block.ctypes.data, tangents.ctypes.data, commands.ctypes.data, len(commands), end,
                most_steps(end - block[layout.TIME]), times.ctypes.data, len(times), positions.ctypes.data, 1,
                shown.ctypes.data, others.ctypes.data, len(others), seen.ctypes.data, shown_others.ctypes.data,
                moves.ctypes.data, events.ctypes.data, room,
            )  # fmt: skip
            check_outcome(outcome)
            if not is_whole:
                slopes[:, own], of_seen[..., own] = shown[:, :used], shown_others[..., :used]
        found = int(self._tiles[0].block[layout.COUNT])
        return Shown(
            positions, seen[at_currents, 0], slopes, of_seen[at_currents, 0], events[: min(found, room)],
            seen[at_pressures, -1], of_seen[at_pressures, -1],
        )  # fmt: skip

    def rows(self, commands: Array, end: float, times: Array) -> tuple[Array, tuple[Event, ...]]:
        """As `piece`, of a run without derivatives: whole rows (see `samples.ROW_COLUMNS`), and all events."""
        (tile,) = self._tiles
        block, before, room = tile.block.ctypes.data, tile.block.copy(), EVENT_ROOM
        times, commands = np.ascontiguousarray(times), np.ascontiguousarray(commands)
        columns = GAS_COLUMNS if tile.block[layout.DENSITY] else ROW_COLUMNS
        rows = np.empty((len(times), columns))
        while True:
            events = np.empty((room, 4))
            tile.block[[layout.COUNT, layout.SAMPLED, layout.SAMPLED_ROWS]] = 0.0
            outcome = tile.plan.entry("drive")(
                block, block, commands.ctypes.data, len(commands), end, most_steps(end - tile.block[layout.TIME]),
                times.ctypes.data, len(times), rows.ctypes.data, columns, block, block, 0, block, block, block,
                events.ctypes.data, room,
            )  # fmt: skip
            check_outcome(outcome)
            count = int(tile.block[layout.COUNT])
            if count <= room:
                return rows, events_of(events[:count])
            tile.block[:], room = before, count

    def become(self, numbers: Array, slopes: Array | None = None) -> None:
        """Go on with other numbers, from the last command on, with which the last piece has ended.

        Args:
            numbers: (m,) of the valve. slopes: (k, m) derivatives of these.
        """
        values = np.ascontiguousarray(numbers)
        for plan, block, tangents, own in self._tiles:
            moved = np.zeros((len(values), int(block[layout.WIDTH])))
            if slopes is not None:
                moved[:, : own.stop - own.start] = slopes[own].T
            plan.entry("renumber")(block.ctypes.data, tangents.ctypes.data, values.ctypes.data, moved.ctypes.data)


def _both(currents: Array, pressures: Array) -> tuple[Array, Any, Any]:
    """The times of currents and pressures together, s, ascending, and where each of them stand among these."""
    whole, none = slice(None), slice(0, 0)
    if not len(pressures):
        return np.ascontiguousarray(currents), whole, none
    if not len(currents):
        return np.ascontiguousarray(pressures), none, whole
    both = np.union1d(currents, pressures)
    return both, np.searchsorted(both, currents), np.searchsorted(both, pressures)
