"""A machine, compiled: runs of it on arrays."""

from __future__ import annotations

import ctypes
from collections.abc import Mapping, Sequence
from typing import Final, NamedTuple

import numpy as np
from numpy.typing import NDArray

from valve_sim.model.core import machine
from valve_sim.model.core.hybrid import driver
from valve_sim.model.core.hybrid import layout as at
from valve_sim.model.core.hybrid.kernels import Kernels
from valve_sim.model.core.hybrid.system import System
from valve_sim.model.core.lowering import lowered

Array = NDArray[np.float64]
TOLERANCE: Final = 1e-9
"""Relative error of a step, of the largest size that a state has had so far."""
FEW_EVENTS: Final = 64


class Run(NamedTuple):
    """What a run leaves behind.

    Attributes:
        outcome: of `driver`. time: s, that it came to. steps: that it took.
        outputs: (n, outputs). slopes: (n, outputs, directions). events: (e, 3) s, transition, and which of its cases.
    """

    outcome: int
    time: float
    steps: int
    outputs: Array
    slopes: Array
    events: Array


class Changes:
    """When inputs change, and how, at an address that compiled code is told.

    Args:
        rows: (k, 1 + 2 inputs) s, and from then on a value and a slope of each input; the first is of the start.
        moves: (k, 1 + inputs, directions) derivatives of the times, and of the values; None: they are known.
    """

    def __init__(self, rows: Array, moves: Array | None = None) -> None:
        self.rows = np.ascontiguousarray(rows, dtype=np.float64)
        self.moves, self.has_moves = (self.rows, 0) if moves is None else (np.ascontiguousarray(moves), 1)
        self.address, self.count = self.rows.ctypes.data, len(self.rows)
        self.has_slopes = bool(np.any(self.rows[:, 2::2]))


NO_CHANGES: Final = Changes(np.empty((0, 1)))


class Room:
    """Memory of one run at a time: a block, its tangents, and so many events; later ones are not told."""

    def __init__(self, width: int, events: int) -> None:
        self.block, self.tangents = np.zeros(at.SIZE), np.zeros((at.SIZE, width))
        self.events = np.empty((events, driver.EVENT))
        self.addresses = [own.ctypes.data for own in (self.block, self.tangents, self.events)]


class Compiled:
    """The kernels of a machine with so many directions of derivatives.

    Args:
        system: what follows from its description. free: names of parameters that derivatives are taken to.
        width: directions of derivatives; 0 for none.
    """

    def __init__(self, system: System, free: Sequence[str], width: int) -> None:
        kernels = Kernels(system, free, width)
        self.width, self._system, self.outputs = width, system, len(system.outputs)
        self._slots, self._rooms = kernels.slots, list[Room]()
        self._library = machine.library(f"hybrid {system.digest} {free} {width}", kernels.text, machine.WELL)
        self._blank = self._made()

    def _made(self) -> Array:
        """The block of a machine at rest at 0, with all numbers 0."""
        blank, system, description = np.zeros(at.SIZE), self._system, self._system.description
        named = {"at": at.AT, "look": at.LOOK, "enter": at.ENTER, "row": at.ROW}
        named |= {f"jump{k}": at.JUMP + k for k in range(len(description.transitions))}
        for g, group in enumerate(system.groups):
            named[f"move{2 * g}"] = at.MOVE + 2 * g
            if group.flow.shares:
                named[f"move{2 * g + 1}"] = at.MOVE + 2 * g + 1
            else:  # what slides there is nothing that moves
                blank.view(np.int64)[at.MOVE + 2 * g + 1] = self._library.address(f"move{2 * g}")
        for name, slot in named.items():
            blank.view(np.int64)[slot] = self._library.address(name)
        for slot, count in (
            (at.STATES, len(description.states)), (at.INPUTS, len(description.inputs)),
            (at.OUTPUTS, len(description.outputs)), (at.SWITCHES, len(system.switches)),
            (at.SLIDERS, len(system.sliders)), (at.WIDTH, self.width), (at.IS_CHECKED, len(system.checked)),
        ):  # fmt: skip
            blank[slot] = count
        for i, name in enumerate(description.states):
            blank[at.CHECKED + i] = name in system.checked
        for j, switch in enumerate(system.switches):
            blank[at.SLIDER_OF + j] = system.sliders.index(j) if j in system.sliders else -1
            is_state = switch.op == "state"
            blank[at.SNAP + j] = description.states.index(str(switch.payload)) if is_state else -1
        blank[at.SWITCH_OF : at.SWITCH_OF + len(system.sliders)] = system.sliders
        for name, value in description.held.items():
            blank[self._slots[name]] = value
        return blank[: at.COPIED]

    def run(
        self, states: Array, numbers: Array, directions: Sequence[Mapping[str, float]], changes: Changes, times: Array,
        most: int, tolerance: float,
    ) -> Run:  # fmt: skip
        """Run a machine from its start to the last of some times.

        Args:
            states, numbers: at the start, SI, in their order; the numbers are the parameters.
            directions: at most `width`, each by how much states at the start and parameters change, by name.
            changes: of the inputs. times: (n,) s, ascending, none before the start. most: steps that it may take.
            tolerance: relative error of a step, of the largest size that a state has had so far.
        """
        try:
            room = self._rooms.pop()
        except IndexError:
            room = Room(self.width, FEW_EVENTS)
        self.begin(room, states, numbers, changes, tolerance)
        if self.width:
            room.tangents[: at.COPIED] = 0.0
            for column, direction in enumerate(directions):
                for name, by in direction.items():
                    room.tangents[self._slots[name], column] = by
        found = self.advance(room, changes, times, most)
        if room.block[at.EVENTS] > len(room.events):  # more than ever before: once more, with room for them
            self._rooms.append(Room(self.width, 2 * int(room.block[at.EVENTS])))
            return self.run(states, numbers, directions, changes, times, most, tolerance)
        self._rooms.append(room)
        if len(directions) < self.width:
            return found._replace(slopes=found.slopes[:, :, : len(directions)])
        return found

    def begin(self, room: Room, states: Array, numbers: Array, changes: Changes, tolerance: float) -> None:
        """Make the block of a room that of a machine at its start; arguments: see `run`."""
        block = room.block
        block[: at.COPIED] = self._blank
        block[at.STATE : at.STATE + len(states)] = states
        block[at.PEAK : at.PEAK + len(states)] = np.abs(states)
        block[at.NUMBERS : at.NUMBERS + len(numbers)] = numbers
        block[at.TIME], block[at.TOLERANCE] = changes.rows[0, 0], tolerance
        block[at.IS_STRAIGHT] = changes.has_slopes

    def advance(self, room: Room, changes: Changes, times: Array, most: int) -> Run:
        """Run a machine that has begun on to the last of some times, with the changes of inputs on the way.

        With inputs that hold it is the same run to the last bit, in whatever pieces. Arguments: see `run`.
        """
        block, count = room.block, len(times)
        block[at.SAMPLED] = block[at.EVENTS] = block[at.TAKEN] = 0.0
        rows, slopes = np.empty((count, self.outputs)), np.empty((count, self.outputs, self.width))
        outcome = _drive()(
            *room.addresses[:2], changes.address, changes.count, changes.moves.ctypes.data, changes.has_moves,
            times[-1], most, times.ctypes.data, count, rows.ctypes.data, slopes.ctypes.data, room.addresses[2],
            len(room.events),
        )  # fmt: skip
        events = room.events[: int(block[at.EVENTS])].copy()
        return Run(outcome, float(block[at.TIME]), int(block[at.TAKEN]), rows, slopes, events)


@machine.made_once
def _loaded() -> machine.Library:
    return machine.library("hybrid driver", lambda: lowered(driver.FUNCTIONS, ("drive",)))


@machine.made_once
def _drive():  # type: ignore[no-untyped-def]
    pointer, integer, double = ctypes.c_void_p, ctypes.c_int64, ctypes.c_double
    arguments = (
        pointer, pointer, pointer, integer, pointer, integer, double, double, pointer, integer, pointer, pointer,
        pointer, integer,
    )  # fmt: skip
    return ctypes.CFUNCTYPE(integer, *arguments)(_loaded().address("drive"))
