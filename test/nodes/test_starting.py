"""Signals to a node: ROS shuts down, and no exception comes up at whatever place the program has reached."""

from __future__ import annotations

import os
import signal
import subprocess
import sys
import time
from pathlib import Path

import pytest

from .ros_process import ENDS_WITHIN, slowness

LONGEST = 2.0
"""s."""

pytestmark = pytest.mark.ros
pytest.importorskip("rclpy", reason="there is no ROS 2 here: rclpy cannot be imported")

PROGRAM = """
import ctypes, os, sys, time
import rclpy
from valve_sim.nodes.starting import Program

# The program imports its node from here.
sys.modules["program"] = sys.modules["__main__"]


def interrupted(place):
    # Whatever Python does next is where an exception would come up.
    if place == where:
        print(time.monotonic(), flush=True)
        os.kill(os.getpid(), number)
    while is_endless and place == where:
        pass
    for _ in range(1000):
        pass
    print("past", place, flush=True)


class Node:
    exit_code = 0

    def spin(self):
        interrupted("spin")
        interrupted("thread")
        if where == "hang":
            os.kill(os.getpid(), number)
        while rclpy.ok():
            pass
        print("ROS is shut down", flush=True)

    def close(self, timeout):
        interrupted("close")
        if where == "hang":
            # As compiled code that never returns, and lets no other thread of Python run.
            ctypes.PyDLL(None).sleep(10_000)
        return where != "thread"


def make(given):
    interrupted("make")
    return Node()


where, number, is_endless = sys.argv[1], int(sys.argv[2]), sys.argv[3] == "True"
raise SystemExit(Program("node", "program:make", "", "")(["node"]))
"""


def run(
    folder: Path, place: str, number: signal.Signals, *, is_endless: bool = False
) -> subprocess.CompletedProcess[str]:
    """A node that gets a signal at a place, and may stay there."""
    arguments = [sys.executable, "-c", PROGRAM, place, str(int(number)), str(is_endless)]
    environment = {**os.environ, "ROS_LOG_DIR": str(folder)}
    return subprocess.run(arguments, capture_output=True, text=True, timeout=ENDS_WITHIN, env=environment, check=False)


@pytest.mark.parametrize("number", [signal.SIGINT, signal.SIGTERM])
@pytest.mark.parametrize("place", ["make", "spin"])
def test_a_signal_raises_nothing_and_ends_the_node_with_code_0(
    tmp_path: Path, place: str, number: signal.Signals
) -> None:
    ran = run(tmp_path, place, number)
    assert ran.returncode == 0, ran.stderr
    assert "Traceback" not in ran.stderr
    said = [line for line in ran.stdout.splitlines() if not line[0].isdigit()]
    assert said == ["past make", "past spin", "past thread", "ROS is shut down", "past close"]


def test_a_node_does_linear_algebra_in_one_thread() -> None:
    """NumPy's starts its threads when it is loaded."""
    program = "import os; import valve_sim.nodes.__main__, numpy; print(len(os.listdir('/proc/self/task')))"
    environment = {name: value for name, value in os.environ.items() if name != "OPENBLAS_NUM_THREADS"}
    ran = subprocess.run([sys.executable, "-c", program], env=environment, capture_output=True, text=True, check=True)
    assert ran.stdout == "1\n"


@pytest.mark.any_distribution
@pytest.mark.parametrize("module", ["valve", "monitor", "identification", "profile"])
def test_a_node_starts_without_what_takes_a_second_to_load(module: str) -> None:
    heavy = ["scipy.optimize", "scipy.signal", "scipy.stats", "matplotlib"]
    heavy += ["rosbags", "mcap"] if module == "valve" else []
    script = f"import sys, valve_sim.nodes.{module}; print([name for name in {heavy} if name in sys.modules])"
    ran = subprocess.run(
        [sys.executable, "-c", script], capture_output=True, text=True, timeout=ENDS_WITHIN, check=True
    )
    assert ran.stdout == "[]\n"


@pytest.mark.parametrize("place", ["make", "spin"])
def test_a_node_that_reads_or_answers_without_end_ends_with_code_0_within_two_seconds(
    tmp_path: Path, place: str
) -> None:
    # A machine that is busy with something else holds up one of them, and not each.
    assert any(seconds_to_end(tmp_path, place, signal.SIGTERM, is_endless=True) < LONGEST for _ in range(3))


def test_a_node_that_hangs_in_compiled_code_is_ended_and_says_where(tmp_path: Path) -> None:
    ran = run(tmp_path, "hang", signal.SIGTERM)
    assert ran.returncode == 1
    assert "in close" in ran.stderr


def seconds_to_end(folder: Path, place: str, number: signal.Signals, *, is_endless: bool) -> float:
    """How long it takes from the signal to the end, were it alone here."""
    ran = run(folder, place, number, is_endless=is_endless)
    seconds = time.monotonic() - float(next(line for line in ran.stdout.splitlines() if line[0].isdigit()))
    assert ran.returncode == 0, ran.stderr
    return seconds / slowness()
