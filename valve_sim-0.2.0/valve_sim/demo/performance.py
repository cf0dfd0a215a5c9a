"""One run of the demonstration: from messages to a bag and a story."""

from __future__ import annotations

import contextlib
import time
from collections.abc import Iterator
from typing import Any, Final

from rich.console import Console
from rich.live import Live

from valve_sim.demo.listener import COMMAND, TOPICS, Listener, Message
from valve_sim.demo.model_time import NANOSECONDS, ModelTime
from valve_sim.demo.process import DemoError, ValveProcess
from valve_sim.demo.stopping import StopSignals
from valve_sim.demo.story import ENERGISED, LEAD, RESTING, Story
from valve_sim.files.parameter_files import default_valve
from valve_sim.model import Phase
from valve_sim.traces import BagRecorder

FRAME: Final = 1.0 / 30.0
"""s between two updates."""
LONG_START: Final = 5.0
"""s to its first message after which a node is most likely compiling the model, which `make` has done before."""
LONGEST_SILENCE: Final = 20.0
"""s by which it may be late before it counts as silent: a busy machine holds a process up for some."""
START_LIMIT: Final = 120.0
"""s within which the first message of the node must come."""


class Performance:
    """One run: messages in, bag and story out.

    Args:
        listener: hears the valve. process: is the valve. recorder: takes the bag. console: takes the words.
        speed: model seconds a second. signals: may ask it to stop.
    """

    def __init__(
        self,
        listener: Listener,
        process: ValveProcess,
        recorder: BagRecorder,
        console: Console,
        speed: float,
        signals: StopSignals,
    ) -> None:
        self.story = Story()
        self._listener, self._process, self._recorder, self._console = listener, process, recorder, console
        self._speed = speed
        self._signals = signals
        self._clock = ModelTime(speed)
        self._held: list[Message] = []
        self._sent = b""
        self._volts = 0.0
        self._coil_stamp = 0
        self._stroke = default_valve().parameters.stroke
        self._live: Live | None = None

    @contextlib.contextmanager
    def shown(self) -> Iterator[None]:
        """Context in which a terminal shows the valve as it moves; without a terminal, lines are printed."""
        if not self._console.is_terminal:
            yield
            return
        with Live(console=self._console, auto_refresh=False, transient=True) as self._live:
            yield
        self._live = None

    def wait_for_valve(self) -> None:
        """Return when the node publishes and listens.

        Raises:
            DemoError: it died, or stays silent.
            StoppedError: a signal came.
        """
        begin, is_told = time.monotonic(), False
        while not (self._clock.is_set and self._listener.is_heard):
            if time.monotonic() > begin + LONG_START and not is_told:
                self._say("(it is still starting: the first time, it compiles the model)")
                is_told = True
            if time.monotonic() > begin + START_LIMIT:
                raise DemoError(
                    f"valve_node published nothing within {START_LIMIT:.0f} s; look for a firewall or a container "
                    "without shared memory between ROS processes"
                )
            self._look()

    def rest(self) -> None:
        """Command 0 V, as the first message on a fresh connection takes longer than all that follow."""
        self._record_command(self._listener.command(0.0), self._clock.at(time.time_ns()))
        self.follow(LEAD)

    def stroke(self, volts: float) -> None:
        """Command a voltage, then none; follow the valve through both."""
        for level, duration in ((volts, ENERGISED), (0.0, RESTING)):
            self._say(f"[bold]{level:g} V[/] on the coil")
            self._sent = self._listener.command(level)
            self.follow(duration)

    def follow(self, duration: float) -> None:
        """Watch for so many seconds of model time."""
        end = self._clock.at(time.time_ns()) + round(duration * NANOSECONDS)
        while self._clock.latest < end:
            self._look()
            if self._clock.at(time.time_ns()) - end > LONGEST_SILENCE * self._speed * NANOSECONDS:
                raise DemoError(f"valve_node fell silent: {self._process.last_words()}")

    def _record_command(self, payload: bytes, stamp: int) -> None:
        self._recorder.write(COMMAND, "std_msgs/msg/Float64", payload, stamp)

    def _look(self) -> None:
        time.sleep(FRAME)
        self._signals.check()
        self._process.check()
        self._listener.expect_valves(1)
        while not self._listener.messages.empty():
            message = self._listener.messages.get()
            if message.topic == "/valve/joint_states":
                self._take_joint_states(message)
            elif message.topic == "/valve/coil":
                self._take_coil(message)
            else:
                self._held.append(message)
        self._held = [message for message in self._held if not self._take_unstamped(message)]
        if self._live is not None:
            self._live.update(self.story.table(self._stroke), refresh=True)

    def _take_joint_states(self, message: Message) -> None:
        content = self._listener.decode(message)
        stamp = _stamp(content)
        self._clock.observe(stamp, message.published)
        self.story.joint_states(stamp / NANOSECONDS, content.position, content.velocity[0], content.effort[0])
        self._record(message, stamp)

    def _take_coil(self, message: Message) -> None:
        """Take the current, and the voltage: a command is recorded as of when the coil has it, however late that is."""
        content = self._listener.decode(message)
        self._coil_stamp = _stamp(content)
        self.story.current(self._coil_stamp / NANOSECONDS, content.current)
        if content.voltage != self._volts:
            self._volts = content.voltage
            self.story.command(self._coil_stamp / NANOSECONDS, content.voltage)
            self._record_command(self._sent, self._coil_stamp)
        self._record(message, self._coil_stamp)

    def _take_unstamped(self, message: Message) -> bool:
        """Tell and record a message whose time, and the command before it, are known by now; whether it was."""
        stamp = self._clock.stamp_of(message.published)
        if stamp is None or stamp > self._coil_stamp:
            return False
        if message.topic == "/valve/phase":
            content = self._listener.decode(message)
            line = self.story.phase(stamp / NANOSECONDS, Phase(content.data))
            if line is not None:
                self._say(line)
        self._record(message, stamp)
        return True

    def _record(self, message: Message, stamp: int) -> None:
        self._recorder.write(message.topic, TOPICS[message.topic], message.payload, stamp)

    def _say(self, line: str) -> None:
        self._console.print(line, highlight=False)


def _stamp(content: Any) -> int:
    """The stamp of a decoded message, ns."""
    return int(content.header.stamp.sec) * NANOSECONDS + int(content.header.stamp.nanosec)
