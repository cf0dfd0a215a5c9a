"""A valve simulated in step with a clock, without ROS: commands from any thread, readings in the stepping one."""

from __future__ import annotations

import math
from functools import partial
from typing import Final, NamedTuple

from valve_sim.model import CoilReading, Event, EventKind, Phase, Reading, SimulationError, Stepper, Valve
from valve_sim.model.gas import GAS
from valve_sim.nodes.realtime import NANOSECONDS, TimedQueue

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


class Timeline:
    """Clock time, ns, to model time, s, and to the stamp of a message, ns.

    Model time starts at 0, so that it stays exact to the nanosecond; a stamp adds what ROS time was then.
    """

    def __init__(self, clock: int, stamp: int, scale: float) -> None:
        self._clock = clock
        self._model = 0.0
        self._stamp = stamp
        self._scale = scale

    def model_time(self, clock: int) -> float:
        """Model time, s."""
        return self.at(clock)[0]

    def at(self, clock: int) -> tuple[float, int]:
        """Model time, s, and stamp, ns."""
        time = self._model + (clock - self._clock) / NANOSECONDS * self._scale
        return time, self._stamp + round(time * NANOSECONDS)

    def set_scale(self, clock: int, scale: float) -> None:
        """Change the time scale from this clock time on, without a jump in model time."""
        self._model = self.model_time(clock)
        self._clock = clock
        self._scale = scale

    def shift_stamps(self, nanoseconds: int) -> None:
        """Have all stamps from now on so much later; model time goes on as before."""
        self._stamp += nanoseconds


class Step(NamedTuple):
    """Result of one step.

    Attributes:
        stamp: of the reading, ns.
        reading: the valve.
        phases: the phases entered since the step before, in order; a brief one is not left out.
        failure: why the valve was put back to rest; empty if it was not.
        switches: the coil just before and just after each change of its voltage since the step before, with stamps,
            ns, that ascend and lie between those of the two steps.
        obeyed: pressures that hold since the step before: the name, the stamp, ns, from which on, and Pa.
        switched_off: why the coil was switched off since the step before without a command; empty if it was not.
    """

    stamp: int
    reading: Reading
    phases: tuple[Phase, ...]
    failure: str
    switches: tuple[tuple[int, CoilReading], ...] = ()
    obeyed: tuple[tuple[str, int, float], ...] = ()
    switched_off: str = ""


class LiveValve:
    """A stepper with its clock, its command and its watchdog; which command holds: docs/reference/command_safety.md.

    `command`, `set_pressure`, `limit`, `set_valve`, `set_scale`, `reset` may be called in any thread:
    they store, the next `step` consumes, each at its own time. `restart` and `step` belong to one stepping thread.

    `scale` is in model seconds a second of the clock; `command_timeout` in s of the clock, 0 for never.
    """

    def __init__(
        self, valve: Valve, *, scale: float = 1.0, command_timeout: float = 0.0, max_voltage: float = math.inf
    ) -> None:
        self.command_timeout = command_timeout
        self.last_command: int | None = None
        self.timed_out = False
        self.withdrawn = 0.0
        """V of the last command, if that ended because `max_voltage` was set below it; else 0."""
        self.strokes = 0
        self.phase = Phase.CLOSED
        self.failures = 0
        self._max_voltage = max_voltage
        self._heard: dict[str, float] = {}
        self._valve = valve
        self._scale = scale
        self._timeline = Timeline(0, 0, scale)
        self._requests = TimedQueue()
        self._reached = 0
        self._stepper: Stepper | None = None
        self._announced: Phase | None = None
        self._switches: list[tuple[int, CoilReading]] = []
        self._obeyed: list[tuple[str, int, float]] = []
        self._switched_off = ""
        self._stamp = -1

    @property
    def valve(self) -> Valve:
        """The valve that is simulated, or will be from the next step on."""
        return self._valve

    @property
    def volts(self) -> float:
        """The voltage in force, V; 0 before the first start."""
        return 0.0 if self._stepper is None else self._stepper.volts

    def command(self, clock: int, volts: float) -> bool:
        """A voltage that is in force from clock time `clock`, ns; False, and nothing else, if it is not acceptable."""
        if not (math.isfinite(volts) and abs(volts) <= self._max_voltage):
            return False
        self._requests.post(clock, "command", partial(self._energise, volts))
        return True

    def pressure(self, name: str) -> float:
        """A pressure in force, Pa, as it was heard last, or else as declared; NaN for a valve without gas."""
        gas = self._valve.gas
        return math.nan if gas is None else self._heard.get(name, getattr(gas, name))

    def set_pressure(self, name: str, clock: int, pressure: float) -> bool:
        """A pressure, Pa, from clock time `clock` on, ns; False, and nothing else, if it is out of range.

        It stays through a reset, until another is heard or declared. A valve without gas has no use for it.
        """
        if not GAS[name].lower <= pressure <= GAS[name].upper:
            return False
        self._requests.post(clock, name, partial(self._apply_pressure, name, pressure))
        return True

    def limit(self, clock: int, max_voltage: float) -> None:
        """Limit commands from now on, V; a voltage in force beyond the limit ends at clock time `clock`, ns."""
        self._max_voltage = max_voltage
        self._requests.post(clock, f"limit {max_voltage!r}", partial(self._withdraw_beyond, max_voltage))

    def set_valve(self, clock: int, valve: Valve) -> None:
        """Continue with another valve, without a jump in state."""
        self._valve = valve
        self._requests.post(clock, "valve", partial(self._continue_as, valve))

    def set_scale(self, clock: int, scale: float) -> None:
        """Continue at another time scale."""
        self._scale = scale
        self._requests.post(clock, "scale", lambda clock: self._timeline.set_scale(clock, scale))

    def reset(self, clock: int) -> None:
        """Put the valve to rest: closed, without current, as before the first command."""
        self._requests.post(clock, "reset", self._rest)

    def restart(self, clock: int, stamp: int) -> None:
        """Restart at clock time `clock`, ns, with stamps from `stamp` on: the valve rests closed.

        What was stored before a jump of the clock is forgotten; what came before the first start is not.
        """
        if self._stepper is not None:
            self._requests.clear()
        self._reached = clock
        self._timeline = Timeline(clock, stamp, self._scale)
        self._stepper = Stepper(self._valve, 0.0)
        self._heard = {}
        self._announced = None
        self._stamp = stamp - 1
        self._forget_command()

    def shift_stamps(self, nanoseconds: int) -> None:
        """Have all stamps from the next step on so much later, because the clock that they follow was set.

        To be called by the stepping thread.
        """
        self._timeline.shift_stamps(nanoseconds)
        self._stamp += nanoseconds

    def step(self, clock: int) -> Step:
        """Advance to clock time `clock`, ns. The state does not depend on how often this is called."""
        failure, self._switches, self._obeyed, self._switched_off = "", [], [], ""
        stepper = self._running
        try:
            # A command cannot act before what is published already.
            self._requests.deliver(self._reached, clock)
            self._watch_command(clock)
            time, stamp = self._timeline.at(clock)
            reading = stepper.advance(time)
        except SimulationError as error:
            failure = str(error)
            self.failures += 1
            self._rest(clock)
            time, stamp = self._timeline.at(clock)
            reading = stepper.advance(time)
        self._reached = clock
        self._stamp = stamp
        self.phase = reading.phase
        phases: tuple[Phase, ...] = ()
        if reading.events or reading.phase is not self._announced:
            self.strokes += sum(event.kind is EventKind.REACHED_STOP for event in reading.events)
            phases = self._phases_to_announce(reading)
        switches = tuple(switch for switch in self._switches if switch[0] < self._stamp) if self._switches else ()
        return Step(self._stamp, reading, phases, failure, switches, tuple(self._obeyed), self._switched_off)

    @property
    def _running(self) -> Stepper:
        if self._stepper is None:
            raise RuntimeError("restart comes before the first step")
        return self._stepper

    def _energise(self, volts: float, clock: int) -> None:
        self._watch_command(clock)
        self._switch(clock, volts)
        self.last_command = clock
        self.timed_out, self.withdrawn = False, 0.0

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

    def _watch_command(self, clock: int) -> None:
        """De-energise the coil where no other command has come in time."""
        if self.command_timeout <= 0.0 or self.last_command is None or self.timed_out:
            return
        deadline = self.last_command + round(self.command_timeout * NANOSECONDS)
        if clock >= deadline:
            volts = self._running.volts
            if volts:
                self._switched_off = f"no command for {self.command_timeout:g} s (command_timeout), {volts:g} V held"
            self._switch(max(self._reached, deadline), 0.0)
            self.timed_out = True

    def _withdraw_beyond(self, max_voltage: float, clock: int) -> None:
        volts = self._running.volts
        if abs(volts) > max_voltage:
            self._switched_off = f"max_voltage was set to {max_voltage:g} V, below the {abs(volts):g} V that held"
            self._switch(clock, 0.0)
            self._forget_command()
            self.withdrawn = volts

    def _switch(self, clock: int, volts: float) -> None:
        """Another voltage from clock time `clock` on, ns; what jumps then is kept with two stamps, 1 ns apart."""
        old = self._running.volts
        before, after = self._running.command(self._timeline.model_time(clock), volts)
        if volts == old:
            return
        last = self._switches[-1][0] if self._switches else self._stamp
        stamp = max(self._timeline.at(clock)[1], last + 1)
        if stamp - 1 > last:
            self._switches.append((stamp - 1, before))
        self._switches.append((stamp, after))

    def _rest(self, clock: int) -> None:
        self._running.reset(self._timeline.model_time(clock))
        for name, pressure in self._heard.items():
            self._put(name, clock, pressure)
        self._forget_command()

    def _forget_command(self) -> None:
        self.last_command = None
        self.timed_out, self.withdrawn = False, 0.0

    def _phases_to_announce(self, reading: Reading) -> tuple[Phase, ...]:
        after = _PHASE_AFTER
        if self._running.valve.parameters.has_one_plunger:
            after = {**_PHASE_AFTER, EventKind.UNSEATED: Phase.MAIN}
        entered = [after[event.kind] for event in reading.events if event.kind in after]
        announced: list[Phase] = []
        for phase in [*entered, reading.phase]:
            if phase != (announced[-1] if announced else self._announced):
                announced.append(phase)
        self._announced = reading.phase
        return tuple(announced)


class SelfTest(NamedTuple):
    """Whether the valve opened fully and its main plunger, or the only one, seated again; and the event times."""

    passed: bool
    summary: str


def self_test(valve: Valve) -> SelfTest:
    """Open and close a valve with these parameters; the running one is not affected.

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
        return SelfTest(False, str(error))
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
    return SelfTest(
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
