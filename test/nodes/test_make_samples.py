"""bags/make_samples.py --live makes the shipped recordings; killed at work, it leaves nothing behind."""

from __future__ import annotations

import contextlib
import os
import shutil
import signal
import subprocess
import sys
import time
from collections.abc import Callable, Iterator
from pathlib import Path

import numpy as np
import pytest

from valve_sim.traces import read_trace

from .ros_process import ENDS_WITHIN, PATIENCE

pytestmark = [
    pytest.mark.ros,
    pytest.mark.skipif(shutil.which("setpriv") is None, reason="there is no setpriv (util-linux) here"),
]

MAKER = Path(__file__).parents[2] / "bags" / "make_samples.py"


def nodes_of(process: int) -> Iterator[int]:
    """Its children that run valve_node, by the parent that /proc tells, fourth in stat."""
    for folder in Path("/proc").glob("[0-9]*"):
        with contextlib.suppress(OSError, IndexError):
            parent = int((folder / "stat").read_text().rpartition(")")[2].split()[1])
            words = (folder / "cmdline").read_bytes().decode().split("\0")
            if parent == process and words[0] == sys.executable and "valve_node" in words:
                yield int(folder.name)


def is_alive(process: int) -> bool:
    """Whether a process is there and has not ended."""
    try:
        return Path(f"/proc/{process}/stat").read_text().rpartition(")")[2].split()[0] not in "ZX"
    except OSError:
        return False


def until(condition: Callable[[], object]) -> bool:
    deadline = time.monotonic() + PATIENCE
    while not condition():
        if time.monotonic() > deadline:
            return False
        time.sleep(0.02)
    return True


def test_what_is_shipped_is_what_it_makes_and_a_live_valve_is_recorded(in_own_domain: None, tmp_path: Path) -> None:
    command = [sys.executable, str(MAKER), "--folder", str(tmp_path), "--live"]
    subprocess.run(command, check=True, timeout=ENDS_WITHIN, env={**os.environ, "ROS_LOG_DIR": str(tmp_path / "log")})
    for name in ("one_opening.mcap", "eight_strokes.mcap"):
        made, shipped = read_trace(tmp_path / name), read_trace(MAKER.parent / name)
        assert np.max(np.abs(made.pilot_position - shipped.pilot_position)) < 1e-9
    assert np.max(read_trace(tmp_path / "live.mcap").pilot_position) > 1.2e-3, "it opens"


def test_the_valve_that_is_recorded_ends_with_who_records_it(in_own_domain: None, tmp_path: Path) -> None:
    command = [sys.executable, str(MAKER), "--folder", str(tmp_path), "--live"]
    with subprocess.Popen(command, env={**os.environ, "ROS_LOG_DIR": str(tmp_path)}) as maker:
        try:
            assert until(lambda: any(nodes_of(maker.pid))), "no valve_node was started"
            (node,) = nodes_of(maker.pid)
        finally:
            maker.kill()
    try:
        assert until(lambda: not is_alive(node)), "it stays behind"
    finally:
        if is_alive(node):
            os.kill(node, signal.SIGKILL)
