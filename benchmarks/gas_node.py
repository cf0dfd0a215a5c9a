"""What gas costs valve_node at 1 kHz: `python -m benchmarks.gas_node`.

Three nodes side by side, to which nobody listens: without gas, with a tank of hydrogen and a dead end behind it, where
nothing flows once the pressures are equal, and with a demand, so that it flows for as long as the valve is open. Each
opens and closes once in two seconds. What they use is counted from when all of them are at work, with their models
compiled. Needs ROS 2.
"""

from __future__ import annotations

import argparse
import contextlib
import os
import signal
import subprocess
import sys
import time
from collections.abc import Iterator, Mapping, Sequence
from typing import Final

import rclpy
from rclpy.node import Node
from sensor_msgs.msg import JointState
from std_msgs.msg import Float64

from benchmarks.node_timing import RATE, processor_seconds
from valve_sim.files.resources import config_path

VOLTS: Final = 9.0
HYDROGEN: Final = ("--params-file", str(config_path("hydrogen_35mpa.yaml")))
NODES: Final = {
    "plain": (),
    "dead_end": HYDROGEN,
    "demand": (*HYDROGEN, "-p", "gas.demand_orifice_diameter:=0.0001"),
}
"""Namespace to arguments."""
WANTED: Final = 2.0
"""Points of a core by which gas may be dearer."""


@contextlib.contextmanager
def running(nodes: Mapping[str, Sequence[str]]) -> Iterator[Mapping[str, subprocess.Popen[bytes]]]:
    """A valve_node for each, ended by SIGINT."""
    start = [sys.executable, "-m", "valve_sim.nodes", "valve_node", "--ros-args", "-p", f"publish_rate:={RATE}"]
    started = {
        name: subprocess.Popen([*start, "-r", f"__ns:=/{name}", *arguments]) for name, arguments in nodes.items()
    }
    try:
        yield started
    finally:
        for process in started.values():
            process.send_signal(signal.SIGINT)
        for process in started.values():
            process.wait(30.0)


def wait_until_at_work(node: Node, names: Sequence[str]) -> None:
    """Listen to each until it has published, and no longer."""
    silent = set(names)
    heard = {name: (lambda _, name=name: silent.discard(name)) for name in names}
    ears = [node.create_subscription(JointState, f"/{name}/valve/joint_states", heard[name], 1) for name in names]
    while silent:
        rclpy.spin_once(node, timeout_sec=0.1)
    for ear in ears:
        node.destroy_subscription(ear)
    time.sleep(2.0)


def shares(duration: float) -> dict[str, float]:
    """Percent of a core that each takes, in the same run."""
    node = rclpy.create_node("gas_node_cost")
    commands = {name: node.create_publisher(Float64, f"/{name}/valve/coil_voltage", 10) for name in NODES}
    with running(NODES) as started:
        wait_until_at_work(node, list(NODES))
        before = {name: processor_seconds(process.pid) for name, process in started.items()}
        start, count = time.monotonic(), 0
        while (elapsed := time.monotonic() - start) < duration:
            for command in commands.values():
                command.publish(Float64(data=0.0 if count % 2 else VOLTS))
            count += 1
            time.sleep(1.0)
        return {
            name: 100.0 * (processor_seconds(process.pid) - before[name]) / elapsed for name, process in started.items()
        }


def main() -> int:
    """Measure and print; 1 if gas costs more than it may."""
    parser = argparse.ArgumentParser(description="What gas costs valve_node.")
    parser.add_argument("--seconds", type=float, default=60.0, help="how long to count (default 60)")
    duration = parser.parse_args().seconds
    os.environ.setdefault("ROS_AUTOMATIC_DISCOVERY_RANGE", "LOCALHOST")
    rclpy.init()
    try:
        found = shares(duration)
    finally:
        rclpy.try_shutdown()
    for name, share in found.items():
        print(f"{name:10s}{share:6.2f} % of a core, {share - found['plain']:+.2f}")
    return int(max(found.values()) - found["plain"] > WANTED)


if __name__ == "__main__":
    raise SystemExit(main())
