"""How well valve_node keeps time: `python -m benchmarks.node_timing`.

Starts valve_node as a process, commands full strokes (9 V, 0 V) at 50 Hz from this one, listens, and prints: steps
lost, lateness, share of a core, command to first changed joint_states, and with a warm and a cold compile cache how
long it takes from the start to the first message, and to the first in which a command shows that was sent as soon as
that was heard. Beside the share stands that of a process that sleeps and publishes the same bytes over and over: no
node written with rclpy takes less. Wants a quiet machine with two cores; needs ROS 2.
"""

from __future__ import annotations

import argparse
import contextlib
import os
import signal
import subprocess
import sys
import tempfile
import threading
import time
from collections.abc import Iterator
from pathlib import Path
from typing import Any

import numpy as np
import rclpy
from diagnostic_msgs.msg import DiagnosticArray
from rclpy.executors import ExternalShutdownException, SingleThreadedExecutor
from rclpy.node import Node
from rclpy.qos import QoSProfile
from sensor_msgs.msg import JointState
from std_msgs.msg import Float64

RATE = 1000.0
COMMAND_RATE = 50.0
GOLDEN_RATIO = 0.618034
CHANGED = 1e-3
"""Newtons by which the attraction moves from one sample to the next when a command has arrived; at rest it stays."""
FLOOR = """
import array, threading, time
import rclpy
from rclpy.serialization import serialize_message
from sensor_msgs.msg import JointState

rclpy.init()
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
WANTED = {
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
                values = {item.key: item.value for item in status.values}
                self.lost = int(values["lost steps"])
                with contextlib.suppress(ValueError):
                    self.lateness.append(float(values["lateness p99 (ms)"]))


@contextlib.contextmanager
def listening() -> Iterator[Listener]:
    """A listener whose executor spins in a thread."""
    listener = Listener()
    executor = SingleThreadedExecutor()
    executor.add_node(listener.node)

    def spin() -> None:
        with contextlib.suppress(ExternalShutdownException):
            executor.spin()

    sys.setswitchinterval(1e-4)  # or the two threads here would wait for each other, and it would count as latency
    thread = threading.Thread(target=spin, daemon=True)
    thread.start()
    try:
        yield listener
    finally:
        executor.shutdown()
        thread.join(2.0)
        listener.node.destroy_node()


@contextlib.contextmanager
def running_node(**environment: str) -> Iterator[subprocess.Popen[bytes]]:
    """valve_node as a process, ended by SIGINT."""
    command = [sys.executable, "-m", "valve_sim.nodes", "valve_node", "--ros-args", "-p", f"publish_rate:={RATE}"]
    process = subprocess.Popen(command, env={**os.environ, **environment})
    try:
        yield process
    finally:
        process.send_signal(signal.SIGINT)
        process.wait(10.0)


def share_of_floor(duration: float) -> float:
    """What FLOOR takes of a core with the same listener, %."""
    with listening() as listener, subprocess.Popen([sys.executable, "-c", FLOOR]) as process:
        try:
            listener.first.wait(60.0)
            time.sleep(1.0)
            used, start = processor_seconds(process.pid), time.monotonic()
            time.sleep(duration)
            return 100.0 * (processor_seconds(process.pid) - used) / (time.monotonic() - start)
        finally:
            process.kill()


def seconds_to_first_messages(**environment: str) -> tuple[float, float]:
    """From the start of the process to the first joint_states, and to those that show a command sent then, s."""
    with listening() as listener:
        start = time.monotonic()
        with running_node(**environment):
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


def processor_seconds(process_id: int) -> float:
    """User and system time of a process so far, s."""
    fields = Path(f"/proc/{process_id}/stat").read_text().rsplit(")", 1)[1].split()
    return (int(fields[11]) + int(fields[12])) / os.sysconf("SC_CLK_TCK")


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
    with listening() as listener, running_node() as process:
        listener.first.wait(60.0)
        time.sleep(2.0)
        listener.rows.clear()
        listener.lateness.clear()
        lost_before, used, start = listener.lost, processor_seconds(process.pid), time.monotonic()
        sent = command_strokes(listener, duration)
        share = (processor_seconds(process.pid) - used) / (time.monotonic() - start)
        time.sleep(1.1)
        received, stamps, attraction = (np.array(column) for column in zip(*listener.rows, strict=True))
    gaps = np.diff(stamps) * 1e-9 * RATE
    return {
        "steps lost": float(listener.lost - lost_before + np.sum(np.round(gaps) - 1)),
        "lateness p99, median second (ms)": float(np.median(listener.lateness)),
        "lateness p99, worst second (ms)": float(np.max(listener.lateness)),
        "share of a core (%)": 100.0 * share,
        **response_times(np.array(sent), received, attraction),
    }


def response_times(sent: Any, received: Any, attraction: Any) -> dict[str, float]:
    """Command to the first sample whose attraction has moved, both times on this process's clock."""
    changed = received[1:][np.abs(np.diff(attraction)) > CHANGED]
    first = changed[np.minimum(np.searchsorted(changed, sent), len(changed) - 1)]
    delays = (first - sent) * 1e-6
    delays = delays[delays >= 0.0]
    return {
        "command to first changed joint_states p50 (ms)": float(np.percentile(delays, 50)),
        "command to first changed joint_states p99 (ms)": float(np.percentile(delays, 99)),
    }


def main() -> int:
    """Measure and print; 1 if a figure falls short."""
    parser = argparse.ArgumentParser(description="How well valve_node keeps time.")
    parser.add_argument("--seconds", type=float, default=60.0, help="how long to command strokes (default 60)")
    duration = parser.parse_args().seconds
    rclpy.init()
    try:
        with tempfile.TemporaryDirectory() as cache:
            figures = {}
            for state in ("cold", "warm"):
                first, obeyed = seconds_to_first_messages(NUMBA_CACHE_DIR=cache)
                figures[f"start to first message, {state} (s)"] = first
                figures[f"start to a command obeyed, {state} (s)"] = obeyed
        figures["a thread that only sleeps: lateness p99 (ms)"] = bare_lateness()
        figures.update(measure_running(duration))
        figures["a thread that only sleeps, afterwards (ms)"] = bare_lateness()
        figures["sleeping and publishing alone: share of a core (%)"] = share_of_floor(duration / 4.0)
    finally:
        rclpy.try_shutdown()
    for name, value in figures.items():
        wanted = WANTED.get(name)
        verdict = "" if wanted is None else f"   wanted at most {wanted:g}: {'yes' if value <= wanted else 'NO'}"
        print(f"{name:50s}{value:9.3f}{verdict}")
    return int(any(not figures[name] <= wanted for name, wanted in WANTED.items()))


if __name__ == "__main__":
    raise SystemExit(main())
