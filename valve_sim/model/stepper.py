"""A valve stepped in real time, by the same compiled core as a whole trace."""

from __future__ import annotations

import math
from typing import Any, NamedTuple

import numpy as np

from valve_sim.model import driver
from valve_sim.model.core_types import Phase
from valve_sim.model.sampling import ROW
from valve_sim.model.simulation import (
    TOLERANCE,
    Event,
    Valve,
    check_flux,
    check_outcome,
    event_log,
    event_tuple,
    most_steps,
    new_states,
    rated_current,
)
from valve_sim.model.transitions import set_voltage, settle


class CoilReading(NamedTuple):
    """What is measured at the coil's terminals at one time: s, A, V."""

    time: float
    current: float
    voltage: float


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
    coil_voltage: float = math.nan


class Stepper:
    """A valve stepped in real time, by the same compiled core; its state does not depend on the size of the steps.

    Args:
        valve: what is stepped.
        start_time: s; the valve rests closed and without current until then.
        tolerance: relative error of one step.
    """

    def __init__(self, valve: Valve, start_time: float = 0.0, *, tolerance: float = TOLERANCE) -> None:
        self._tolerance = tolerance
        self._events = event_log()
        self._pending: list[Event] = []
        self._row = np.empty((1, ROW))
        self._current = np.empty(1)
        self._valve = valve
        self._record = valve.record()
        check_flux(self._record)
        self._commands: list[tuple[float, float]] = []
        self.reset(start_time)

    @property
    def valve(self) -> Valve:
        """What is stepped."""
        return self._valve

    @property
    def volts(self) -> float:
        """The voltage in force, V."""
        return float(self._state[0]["volts"])

    def reset(self, time: float) -> None:
        """Rest closed and without current at `time`, s."""
        self._state = new_states(self._record, time)
        self._shown = self._state.copy()
        self._commands = []
        self._pending = []

    def command(self, time: float, volts: float) -> tuple[CoilReading, CoilReading]:
        """A voltage in force from `time` on; a time that is past takes effect at the latest time stepped to.

        Returns:
            the coil just before and just after.
        """
        time = max(time, float(self._state[0]["time"]))
        self._go(self._state, time, commit=True, collect=True)
        before = self._coil(time)
        set_voltage(self._record, self._state, volts)
        if self._delay:
            self._commands.append((time, volts))
        self._go(self._state, time, commit=False, collect=True)
        return before, self._coil(time)

    def advance(self, time: float) -> Reading:
        """Step to `time`, s (not before the last command), and read the valve there.

        Raises:
            SimulationError: the step could not be carried to its end.
        """
        self._go(self._state, time, commit=False, collect=True)
        row = self._row[0]
        pilot, main, velocity, attraction, phase_number, x, volts = (float(value) for value in row)
        current = float(self._current[0])
        phase = Phase(int(phase_number))
        moves_main = phase is Phase.MAIN
        if self._delay:
            pilot, main = self._delayed(time - self._delay)
        record = self._record[0]
        lifted = phase in (Phase.MAIN, Phase.OPEN)
        effort = -float(record["spring_preload"] + record["spring_rate"] * x) if lifted else 0.0
        events, self._pending = tuple(self._pending), []
        return Reading(
            time, pilot, main, velocity, velocity if moves_main else 0.0, current * rated_current(self._record),
            attraction, effort, phase, events, volts,
        )  # fmt: skip

    def set_valve(self, valve: Valve, time: float) -> None:
        """Continue as another valve from `time` on, without a jump in position, velocity or current.

        The only exception is geometry: plungers beyond a stop that moved inwards are put at the new stop.
        """
        record = valve.record()
        check_flux(record)
        time = max(time, float(self._state[0]["time"]))
        self._go(self._state, time, commit=True, collect=True)
        state = self._state[0]
        volts = float(state["volts"])
        set_voltage(self._record, self._state, volts)  # the current so far belongs to the old coil
        self._valve = valve
        self._record = record
        settle(self._record, self._state)
        self._shown = self._state.copy()
        self._commands = []

    def _coil(self, time: float) -> CoilReading:
        """The coil as it was shown last."""
        return CoilReading(time, float(self._current[0]) * rated_current(self._record), float(self._row[0, 6]))

    @property
    def _delay(self) -> float:
        return float(self._record[0]["sensor_delay"])

    def _go(self, states: Any, time: float, *, commit: bool, collect: bool) -> None:
        self._times = np.array([time])
        samples = (self._times, self._row, self._times, self._current)
        control = (self._tolerance, most_steps(time - float(states[0]["time"])))
        _, count, outcome = driver.run(self._record, states, (time, commit), samples, (self._events, 0), control, None)
        check_outcome(outcome)
        if collect:
            self._pending.extend(event_tuple(self._events, min(count, len(self._events))))

    def _delayed(self, time: float) -> tuple[float, float]:
        """The positions as a late sensor shows them: a second state follows the first by the delay."""
        shown = self._shown
        time = max(time, float(shown[0]["time"]))
        while self._commands and self._commands[0][0] <= time:
            command_time, volts = self._commands.pop(0)
            self._go(shown, max(command_time, float(shown[0]["time"])), commit=True, collect=False)
            set_voltage(self._record, shown, volts)
        self._go(shown, time, commit=False, collect=False)
        return float(self._row[0, 0]), float(self._row[0, 1])
