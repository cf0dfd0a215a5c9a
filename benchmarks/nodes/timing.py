"""How well does valve_node keep time? `python -m benchmarks.nodes.timing`.

Starts valve_node as a process, commands full strokes (9 V, 0 V) at 50 Hz from this one, listens, and prints: steps
lost, lateness, share of a core, command to first changed joint_states, and with a warm and a cold compile cache how
long it takes from the start to the first message, and to the first in which a command shows that was sent as soon as
that was heard. Beside the share stands that of a process that sleeps and publishes the same bytes over and over: no
node written with rclpy takes less.

Wants a quiet machine with two cores; needs ROS 2.
"""

from __future__ import annotations

import contextlib
import math
import sys
import tempfile
import threading
import time
from collections.abc import Iterator
from typing import Any, Final

import numpy as np
from diagnostic_msgs.msg import DiagnosticArray
from nodes.ros_process import cpu_seconds
from rclpy.executors import ExternalShutdownException, SingleThreadedExecutor
from rclpy.node import Node
from rclpy.qos import QoSProfile
from sensor_msgs.msg import JointState
from std_msgs.msg import Float64

from benchmarks.common import parser, say
from benchmarks.nodes.driver import program, ros, running, values_of

RATE: Final = 1000.0
COMMAND_RATE: Final = 50.0
GOLDEN_RATIO: Final = 0.618034
CHANGED: Final = 1e-3
"""Newtons by which the attraction moves from one sample to the next when a command has arrived; at rest it stays."""
AT_RATE: Final = f"publish_rate:={RATE}"
FLOOR: Final = """
import array, signal, threading, time
import rclpy
from rclpy.serialization import serialize_message
from rclpy.signals import SignalHandlerOptions
from sensor_msgs.msg import JointState

signal.signal(signal.SIGINT, signal.SIG_DFL)
rclpy.init(signal_handler_options=SignalHandlerOptions.NO)
node = rclpy.create_node("valve")
publish = node.create_publisher(JointState, "~/joint_states", 10).publish
two = array.array("d", [1.0, 2.0])
message = serialize_message(JointState(name=["pilot_plunger", "main_plunger"], position=two, velocity=two, effort=two))

def work():
    start, index = time.monotonic(), 0
    while True:
        index += 1
        time.sleep(max(0.0, start + index / RATE - time.monotonic()))
        publish(message)

threading.Thread(target=work, daemon=True).start()
rclpy.spin(node)
""".replace("RATE", str(RATE))
"""A process that does what a node must do at least."""
WANTED: Final = {
    "steps lost": 0.0,
    "lateness p99, median second (ms)": 0.5,
    "share of a core (%)": 14.0,
    "command to first changed joint_states p50 (ms)": 1.6,
    "command to first changed joint_states p99 (ms)": 2.5,
    "start to first message, warm (s)": 1.5,
    "start to first message, cold (s)": 4.0,
}


class Listener:
    """Hears the node and notes when, ns of the monotonic clock."""

    def __init__(self) -> None:
        self.node = Node("node_timing")
        self.first = threading.Event()
        self.rows: list[tuple[int, int, float]] = []  # received, stamp, attraction
        self.lateness: list[float] = []
        self.lost = 0
        self.node.create_subscription(JointState, "/valve/joint_states", self._hear, QoSProfile(depth=1000))
        self.node.create_subscription(DiagnosticArray, "/diagnostics", self._hear_diagnostics, 10)
        self.commands = self.node.create_publisher(Float64, "/valve/coil_voltage", 10)

    def _hear(self, message: Any) -> None:
        stamp = message.header.stamp
        self.rows.append((time.monotonic_ns(), stamp.sec * 1_000_000_000 + stamp.nanosec, message.effort[0]))
        self.first.set()

    def _hear_diagnostics(self, message: Any) -> None:
        for status in message.status:
            if status.name == "valve: timing":
                values = values_of(status)
                self.lost = int(values["lost steps"])
                with contextlib.suppress(ValueError):
                    self.lateness.append(float(values["lateness p99 (ms)"]))


@contextlib.contextmanager
def listening() -> Iterator[Listener]:
    """A listener in a thread of its own, so that it hears while this one sends."""
    listener, executor = Listener(), SingleThreadedExecutor()
    executor.add_node(listener.node)

    def spin() -> None:
        with contextlib.suppress(ExternalShutdownException):
            executor.spin()

    thread = threading.Thread(target=spin, daemon=True)
    thread.start()
    try:
        yield listener
    finally:
        executor.shutdown()
        thread.join(2.0)
        listener.node.destroy_node()


def share_of_floor(duration: float) -> float:
    """What FLOOR takes of a core with the same listener, %."""
    with listening() as listener, running({"floor": [sys.executable, "-c", FLOOR]}) as processes:
        listener.first.wait(60.0)
        time.sleep(1.0)
        return share_while(processes["floor"].pid, lambda: time.sleep(duration))


def share_while(process_id: int, work: Any) -> float:
    """What a process takes of a core while something is done here, %."""
    used, start = cpu_seconds(process_id), time.monotonic()
    work()
    return 100.0 * (cpu_seconds(process_id) - used) / (time.monotonic() - start)


def seconds_to_first_messages(**environment: str) -> tuple[float, float]:
    """From the start of the process to the first joint_states, and to those that show a command sent then, s."""
    with listening() as listener:
        start = time.monotonic()
        with running({"valve": program("valve_node", AT_RATE)}, **environment):
            listener.first.wait(60.0)
            first = time.monotonic() - start
            listener.commands.publish(Float64(data=9.0))
            while listener.rows[-1][2] < CHANGED and time.monotonic() - start < 120.0:
                time.sleep(0.01)
            return first, time.monotonic() - start


def command_strokes(listener: Listener, duration: float) -> list[int]:
    """Full strokes at COMMAND_RATE; the times of sending, ns.

    Spread over the node's period: sent at one phase of it, all would wait equally long, and how long would be chance.
    """
    sent = []
    start = time.monotonic()
    for index in range(int(duration * COMMAND_RATE)):
        phase = index * GOLDEN_RATIO % 1.0
        time.sleep(max(0.0, start + index / COMMAND_RATE + phase / RATE - time.monotonic()))
        sent.append(time.monotonic_ns())
        listener.commands.publish(Float64(data=9.0 if index % 2 == 0 else 0.0))
    time.sleep(0.1)
    return sent


def bare_lateness(duration: float = 3.0) -> float:
    """99th percentile of how late a thread that only sleeps wakes on this machine, ms: no node can do better."""
    late = []
    start = time.monotonic()
    for index in range(int(duration * RATE)):
        time.sleep(max(0.0, start + index / RATE - time.monotonic()))
        late.append(time.monotonic() - start - index / RATE)
    return float(np.percentile(late, 99)) * 1e3


def measure_running(duration: float) -> dict[str, float]:
    """All that is measured while the node runs."""
    with listening() as listener, running({"valve": program("valve_node", AT_RATE)}) as processes:
        listener.first.wait(60.0)
        time.sleep(2.0)
        listener.rows.clear()
        listener.lateness.clear()
        lost_before, sent = listener.lost, list[int]()
        share = share_while(processes["valve"].pid, lambda: sent.extend(command_strokes(listener, duration)))
        time.sleep(1.1)
        received, stamps, attraction = (np.array(column) for column in zip(*listener.rows, strict=True))
    gaps = np.diff(stamps) * 1e-9 * RATE
    return {
        "steps lost": float(listener.lost - lost_before + np.sum(np.round(gaps) - 1)),
        "lateness p99, median second (ms)": float(np.median(listener.lateness)),
        "lateness p99, worst second (ms)": float(np.max(listener.lateness)),
        "share of a core (%)": share,
        **response_times(np.array(sent), received, attraction),
    }


def response_times(sent: Any, received: Any, attraction: Any) -> dict[str, float]:
    """Command to the first sample whose attraction has moved, both times on this process's clock."""
    changed = received[1:][np.abs(np.diff(attraction)) > CHANGED]
    first = changed[np.minimum(np.searchsorted(changed, sent), len(changed) - 1)]
    delays = (first - sent) * 1e-6
    delays = delays[delays >= 0.0]
    return {
        f"command to first changed joint_states p{part} (ms)": float(np.percentile(delays, part)) for part in (50, 99)
    }


def measure_timing(duration: float) -> dict[str, float]:
    """Starts, and a node at work."""
    figures = {}
    with tempfile.TemporaryDirectory() as cache:
        for state in ("cold", "warm"):
            first, obeyed = seconds_to_first_messages(NUMBA_CACHE_DIR=cache, VALVE_SIM_CACHE=cache)
            figures[f"start to first message, {state} (s)"] = first
            figures[f"start to a command obeyed, {state} (s)"] = obeyed
    figures["a thread that only sleeps: lateness p99 (ms)"] = bare_lateness()
    figures.update(measure_running(duration))
    figures["a thread that only sleeps, afterwards (ms)"] = bare_lateness()
    figures["sleeping and publishing alone: share of a core (%)"] = share_of_floor(duration / 4.0)
    return figures


def main() -> int:
    """Measure and print; 1 if a figure falls short."""
    known = parser("nodes.timing", __doc__)
    known.add_argument("--seconds", type=float, default=60.0, help="how long to command strokes (default: 60)")
    options = known.parse_args()
    with ros():
        figures = measure_timing(options.seconds)
    return int(not all([judged(name, value) for name, value in figures.items()]))


def judged(name: str, value: float) -> bool:
    """Print a figure; whether it is as wanted, or nothing is wanted of it."""
    most = WANTED.get(name, math.inf)
    return say(value <= most, f"{name:50s}{value:9.3f}{f'   at most {most:g}' if name in WANTED else ''}")


if __name__ == "__main__":
    raise SystemExit(main())
