"""A valve stepped in real time, by the same compiled core as a whole trace."""

from __future__ import annotations

import copy
import math
from collections import deque
from collections.abc import Callable
from typing import Final, NamedTuple

from valve_sim.model.core_types import Phase
from valve_sim.model.errors import SimulationError
from valve_sim.model.live import Live
from valve_sim.model.response import Event
from valve_sim.model.simulation import TOLERANCE, check_flux
from valve_sim.model.valve import Valve

_PHASES: Final = tuple(Phase)
_MAIN: Final = Phase.MAIN


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


_Change = Callable[[Live], Live]
"""Changes a valve that is stepped, at the time of its state; returns what is stepped from there on."""


class Stepper:
    """A valve stepped in real time, by the same compiled core; its state does not depend on the size of the steps.

    Args:
        valve: what is stepped.
        start_time: s; the valve rests closed and without current until then.
        tolerance: relative error of one step.
    """

    def __init__(self, valve: Valve, start_time: float = 0.0, *, tolerance: float = TOLERANCE) -> None:
        self._tolerance = tolerance
        check_flux(valve)
        self._valve = valve
        self._changes: deque[tuple[float, _Change]] = deque()
        self.reset(start_time)

    @property
    def valve(self) -> Valve:
        """The valve that is stepped."""
        return self._valve

    @property
    def volts(self) -> float:
        """The voltage in force, V."""
        return self._volts

    def reset(self, time: float) -> None:
        """Start again at `time`, s: closed, at rest and without current."""
        self._live = Live.at_rest(self._valve, time, self._tolerance)
        self._delay = 0.0
        self._become(self._valve, time)
        self._volts = 0.0
        self._pending: tuple[Event, ...] = ()

    def copy(self) -> Stepper:
        """An independent stepper in this state, from which the simulation can be repeated from this time on."""
        twin = copy.copy(self)
        twin._live, twin._late, twin._changes = self._live.copy(), self._late.copy(), self._changes.copy()
        return twin

    def command(self, time: float, volts: float) -> tuple[CoilReading, CoilReading]:
        """Set the voltage in force from `time` on; a time that is past counts as the latest time stepped to.

        Returns:
            the coil just before and just after.
        """
        time = self._commit(time)
        before = self._coil(time)

        def change(live: Live) -> Live:
            live.command(volts)
            return live

        self._change(time, change)
        self._volts = float(volts)
        self._pending += self._live.step(time, commit=False)
        return before, self._coil(time)

    def supply(self, time: float, pressure: float) -> None:
        """Set the tank's pressure, Pa, from `time` on, as `command` sets the voltage; of a valve with gas."""
        self._supply(time, tank=pressure)

    def set_demand_pressure(self, time: float, pressure: float) -> None:
        """Set the pressure behind the demand's orifice, Pa, from `time` on, as `command` does; of a valve with gas."""
        self._supply(time, demand=pressure)

    def _commit(self, time: float) -> float:
        """Step exactly to a time, or to the latest time stepped to; returns which, s."""
        time = max(time, self._live.reached)
        self._pending += self._live.step(time, commit=True)
        return time

    def _supply(self, time: float, **pressures: float) -> None:
        def change(live: Live) -> Live:
            live.supply(**pressures)
            return live

        self._change(self._commit(time), change)

    def _change(self, time: float, change: _Change) -> None:
        """Change the valve, which has been stepped to this time, s; a late sensor shows it later."""
        self._live = change(self._live)
        if self._delay:
            self._changes.append((time, change))

    def advance(self, time: float) -> Reading:
        """Step to `time`, s (not before the last command), and read the valve there.

        Raises:
            SimulationError: the step could not be carried to its end.
        """
        self._pending += self._live.step(time, commit=False)
        pilot, main, velocity, attraction, number, x, volts, _, current, *of_gas = self._live.row.tolist()
        phase = _PHASES[int(number)]
        if self._delay:
            pilot, main = self._delayed(time - self._delay)
        effort = -(self._preload + self._rate * x) if phase >= _MAIN else 0.0
        events, self._pending = self._pending, ()
        return Reading(
            time, pilot, main, velocity, velocity if phase >= _MAIN else 0.0, current, attraction, effort, phase,
            events, volts, *of_gas,
        )  # fmt: skip

    def set_valve(self, valve: Valve, time: float) -> None:
        """Continue as another valve from `time` on. Neither its state nor what a late sensor shows jumps.

        Position, velocity, normalised current u and the outlet's pressure go on; a late or slow sensor shows the old
        valve until its delay has passed. Exceptions: plungers beyond a stop that moved inwards are put at the new
        stop; a coil without inductance takes its new current. Changes that only scale a reading show at once (rated
        current, gain of the sensor, gap in the main plunger's position), and so do a shorter delay of the sensor and
        the end of its filter.

        Raises:
            SimulationError: no current follows from the flux of the valve; nothing has changed.
        """
        if (valve.gas is None) != (self._valve.gas is None):
            raise SimulationError("a valve that is stepped cannot get gas, or lose it; start a new one")
        check_flux(valve)
        time = self._commit(time)
        self._change(time, lambda live: live.as_valve(valve, self._tolerance))
        self._become(valve, time)

    def _become(self, valve: Valve, time: float) -> None:
        """Read this valve from `time` on, s, whose sensor may be late where it was not, or no longer."""
        was_late = self._delay > 0.0
        self._valve = valve
        self._delay = self._live.delay
        self._preload, self._rate = valve.parameters.spring_preload, valve.parameters.spring_rate
        if not (was_late and self._delay):
            self._changes.clear()
            self._late, self._shown_until = self._live.copy(), time

    def _coil(self, time: float) -> CoilReading:
        """The coil as it was shown last."""
        row = self._live.row
        return CoilReading(time, float(row[8]), float(row[6]))

    def _delayed(self, time: float) -> tuple[float, float]:
        """The positions as a late sensor shows them: a second state follows the first by the delay.

        Where a delay grew, they stand still until it has caught up.
        """
        self._shown_until = time = max(time, self._shown_until)
        while self._changes and self._changes[0][0] <= time:
            changed, change = self._changes.popleft()
            self._late.step(max(changed, self._late.reached), commit=True)
            self._late = change(self._late)
        self._late.step(time, commit=False)
        return float(self._late.row[0]), float(self._late.row[1])
