"""docs/examples/sequencer.py and signals at any moment: each closes all valves, whatever ROS is at just then."""

from __future__ import annotations

import os
import subprocess
import sys
from pathlib import Path
from typing import Any

import pytest

from nodes.ros import LATCHED, Bool, Float64

from .ros_process import PATIENCE, Probe

pytestmark = pytest.mark.ros


HERE = Path(__file__).parent
SEQUENCER = HERE.parents[1] / "docs" / "examples" / "sequencer.py"
NAMES = ("quick_1", "quick_2", "quick_3")


class QuickValve:
    """What the sequencer sees of a valve, open as soon as it has a voltage: so that messages come all the time."""

    def __init__(self, node: Any, name: str) -> None:
        self.voltages: list[float] = []
        self._is_open = node.create_publisher(Bool, f"/{name}/valve/is_open", LATCHED)
        self._is_open.publish(Bool(data=False))
        node.create_subscription(Float64, f"/{name}/valve/coil_voltage", self._take, 10)

    def _take(self, message: Float64) -> None:
        if message.data != (self.voltages[-1] if self.voltages else 0.0):
            self._is_open.publish(Bool(data=message.data > 0.0))
        self.voltages.append(message.data)


@pytest.mark.parametrize("runs", [3, pytest.param(12, marks=pytest.mark.long)])
def test_a_signal_at_any_moment_closes_all_and_is_named(probe: Probe, tmp_path: Path, runs: int) -> None:
    valves = [QuickValve(probe.node, name) for name in NAMES]
    program = [str(HERE / "interrupted_sequencer.py"), str(SEQUENCER), str(runs), "17", str(len(NAMES))]
    parameters = ["-p", f"namespaces:=[{', '.join(NAMES)}]", "-p", "cycles:=1000000", "-p", "hold:=0.01"]
    output, errors = tmp_path / "output", tmp_path / "errors"
    with (
        output.open("w") as out,
        errors.open("w") as err,
        subprocess.Popen(
            [sys.executable, *program, "--ros-args", *parameters, "-p", f"timeout:={PATIENCE}"],
            stdout=out,
            stderr=err,
            env={**os.environ, "ROS_LOG_DIR": str(tmp_path)},
        ) as process,
    ):
        try:
            assert probe.until(lambda: process.poll() is not None, 10 * runs * PATIENCE), output.read_text()
        finally:
            process.kill()
    ended, words = output.read_text().split(), errors.read_text()
    assert len(ended) >= runs
    assert set(ended) == {"1"}, words
    assert words.count("sequencer: interrupted; all valves are commanded closed\n") == len(ended)
    assert "Traceback" not in words
    assert all(max(valve.voltages) > 0.0 for valve in valves)
    # What was sent last may be on its way when the process has ended.
    assert probe.until(lambda: all(valve.voltages[-1] == 0.0 for valve in valves))
