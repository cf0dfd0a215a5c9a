"""Messages that nobody would send on purpose, to nodes that run: `python -m benchmarks.fuzz --only topics`.

valve_node, a second one on simulated time, identification_node, monitor_node, opcua_node and archive_node get, at up to
10 kHz and more: voltages that are no numbers, denormal or huge; JointStates of wrong lengths, names and stamps from
1901 to 2038 (what the stamp can hold), forwards and backwards; a /clock that does likewise; reports and findings
whose values are no numbers, too long or out of bounds; serialized messages that are cut or changed; publishers of
another type on the topic. Then each must live, have written no traceback, not have grown, and do its work: step, obey
the next good command, play, count samples, serve, archive. What is not so is
printed as a finding, and the exit code is 1.

Needs ROS 2. The same seed sends the same messages.
"""

from __future__ import annotations

import array
import collections
import contextlib
import importlib.util
import itertools
import math
import socket
import struct
import tempfile
import time
from collections.abc import Callable, Iterator, Mapping, Sequence
from pathlib import Path
from typing import Any, Final, NamedTuple

import numpy as np
import rclpy
from builtin_interfaces.msg import Time
from diagnostic_msgs.msg import DiagnosticArray, DiagnosticStatus, KeyValue
from nodes.ros import LATCHED
from nodes.ros_process import NodeProcess, Probe, free_port, running
from rclpy.serialization import serialize_message
from rosgraph_msgs.msg import Clock
from sensor_msgs.msg import BatteryState, Imu, JointState
from std_msgs.msg import Bool, Float64, String, UInt8

from benchmarks.common import resident
from benchmarks.nodes.driver import ros
from valve_sim.model.errors import ValveError
from valve_sim.records.archive import Archive

ROOT: Final = Path(__file__).resolve().parents[2]

PATIENCE: Final = 60.0
"""s, after which a node that does not do its work counts as hanging."""
MOST_GROWTH: Final = 50.0
"""MB by which a node may have grown since the first round; until then it loads what it needs for its first stroke."""
BURST: Final = 1000
"""Messages that are sent without a pause."""
FLOOD_RATE: Final = 10_000.0
"""Hz, on average: what a burst was too quick for, a pause makes up."""
NUMBERS: Final = (
    math.nan, math.inf, -math.inf, 1e308, -1e308, 5e-324, -5e-324, 2.2e-308, -0.0, 0.0, 30.0, -30.0,
    math.nextafter(30.0, math.inf), 1e16, 1e-3, 9.0, -9.0,
)  # fmt: skip
SECONDS: Final = (0, 1, -1, -(2**31), 2**31 - 1, 2**31 - 2, 1_700_000_000, 10_000)
"""Of a stamp: 1970, 1901, 2038; 2106 is beyond what its 32 bits with a sign can hold."""
NAMES: Final = ("pilot_plunger", "main_plunger", "elbow", "", "pilot_plunger\x00", "é" * 300, "<script>")

REPORT: Final = {
    "schema": "valve_sim/stroke/1", "valve": "/valve", "time": "1.7e9", "stroke": "1", "volts": "9.0", "t1": "5.3e-3",
    "t2": "9.9e-3", "opened": "true", "closed": "true", "residual_rms_um": "1.0", "scores.a": "1.0",
    "alarm.raised": "false", "alarm.sum": "1.0", "alarm.threshold": "9.0", "damping.pilot_damping.value": "1.0",
}  # fmt: skip
"""Keys and values of ~/stroke_report."""
FINDING: Final = {
    "valve": "/valve", "stroke": "3", "time": "1.7e9", "kind": "effects", "effects": "stiction", "probability": "0.9",
    "parameters.stiction.force.value": "0.3", "parameters.stiction.force.stderr": "0.01",
}  # fmt: skip
VALUES: Final = ("nan", "inf", "1e308", "", "x" * 3000, "-1", "é\x00", "[" * 200_000, "9" * 30_000, "é" * 200_000)

Random = np.random.Generator


# --- what is sent ---


def any_number(random: Random) -> float:
    """A nasty number, any 64 bits, or a small one."""
    kind = random.integers(3)
    if kind == 0:
        return NUMBERS[int(random.integers(len(NUMBERS)))]
    if kind == 1:
        return float(struct.unpack("<d", random.bytes(8))[0])
    return float(random.uniform(-31.0, 31.0))


def any_voltage(random: Random) -> Float64:
    """A command."""
    return Float64(data=any_number(random))


def any_stamp(random: Random) -> Time:
    """A stamp at an end of what it can hold, about now, or anywhere."""
    kind = random.integers(3)
    if kind == 0:
        seconds = SECONDS[int(random.integers(len(SECONDS)))]
    elif kind == 1:
        seconds = int(time.time()) + int(random.integers(-2, 3))
    else:
        seconds = int(random.integers(-(2**31), 2**31))
    nanoseconds = (0, 1, 999_999_999, 1_000_000_000, 2**32 - 1, int(random.integers(10**9)))
    return Time(sec=seconds, nanosec=nanoseconds[int(random.integers(len(nanoseconds)))])


def any_joint_state(random: Random) -> JointState:
    """Names and arrays of any lengths; half of them could be samples but for their numbers and stamps."""
    message = JointState()
    message.header.stamp = any_stamp(random)
    if random.random() < 0.5:
        message.name = ["pilot_plunger", "main_plunger"]
    else:
        message.name = [NAMES[int(index)] for index in random.integers(len(NAMES), size=random.integers(5))]
    for field in ("position", "velocity", "effort"):
        size = 2 if random.random() < 0.5 else int(random.integers(300))
        numbers = random.uniform(0.0, 1.3e-3, size) if random.random() < 0.5 else random.standard_normal(size)
        values = array.array("d", numbers.tolist())
        for index in range(min(size, 2)):
            if random.random() < 0.3:
                values[index] = any_number(random)
        setattr(message, field, values)
    return message


def any_clock(random: Random) -> Clock:
    """A time, in no order."""
    return Clock(clock=any_stamp(random))


def any_coil(random: Random) -> BatteryState:
    """A stamped current and voltage."""
    message = BatteryState()
    message.header.stamp = any_stamp(random)
    message.current, message.voltage = (float(np.float32(min(max(any_number(random), -3e38), 3e38))) for _ in range(2))
    return message


def one_of(values: Sequence[Any], random: Random) -> Any:
    """Any of them."""
    return values[int(random.integers(len(values)))]


def any_diagnostics(random: Random, said: Mapping[str, str] = FINDING) -> DiagnosticArray:
    """Statuses of the nodes that are heard, with values of a finding or a stroke, some of which hold anything."""
    message = DiagnosticArray()
    message.header.stamp = any_stamp(random)
    for _ in range(int(random.integers(4))):
        texts = (*said.values(), *VALUES)
        values = {name: value if random.random() < 0.7 else one_of(texts, random) for name, value in said.items()}
        message.status.append(
            DiagnosticStatus(
                level=bytes([int(random.integers(256))]),
                name=one_of(("monitor: valve", "monitor: finding", "valve: timing", "", "x: y"), random),
                message=one_of(("as commissioned", "x" * 3000, ""), random),
                values=[KeyValue(key=name, value=value) for name, value in values.items()],
            )
        )
    return message


def any_report(random: Random) -> DiagnosticArray:
    """Reports of strokes."""
    return any_diagnostics(random, REPORT)


def broken(message: Any, random: Random) -> bytes:
    """A serialized message that is cut, or some of whose bytes are others."""
    content = bytearray(serialize_message(message))
    if random.random() < 0.5:
        return bytes(content[: int(random.integers(4, len(content) + 1))])
    for _ in range(int(random.integers(1, 5))):
        content[int(random.integers(4, len(content)))] = int(random.integers(256))
    return bytes(content)


class Surface(NamedTuple):
    """A topic that is flooded: its type, what makes a message, types that do not belong there, and its share."""

    topic: str
    kind: Any
    make: Callable[[Random], Any]
    wrong_kinds: tuple[Any, ...]
    share: float


SURFACES: Final = (
    Surface("/valve/coil_voltage", Float64, any_voltage, (String, JointState), 0.25),
    Surface("/valve/measured/joint_states", JointState, any_joint_state, (Imu, Float64), 0.25),
    Surface("/valve/measured/coil", BatteryState, any_coil, (Float64,), 0.1),
    Surface("/clock", Clock, any_clock, (), 0.1),
    Surface("/monitor/stroke_report", DiagnosticArray, any_report, (String,), 0.15),
    Surface("/monitor/finding", DiagnosticArray, any_diagnostics, (String,), 0.1),
    Surface("/diagnostics", DiagnosticArray, any_diagnostics, (), 0.05),
)


def stranger(name: str) -> Any:
    """A node in a participant of its own."""
    context = rclpy.Context()
    rclpy.init(context=context)
    return rclpy.create_node(name, context=context)


class Sender:
    """Floods one surface."""

    def __init__(self, probe: Probe, surface: Surface) -> None:
        self.sent: collections.Counter[str] = collections.Counter()
        self._probe = probe
        self._surface = surface
        # Findings are latched: a subscriber that wants them so hears no other publisher.
        self._good = probe.talker(
            surface.topic, surface.kind, LATCHED if surface.topic.endswith(("/finding", "/stroke_report")) else 10
        )
        # A participant knows one type of a topic, so each wrong one has a participant of its own.
        self._strangers = [
            stranger(f"{kind.__name__.lower()}_on{surface.topic.replace('/', '_')}") for kind in surface.wrong_kinds
        ]
        self._wrong = [
            (kind, node.create_publisher(kind, surface.topic, 10))
            for kind, node in zip(surface.wrong_kinds, self._strangers, strict=True)
        ]

    def close(self) -> None:
        """End the publishers of other types."""
        for node in self._strangers:
            node.context.shutdown()

    def flood(self, count: int, random: Random) -> None:
        """So many messages: nine of ten well-formed, one broken or of another type."""
        begun = time.monotonic()
        for number in range(1, count + 1):
            self._send(random)
            if number % BURST == 0:
                self._probe.spin_for(max(1e-3, begun + number / FLOOD_RATE - time.monotonic()))

    def _send(self, random: Random) -> None:
        kind = random.random()
        if kind < 0.9:
            self._good.publish(self._surface.make(random))
            self.sent["well-formed"] += 1
        elif kind < 0.99 or not self._wrong:
            self._good.publish(broken(self._surface.make(random), random))
            self.sent["broken"] += 1
        else:
            make, publisher = self._wrong[int(random.integers(len(self._wrong)))]
            publisher.publish(make())
            self.sent["of another type"] += 1


# --- what must still work ---


Nodes = dict[str, NodeProcess]
NEEDS: Final = {
    "valve": "rclpy", "simulated": "rclpy", "identification": "rclpy", "monitor": "rclpy", "archive": "rclpy",
    "opcua": "asyncua",
}  # fmt: skip
"""The library that each node needs."""
NAMES_OF_NODES: Final = tuple(name for name, module in NEEDS.items() if importlib.util.find_spec(module) is not None)


@contextlib.contextmanager
def under_fire(folder: Path, names: Sequence[str], port: int) -> Iterator[Nodes]:
    """The nodes of these names while inside."""
    on_sim_time = ["--ros-args", "-p", "use_sim_time:=true"]
    bag = ["-p", f"bag:={ROOT / 'bags' / 'one_opening.mcap'}", "-p", "loop:=true", "-p", "rate:=0.01"]
    how: dict[str, tuple[list[str], str]] = {
        "valve": ([], "valve_node"),
        "simulated": ([*on_sim_time, "-r", "__node:=simulated"], "valve_node"),
        "identification": ([*on_sim_time, *bag, "-p", f"output:={folder}"], "identification_node"),
        "monitor": ([], "monitor_node"),
        "archive": (["--ros-args", "-p", f"folder:={folder / 'archive'}"], "archive_node"),
        "opcua": (["--ros-args", "-p", f"folder:={folder / 'opcua'}", "-p", f"port:={port}"], "opcua_node"),
    }
    with contextlib.ExitStack() as stack:
        yield {name: stack.enter_context(running(folder, *how[name])) for name in names}


class Check:
    """What each node does when all is well, as seen from outside."""

    def __init__(self, nodes: Nodes, folder: Path, port: int) -> None:
        self.nodes, self._folder, self._port = nodes, folder, port
        self.findings: list[str] = []
        self.probe = Probe("/valve")
        self._now, self._acted = 10**9, 0.0
        probe = self.probe
        self._joints = {name: probe.hear(f"/{name}/joint_states", JointState) for name in ("valve", "simulated")}
        self._phases = {name: probe.hear(f"/{name}/phase", UInt8, latched=True) for name in ("valve", "simulated")}
        self._open = {name: probe.hear(f"/{name}/is_open", Bool, latched=True) for name in ("valve", "simulated")}
        self._played = probe.hear("/identification/measured/joint_states", JointState)
        self._diagnostics = probe.hear("/diagnostics", DiagnosticArray)
        self._voltage = {name: probe.talker(f"/{name}/coil_voltage", Float64) for name in ("valve", "simulated")}
        self._samples = probe.talker("/valve/measured/joint_states", JointState)
        self._clock = probe.talker("/clock", Clock)
        self._reports = probe.talker("/monitor/stroke_report", DiagnosticArray, LATCHED)

    def forget(self) -> None:
        """Empty the ears; the latched ones keep their last."""
        for heard in (*self._joints.values(), self._played, self._diagnostics):
            heard.clear()
        for latched in (*self._phases.values(), *self._open.values()):
            del latched[:-1]

    def all(self, when: str) -> None:
        """Find out whether all is well."""
        self._lives(when)
        checks = {
            "valve": lambda: self._valve_works("valve", lambda: None),
            "simulated": lambda: self._valve_works("simulated", self._tick),
            "identification": self._identification_works,
            "monitor": self._monitor_works,
            "archive": self._archive_works,
            "opcua": self._opcua_works,
        }
        for name in self.nodes:
            if not checks[name]():
                self.findings.append(f"{when}: {name} does not do its work within {PATIENCE:g} s")
        self._lives(when)

    def megabytes(self) -> dict[str, float]:
        """Memory of each process, MB."""
        processes = {name: process.process for name, process in self.nodes.items()}
        return {name: resident(one.pid) if one.poll() is None else 0.0 for name, one in processes.items()}

    def _lives(self, when: str) -> None:
        for name, process in self.nodes.items():
            if process.process.poll() is not None:
                self.findings.append(f"{when}: {name} has ended with code {process.process.returncode}")
            if "Traceback" in process.output:
                self.findings.append(f"{when}: {name} wrote a traceback")
            if self.findings:
                print(f"--- the end of what {name} said ---", process.output[-3000:], sep="\n")

    def _valve_works(self, name: str, tick: Callable[[], object]) -> bool:
        """It opens by the next good command, closes by one more, and steps by 1 ms meanwhile.

        Samples that a busy machine left out, between others or in this program's queue, are no failure of the node.
        """
        self.forget()
        for volts, wanted in ((9.0, True), (0.0, False)):

            def command(volts: float = volts) -> None:
                tick()
                self._voltage[name].publish(Float64(data=volts))

            def obeys(wanted: bool = wanted) -> bool:
                self._now_and_then(command)
                is_there = bool(self._open[name]) and self._open[name][-1].data is wanted
                return is_there and millisecond_steps(self._joints[name][-1000:]) > 50

            self._joints[name].clear()  # of before: a clock that jumped
            if not self.probe.until(obeys, PATIENCE):
                return False
        return True

    def _identification_works(self) -> bool:
        self._played.clear()

        def plays() -> bool:
            self._now_and_then(self._tick)
            return len(self._played) > 100 and "identified: " in self.nodes["identification"].output

        return self.probe.until(plays, PATIENCE)

    def _monitor_works(self) -> bool:
        before = self._samples_counted()

        def sample() -> None:
            message = JointState(name=["pilot_plunger"], position=[1e-7])
            message.header.stamp.sec, message.header.stamp.nanosec = divmod(time.time_ns(), 10**9)
            self._samples.publish(message)

        def counts() -> bool:
            self._now_and_then(sample)
            return self._samples_counted() > before + 50

        return self.probe.until(counts, PATIENCE)

    def _archive_works(self) -> bool:
        """It keeps a good report that comes now."""
        begun = time.time()

        def report() -> None:
            values = {**REPORT, "time": str(time.time())}
            entries = [KeyValue(key=name, value=value) for name, value in values.items()]
            self._reports.publish(DiagnosticArray(status=[DiagnosticStatus(values=entries)]))

        def keeps() -> bool:
            self._now_and_then(report)
            with contextlib.suppress(ValveError):  # the node has not made it yet
                rows = Archive(self._folder / "archive").read("strokes", "/valve")
                return any(row["time"].timestamp() > begun for row in rows)
            return False

        return self.probe.until(keeps, PATIENCE)

    def _opcua_works(self) -> bool:
        """It answers at its port."""

        def answers() -> bool:
            try:
                socket.create_connection(("127.0.0.1", self._port), 1.0).close()
            except OSError:
                return False
            return True

        return self.probe.until(answers, PATIENCE)

    def _samples_counted(self) -> int:
        for message in reversed(self._diagnostics):
            for status in message.status:
                if status.name == "monitor: input":
                    return int(next(item.value for item in status.values if item.key == "samples"))
        return 0

    def _now_and_then(self, action: Callable[[], object]) -> None:
        """At most each 10 ms: what is tested here is no flood."""
        if time.monotonic() > self._acted + 0.01:
            self._acted = time.monotonic()
            action()

    def _tick(self) -> None:
        """10 ms of simulated time more."""
        self._now += 10**7
        seconds, nanoseconds = divmod(self._now, 10**9)
        self._clock.publish(Clock(clock=Time(sec=seconds, nanosec=nanoseconds)))


def millisecond_steps(samples: Sequence[JointState]) -> int:
    """How many samples are stamped exactly 1 ms after the one before."""
    stamps = [sample.header.stamp.sec * 10**9 + sample.header.stamp.nanosec for sample in samples]
    return sum(after - before == 10**6 for before, after in itertools.pairwise(stamps))


def fuzz(messages: int, seed: int, rounds: int, names: Sequence[str]) -> list[str]:
    """Start the nodes, send, check between rounds, print counts; the findings."""
    random, port = np.random.default_rng(seed), free_port()
    with (
        tempfile.TemporaryDirectory(prefix="valve_sim-topic-fuzz-") as folder,
        under_fire(Path(folder), names, port) as nodes,
    ):
        check = Check(nodes, Path(folder), port)
        senders = {surface.topic: Sender(check.probe, surface) for surface in SURFACES}
        check.all("before")
        seconds = 0.0
        for number in range(1, rounds + 1):
            begun = time.monotonic()
            for surface in SURFACES:
                senders[surface.topic].flood(math.ceil(surface.share * messages / rounds), random)
            seconds += time.monotonic() - begun
            check.all(f"after round {number} of {rounds}")
            if number == 1:
                before = check.megabytes()
            if check.findings:
                break
        for topic, sender in senders.items():
            print(f"{topic}: {', '.join(f'{count} {what}' for what, count in sorted(sender.sent.items()))}")
        print(f"{sum(sum(sender.sent.values()) for sender in senders.values())} messages in {seconds:.0f} s")
        for name, megabytes in check.megabytes().items():
            growth = megabytes - before[name]
            print(f"{name}: {before[name]:.1f} MB after the first round, {growth:+.1f} MB since")
            if growth > MOST_GROWTH:
                check.findings.append(f"{name} has grown by {growth:.1f} MB")
        for sender in senders.values():
            sender.close()
        check.probe.close()
    return check.findings


def flood_nodes(messages: int, seed: int, rounds: int, names: Sequence[str] | None) -> int:
    """Fuzz and count; 1 if there is a finding."""
    with ros():
        findings = fuzz(messages, seed, rounds, names or NAMES_OF_NODES)
    print(f"{len(findings)} findings", *findings, sep="\n")
    return 1 if findings else 0
