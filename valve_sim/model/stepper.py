"""A valve stepped in real time, by the same compiled core as a whole trace."""

from __future__ import annotations

import math
from collections.abc import Callable
from typing import Any, Final, NamedTuple

import numpy as np

from valve_sim.model import driver
from valve_sim.model.core_types import STATE_RECORD, Phase
from valve_sim.model.gas.boundary import set_demand, set_inlet
from valve_sim.model.gas.record import is_of_gas
from valve_sim.model.response import Event, event_log, event_tuple
from valve_sim.model.simulation import (
    TOLERANCE,
    Valve,
    check_flux,
    check_outcome,
    columns_of,
    most_steps,
    new_states,
    rated_current,
)
from valve_sim.model.transitions import set_voltage, settle

_PHASES: Final = tuple(Phase)
_MAIN: Final = Phase.MAIN
Setter = Callable[[Any, Any, float], None]
"""Changes a valve's state at its time, given its record and a value."""


class CoilReading(NamedTuple):
    """What is measured at the coil's terminals at one time: s, A, V."""

    time: float
    current: float
    voltage: float


class Reading(NamedTuple):
    """A valve at one time: m, m/s, A, N, V; `main_effort` is the spring's force on the main plunger (− closes).

    Outlet pressure, Pa, and mass flow, kg/s, are NaN for a valve without gas.
    """

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
    coil_voltage: float = math.nan
    outlet_pressure: float = math.nan
    mass_flow: float = math.nan


def reading_at_rest(valve: Valve, time: float) -> Reading | None:
    """What a stepper reads of a valve that nobody has commanded since its start, without compiled code; `time` in s.

    None where this does not go without saying: gas flows, and effects may push a plunger.
    """
    if valve.effects or valve.gas is not None:
        return None
    return Reading(time, *(0.0,) * 7, Phase.CLOSED, (), 0.0)


class _State:
    """A valve's state as it is stepped: to look up one of its fields takes longer than to read it."""

    def __init__(self, array: Any) -> None:
        self.array = array
        self.time = array["time"]

    @property
    def reached(self) -> float:
        """The time of the state, s."""
        return float(self.time.item())


class Stepper:
    """A valve stepped in real time, by the same compiled core; its state does not depend on the size of the steps.

    A step a millisecond finds the processor's caches filled by others, and then each of NumPy's functions costs ten
    times what it costs in a loop. So what does not change from step to step is read off the records once.

    Args:
        valve: what is stepped.
        start_time: s; the valve rests closed and without current until then.
        tolerance: relative error of one step.
    """

    def __init__(self, valve: Valve, start_time: float = 0.0, *, tolerance: float = TOLERANCE) -> None:
        self._tolerance = tolerance
        self._log = (event_log(), 0)
        self._pending: list[Event] = []
        self._times, self._current = np.empty(1), np.empty(1)
        record = valve.record()
        check_flux(record)
        self._become(valve, record)
        self._commands: list[tuple[float, Setter, float]] = []
        self.reset(start_time)

    @property
    def valve(self) -> Valve:
        """What is stepped."""
        return self._valve

    @property
    def volts(self) -> float:
        """The voltage in force, V."""
        return self._volts

    def reset(self, time: float) -> None:
        """Rest closed and without current at `time`, s."""
        self._follow(new_states(self._record, time))
        self._volts = 0.0
        self._commands = []
        self._pending = []

    def command(self, time: float, volts: float) -> tuple[CoilReading, CoilReading]:
        """A voltage in force from `time` on; a time that is past takes effect at the latest time stepped to.

        Returns:
            the coil just before and just after.
        """
        time = self._commit(time)
        before = self._coil(time)
        self._set(time, set_voltage, volts)
        self._volts = float(volts)
        self._step_to(time, commit=False)
        return before, self._coil(time)

    def supply(self, time: float, pressure: float) -> None:
        """The tank's pressure, Pa, from `time` on, likewise; of a valve with gas."""
        self._set(self._commit(time), _set_inlet, pressure)

    def set_demand_pressure(self, time: float, pressure: float) -> None:
        """The pressure behind the demand's orifice, Pa, from `time` on, likewise; of a valve with gas."""
        self._set(self._commit(time), set_demand, pressure)

    def _commit(self, time: float) -> float:
        """Step exactly to a time, or to the latest time stepped to; returns which, s."""
        time = max(time, self._state.reached)
        self._step_to(time, commit=True)
        return time

    def _set(self, time: float, setter: Setter, value: float) -> None:
        setter(self._record, self._state.array, value)
        if self._delay:
            self._commands.append((time, setter, value))

    def advance(self, time: float) -> Reading:
        """Step to `time`, s (not before the last command), and read the valve there.

        Raises:
            SimulationError: the step could not be carried to its end.
        """
        self._step_to(time, commit=False)
        pilot, main, velocity, attraction, number, x, volts, *of_gas = self._shown_row.tolist()
        phase = _PHASES[int(number)]
        if self._delay:
            pilot, main = self._delayed(time - self._delay)
        effort = -(self._preload + self._rate * x) if phase >= _MAIN else 0.0
        events: tuple[Event, ...] = ()
        if self._pending:
            events, self._pending = tuple(self._pending), []
        return Reading(
            time, pilot, main, velocity, velocity if phase is _MAIN else 0.0, self._current.item() * self._rated,
            attraction, effort, phase, events, volts, *of_gas,
        )  # fmt: skip

    def set_valve(self, valve: Valve, time: float) -> None:
        """Continue as another valve from `time` on, without a jump in position, velocity or current.

        The only exception is geometry: plungers beyond a stop that moved inwards are put at the new stop.
        """
        record = valve.record()
        check_flux(record)
        self._commit(time)
        set_voltage(self._record, self._state.array, self._volts)  # the current so far belongs to the old coil
        state = _state_of(record, self._state.array, self._record)
        self._become(valve, record)
        settle(record, state)
        self._follow(state)
        self._commands = []

    def _become(self, valve: Valve, record: Any) -> None:
        """Take over a valve, and what each reading needs of its record."""
        self._valve = valve
        self._record = record
        self._row = np.empty((1, columns_of(record)))
        self._shown_row = self._row[0]
        self._samples = (self._times, self._row, self._times, self._current)
        self._rated = rated_current(record)
        self._delay, self._preload, self._rate = (
            float(record[0][name]) for name in ("sensor_delay", "spring_preload", "spring_rate")
        )

    def _follow(self, state: Any) -> None:
        """Step this state from now on; a late sensor shows a copy of it."""
        self._state, self._shown = _State(state), _State(state.copy())

    def _coil(self, time: float) -> CoilReading:
        """The coil as it was shown last."""
        return CoilReading(time, self._current.item() * self._rated, float(self._row[0, 6]))

    def _step_to(self, time: float, *, commit: bool) -> None:
        """Step the valve, and note its events."""
        count = self._go(self._state, time, commit)
        if count:
            events, _ = self._log
            self._pending.extend(event_tuple(events, min(count, len(events))))

    def _go(self, state: _State, time: float, commit: bool) -> int:
        """Step a state, and show it; how many events there were."""
        self._times[0] = time
        control = (self._tolerance, most_steps(time - state.time.item()), True)
        _, count, outcome = driver.run(
            self._record, state.array, (time, commit), self._samples, self._log, control, None
        )
        if outcome:
            check_outcome(outcome)
        return count  # type: ignore[no-any-return]

    def _delayed(self, time: float) -> tuple[float, float]:
        """The positions as a late sensor shows them: a second state follows the first by the delay."""
        shown = self._shown
        time = max(time, shown.reached)
        while self._commands and self._commands[0][0] <= time:
            command_time, setter, value = self._commands.pop(0)
            self._go(shown, max(command_time, shown.reached), True)
            setter(self._record, shown.array, value)
        self._go(shown, time, False)
        return float(self._row[0, 0]), float(self._row[0, 1])


def _set_inlet(record: Any, state: Any, pressure: float) -> None:
    set_inlet(record, state, pressure, 0.0)


def _state_of(record: Any, state: Any, before: Any) -> Any:
    """A state with what another valve's record asks for: gas as declared where there was none, or no gas.

    Args:
        record: of the other valve; where it declares another pressure than before, that one counts from now on.
        state: of the valve so far. before: its record.
    """
    following = new_states(record, float(state[0]["time"]))
    if following.dtype != state.dtype:
        for name in STATE_RECORD.names or ():
            following[name] = state[name]
        return following
    if is_of_gas(record):
        for name, setter in (("inlet_pressure", _set_inlet), ("demand_pressure", set_demand)):
            if record[0][name] != before[0][name]:
                setter(record, state, float(record[0][name]))
    return state
