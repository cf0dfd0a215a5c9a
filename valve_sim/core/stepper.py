"""A valve stepped in real time, by the same integrator as a whole run, and equal to it to the last bit."""

from __future__ import annotations

from collections import deque
from collections.abc import Callable
from typing import Final, NamedTuple

import numpy as np
from numpy.typing import NDArray

from valve_sim.core import layout
from valve_sim.core.driver import LIVE_EVENTS, ROW_COLUMNS
from valve_sim.core.entries import ENTRIES
from valve_sim.core.plan import Plan, entry, method
from valve_sim.core.simulation import TOLERANCE, check_geometry, check_outcome
from valve_sim.core.valve import Valve
from valve_sim.model.core_types import EventKind, Phase
from valve_sim.model.response import Event

Array = NDArray[np.float64]
_KINDS: Final = tuple(EventKind)
_PHASES: Final = tuple(Phase)
_EVENTS_AT: Final = layout.SIZE + ROW_COLUMNS


class Reading(NamedTuple):
    """A valve at one time: m, m/s, A, N, V; `main_effort` is the spring's force on the main plunger (− closes)."""

    time: float
    pilot_position: float
    main_position: float
    pilot_velocity: float
    main_velocity: float
    coil_current: float
    attraction: float
    main_effort: float
    phase: Phase
    events: tuple[Event, ...]
    coil_voltage: float


class _Live:
    """The block of a valve that is stepped, with its row of output and its events, and functions bound to it.

    Args:
        plan: of the valve. block: (layout.SIZE,).
    """

    def __init__(self, plan: Plan, block: Array) -> None:
        self.plan = plan
        self.memory = np.zeros(_EVENTS_AT + 4 * LIVE_EVENTS)
        self.memory[: layout.SIZE] = block
        self.block, self.row = self.memory[: layout.SIZE], self.memory[layout.SIZE : _EVENTS_AT]
        self.events = self.memory[_EVENTS_AT:].reshape(LIVE_EVENTS, 4)
        address = self.memory.ctypes.data
        self.advance, self.command, self.halt = (method(name).bound(address) for name in ENTRIES)

    def copy(self) -> _Live:
        """Another one in the same state."""
        return _Live(self.plan, self.block)

    def taken_events(self) -> tuple[Event, ...]:
        """The events since the last time they were taken."""
        count = min(int(self.block[layout.COUNT]), LIVE_EVENTS)
        self.block[layout.COUNT] = 0.0
        return tuple([Event(t, _KINDS[int(kind)], x, v) for t, kind, x, v in self.events[:count].tolist()])


_Change = Callable[[_Live], _Live]


class Stepper:
    """A valve stepped in real time; its state does not depend on when it was looked at.

    Args:
        valve: what is stepped.
        start_time: s; the valve rests closed and without current until then.
        tolerance: relative error of one step.

    Attributes:
        step: the raw entry: steps to a time, s, fills `row` and returns an Outcome, 0 if all is well; a tenth of the
            time that `advance` takes. It is another one after `set_valve` and `reset`.
    """

    def __init__(self, valve: Valve, start_time: float = 0.0, *, tolerance: float = TOLERANCE) -> None:
        self._tolerance, self._valve = tolerance, valve
        self.reset(start_time)

    @property
    def valve(self) -> Valve:
        """What is stepped."""
        return self._valve

    @property
    def row(self) -> Array:
        """What the raw entry read: `driver.ROW_COLUMNS` numbers, see `driver.run`; positions not late."""
        return self._live.row

    @property
    def volts(self) -> float:
        """The voltage in force, V."""
        return float(self._live.block[layout.VOLTS])

    def reset(self, time: float) -> None:
        """Rest closed and without current at a time, s."""
        plan = self._valve.plan()
        block = plan.block(self._valve.numbers(), self._tolerance, time)
        check_geometry(block)
        self._become(_Live(plan, block))
        self._late, self._changes = self._live.copy(), deque[tuple[float, _Change]]()
        self._shown_until = time
        self._pending: tuple[Event, ...] = ()

    def _become(self, live: _Live) -> None:
        self._live, self.step = live, live.advance
        self._delay = float(live.block[layout.DELAY])
        parameters = self._valve.parameters
        self._preload, self._rate = parameters.spring_preload, parameters.spring_rate

    def command(self, time: float, volts: float) -> None:
        """A voltage in force from `time`, s, on; a time that is past takes effect at the state's.

        Raises:
            SimulationError: the step could not be carried to its end.
        """
        time = max(time, float(self._live.block[layout.TIME]))

        def change(live: _Live) -> _Live:
            check_outcome(live.command(time, volts))
            return live

        self._changed(time, change)

    def _changed(self, time: float, change: _Change) -> None:
        """Change the valve; a late sensor shows it later."""
        self._pending += self._live.taken_events()
        self._become(change(self._live))
        if self._delay:
            self._changes.append((time, change))

    def advance(self, time: float) -> Reading:
        """Step to `time`, s (not before the last command), and read the valve there.

        Raises:
            SimulationError: the step could not be carried to its end.
        """
        live = self._live
        check_outcome(live.advance(time))
        pilot, main, velocity, attraction, number, x, volts, _, current = live.row.tolist()
        phase = _PHASES[int(number)]
        if self._delay:
            pilot, main = self._delayed(time)
        events = self._pending
        if live.block[layout.COUNT] or events:
            events += live.taken_events()
            self._pending = ()
        lifted = phase >= Phase.MAIN
        moves = phase is Phase.MAIN or live.block[layout.BEYOND] > 0.0
        return Reading(
            time, pilot, main, velocity, velocity if moves else 0.0, current, attraction,
            -(self._preload + self._rate * x) if lifted else 0.0, phase, events, volts,
        )  # fmt: skip

    def _delayed(self, time: float) -> tuple[float, float]:
        """The positions as a late sensor shows them at a time, s: a second state follows the first by the delay.

        Where a delay grew, they stand still until it has caught up.
        """
        self._shown_until = until = max(time - self._delay, self._shown_until)
        while self._changes and self._changes[0][0] <= until:
            _, change = self._changes.popleft()
            self._late = change(self._late)
        late = self._late
        check_outcome(late.advance(until))
        late.block[layout.COUNT] = 0.0
        return float(late.row[0]), float(late.row[1])

    def set_valve(self, valve: Valve, time: float) -> None:
        """Continue as another valve from `time`, s, on, without a jump in its state, and a late sensor with it.

        Position, velocity and currents go on. Exceptions: plungers beyond a stop that moved inwards are put at the new
        stop; a coil without inductance takes its new current. What only scales a reading shows at once.

        Raises:
            SimulationError: the gap is not inside the stroke; nothing has changed.
        """
        time = max(time, float(self._live.block[layout.TIME]))
        plan = valve.plan()
        blank = plan.block(valve.numbers(), self._tolerance, time)
        check_geometry(blank)

        def change(live: _Live) -> _Live:
            check_outcome(live.halt(time))
            return _Live(plan, _carried(live, plan, blank.copy()))

        was_late = self._delay > 0.0
        self._valve = valve
        self._changed(time, change)
        if not (was_late and self._delay):
            self._changes.clear()
            self._late, self._shown_until = self._live.copy(), time - self._delay
        self._pending += self._live.taken_events()


_KEPT: Final = (
    layout.TIME, layout.X, layout.V, layout.MODE, layout.MOVING, layout.DIRECTION, layout.UNSEATED_TIME, layout.VOLTS,
    layout.PATH, layout.PEAK, layout.SHOWN_PILOT, layout.SHOWN_MAIN,
)  # fmt: skip
"""Slots that go over to another valve."""


def _carried(live: _Live, plan: Plan, block: Array) -> Array:
    """The block of another valve in the state of a live one, as far as it can be."""
    before, row = live.block, live.row
    check_outcome(live.advance(float(before[layout.TIME])))
    for slot in _KEPT:
        block[slot] = before[slot]
    block[layout.COUNT] = 0.0
    held = dict(zip(live.plan.states, before[layout.COIL :], strict=False))
    current = float(row[7])
    states = {"u": current, "w": held.get("w", current), "temperature": held.get("temperature", 0.0)}
    for place, name in enumerate(plan.states):
        block[layout.COIL + place] = states[name]
    if not before[layout.SENSOR_LAG]:
        lifted = before[layout.MODE] >= Phase.MAIN
        block[layout.SHOWN_PILOT] = before[layout.X]
        block[layout.SHOWN_MAIN] = before[layout.X] - before[layout.GAP] if lifted else 0.0
    block[layout.PEAK] = max(block[layout.PEAK], abs(current))
    address = block.ctypes.data
    entry("settle")(address)
    return block
