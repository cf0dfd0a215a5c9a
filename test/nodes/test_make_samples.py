"""bags/make_samples.py --live makes the shipped recordings."""

from __future__ import annotations

import os
import shutil
import subprocess
import sys
from pathlib import Path

import numpy as np
import pytest

from valve_sim.recordings import read_trace

from .ros_process import ENDS_WITHIN

pytestmark = [
    pytest.mark.ros,
    pytest.mark.long,
    pytest.mark.skipif(shutil.which("setpriv") is None, reason="there is no setpriv (util-linux) here"),
]

MAKER = Path(__file__).parents[2] / "bags" / "make_samples.py"


def test_what_is_shipped_is_what_it_makes_and_a_live_valve_is_recorded(in_own_domain: None, tmp_path: Path) -> None:
    command = [sys.executable, str(MAKER), "--folder", str(tmp_path), "--live"]
    subprocess.run(command, check=True, timeout=ENDS_WITHIN, env={**os.environ, "ROS_LOG_DIR": str(tmp_path / "log")})
    for name in ("one_opening.mcap", "eight_strokes.mcap"):
        made, shipped = read_trace(tmp_path / name), read_trace(MAKER.parent / name)
        assert np.max(np.abs(made.pilot_position - shipped.pilot_position)) < 1e-9
    assert np.max(read_trace(tmp_path / "live.mcap").pilot_position) > 1.2e-3, "it opens"
