"""Whatever a node calculates, a signal ends it within two seconds."""

from __future__ import annotations

import os
import signal
import subprocess
import sys
import time
from pathlib import Path

import pytest

from .endless_node import PLACES
from .ros_process import ENDS_WITHIN, PATIENCE, own_lines, running, slowness

pytestmark = pytest.mark.ros
pytest.importorskip("rclpy", reason="there is no ROS 2 here: rclpy cannot be imported")

HERE = Path(__file__).parent
ROOT = HERE.parents[1]
LONGEST = 2.0
"""s."""
PARAMETERS = {
    "identification_node": {"bag": ROOT / "bags" / "one_opening.mcap", "rate": 0},
    "command_profile": {"profile": ROOT / "none.yaml"},
}


def seconds_to_end(folder: Path, node: str, number: signal.Signals) -> tuple[float, list[str]]:
    """How long it takes from a signal while it calculates, were it alone here; and what it says on stderr."""
    given = [word for name, value in PARAMETERS.get(node, {}).items() for word in ("-p", f"{name}:={value}")]
    if node == "identification_node":
        given += ["-p", f"output:={folder}"]
    command = [sys.executable, str(HERE / "endless_node.py"), node, "--ros-args", "--log-level", "warn", *given]
    environment = {**os.environ, "ROS_LOG_DIR": str(folder)}
    with subprocess.Popen(
        command, stdout=subprocess.PIPE, stderr=subprocess.PIPE, text=True, env=environment
    ) as process:
        try:
            assert process.stdout is not None
            assert process.stdout.readline() == "calculating\n"
            before, start = slowness(), time.monotonic()
            process.send_signal(number)
            process.wait(PATIENCE)
            seconds = (time.monotonic() - start) / max(before, slowness())
            # The code of command_profile says whether all was sent.
            assert process.wait(ENDS_WITHIN) == (node == "command_profile")
            assert process.stderr is not None
            return seconds, own_lines(process.stderr.read())
        finally:
            process.kill()


@pytest.mark.parametrize(
    "node", ["valve_node", "monitor_node", *(pytest.param(node, marks=pytest.mark.long) for node in list(PLACES)[2:])]
)
def test_a_node_ends_within_two_seconds_whatever_it_calculates(in_own_domain: None, tmp_path: Path, node: str) -> None:
    # A machine that is busy with something else holds up one of them, and not each.
    tries = (seconds_to_end(tmp_path, node, signal.SIGINT) for _ in range(3))
    seconds, said = next(((seconds, said) for seconds, said in tries if seconds < LONGEST), (LONGEST, []))
    assert seconds < LONGEST
    # While it is still being made, what it reads is nobody's calculation yet.
    expected = [] if node == "command_profile" else [f"{node}: ended in the middle of a calculation"]
    assert said == expected


def test_ctrl_c_that_comes_again_and_again_is_one_end(in_own_domain: None, tmp_path: Path) -> None:
    with running(tmp_path) as node:
        begin = time.monotonic()
        while "ready: " not in node.output and time.monotonic() - begin < PATIENCE:
            time.sleep(0.1)
        while node.process.poll() is None:
            node.process.send_signal(signal.SIGINT)
            time.sleep(1e-3)
        assert node.exit_code() == 0
        assert "Traceback" not in node.output
