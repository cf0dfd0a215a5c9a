"""Signals while a program starts, and what it loads."""

from __future__ import annotations

import os
import subprocess
import sys
from pathlib import Path

import pytest

from .ros_process import ENDS_WITHIN, own_lines

pytestmark = pytest.mark.ros
pytest.importorskip("rclpy", reason="there is no ROS 2 here: rclpy cannot be imported")

INTERRUPTED = """
import importlib, os, signal, sys, time

class Interrupting:
    def find_spec(self, name, path, target=None):
        if name == where:
            sys.meta_path.remove(self)
            os.kill(os.getpid(), number)
            while is_endless:
                time.sleep(0.01)

where, number, is_endless, *sys.argv = sys.argv[1], int(sys.argv[2]), sys.argv[3] == "endless", *sys.argv[4:]
sys.meta_path.insert(0, Interrupting())
program = importlib.import_module("valve_sim.nodes.__main__")
raise SystemExit(getattr(program, sys.argv[0].rpartition("/")[2])())
"""
"""A program that gets a signal while it looks for a module, and may never find it."""


def run(folder: Path, *words: str) -> subprocess.CompletedProcess[str]:
    environment = {**os.environ, "ROS_LOG_DIR": str(folder)}
    command = [sys.executable, "-c", *words]
    return subprocess.run(command, capture_output=True, text=True, timeout=ENDS_WITHIN, env=environment, check=False)


@pytest.mark.parametrize(
    ("program", "module", "number", "code"),
    [
        ("valve_node", "numpy", 2, 0),
        ("command_profile", "numpy", 15, 1),
        ("valve_node", "valve_sim.nodes.messages", 2, 0),
    ],
)
def test_a_signal_while_it_starts_ends_a_program_without_a_word(
    in_own_domain: None, tmp_path: Path, program: str, module: str, number: int, code: int
) -> None:
    ran = run(tmp_path, INTERRUPTED, module, str(number), "endless", f"/usr/bin/{program}")
    assert (ran.returncode, own_lines(ran.stderr)) == (code, [])


@pytest.mark.any_distribution
def test_a_node_starts_without_what_takes_a_second_to_load_and_with_one_thread_for_linear_algebra(
    tmp_path: Path,
) -> None:
    heavy = ["scipy.optimize", "scipy.signal", "scipy.stats", "matplotlib"]
    for modules, not_loaded in (
        (("valve",), [*heavy, "rosbags", "mcap"]),
        (("monitor", "identification", "profile"), heavy),
    ):
        imports = ", ".join(f"valve_sim.nodes.{module}" for module in modules)
        told = "os.environ['OPENBLAS_NUM_THREADS'], *(name for name in sys.argv[1:] if name in sys.modules)"
        ran = run(tmp_path, f"import os, sys, {imports}; print({told})", *not_loaded)
        assert ran.stdout == "1\n", ran.stderr
