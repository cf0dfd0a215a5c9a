"""A valve that is stepped live, by the same integrator as a whole run, and equal to it to the last bit."""

from __future__ import annotations

import functools
import math
from typing import Final

import numpy as np
from numpy.typing import NDArray

from valve_sim.model.core import layout
from valve_sim.model.core.driver import LIVE_EVENTS
from valve_sim.model.core.gas import PREFIX
from valve_sim.model.core.plan import Plan
from valve_sim.model.core.samples import GAS_COLUMNS, ROW_COLUMNS
from valve_sim.model.core_types import Phase
from valve_sim.model.response import Event, events_of
from valve_sim.model.simulation import check_geometry, check_outcome
from valve_sim.model.valve import Valve

Array = NDArray[np.float64]
_EVENTS_AT: Final = layout.SIZE + GAS_COLUMNS


class Live:
    """The block of a valve that is stepped, with its row of output, its events, and the functions bound to it.

    Args:
        plan: of the valve. block: (layout.SIZE,), copied.

    Attributes:
        block: parameters and state of the valve, see `layout`.
        row: the last reading, see `samples.ROW_COLUMNS`; positions are not delayed.
        advance: steps to a time, s, fills `row` and returns an Outcome, 0 if all is well.
    """

    def __init__(self, plan: Plan, block: Array) -> None:
        self.plan = plan
        self._memory = np.zeros(_EVENTS_AT + 4 * LIVE_EVENTS)
        self._memory[: layout.SIZE] = block
        columns = GAS_COLUMNS if block[layout.DENSITY] else ROW_COLUMNS
        self.block, self.row = self._memory[: layout.SIZE], self._memory[layout.SIZE : layout.SIZE + columns]
        self._events = self._memory[_EVENTS_AT:].reshape(LIVE_EVENTS, 4)
        address = self._memory.ctypes.data
        bound = [functools.partial(plan.entry(name), address) for name in ("advance", "command", "halt")]
        self.advance, self._command, self._halt = bound

    @classmethod
    def at_rest(cls, valve: Valve, time: float, tolerance: float) -> Live:
        """A valve that rests closed and without current at a time, s.

        Raises:
            SimulationError: the gap is not inside the stroke.
        """
        plan = valve.plan()
        block = plan.block(valve.numbers(), tolerance, time)
        check_geometry(block)
        return cls(plan, block)

    @property
    def reached(self) -> float:
        """The time of the state, s."""
        return float(self.block[layout.TIME])

    @property
    def delay(self) -> float:
        """Delay of the position sensor, s."""
        return float(self.block[layout.DELAY])

    def copy(self) -> Live:
        """A copy of this valve in this state, which is then stepped independently."""
        return Live(self.plan, self.block)

    def step(self, time: float, *, commit: bool) -> tuple[Event, ...]:
        """Step to a time, s, and read the valve there; the events on the way, mostly none.

        Args:
            time: s. commit: whether to stop exactly there, or at the last whole step.

        Raises:
            SimulationError: the step could not be carried to its end.
        """
        if commit:
            check_outcome(self._halt(time))
        outcome = self.advance(time)
        if outcome:
            check_outcome(outcome)
        return self._taken_events() if self.block[layout.COUNT] else ()

    def command(self, volts: float) -> None:
        """A voltage in force from the state's time on; reads the valve there.

        Raises:
            SimulationError: the step could not be carried to its end.
        """
        check_outcome(self._command(self.reached, volts))

    def supply(self, tank: float = math.nan, demand: float = math.nan) -> None:
        """Pressures of the tank, and behind the demand, Pa, from the state's time on; NaN: as before. Of a gas."""
        change = np.array([tank, 0.0, demand])
        self.plan.entry("set_pressures")(self._memory.ctypes.data, change.ctypes.data)

    def _taken_events(self) -> tuple[Event, ...]:
        count = min(int(self.block[layout.COUNT]), LIVE_EVENTS)
        self.block[layout.COUNT] = 0.0
        return events_of(self._events[:count])

    def as_valve(self, valve: Valve, tolerance: float) -> Live:
        """This state, stepped on as another valve.

        Position, velocity, currents and the outlet's pressure go on. Exceptions: plungers beyond a stop that moved
        inwards are put at the new stop; a coil without inductance takes its new current.

        Raises:
            SimulationError: the gap is not inside the stroke.
        """
        plan, before = valve.plan(), self.block
        block = plan.block(valve.numbers(), tolerance, self.reached)
        check_geometry(block)
        check_outcome(self.advance(self.reached))
        if before[layout.DENSITY]:
            self._go_on_with_gas(plan, block)
        for slot in _KEPT:
            block[slot] = before[slot]
        block[layout.COUNT] = before[layout.COUNT]
        held = dict(zip(self.plan.states, before[layout.COIL :].tolist(), strict=False))
        current = float(self.row[7])
        states = {
            "u": current, "w": held.get("w", current), "temperature": held.get("temperature", 0.0),
            "density": float(block[int(block[layout.DENSITY])]),
        }  # fmt: skip
        for place, name in enumerate(plan.states):
            block[layout.COIL + place] = states[name]
        if not before[layout.SENSOR_LAG]:
            lifted = before[layout.MODE] >= Phase.MAIN
            block[layout.SHOWN_PILOT] = before[layout.X]
            block[layout.SHOWN_MAIN] = before[layout.X] - before[layout.GAP] if lifted else 0.0
        block[layout.PEAK] = max(block[layout.PEAK], abs(current))
        plan.entry("settle")(block.ctypes.data)
        found = Live(plan, block)
        found._events[:] = self._events
        return found

    def _go_on_with_gas(self, plan: Plan, block: Array) -> None:
        """Put the outlet's pressure, and those at both ends unless others are declared, into the block of a valve."""
        before = self.block
        outlet, at = float(self.row[ROW_COLUMNS]), layout.NUMBERS + plan.parameters.index(f"{PREFIX}outlet_pressure")
        same = [plan.parameters.index(f"{PREFIX}{name}") for name in ("gas_constant", "covolume", "inlet_temperature")]
        there = [self.plan.parameters.index(plan.parameters[place]) for place in same]
        numbers = block[layout.NUMBERS : layout.NUMBERS + len(plan.parameters)].copy()
        numbers[at - layout.NUMBERS] = outlet
        block[:] = plan.block(numbers, float(block[layout.TOLERANCE]), self.reached)
        if (before[layout.NUMBERS + np.array(there)] == numbers[same]).all():
            block[int(block[layout.DENSITY])] = before[int(before[layout.DENSITY])]
        if block[layout.DECLARED_TANK] == before[layout.DECLARED_TANK]:
            own = slice(layout.TANK, layout.TANK_TIME + 1)
            block[own] = before[own]
        if block[layout.DECLARED_DEMAND] == before[layout.DECLARED_DEMAND]:
            block[layout.DEMAND] = before[layout.DEMAND]
        for slot in (layout.REGIME, layout.CHANGED, layout.GAS_STEP):
            block[slot] = before[slot]


_KEPT: Final = (
    layout.TIME, layout.X, layout.V, layout.MODE, layout.MOVING, layout.DIRECTION, layout.UNSEATED_TIME, layout.VOLTS,
    layout.PATH, layout.PEAK, layout.SHOWN_PILOT, layout.SHOWN_MAIN,
)  # fmt: skip
"""Slots that go over to another valve."""
