"""Signals to a node: ROS shuts down, and no exception comes up at whatever place the program has reached."""

from __future__ import annotations

import os
import signal
import subprocess
import sys
from pathlib import Path

import pytest

from .ros_process import ENDS_WITHIN

pytestmark = pytest.mark.ros
pytest.importorskip("rclpy", reason="there is no ROS 2 here: rclpy cannot be imported")

PROGRAM = """
import os, sys
import rclpy
from valve_sim.nodes.starting import run_node


def interrupted(place):
    # Whatever Python does next is where an exception would come up.
    for _ in range(count if place == where else 0):
        os.kill(os.getpid(), number)
    for _ in range(1000):
        pass
    print("past", place, flush=True)


class Shell:
    exit_code = 0

    def spin(self):
        interrupted("spin")
        while rclpy.ok():
            pass
        print("ROS is shut down", flush=True)

    def close(self, timeout):
        return True


def make(given):
    interrupted("make")
    return Shell()


where, number, count = sys.argv[1], int(sys.argv[2]), int(sys.argv[3])
raise SystemExit(run_node("node", make, ["node"]))
"""


def run(folder: Path, place: str, number: signal.Signals, count: int = 1) -> subprocess.CompletedProcess[str]:
    """A node that gets so many signals at a place."""
    arguments = [sys.executable, "-c", PROGRAM, place, str(int(number)), str(count)]
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
    assert ran.stdout.splitlines() == ["past make", "past spin", "ROS is shut down"]


def test_a_node_does_linear_algebra_in_one_thread() -> None:
    """NumPy's starts its threads when it is loaded."""
    program = "import os; import valve_sim.nodes.identification_node, numpy; print(len(os.listdir('/proc/self/task')))"
    environment = {name: value for name, value in os.environ.items() if name != "OPENBLAS_NUM_THREADS"}
    ran = subprocess.run([sys.executable, "-c", program], env=environment, capture_output=True, text=True, check=True)
    assert ran.stdout == "1\n"


def test_a_second_signal_ends_a_node_that_is_still_being_made(tmp_path: Path) -> None:
    ran = run(tmp_path, "make", signal.SIGINT, 2)
    assert ran.returncode == -signal.SIGINT
    assert ran.stdout == ""
