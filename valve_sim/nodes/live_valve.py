"""A valve simulated in step with a clock, without ROS: commands from any thread, readings in the stepping one."""

from __future__ import annotations

import math
from typing import Final, NamedTuple

from valve_sim.model import CoilReading, Event, EventKind, Phase, Reading, SimulationError, Stepper, Valve
from valve_sim.nodes.realtime import NANOSECONDS, Mailbox

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
"""s for which a self-test holds the voltage, and then 0 V."""


class Timeline:
    """Clock time, ns, to model time, s, and to the stamp of a message, ns.

    Model time starts at 0, so that it stays exact to the nanosecond; a stamp adds what ROS time was then.

    Args:
        clock: clock time at model time 0, ns.
        stamp: stamp of model time 0, ns.
        scale: model seconds a second of the clock.
    """

    def __init__(self, clock: int, stamp: int, scale: float) -> None:
        self._clock = clock
        self._model = 0.0
        self._stamp = stamp
        self._scale = scale

    def model_time(self, clock: int) -> float:
        """Model time, s."""
        return self._model + (clock - self._clock) / NANOSECONDS * self._scale

    def stamp(self, clock: int) -> int:
        """Stamp, ns."""
        return self._stamp + round(self.model_time(clock) * NANOSECONDS)

    def set_scale(self, clock: int, scale: float) -> None:
        """Change the time scale from this clock time on, without a jump in model time."""
        self._model = self.model_time(clock)
        self._clock = clock
        self._scale = scale


class Step(NamedTuple):
    """Result of one step.

    Attributes:
        stamp: of the reading, ns.
        reading: the valve.
        phases: the phases entered since the step before, in order; a brief one is not left out.
        failure: why the valve was put back to rest; empty if it was not.
        switches: the coil just before and just after each change of its voltage since the step before, with stamps,
            ns, that ascend and lie between those of the two steps.
    """

    stamp: int
    reading: Reading
    phases: tuple[Phase, ...]
    failure: str
    switches: tuple[tuple[int, CoilReading], ...] = ()


class LiveValve:
    """A stepper with its clock, its command and its watchdog; which command holds: docs/reference/command_safety.md.

    `command`, `limit`, `set_valve`, `set_scale`, `reset` may be called in any thread: they store, the next `step`
    consumes, each at its own time. `restart` and `step` belong to one stepping thread.

    Args:
        valve: what is simulated.
        scale: model seconds a second of the clock.
        command_timeout: s of the clock after which, without a new command, the coil is de-energised; 0 for never.
        max_voltage: V, the largest command of either sign; `limit` changes it.
    """

    def __init__(
        self, valve: Valve, *, scale: float = 1.0, command_timeout: float = 0.0, max_voltage: float = math.inf
    ) -> None:
        self.command_timeout = command_timeout
        self.last_command: int | None = None
        self.timed_out = False
        self.strokes = 0
        self.phase = Phase.CLOSED
        self.volts = 0.0
        self.failures = 0
        self._max_voltage = max_voltage
        self._valve = valve
        self._scale = scale
        self._timeline = Timeline(0, 0, scale)
        self._mailbox = Mailbox()
        self._reached = 0
        self._stepper: Stepper | None = None
        self._announced: Phase | None = None
        self._switches: list[tuple[int, CoilReading]] = []
        self._stamp = -1

    @property
    def valve(self) -> Valve:
        """The valve that is simulated, or will be from the next step on."""
        return self._valve

    def command(self, clock: int, volts: float) -> bool:
        """A voltage that is in force from clock time `clock`, ns; False, and nothing else, if it is not acceptable."""
        if not (math.isfinite(volts) and abs(volts) <= self._max_voltage):
            return False
        self._mailbox.post(clock, lambda time: self._energise(time, volts), "command")
        return True

    def limit(self, clock: int, max_voltage: float) -> None:
        """Limit commands from now on, V; a voltage in force beyond the limit ends at clock time `clock`, ns."""
        self._max_voltage = max_voltage
        self._mailbox.post(clock, lambda time: self._withdraw_beyond(time, max_voltage))

    def set_valve(self, clock: int, valve: Valve) -> None:
        """Continue with another valve, without a jump in state."""
        self._valve = valve
        self._mailbox.post(clock, lambda time: self._running.set_valve(valve, self._timeline.model_time(time)), "valve")

    def set_scale(self, clock: int, scale: float) -> None:
        """Continue at another time scale."""
        self._scale = scale
        self._mailbox.post(clock, lambda time: self._timeline.set_scale(time, scale))

    def reset(self, clock: int) -> None:
        """Put the valve to rest: closed, without current, as before the first command."""
        self._mailbox.post(clock, self._rest)

    def restart(self, clock: int, stamp: int) -> None:
        """Restart at clock time `clock`, ns, with stamps from `stamp` on: the valve rests closed.

        What was stored before a jump of the clock is forgotten; what came before the first start is not.
        """
        if self._stepper is not None:
            self._mailbox.clear()
        self._reached = clock
        self._timeline = Timeline(clock, stamp, self._scale)
        self._stepper = Stepper(self._valve, 0.0)
        self._announced = None
        self._stamp = stamp - 1
        self._forget_command()

    def step(self, clock: int) -> Step:
        """Advance to clock time `clock`, ns. The state does not depend on how often this is called."""
        failure, self._switches = "", []
        try:
            # A command cannot act before what is published already.
            self._mailbox.deliver(self._reached, clock)
            self._watch_command(clock)
            reading = self._running.advance(self._timeline.model_time(clock))
        except SimulationError as error:
            failure = str(error)
            self.failures += 1
            self._rest(clock)
            reading = self._running.advance(self._timeline.model_time(clock))
        self._reached = clock
        self.strokes += sum(event.kind is EventKind.REACHED_STOP for event in reading.events)
        self.phase = reading.phase
        self.volts = self._running.volts
        self._stamp = self._timeline.stamp(clock)
        switches = tuple(switch for switch in self._switches if switch[0] < self._stamp)
        return Step(self._stamp, reading, self._phases_to_announce(reading), failure, switches)

    @property
    def _running(self) -> Stepper:
        if self._stepper is None:
            raise RuntimeError("restart comes before the first step")
        return self._stepper

    def _energise(self, clock: int, volts: float) -> None:
        self._watch_command(clock)
        self._switch(clock, volts)
        self.last_command = clock
        self.timed_out = False

    def _watch_command(self, clock: int) -> None:
        if self.command_timeout <= 0.0 or self.last_command is None or self.timed_out:
            return
        deadline = max(self._reached, self.last_command + round(self.command_timeout * NANOSECONDS))
        if clock >= deadline:
            self._switch(deadline, 0.0)
            self.timed_out = True

    def _withdraw_beyond(self, clock: int, max_voltage: float) -> None:
        if abs(self._running.volts) > max_voltage:
            self._switch(clock, 0.0)
            self._forget_command()

    def _switch(self, clock: int, volts: float) -> None:
        """Another voltage from clock time `clock` on, ns; what jumps then is kept with two stamps, 1 ns apart."""
        old = self._running.volts
        before, after = self._running.command(self._timeline.model_time(clock), volts)
        if volts == old:
            return
        last = self._switches[-1][0] if self._switches else self._stamp
        stamp = max(self._timeline.stamp(clock), last + 1)
        if stamp - 1 > last:
            self._switches.append((stamp - 1, before))
        self._switches.append((stamp, after))

    def _rest(self, clock: int) -> None:
        self._running.reset(self._timeline.model_time(clock))
        self._forget_command()

    def _forget_command(self) -> None:
        self.last_command = None
        self.timed_out = False

    def _phases_to_announce(self, reading: Reading) -> tuple[Phase, ...]:
        entered = [_PHASE_AFTER[event.kind] for event in reading.events if event.kind in _PHASE_AFTER]
        announced: list[Phase] = []
        for phase in [*entered, reading.phase]:
            if phase != (announced[-1] if announced else self._announced):
                announced.append(phase)
        self._announced = reading.phase
        return tuple(announced)


class SelfTest(NamedTuple):
    """One stroke of the model at the reference voltage, apart from the running valve.

    Attributes:
        passed: the valve opened fully, and its main plunger seated again.
        summary: the event times, in one sentence.
    """

    passed: bool
    summary: str


def self_test(valve: Valve) -> SelfTest:
    """Open and close a valve with these parameters; the running one is not affected."""
    stepper = Stepper(valve)
    volts = valve.parameters.reference_voltage
    try:
        stepper.command(0.0, volts)
        opening = stepper.advance(SELF_TEST_SECONDS).events
        stepper.command(SELF_TEST_SECONDS, 0.0)
        closing = stepper.advance(2 * SELF_TEST_SECONDS).events
    except SimulationError as error:
        return SelfTest(False, str(error))
    opened = _milliseconds(opening, 0.0, EventKind.REACHED_STOP, EventKind.BOUNCED_AT_STOP)
    closed = _milliseconds(closing, SELF_TEST_SECONDS, EventKind.MAIN_SEATED)
    picked_up = _milliseconds(opening, 0.0, EventKind.PICKED_UP, EventKind.HELD_AT_GAP)
    released = _milliseconds(closing, SELF_TEST_SECONDS, EventKind.RELEASED)
    summary = (
        f"at {volts:g} V: main plunger picked up {picked_up}, stop reached {opened}; "
        f"at 0 V: stop left {released}, main plunger seated {closed}"
    )
    return SelfTest("never" not in (opened, closed), summary)


def _milliseconds(events: tuple[Event, ...], since: float, *kinds: EventKind) -> str:
    times = [event.time - since for event in events if event.kind in kinds]
    return f"after {times[0] * 1e3:.3f} ms" if times else "never"
