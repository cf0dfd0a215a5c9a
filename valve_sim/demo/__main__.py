"""The command line of the demonstration, and its course."""

from __future__ import annotations

from valve_sim import early_signals  # noqa: F401 -- first, for its effect

# isort: split

import contextlib
import importlib
import os
import queue
import shlex
import shutil
import signal
import subprocess
import sys
import threading
import time
from bisect import bisect_right
from collections.abc import Iterator, Mapping, Sequence
from pathlib import Path
from types import FrameType
from typing import Any, Final, NamedTuple

import click
from rich.console import Console
from rich.live import Live

from valve_sim.demo.story import ENERGISED, LEAD, RESTING, Story, comparison
from valve_sim.files.parameter_files import default_valve
from valve_sim.model import Phase, ValveError
from valve_sim.recordings import BagRecorder, events_from_sensors, read_trace

VOLTS: Final = 9.0
SPEED: Final = 0.02
"""Model seconds a second: a stroke of 10 ms takes half a second, slow enough to watch."""
NANOSECONDS: Final = 1_000_000_000
DISCOVERY: Final = 0.4
"""s in which ROS discovers other nodes."""
FRAME: Final = 1.0 / 30.0
"""s between two updates."""
LONG_START: Final = 5.0
"""s to its first message after which a node is most likely compiling the model, which `make` has done before."""
LONGEST_SILENCE: Final = 20.0
"""s by which the node may be late before it counts as silent: a busy machine holds a process up for some."""
START_LIMIT: Final = 120.0
"""s within which the first message of the node must come."""
STOP_LIMIT: Final = 20.0
"""s within which the node must end after it was asked to; a killed one would stay on its topics for as long."""
COMMAND: Final = "/valve/coil_voltage"
FLOAT: Final = "std_msgs/msg/Float64"
TOPICS: Final[Mapping[str, str]] = {
    "/valve/joint_states": "sensor_msgs/msg/JointState",
    "/valve/coil": "sensor_msgs/msg/BatteryState",
    "/valve/phase": "std_msgs/msg/UInt8",
    "/valve/is_open": "std_msgs/msg/Bool",
}
"""What is heard and recorded: each topic's type."""


class DemoError(ValveError):
    """The demonstration cannot go on: one line that says why and what to do."""


class StoppedError(Exception):
    """A signal asked the demonstration to end."""


class StopSignals:
    """Notes SIGINT and SIGTERM from now on; `check` raises between two updates.

    An exception from the handler could come up anywhere, also inside ROS or the recorder, and leave half a bag.
    """

    def __init__(self) -> None:
        self._has_come = False
        for number in (signal.SIGINT, signal.SIGTERM):
            signal.signal(number, self._note)

    def check(self) -> None:
        """Raise StoppedError if a signal came."""
        if self._has_come:
            raise StoppedError

    def _note(self, number: int, frame: FrameType | None) -> None:
        self._has_come = True


class ValveProcess:
    """valve_node as a process of its own; what it prints goes to a file."""

    def __init__(self, command: Sequence[str], log: Path) -> None:
        self._log = log
        with log.open("wb") as output:
            # In a session of its own: Ctrl-C is for this process, which stops the node once the bag is closed.
            self._process = subprocess.Popen(command, stdout=output, stderr=output, start_new_session=True)

    def check(self) -> None:
        """Raise DemoError if it has ended."""
        code = self._process.poll()
        if code is not None:
            raise DemoError(f"valve_node ended with code {code}: {self.last_words()} (all it said: {self._log})")

    def last_words(self) -> str:
        """The last line that it printed."""
        lines = self._log.read_text(errors="replace").splitlines()
        return next((line.strip() for line in reversed(lines) if line.strip()), "it said nothing")

    def stop(self) -> None:
        """Ask it to end, and see that it does."""
        if self._process.poll() is None:
            self._process.send_signal(signal.SIGINT)
            try:
                self._process.wait(STOP_LIMIT)
            except subprocess.TimeoutExpired:
                self._process.kill()
                self._process.wait()


class ModelTime:
    """The valve's time, ns, from messages that show both its stamp and when it was published by the wall's clock, ns.

    valve_node publishes all of one step at once, the stamped joint states first. So a message without a stamp belongs
    to the last joint states published before it. Its arrival does not tell: on a busy machine one topic arrives tens of
    milliseconds later than another.
    """

    def __init__(self, speed: float) -> None:
        self._speed = speed
        self._published: list[int] = []
        self._stamps: list[int] = []
        self._lead = 0.0

    @property
    def latest(self) -> int | None:
        """The newest stamp; None before the first."""
        return self._stamps[-1] if self._stamps else None

    def observe(self, stamp: int, published: int) -> None:
        """A stamp was published at this time of the wall's clock."""
        if self._published and published < self._published[-1]:
            return  # the wall's clock was set back; keep the relation known so far
        self._stamps.append(stamp)
        self._published.append(published)
        self._lead = max(self._lead, (stamp - self._stamps[0]) - self._speed * (published - self._published[0]))

    def stamp_of(self, published: int) -> int | None:
        """The stamp of the step with which something was published; None while that may still be on its way."""
        if not self._published or published >= self._published[-1]:
            return None
        return self._stamps[max(bisect_right(self._published, published) - 1, 0)]

    def at(self, wall: int) -> int:
        """The valve's time at a time of the wall's clock, by the stamp with the least delay."""
        return self._stamps[0] + round(self._speed * (wall - self._published[0]) + self._lead)


class Message(NamedTuple):
    """What came on a topic: serialized, and when it was published by the wall's clock, ns."""

    topic: str
    payload: bytes
    published: int


class Listener:
    """This process's ROS node: hears the valve's topics in a thread of its own, commands its coil."""

    def __init__(self) -> None:
        from rclpy.executors import SingleThreadedExecutor
        from rclpy.node import Node
        from rclpy.qos import DurabilityPolicy, QoSProfile

        self.messages: queue.SimpleQueue[Message] = queue.SimpleQueue()
        self._node: Any = Node("valve_demo")
        latched = QoSProfile(depth=10, durability=DurabilityPolicy.TRANSIENT_LOCAL)
        for topic, kind in TOPICS.items():
            quality = latched if topic.endswith(("/phase", "/is_open")) else QoSProfile(depth=2000)
            self._node.create_subscription(message_class(kind), topic, self._hear(topic), quality, raw=True)
        self._commands = self._node.create_publisher(message_class(FLOAT), COMMAND, 10)
        self._executor = SingleThreadedExecutor()
        self._executor.add_node(self._node)
        self._is_closing = False
        self._thread = threading.Thread(target=self._spin, daemon=True)
        self._thread.start()

    def _spin(self) -> None:
        try:
            self._executor.spin()
        except Exception:
            # A signal or `close` shuts ROS down while it waits, which may then fail with any exception.
            if self._node.context.ok() and not self._is_closing:
                raise

    def _hear(self, topic: str) -> Any:
        def hear(payload: bytes, information: Mapping[str, int]) -> None:
            # A middleware without the time of publication gives 0.
            self.messages.put(Message(topic, bytes(payload), information["source_timestamp"] or time.time_ns()))

        return hear

    def command(self, volts: float) -> bytes:
        """Command the coil; returns the message as serialized."""
        from rclpy.serialization import serialize_message

        message = message_class(FLOAT)(data=volts)
        self._commands.publish(message)
        return bytes(serialize_message(message))

    @property
    def is_heard(self) -> bool:
        """Whether there is a subscriber to the commands."""
        return bool(self._commands.get_subscription_count() > 0)

    def expect_valves(self, most: int) -> None:
        """Raise DemoError if more nodes publish as this valve: their messages would be mixed up."""
        if self._node.count_publishers("/valve/joint_states") > most:
            raise DemoError(
                "another valve publishes on /valve/joint_states already; stop it, or choose another ROS_DOMAIN_ID"
            )

    def close(self) -> None:
        """Shut down the node."""
        from rclpy.utilities import try_shutdown

        self._is_closing = True
        self._executor.shutdown()
        self._thread.join(STOP_LIMIT)
        self._node.destroy_node()
        try_shutdown()


class Performance:
    """One run: messages in, bag and story out."""

    def __init__(
        self, listener: Listener, process: ValveProcess, recorder: BagRecorder, console: Console, speed: float,
        signals: StopSignals,
    ) -> None:  # fmt: skip
        self.story = Story()
        self._listener, self._process, self._recorder, self._console = listener, process, recorder, console
        self._speed, self._signals = speed, signals
        self._clock = ModelTime(speed)
        self._held: list[Message] = []
        self._sent, self._volts, self._coil_stamp = b"", 0.0, 0
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
        """Return when positions and coil are heard, and the node listens."""
        begin, is_told = time.monotonic(), False
        while self._clock.latest is None or not self._coil_stamp or not self._listener.is_heard:
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
        self._follow(LEAD)

    def stroke(self, volts: float) -> None:
        """Command a voltage, then none; follow the valve through both."""
        for level, duration in ((volts, ENERGISED), (0.0, RESTING)):
            self._say(f"[bold]{level:g} V[/] on the coil")
            self._sent = self._listener.command(level)
            self._follow(duration)

    def _follow(self, duration: float) -> None:
        """Watch for so many seconds of model time."""
        end = self._clock.at(time.time_ns()) + round(duration * NANOSECONDS)
        while (self._clock.latest or 0) < end:
            self._look()
            if self._clock.at(time.time_ns()) - end > LONGEST_SILENCE * self._speed * NANOSECONDS:
                raise DemoError(f"valve_node fell silent: {self._process.last_words()}")

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
        content, stamp = decoded(message)
        self._clock.observe(stamp, message.published)
        self.story.joint_states(stamp / NANOSECONDS, content.position, content.velocity[0], content.effort[0])
        self._record(message, stamp)

    def _take_coil(self, message: Message) -> None:
        """Take the current, and the voltage: a command is recorded as of when the coil has it, however late that is."""
        content, self._coil_stamp = decoded(message)
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
            content, _ = decoded(message)
            line = self.story.phase(stamp / NANOSECONDS, Phase(content.data))
            if line is not None:
                self._say(line)
        self._record(message, stamp)
        return True

    def _record(self, message: Message, stamp: int) -> None:
        self._recorder.write(message.topic, TOPICS[message.topic], message.payload, stamp)

    def _record_command(self, payload: bytes, stamp: int) -> None:
        self._recorder.write(COMMAND, FLOAT, payload, stamp)

    def _say(self, line: str) -> None:
        self._console.print(line, highlight=False)


def message_class(name: str) -> Any:
    """The class of a message: "std_msgs/msg/Bool" and the like."""
    package, _, kind = name.split("/")
    return getattr(importlib.import_module(f"{package}.msg"), kind)


def decoded(message: Message) -> tuple[Any, int]:
    """The message itself, and its stamp, ns, 0 without one."""
    from rclpy.serialization import deserialize_message

    content = deserialize_message(message.payload, message_class(TOPICS[message.topic]))
    header = getattr(content, "header", None)
    return content, 0 if header is None else int(header.stamp.sec) * NANOSECONDS + int(header.stamp.nanosec)


def perform(folder: Path, strokes: int, speed: float, console: Console, signals: StopSignals) -> None:
    """Run the demonstration; leaves strokes/ (a rosbag2 bag), stroke.png and valve_node.log in the folder.

    Raises:
        ValveError: no ROS 2, the node failed, or the folder cannot be written to.
        StoppedError: a signal came; unfinished files are removed.
    """
    bag, log = folder / "strokes", folder / "valve_node.log"
    try:
        shutil.rmtree(bag, ignore_errors=True)
        folder.mkdir(parents=True, exist_ok=True)
        log.touch()
    except OSError as error:
        raise DemoError(
            f"{folder}: cannot be written ({error.strerror}); choose another place with --output"
        ) from error
    _enter_ros(folder)
    listener = Listener()
    try:
        time.sleep(DISCOVERY)
        listener.expect_valves(0)
        signals.check()
        console.print(f"starting valve_node at {speed:g} of real time")
        command = [sys.executable, "-m", "valve_sim.nodes", "valve_node", "--ros-args", "-p", f"time_scale:={speed!r}"]
        process = ValveProcess(command, log)
        try:
            with BagRecorder(bag) as recorder:
                performance = Performance(listener, process, recorder, console, speed, signals)
                performance.wait_for_valve()
                with performance.shown():
                    performance.rest()
                    for number in range(1, strokes + 1):
                        console.print(f"\nstroke {number} of {strokes}")
                        performance.stroke(VOLTS)
        finally:
            process.stop()
    finally:
        listener.close()
    _conclude(bag, folder / "stroke.png", performance.story, console)


def _enter_ros(folder: Path) -> None:
    os.environ.setdefault("ROS_AUTOMATIC_DISCOVERY_RANGE", "LOCALHOST")
    os.environ.setdefault("ROS_LOG_DIR", str((folder / "log").resolve()))
    try:
        import rclpy
        from rclpy.signals import SignalHandlerOptions

        for kind in TOPICS.values():
            message_class(kind)
    except ImportError as error:
        raise DemoError(
            f"ROS 2 is not here ({error}); source your ROS 2, or type make run, which installs its wheels"
        ) from error
    # Signals are handled by this process: ROS would shut down while a bag is still open.
    rclpy.init(args=[], signal_handler_options=SignalHandlerOptions.NO)


def _conclude(bag: Path, picture: Path, story: Story, console: Console) -> None:
    from valve_sim.identification.reporting.figures import draw_response, save_figure

    parameters = default_valve().parameters
    seen = events_from_sensors(read_trace(bag), parameters.pilot_gap)
    console.print()
    console.print(comparison(seen))
    console.print(
        "(from the recorded positions, since the voltage on the coil; the lines above are good to one sample, "
        "where none was missed)"
    )
    arrivals = {event.kind: event.after_command for event in seen[0].events} if seen else {}
    names = {"pilot_reaches_main": "t1", "reaches_stop": "t2"}
    figure = draw_response(
        *story.first_stroke(),
        f"valve_node at {VOLTS:g} V, as it published",
        marks={name: arrivals[kind] for kind, name in names.items() if kind in arrivals},
        levels={"gap": parameters.pilot_gap, "stroke": parameters.stroke},
    )
    save_figure(figure, picture)
    console.print(f"recorded {bag}, drew {picture}", highlight=False, soft_wrap=True)
    program = "valve-sim" if shutil.which("valve-sim") else f"{shlex.quote(sys.executable)} -m valve_sim"
    console.print(f"next: {program} info {shlex.quote(str(bag))}", highlight=False, soft_wrap=True)


@click.command(context_settings={"show_default": True})
@click.option("--strokes", type=click.IntRange(1, 100), default=3, help="How many.")
@click.option("--speed", type=click.FloatRange(0.001, 1.0), default=SPEED, help="Model seconds a second.")
@click.option(
    "--output", type=click.Path(path_type=Path), default=Path("runs/demo"), help="Folder for bag and picture."
)
def main(strokes: int, speed: float, output: Path) -> None:
    """Show a valve at work on ROS 2 topics, record it, and compare it with the paper."""
    try:
        perform(output, strokes, speed, Console(), StopSignals())
    except ValveError as error:
        click.echo(f"demo: {error}", err=True)
        sys.exit(2)
    except StoppedError:
        click.echo("demo: stopped", err=True)
        sys.exit(130)


if __name__ == "__main__":
    main()
