"""Do three valves and three monitors fit on two cores? `python -m benchmarks.station --seconds 60`.

Starts valve_node and monitor_node for each of three tanks as processes, at 500 Hz, as launch/station.launch.py does;
commands one stroke a second to each valve in turn, and prints by node what it takes of a core once the monitors are
commissioned, by valve the steps that it lost, commissioning included, by monitor the strokes that it reported. Wanted:
no step lost, at most 120 % of a core in all. Exit code 1 where that falls short. Wants a quiet machine with two cores;
needs ROS 2.
"""

from __future__ import annotations

import argparse
import contextlib
import os
import signal
import subprocess
import sys
import time
from collections.abc import Iterator, Mapping
from typing import Any, NamedTuple

import rclpy
from diagnostic_msgs.msg import DiagnosticArray
from rclpy.executors import SingleThreadedExecutor
from rclpy.node import Node
from std_msgs.msg import Float64, String

from benchmarks.node_timing import processor_seconds

TANKS = ("tank_1", "tank_2", "tank_3")
RATE = 500.0
COMMISSIONING = 8
PARAMETERS = {
    "valve": (f"publish_rate:={RATE}",),
    "monitor": ("measured:=joint_states", "noise_um:=1.0", f"commissioning_strokes:={COMMISSIONING}"),
}
PERIOD = 1.0
"""s from one stroke of a valve to its next."""
OPEN_SECONDS = 0.1
MOST_SHARE = 120.0
"""% of a core, of all nodes."""
PATIENCE = 60.0
"""s for every node to be there, compiled."""


class Figures(NamedTuple):
    """What was measured: share of a core by node, %, steps lost by valve, reports by monitor."""

    shares: dict[str, float]
    lost: dict[str, int]
    reported: dict[str, int]


class Hand:
    """Commands the valves, and hears what the nodes say of themselves."""

    def __init__(self) -> None:
        self.node = Node("station_benchmark")
        self.executor = SingleThreadedExecutor()
        self.executor.add_node(self.node)
        self.lost: dict[str, int] = {}
        self.arriving: set[str] = set()
        self.reported = dict.fromkeys(TANKS, 0)
        self.voltages = [self.node.create_publisher(Float64, f"/{tank}/valve/coil_voltage", 10) for tank in TANKS]
        self.node.create_subscription(DiagnosticArray, "/diagnostics", self._hear_diagnostics, 100)
        for tank in TANKS:
            self.node.create_subscription(String, f"/{tank}/monitor/stroke_report", self._counter(tank), 10)

    def _counter(self, tank: str) -> Any:
        def count(message: Any) -> None:
            self.reported[tank] += 1

        return count

    def _hear_diagnostics(self, message: Any) -> None:
        for status in message.status:
            name, _, task = status.name.partition(": ")
            tank = name.partition("/")[0]
            values = {item.key: item.value for item in status.values}
            if task == "timing":
                self.lost[tank] = int(values["lost steps"])
            elif task == "input" and int(values["samples"]) > 0:
                self.arriving.add(tank)

    def wait_for_all(self, patience: float = PATIENCE) -> bool:
        """Whether every valve and every monitor came to run within so many seconds."""
        end = time.monotonic() + patience
        while time.monotonic() < end:
            self.spin_for(0.5)
            if len(self.lost) == len(self.arriving) == len(TANKS):
                return True
        return False

    def spin_for(self, seconds: float) -> None:
        """Hear what comes."""
        end = time.monotonic() + seconds
        while (remaining := end - time.monotonic()) > 0.0:
            self.executor.spin_once(timeout_sec=remaining)

    def strokes(self, seconds: float) -> None:
        """One stroke each PERIOD of each valve, one valve after the other."""
        end = time.monotonic() + seconds
        while time.monotonic() < end:
            for voltage in self.voltages:
                voltage.publish(Float64(data=9.0))
                self.spin_for(OPEN_SECONDS)
                voltage.publish(Float64(data=0.0))
                self.spin_for(PERIOD / len(self.voltages) - OPEN_SECONDS)


@contextlib.contextmanager
def running_station() -> Iterator[dict[str, int]]:
    """Process ids by node, while inside; ended by SIGINT."""
    processes = {}
    for tank in TANKS:
        for name, parameters in PARAMETERS.items():
            words = ["--ros-args", "-r", f"__ns:=/{tank}", *(word for pair in parameters for word in ("-p", pair))]
            command = [sys.executable, "-m", f"valve_sim.nodes.{name}_node", *words]
            processes[f"{tank}/{name}"] = subprocess.Popen(command)
    try:
        yield {name: process.pid for name, process in processes.items()}
    finally:
        for process in processes.values():
            process.send_signal(signal.SIGINT)
        for process in processes.values():
            try:
                process.wait(10.0)
            except subprocess.TimeoutExpired:
                # A calculation is under way, on a busy machine for minutes.
                process.kill()
                process.wait()


def measure(hand: Hand, pids: Mapping[str, int], seconds: float) -> Figures:
    """Commission, and let the station work for so long."""
    lost = dict(hand.lost)
    hand.strokes((COMMISSIONING + 4) * PERIOD)
    reported = dict(hand.reported)
    used, start = {name: processor_seconds(pid) for name, pid in pids.items()}, time.monotonic()
    hand.strokes(seconds)
    elapsed = time.monotonic() - start
    shares = {name: 100.0 * (processor_seconds(pid) - used[name]) / elapsed for name, pid in pids.items()}
    hand.spin_for(1.5)  # until the last second's diagnostics are here
    return Figures(
        shares,
        {tank: hand.lost[tank] - lost[tank] for tank in TANKS},
        {tank: hand.reported[tank] - reported[tank] for tank in TANKS},
    )


def show(figures: Figures) -> bool:
    """Print; whether all is as wanted."""
    for name, share in figures.shares.items():
        print(f"      {name:16s}{share:6.1f} % of a core")
    print(f"      strokes reported: {figures.reported}")
    total, lost = sum(figures.shares.values()), sum(figures.lost.values())
    verdicts = {
        f"{lost} steps lost (0): {figures.lost}": lost == 0,
        f"{total:.0f} % of a core in all (at most {MOST_SHARE:g} %)": total <= MOST_SHARE,
        "every monitor reported strokes": all(figures.reported.values()),
    }
    for words, is_good in verdicts.items():
        print(f"{'ok   ' if is_good else 'SHORT'} {words}")
    return all(verdicts.values())


def main() -> int:
    """Run and print; 1 if anything falls short."""
    parser = argparse.ArgumentParser(description="Do three valves and three monitors fit on two cores?")
    parser.add_argument("--seconds", type=float, default=60.0, help="how long to command strokes (default 60)")
    seconds = parser.parse_args().seconds
    os.environ.setdefault("OPENBLAS_NUM_THREADS", "1")
    rclpy.init()
    try:
        with running_station() as pids:
            hand = Hand()
            if not hand.wait_for_all():
                print(f"SHORT not every node came to run within {PATIENCE:g} s")
                return 1
            return 0 if show(measure(hand, pids, seconds)) else 1
    finally:
        rclpy.try_shutdown()


if __name__ == "__main__":
    raise SystemExit(main())
