"""What a listener misses that a busy machine holds up: `python -m benchmarks.nodes.stalled`.

Two processes publish JointStates at 1 kHz, one with Fast DDS as it is, one with config/fast_dds_2.xml, each with a
listener of its own, of depth 10. Both listeners are stopped at once for some milliseconds, again and again, and what
each misses is counted. Twice, with the domains exchanged: 162 and 163. Needs ROS 2 with Fast DDS 2.
"""

from __future__ import annotations

import argparse
import os
import random
import signal
import subprocess
import sys
import tempfile
import time
from collections.abc import Mapping, Sequence
from pathlib import Path
from typing import Final

from valve_sim.files.resources import config_path

STALLS: Final = (0.0, 2e-3, 5e-3, 8e-3, 12e-3, 20e-3, 50e-3, 150e-3, 400e-3)
"""s for which the listeners are stopped."""
DOMAINS: Final = ("162", "163")
PUBLISHER: Final = """
import time, rclpy
from rclpy.serialization import serialize_message
from sensor_msgs.msg import JointState
rclpy.init()
publish = rclpy.create_node("valve").create_publisher(JointState, "~/joint_states", 10).handle.publish_raw
two = [1.0, 2.0]
message = JointState(name=["pilot_plunger", "main_plunger"], position=two, velocity=two, effort=two)
start, index = time.monotonic(), 0
while True:
    index += 1
    time.sleep(max(0.0, start + index / 1000.0 - time.monotonic()))
    message.header.stamp.sec, message.header.stamp.nanosec = divmod(index, 1_000_000_000)
    publish(serialize_message(message))
"""
LISTENER: Final = """
import struct, sys, time, rclpy
from sensor_msgs.msg import JointState
rclpy.init()
node, last = rclpy.create_node("listener"), 0
missed = open(sys.argv[1], "w", buffering=1)
def hear(encoded):
    global last
    seconds, nanoseconds = struct.unpack_from("=iI", encoded, 4)
    index = seconds * 1_000_000_000 + nanoseconds
    if last and index > last + 1:
        print(time.monotonic(), index - last - 1, file=missed)
    last = max(last, index)
node.create_subscription(JointState, "/valve/joint_states", hear, 10, raw=True)
rclpy.spin(node)
"""


def missed(repetitions: int, domains: Sequence[str]) -> dict[str, list[int]]:
    """Messages missed by whose publisher it was, for each length of stall."""
    ways: dict[str, Mapping[str, str]] = {
        "as it is": {},
        "profile": {"FASTRTPS_DEFAULT_PROFILES_FILE": str(config_path("fast_dds_2.xml"))},
    }
    publishers, listeners = [], []
    with tempfile.TemporaryDirectory() as folder:
        try:
            for (way, profile), domain in zip(ways.items(), domains, strict=True):
                environment = {**os.environ, "ROS_DOMAIN_ID": domain}
                publishers.append(subprocess.Popen([sys.executable, "-c", PUBLISHER], env={**environment, **profile}))
                command = [sys.executable, "-c", LISTENER, str(Path(folder) / way)]
                listeners.append(subprocess.Popen(command, env=environment))
            time.sleep(5.0)
            spans = [stall_often(listeners, stall, repetitions) for stall in STALLS]
        finally:
            for process in (*publishers, *listeners):
                process.kill()
                process.wait()
        return {way: _by_span(Path(folder) / way, spans) for way in ways}


def stall_often(listeners: Sequence[subprocess.Popen[bytes]], seconds: float, times: int) -> tuple[float, float]:
    """Stop all listeners at once, so many times; the span, s of the monotonic clock, in which what is missed shows."""
    generator, start = random.Random(1), time.monotonic()
    for _ in range(times):
        for number, pause in ((signal.SIGSTOP, seconds), (signal.SIGCONT, generator.uniform(0.15, 0.25))):
            for listener in listeners:
                listener.send_signal(number)
            time.sleep(pause)
    time.sleep(0.5)
    return start, time.monotonic()


def _by_span(found: Path, spans: Sequence[tuple[float, float]]) -> list[int]:
    gaps = [line.split() for line in found.read_text().splitlines()]
    return [sum(int(count) for time, count in gaps if start <= float(time) < end) for start, end in spans]


def main() -> int:
    """Measure and print."""
    parser = argparse.ArgumentParser(description="What a listener misses that a busy machine holds up.")
    parser.add_argument("--repetitions", type=int, default=30, help="stalls of each length (default 30)")
    repetitions = parser.parse_args().repetitions
    for domains in (DOMAINS, DOMAINS[::-1]):
        found = missed(repetitions, domains)
        print(f"{repetitions} stalls of each length; missed:  " + "".join(f"{way:>10s}" for way in found))
        for stall, counts in zip(STALLS, zip(*found.values(), strict=True), strict=True):
            print(f"{1e3 * stall:25.0f} ms        " + "".join(f"{count:10d}" for count in counts))
    return 0


if __name__ == "__main__":
    raise SystemExit(main())
