"""One run of the demonstration: from messages to a bag and a story."""

from __future__ import annotations

import contextlib
import time
from collections.abc import Iterator
from typing import Final

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
        self._command(0.0)
        self.follow(LEAD)

    def stroke(self, volts: float) -> None:
        """Command a voltage, then none; follow the valve through both."""
        for level, duration in ((volts, ENERGISED), (0.0, RESTING)):
            self._say(self.story.command(self._command(level), level))
            self.follow(duration)

    def follow(self, duration: float) -> None:
        """Watch for so many seconds of model time."""
        end = self._clock.at(time.time_ns()) + round(duration * NANOSECONDS)
        while self._clock.latest < end:
            self._look()
            if self._clock.at(time.time_ns()) - end > LONGEST_SILENCE * self._speed * NANOSECONDS:
                raise DemoError(f"valve_node fell silent: {self._process.last_words()}")

    def _command(self, volts: float) -> float:
        """Command and record; the model time of it, s."""
        when = self._clock.at(time.time_ns())
        self._recorder.write(COMMAND, "std_msgs/msg/Float64", self._listener.command(volts), when)
        return when / NANOSECONDS

    def _look(self) -> None:
        time.sleep(FRAME)
        self._signals.check()
        self._process.check()
        self._listener.expect_valves(1)
        while not self._listener.messages.empty():
            message = self._listener.messages.get()
            if message.topic == "/valve/joint_states":
                self._take_joint_states(message)
            else:
                self._held.append(message)
        self._held = [message for message in self._held if not self._take_unstamped(message)]
        if self._live is not None:
            self._live.update(self.story.table(self._stroke), refresh=True)

    def _take_joint_states(self, message: Message) -> None:
        content = self._listener.decode(message)
        stamp = content.header.stamp.sec * NANOSECONDS + content.header.stamp.nanosec
        self._clock.observe(stamp, message.published)
        self.story.joint_states(stamp / NANOSECONDS, content.position, content.velocity[0], content.effort[0])
        self._record(message, stamp)

    def _take_unstamped(self, message: Message) -> bool:
        """Tell and record a message whose time is known by now; whether it was."""
        stamp = self._clock.stamp_of(message.published)
        if stamp is None:
            return False
        content = self._listener.decode(message)
        if message.topic == "/valve/coil_current":
            self.story.current(stamp / NANOSECONDS, content.data)
        elif message.topic == "/valve/phase":
            line = self.story.phase(stamp / NANOSECONDS, Phase(content.data))
            if line is not None:
                self._say(line)
        self._record(message, stamp)
        return True

    def _record(self, message: Message, stamp: int) -> None:
        self._recorder.write(message.topic, TOPICS[message.topic], message.payload, stamp)

    def _say(self, line: str) -> None:
        self._console.print(line, highlight=False)
