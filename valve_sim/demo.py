"""`make run`: a valve at work on ROS 2 topics, for eyes that see it for the first time.

Starts valve_node as a process of its own, in slow motion; commands strokes on its topic; shows what it publishes as it
does so; records the topics as a rosbag2 bag; and puts the event times beside the paper's.

All times are the valve's own: a message without a stamp is recorded under the model time at which it came, as
`ros2 bag record --use-sim-time` does, so that the bag replays and identifies like one from a test bench.
"""

from __future__ import annotations

import contextlib
import math
import os
import queue
import shutil
import signal
import subprocess
import sys
import threading
import time
from collections.abc import Iterator, Mapping, Sequence
from pathlib import Path
from types import FrameType
from typing import TYPE_CHECKING, Any, Final, NamedTuple, NoReturn

import click
import numpy as np
from rich.console import Console
from rich.live import Live
from rich.table import Table

from valve_sim.files.parameter_files import default_valve
from valve_sim.model import Drive, Phase, Response, ValveError
from valve_sim.traces import BagRecorder, StrokeEvents, events_from_sensors, read_trace

if TYPE_CHECKING:
    from rclpy.node import Node

VOLTS: Final = 9.0
ENERGISED: Final = 0.030
"""s of model time that the coil is on; the valve needs 10 ms."""
RESTING: Final = 0.030
"""s of model time that it is off; the valve needs 13 ms to close."""
LEAD: Final = 0.005
"""s of model time before the first command, so that the bag shows the valve at rest."""
SPEED: Final = 0.02
"""Model seconds a second: a stroke of 10 ms takes half a second, which eyes can follow."""
FRAME: Final = 1.0 / 30.0
"""s between two looks at what came."""
START_LIMIT: Final = 60.0
"""s that the node may take to its first message; compiling the model takes ten, once."""
DISCOVERY: Final = 0.4
"""s in which ROS finds out who else is there."""
STOP_LIMIT: Final = 5.0
BAR: Final = 41
"""Characters that stand for the whole travel: one for 30 µm."""
NANOSECONDS: Final = 1_000_000_000

PAPER: Final[Mapping[str, tuple[str, float]]] = {
    "pilot_reaches_main": ("t1 main picked up", 5.3e-3),
    "reaches_stop": ("t2 core reached", 9.9e-3),
    "main_seats": ("main seated", math.nan),
    "reaches_seat": ("pilot seated", math.nan),
}
"""Arrivals by name: words, and the time after the command that the paper measured at 9 V, s."""

_TOPICS: Final[Mapping[str, str]] = {
    "/valve/joint_states": "sensor_msgs/msg/JointState",
    "/valve/coil_current": "std_msgs/msg/Float64",
    "/valve/phase": "std_msgs/msg/UInt8",
    "/valve/is_open": "std_msgs/msg/Bool",
}
_COMMAND: Final = "/valve/coil_voltage"
_STEPS: Final[Mapping[tuple[Phase, Phase], str]] = {
    (Phase.CLOSED, Phase.PILOT): "the pilot plunger leaves its seat",
    (Phase.PILOT, Phase.MAIN): "the pilot plunger takes the main plunger along",
    (Phase.PILOT, Phase.GAP_HOLD): "the pilot plunger waits: the main plunger is too heavy yet",
    (Phase.GAP_HOLD, Phase.MAIN): "the main plunger is lifted",
    (Phase.MAIN, Phase.OPEN): "all parts have reached the core: open",
    (Phase.OPEN, Phase.MAIN): "all parts leave the core",
    (Phase.MAIN, Phase.PILOT): "the main plunger is back on its seat",
    (Phase.PILOT, Phase.CLOSED): "the pilot plunger is back on its seat: closed",
}


class DemoError(ValveError):
    """The demonstration cannot go on: one line that says why and what to do."""


class Sample(NamedTuple):
    """What the node publishes in one step: s, m, m, m/s, N, A, Phase."""

    time: float
    pilot: float
    main: float
    velocity: float
    attraction: float
    current: float
    phase: Phase


class ModelClock:
    """What time it is in the valve, from the stamps that come out of it.

    Args:
        speed: model seconds a second.
    """

    def __init__(self, speed: float) -> None:
        self._speed = speed
        self._origin: tuple[int, int] | None = None
        self._lead = -math.inf
        self.latest = 0
        """The newest stamp, ns."""

    @property
    def is_set(self) -> bool:
        """Whether a stamp has come yet."""
        return self._origin is not None

    def observe(self, stamp: int, received: int) -> None:
        """A stamp (ns) that came at this time of the wall's clock (ns); the least delayed one counts."""
        if self._origin is None:
            self._origin = stamp, received
        self.latest = max(self.latest, stamp)
        first_stamp, first_received = self._origin
        self._lead = max(self._lead, (stamp - first_stamp) - self._speed * (received - first_received))

    def at(self, wall: int) -> int:
        """Model time, ns, at a time of the wall's clock, ns."""
        if self._origin is None:
            raise RuntimeError("a stamp comes before the first question")
        first_stamp, first_received = self._origin
        return first_stamp + round(self._speed * (wall - first_received) + self._lead)


class Story:
    """What the valve has done so far, and how to say it."""

    def __init__(self) -> None:
        self.samples: list[Sample] = []
        self.commands: list[tuple[float, float]] = []
        self._phase = Phase.CLOSED
        self._current = 0.0

    def command(self, when: float, volts: float) -> str:
        """The coil was commanded at model time `when`, s."""
        self.commands.append((when, volts))
        return f"[bold]{volts:g} V[/] on the coil"

    def joint_states(self, when: float, position: Sequence[float], velocity: float, attraction: float) -> None:
        """Positions (pilot, main; m), velocity and attraction of the pilot plunger at model time `when`, s."""
        sample = Sample(when, position[0], position[1], velocity, attraction, self._current, self._phase)
        self.samples.append(sample)

    def current(self, amperes: float) -> None:
        """The coil current."""
        self._current = amperes

    def phase(self, when: float, phase: Phase) -> str | None:
        """A phase was announced; the line to show, if it is worth one."""
        step = self._phase, phase
        self._phase = phase
        words = _STEPS.get(step)
        # The last trace of current lifts a closed pilot plunger by less than an atom: no news.
        is_idle = not self.commands or self.commands[-1][1] == 0.0
        if words is None or not self.commands or (step[1] is Phase.PILOT and step[0] is Phase.CLOSED and is_idle):
            return None
        return f"{1e3 * (when - self.commands[-1][0]):8.2f} ms  {words}"

    def table(self, stroke: float) -> Table:
        """The valve now, with bars as long as its travel; `stroke` in m."""
        table = Table.grid(padding=(0, 2))
        if not self.samples:
            return table
        now = self.samples[-1]
        since = 1e3 * (now.time - self.commands[-1][0]) if self.commands else 0.0
        phase = self._phase.name.lower().replace("_", " ")
        table.add_row("pilot plunger", _bar(now.pilot / stroke), f"{1e6 * now.pilot:7.1f} µm")
        table.add_row("main plunger", _bar(now.main / stroke), f"{1e6 * now.main:7.1f} µm")
        table.add_row("velocity", f"{1e3 * now.velocity:.1f} mm/s", f"{now.current:7.3f} A")
        table.add_row("phase", f"[bold]{phase}[/]", f"{since:7.2f} ms")
        return table

    def first_stroke(self) -> tuple[Response, Drive]:
        """What was heard around the first stroke, and what was commanded; its command is time 0."""
        origin, stop = self.commands[0][0], self.commands[1][0] + RESTING
        heard = [sample for sample in self.samples if origin - LEAD <= sample.time < stop]
        columns = np.array(heard, dtype=np.float64).reshape(-1, len(Sample._fields)).T
        times, pilot, main, velocity, attraction, current, phase = columns.copy()
        response = Response(times - origin, pilot, main, velocity, current, attraction, phase.astype(np.uint8), ())
        commanded, volts = np.array(self.commands[:2]).T
        return response, Drive(commanded - origin, volts)


def _bar(share: float) -> str:
    full = round(BAR * min(max(share, 0.0), 1.0))
    return "█" * full + "░" * (BAR - full)


class Message(NamedTuple):
    """What came on a topic: serialized, and when by the wall's clock, ns."""

    topic: str
    payload: bytes
    received: int


class Listener:
    """This process's ROS node: hears the valve's topics in a thread of its own, commands its coil."""

    def __init__(self) -> None:
        from rclpy.executors import ExternalShutdownException, SingleThreadedExecutor
        from rclpy.node import Node
        from rclpy.qos import DurabilityPolicy, QoSProfile

        self.messages: queue.SimpleQueue[Message] = queue.SimpleQueue()
        self.node: Node = Node("valve_demo")
        self._types = message_classes()
        latched = QoSProfile(depth=10, durability=DurabilityPolicy.TRANSIENT_LOCAL)
        for topic, kind in _TOPICS.items():
            quality = latched if topic.endswith(("/phase", "/is_open")) else QoSProfile(depth=2000)
            self.node.create_subscription(self._types[kind], topic, self._hear(topic), quality, raw=True)
        self._commands = self.node.create_publisher(self._types["std_msgs/msg/Float64"], _COMMAND, 10)
        self._executor = SingleThreadedExecutor()
        self._executor.add_node(self.node)

        def spin() -> None:
            with contextlib.suppress(ExternalShutdownException):
                self._executor.spin()

        self._thread = threading.Thread(target=spin, daemon=True)
        self._thread.start()

    def _hear(self, topic: str) -> Any:
        return lambda payload: self.messages.put(Message(topic, bytes(payload), time.monotonic_ns()))

    def decode(self, message: Message) -> Any:
        """The message itself."""
        from rclpy.serialization import deserialize_message

        return deserialize_message(message.payload, self._types[_TOPICS[message.topic]])

    def command(self, volts: float) -> bytes:
        """Command the coil; returns the message as serialized."""
        from rclpy.serialization import serialize_message

        message = self._types["std_msgs/msg/Float64"](data=volts)
        self._commands.publish(message)
        return bytes(serialize_message(message))

    @property
    def is_heard(self) -> bool:
        """Whether somebody listens to the commands."""
        return bool(self._commands.get_subscription_count() > 0)

    def expect_valves(self, most: int) -> None:
        """No more nodes than so many publish as this valve.

        Raises:
            DemoError: more do, and one would be mistaken for the other.
        """
        if self.node.count_publishers("/valve/joint_states") > most:
            raise DemoError(
                "another valve publishes on /valve/joint_states already; stop it, or choose another ROS_DOMAIN_ID"
            )

    def close(self) -> None:
        """Leave ROS."""
        from rclpy.utilities import try_shutdown

        self._executor.shutdown()
        self._thread.join(STOP_LIMIT)
        self.node.destroy_node()
        try_shutdown()


def message_classes() -> dict[str, Any]:
    """The message types of the topics by name."""
    from sensor_msgs.msg import JointState
    from std_msgs.msg import Bool, Float64, UInt8

    return {
        "sensor_msgs/msg/JointState": JointState,
        "std_msgs/msg/Float64": Float64,
        "std_msgs/msg/UInt8": UInt8,
        "std_msgs/msg/Bool": Bool,
    }


class ValveProcess:
    """valve_node, running.

    Args:
        command: what to run. log: takes what it prints.
    """

    def __init__(self, command: Sequence[str], log: Path) -> None:
        self._log = log
        with log.open("wb") as output:
            self._process = subprocess.Popen(
                list(command),
                stdout=output,
                stderr=subprocess.STDOUT,
                # Ctrl-C is this process's to handle: it stops the node when the bag is safe.
                start_new_session=True,
            )

    def check(self) -> None:
        """The node lives.

        Raises:
            DemoError: it has ended.
        """
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


class Performance:
    """One run: messages in, bag and story out.

    Args:
        listener: hears the valve. process: is the valve. recorder: takes the bag. console: takes the words.
        speed: model seconds a second.
    """

    def __init__(
        self, listener: Listener, process: ValveProcess, recorder: BagRecorder, console: Console, speed: float
    ) -> None:
        self.story = Story()
        self._listener, self._process, self._recorder, self._console = listener, process, recorder, console
        self._speed = speed
        self._clock = ModelClock(speed)
        self._early: list[Message] = []
        self._stroke = default_valve().parameters.stroke
        self._live: Live | None = None

    @contextlib.contextmanager
    def shown(self) -> Iterator[None]:
        """While this lasts, a terminal shows the valve as it moves; elsewhere lines must do."""
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
        """
        deadline = time.monotonic() + START_LIMIT
        while not (self._clock.is_set and self._listener.is_heard):
            if time.monotonic() > deadline:
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
        end = self._clock.at(time.monotonic_ns()) + round(duration * NANOSECONDS)
        while self._clock.latest < end:
            self._look()
            if self._clock.at(time.monotonic_ns()) - end > 5 * self._speed * NANOSECONDS:
                raise DemoError(f"valve_node fell silent: {self._process.last_words()}")

    def _command(self, volts: float) -> float:
        """Command and record; the model time of it, s."""
        when = self._clock.at(time.monotonic_ns())
        self._recorder.write(_COMMAND, "std_msgs/msg/Float64", self._listener.command(volts), when)
        return when / NANOSECONDS

    def _look(self) -> None:
        time.sleep(FRAME)
        self._process.check()
        self._listener.expect_valves(1)
        while not self._listener.messages.empty():
            self._take(self._listener.messages.get())
        if self._live is not None:
            self._live.update(self.story.table(self._stroke), refresh=True)

    def _take(self, message: Message) -> None:
        content = self._listener.decode(message)
        if message.topic == "/valve/joint_states":
            stamp = content.header.stamp.sec * NANOSECONDS + content.header.stamp.nanosec
            is_first = not self._clock.is_set
            self._clock.observe(stamp, message.received)
            self.story.joint_states(stamp / NANOSECONDS, content.position, content.velocity[0], content.effort[0])
            early, self._early = (self._early, []) if is_first else ([], self._early)
            for held in early:
                self._take(held)
        elif not self._clock.is_set:
            self._early.append(message)
            return
        elif message.topic == "/valve/coil_current":
            self.story.current(content.data)
        elif message.topic == "/valve/phase":
            line = self.story.phase(self._clock.latest / NANOSECONDS, Phase(content.data))
            if line is not None:
                self._say(line)
        self._recorder.write(message.topic, _TOPICS[message.topic], message.payload, self._clock.at(message.received))

    def _say(self, line: str) -> None:
        self._console.print(line, highlight=False)


def comparison(strokes: Sequence[StrokeEvents]) -> Table:
    """Event times of the strokes beside the paper's, ms after the command."""
    openings = sum(found.stroke.kind == "opening" for found in strokes)
    table = Table(title="ms after the command", title_justify="left")
    table.add_column("event")
    for number in range(1, openings + 1):
        table.add_column(f"stroke {number}", justify="right")
    table.add_column("paper", justify="right")
    table.add_column("difference", justify="right")
    for kind, (words, paper) in PAPER.items():
        times = [event.after_command for found in strokes for event in found.events if event.kind == kind]
        cells = [f"{1e3 * when:.3f}" for when in times[:openings]] + ["–"] * (openings - len(times))
        is_known = times and not math.isnan(paper)
        difference = f"{1e3 * (float(np.mean(times)) - paper):+.3f}" if is_known else "–"
        table.add_row(words, *cells, "–" if math.isnan(paper) else f"{1e3 * paper:.1f}", difference)
    return table


def perform(folder: Path, strokes: int, speed: float, console: Console) -> None:
    """Run the demonstration; leaves strokes/ (a rosbag2 bag), stroke.png and valve_node.log in the folder.

    Raises:
        DemoError: no ROS 2, or the node failed.
        ValveError: the folder cannot be written to.
    """
    bag = folder / "strokes"
    try:
        shutil.rmtree(bag, ignore_errors=True)
        folder.mkdir(parents=True, exist_ok=True)
        log = folder / "valve_node.log"
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
        console.print(f"starting valve_node at {speed:g} of real time (the first time takes 10 s)")
        command = [sys.executable, "-m", "valve_sim.nodes.valve_node", "--ros-args", "-p", f"time_scale:={speed!r}"]
        process = ValveProcess(command, log)
        try:
            with BagRecorder(bag) as recorder:
                performance = Performance(listener, process, recorder, console, speed)
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

        message_classes()
    except ImportError as error:
        raise DemoError(
            f"ROS 2 is not here ({error}); source your ROS 2, or type make run, which installs its wheels"
        ) from error
    # Signals stay this process's own: ROS would shut down under a bag that is not closed yet.
    rclpy.init(args=[], signal_handler_options=SignalHandlerOptions.NO)


def _conclude(bag: Path, picture: Path, story: Story, console: Console) -> None:
    from valve_sim.identification.plots import plot_response

    parameters = default_valve().parameters
    seen = events_from_sensors(read_trace(bag), parameters.pilot_gap)
    console.print()
    console.print(comparison(seen))
    console.print("(from the recorded positions; a command is on its way for some hundredths)")
    arrivals = {event.kind: event.after_command for event in seen[0].events} if seen else {}
    names = {"pilot_reaches_main": "t1", "reaches_stop": "t2"}
    plot_response(
        picture,
        *story.first_stroke(),
        f"valve_node at {VOLTS:g} V, as it published",
        marks={name: arrivals[kind] for kind, name in names.items() if kind in arrivals},
        levels={"gap": parameters.pilot_gap, "stroke": parameters.stroke},
    )
    console.print(f"recorded {bag}, drew {picture}", highlight=False)
    console.print(f"next: valve-sim info {bag}", highlight=False)


@contextlib.contextmanager
def _stops_once() -> Iterator[None]:
    """Until this ends, the first SIGINT or SIGTERM raises KeyboardInterrupt, and none disturbs the tidying up."""
    numbers = (signal.SIGINT, signal.SIGTERM)

    def stop(number: int, frame: FrameType | None) -> NoReturn:
        for each in numbers:
            signal.signal(each, signal.SIG_IGN)
        raise KeyboardInterrupt

    before = {number: signal.signal(number, stop) for number in numbers}
    try:
        yield
    finally:
        for number, handler in before.items():
            signal.signal(number, handler)


@click.command(context_settings={"show_default": True})
@click.option("--strokes", type=click.IntRange(1, 100), default=3, help="How many.")
@click.option("--speed", type=click.FloatRange(0.001, 1.0), default=SPEED, help="Model seconds a second.")
@click.option(
    "--output", type=click.Path(path_type=Path), default=Path("runs/demo"), help="Folder for bag and picture."
)
def main(strokes: int, speed: float, output: Path) -> None:
    """Show a valve at work on ROS 2 topics, record it, and compare it with the paper."""
    try:
        with _stops_once():
            perform(output, strokes, speed, Console())
    except ValveError as error:
        click.echo(f"demo: {error}", err=True)
        sys.exit(2)
    except KeyboardInterrupt:
        click.echo("demo: stopped", err=True)
        sys.exit(130)


if __name__ == "__main__":
    main()
