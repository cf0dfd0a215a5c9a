"""A machine simulated in step with a clock, without ROS: commands from any thread, readings in the stepping one."""

from __future__ import annotations

import math
from abc import ABC, abstractmethod
from collections.abc import Collection, Mapping, Sequence
from functools import partial
from typing import TYPE_CHECKING, Any, ClassVar, Generic, NamedTuple, TypeVar

from valve_sim.model import CoilReading, SimulationError
from valve_sim.nodes.realtime import NANOSECONDS, TimedQueue

if TYPE_CHECKING:
    from valve_sim.model import Reading, Stepper
    from valve_sim.model.machine_stepper import MachineReading, MachineStepper


S = TypeVar("S", "Stepper", "MachineStepper")
"""What steps a machine."""


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
        reading: the machine, a `Reading` of a valve or else a `MachineReading`.
        phases: the phases entered since the step before, in order; a brief one is not left out.
        failure: why the machine was put back to rest; empty if it was not.
        switches: the coil just before and just after each change of its voltage since the step before, with stamps,
            ns, that ascend and lie between those of the two steps.
        obeyed: pressures that hold since the step before: the name, the stamp, ns, from which on, and Pa.
        switched_off: why the coil was switched off since the step before without a command; empty if it was not.
    """

    stamp: int
    reading: Any
    phases: tuple[int, ...]
    failure: str
    switches: tuple[tuple[int, CoilReading], ...] = ()
    obeyed: tuple[tuple[str, int, float], ...] = ()
    switched_off: str = ""


class LiveMachine(ABC, Generic[S]):
    """A stepper with its clock, its command and its watchdog; which command holds: docs/reference/command_safety.md.

    `command`, `limit`, `set_scale`, `reset`, `go_on_as` may be called in any thread: they store, the next `step`
    consumes, each at its own time. `prepare`, `restart` and `step` belong to one stepping thread.

    `scale` is in model seconds a second of the clock; `command_timeout` in s of the clock, 0 for never.

    Attributes:
        rests: what it does after a reset, in words. shows: channels that topics show of it, phase and is_open included.
    """

    rests: ClassVar[str]
    shows: Collection[str]

    def __init__(self, *, scale: float = 1.0, command_timeout: float = 0.0, max_voltage: float = math.inf) -> None:
        self.command_timeout = command_timeout
        self.last_command: int | None = None
        self.timed_out = False
        self.withdrawn = 0.0
        """V of the last command, if that ended because `max_voltage` was set below it; else 0."""
        self.phase = 0
        self.failures = 0
        self._max_voltage = max_voltage
        self._scale = scale
        self._timeline = Timeline(0, 0, scale)
        self._requests = TimedQueue()
        self._reached = 0
        self._stepper: S | None = None
        self._announced: int | None = None
        self._switches: list[tuple[int, CoilReading]] = []
        self._obeyed: list[tuple[str, int, float]] = []
        self._switched_off = ""
        self._stamp = -1

    @abstractmethod
    def _begun(self) -> S:
        """The machine at rest at model time 0, without voltage."""

    @abstractmethod
    def _entered(self, reading: Any) -> Sequence[int]:
        """The phases that began since the reading before; what else happened is noted."""

    @abstractmethod
    def facts(self) -> Mapping[str, str]:
        """What /diagnostics says of its state, the phase first."""

    @abstractmethod
    def go_on_as(self, clock: int, machine: Any) -> None:
        """Continue as another machine from clock time `clock`, ns, without a jump in state."""

    @abstractmethod
    def self_test(self) -> tuple[bool, str]:
        """Whether it works, and what was seen; the running machine is not affected."""

    def prepare(self) -> None:
        """Have every function at hand by which it is stepped."""
        return

    def warning(self) -> str:
        """What is doubtful about its parameters; empty for nothing."""
        return ""

    def completed(self, given: dict[str, Any], present: Mapping[str, Any]) -> dict[str, Any]:
        """Parameters that are about to be set, and others that follow from them and the present ones."""
        return given

    def pressures(self) -> Mapping[str, float]:
        """Pressures in force at its ends, Pa; none without gas."""
        return {}

    def set_pressure(self, name: str, clock: int, pressure: float) -> bool:
        """A pressure, Pa, from clock time `clock` on, ns; False, and nothing else, if it is not acceptable."""
        return False

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

    def limit(self, clock: int, max_voltage: float) -> None:
        """Limit commands from now on, V; a voltage in force beyond the limit ends at clock time `clock`, ns."""
        self._max_voltage = max_voltage
        self._requests.post(clock, f"limit {max_voltage!r}", partial(self._withdraw_beyond, max_voltage))

    def set_scale(self, clock: int, scale: float) -> None:
        """Continue at another time scale."""
        self._scale = scale
        self._requests.post(clock, "scale", lambda clock: self._timeline.set_scale(clock, scale))

    def reset(self, clock: int) -> None:
        """Put the machine to rest, as before the first command."""
        self._requests.post(clock, "reset", self._rest)

    def restart(self, clock: int, stamp: int) -> None:
        """Restart at clock time `clock`, ns, with stamps from `stamp` on: the machine is at rest.

        What was stored before a jump of the clock is forgotten; what came before the first start is not.
        """
        if self._stepper is not None:
            self._requests.clear()
        self._reached = clock
        self._timeline = Timeline(clock, stamp, self._scale)
        self._stepper = self._begun()
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
            reading: Reading | MachineReading = stepper.advance(time)
        except SimulationError as error:
            failure = str(error)
            self.failures += 1
            self._rest(clock)
            time, stamp = self._timeline.at(clock)
            reading = stepper.advance(time)
        self._reached = clock
        self._stamp = stamp
        self.phase = reading.phase
        entered = self._entered(reading)
        phases: tuple[int, ...] = ()
        if entered or self.phase != self._announced:
            phases = self._phases_to_announce(entered, self.phase)
        switches = tuple(switch for switch in self._switches if switch[0] < self._stamp) if self._switches else ()
        return Step(self._stamp, reading, phases, failure, switches, tuple(self._obeyed), self._switched_off)

    @property
    def _running(self) -> S:
        if self._stepper is None:
            raise RuntimeError("restart comes before the first step")
        return self._stepper

    def _energise(self, volts: float, clock: int) -> None:
        self._watch_command(clock)
        self._switch(clock, volts)
        self.last_command = clock
        self.timed_out, self.withdrawn = False, 0.0

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
        self._forget_command()

    def _forget_command(self) -> None:
        self.last_command = None
        self.timed_out, self.withdrawn = False, 0.0

    def _phases_to_announce(self, entered: Sequence[int], present: int) -> tuple[int, ...]:
        announced: list[int] = []
        for phase in (*entered, present):
            if phase != (announced[-1] if announced else self._announced):
                announced.append(phase)
        self._announced = present
        return tuple(announced)
