"""A valve simulated in step with a clock, and its self-test, without ROS."""

from __future__ import annotations

import contextlib
from collections.abc import Mapping, Sequence
from functools import partial
from typing import Any, Final

from valve_sim.model import Event, EventKind, Phase, Reading, SimulationError, Stepper, Valve
from valve_sim.model.core.plan import OFTEN
from valve_sim.model.gas import GAS
from valve_sim.nodes.live_machine import LiveMachine
from valve_sim.nodes.topics import ENDS
from valve_sim.nodes.valve_parameters import without_orphans

_PHASE_AFTER: Final = {
    EventKind.UNSEATED: Phase.PILOT,
    EventKind.PICKED_UP: Phase.MAIN,
    EventKind.HELD_AT_GAP: Phase.GAP_HOLD,
    EventKind.LIFTED: Phase.MAIN,
    EventKind.DROPPED: Phase.PILOT,
    EventKind.REACHED_STOP: Phase.OPEN,
    EventKind.RELEASED: Phase.MAIN,
    EventKind.MAIN_SEATED: Phase.PILOT,
    EventKind.SEATED: Phase.CLOSED,
}
SELF_TEST_SECONDS: Final = 0.5
"""s for which a self-test holds the voltage, and then 0 V; with gas it may hold the voltage for several times that."""
LONGEST_SELF_TEST: Final = 60.0
"""s after which a self-test no longer waits for the pressure to equalise."""
_STILL_RISING: Final = 1e-6
"""Share of the tank's pressure; an outlet that changes by less within SELF_TEST_SECONDS has come to rest."""


class LiveValve(LiveMachine[Stepper]):
    """A live machine that is a valve. `set_pressure` may be called in any thread, too."""

    rests = "the valve rests closed, without current"
    shows = ("position", "main_position", "current", "phase", "is_open")

    def __init__(self, valve: Valve, **options: float) -> None:
        super().__init__(**options)
        self.strokes = 0
        self._heard: dict[str, float] = {}
        self._valve = valve

    @property
    def valve(self) -> Valve:
        """The valve that is simulated, or will be from the next step on."""
        return self._valve

    def facts(self) -> Mapping[str, str]:
        """The phase, and how often it has opened."""
        return {"phase": Phase(self.phase).name.lower(), "strokes": str(self.strokes)}

    def prepare(self) -> None:
        """Have every function at hand by which it is stepped."""
        load_stepper(self._valve)

    def self_test(self) -> tuple[bool, str]:
        """A stroke of a copy of it."""
        return self_test(self._valve)

    def warning(self) -> str:
        """Whether it cannot open."""
        with contextlib.suppress(Exception):
            if not self._valve.can_open():
                return (
                    f"with these parameters the valve cannot open: at {self._valve.parameters.reference_voltage:g} V "
                    "nothing lifts the pilot plunger off its seat (look at valve.attraction_polynomial[0] and "
                    "valve.seat_load)"
                )
        return ""

    def completed(self, given: dict[str, Any], present: Mapping[str, Any]) -> dict[str, Any]:
        """Drop the tolerances of effects that are switched off."""
        return without_orphans(given, present)

    def pressures(self) -> Mapping[str, float]:
        """Pressures in force, Pa, as they were heard last, or else as declared; none for a valve without gas."""
        gas = self._valve.gas
        return {} if gas is None else {name: self._heard.get(name, getattr(gas, name)) for name in ENDS}

    def set_pressure(self, name: str, clock: int, pressure: float) -> bool:
        """A pressure that stays through a reset, until another is heard or declared."""
        if not GAS[name].lower <= pressure <= GAS[name].upper:
            return False
        self._requests.post(clock, name, partial(self._apply_pressure, name, pressure))
        return True

    def go_on_as(self, clock: int, machine: Valve) -> None:
        """Continue as another valve."""
        self._valve = machine
        self._requests.post(clock, "valve", partial(self._continue_as, machine))

    def _begun(self) -> Stepper:
        self._heard = {}
        return Stepper(self._valve, 0.0)

    def _entered(self, reading: Reading) -> Sequence[Phase]:
        if not reading.events:
            return ()
        self.strokes += sum(event.kind is EventKind.REACHED_STOP for event in reading.events)
        after = _PHASE_AFTER
        if self._running.valve.parameters.has_one_plunger:
            after = {**_PHASE_AFTER, EventKind.UNSEATED: Phase.MAIN}
        return [after[event.kind] for event in reading.events if event.kind in after]

    def _apply_pressure(self, name: str, pressure: float, clock: int) -> None:
        if self._running.valve.gas is None:
            return
        self._watch_command(clock)
        self._put(name, clock, pressure)
        self._heard[name] = pressure
        self._obeyed.append((name, self._timeline.at(clock)[1], pressure))

    def _put(self, name: str, clock: int, pressure: float) -> None:
        """Have the stepper count with a pressure that was heard."""
        stepper = self._running
        put = stepper.supply if name == "inlet_pressure" else stepper.set_demand_pressure
        put(self._timeline.model_time(clock), pressure)

    def _continue_as(self, valve: Valve, clock: int) -> None:
        before = self._running.valve.gas
        if before is None or valve.gas is None:
            self._heard = {}
        for name in [name for name in self._heard if getattr(valve.gas, name) != getattr(before, name)]:
            del self._heard[name]
        self._running.set_valve(valve, self._timeline.model_time(clock))

    def _rest(self, clock: int) -> None:
        super()._rest(clock)
        for name, pressure in self._heard.items():
            self._put(name, clock, pressure)


def load_stepper(valve: Valve) -> None:
    """Have every function at hand that a valve is stepped by, and its equations compiled well: it steps without end."""
    valve.plan(runs=OFTEN)
    stepper = Stepper(valve)
    stepper.command(1e-3, valve.parameters.reference_voltage)
    stepper.set_valve(valve, 2e-3)
    if valve.gas is not None:
        stepper.supply(2e-3, valve.gas.inlet_pressure)
        stepper.set_demand_pressure(2e-3, valve.gas.demand_pressure)
    stepper.advance(3e-3)


def self_test(valve: Valve) -> tuple[bool, str]:
    """Whether a valve opens fully and its main plunger, or the only one, seats again; and when it did what.

    With gas the voltage stays until the pressure has equalised, which may take far longer than the motion.
    """
    stepper, kinds = Stepper(valve), EventKind
    volts = valve.parameters.reference_voltage
    try:
        stepper.command(0.0, volts)
        opening, held = _open(stepper)
        stepper.command(held.time, 0.0)
        closing = stepper.advance(held.time + SELF_TEST_SECONDS).events
    except SimulationError as error:
        return False, str(error)
    is_one, name = valve.parameters.has_one_plunger, "main plunger"
    lifting, seating = [kinds.PICKED_UP, kinds.HELD_AT_GAP], [kinds.MAIN_SEATED]
    if is_one:
        lifting, seating, name = [kinds.UNSEATED], [kinds.SEATED, kinds.BOUNCED_AT_SEAT], "plunger"
    lifted, released = _milliseconds(opening, 0.0, *lifting), _milliseconds(closing, held.time, kinds.RELEASED)
    opened = _milliseconds(opening, 0.0, kinds.REACHED_STOP, kinds.BOUNCED_AT_STOP)
    closed = _milliseconds(closing, held.time, *seating)
    how_far = ""
    if valve.gas is not None and opened == "never":
        outlet, inlet = held.outlet_pressure / 1e6, valve.gas.inlet_pressure / 1e6
        how_far = f" (after {held.time:g} s the outlet is at {outlet:.3g} MPa, the tank at {inlet:.3g} MPa)"
    return (
        "never" not in (opened, closed),
        f"at {volts:g} V: {'seat left' if is_one else 'main plunger picked up'} {lifted}, "
        f"stop reached {opened}{how_far}; at 0 V: stop left {released}, {name} seated {closed}",
    )


def _open(stepper: Stepper) -> tuple[tuple[Event, ...], Reading]:
    """Hold the voltage; with gas until the valve is open or nothing changes. The events, and the valve at the end."""
    reading = stepper.advance(SELF_TEST_SECONDS)
    events, gas, is_changing = reading.events, stepper.valve.gas, True
    while gas is not None and is_changing and reading.phase is not Phase.OPEN and reading.time < LONGEST_SELF_TEST:
        before, reading = reading, stepper.advance(reading.time + SELF_TEST_SECONDS)
        events += reading.events
        rise = abs(reading.outlet_pressure - before.outlet_pressure)
        is_changing = bool(reading.events) or rise > _STILL_RISING * gas.inlet_pressure
    return events, reading


def _milliseconds(events: tuple[Event, ...], since: float, *kinds: EventKind) -> str:
    times = [event.time - since for event in events if event.kind in kinds]
    return f"after {times[0] * 1e3:.3f} ms" if times else "never"
