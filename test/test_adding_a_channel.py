"""The diff of the how-to, applied to a copy of the package: one row, and the channel is everywhere."""

from __future__ import annotations

import json
import shutil
import subprocess
import sys
from pathlib import Path

import pytest

pytestmark = pytest.mark.long

ROOT = Path(__file__).resolve().parents[1]
DIFF = ROOT / "docs" / "examples" / "housing_strain.diff"
USED_EVERYWHERE = """
import json, sys
from dataclasses import replace
from pathlib import Path
import numpy as np
import valve_sim
from valve_sim.files.parameter_files import default_valve
from valve_sim.model import Drive
from valve_sim.reference import pages
from valve_sim.traces import Signal, describe, read_trace, write_bag, write_csv
from valve_sim.traces.map_draft import draft_map
from valve_sim.traces.synthetic import Recording, Sensor, record

folder = Path(sys.argv[1])
valve = default_valve()
made = record(valve, Drive.of([0.01], [9.0]), 0.04, 2e4, Sensor(1e-6, seed=1))
strain = 1e-6 * np.random.default_rng(1).normal(100.0, 5.0, len(made.trace.times))
trace = replace(made.trace, housing_strain=Signal(made.trace.times, strain))
write_bag(folder / "a.mcap", trace)
write_csv(folder / "a.csv", Recording(made.response, trace).columns())
write_bag(folder / "b.mcap", replace(trace, housing_strain=Signal(trace.times, 1e6 * strain)))
from_bag, from_table = (read_trace(folder / name) for name in ("a.mcap", "a.csv"))
print(json.dumps({
    "package": valve_sim.__file__,
    "bag": bool((from_bag.housing_strain.values == strain).all()),
    "table": bool((from_table.housing_strain.values == strain).all()),
    "summary": describe(from_bag).signals["housing_strain"].rate,
    "findings": [len(from_bag.findings), *read_trace(folder / "b.mcap").findings],
    "draft": draft_map(folder / "a.mcap", valve.parameters, "a test"),
    "documented": "housing_strain" in pages()["channels.md"],
}))
"""


def test_the_diff_changes_one_file() -> None:
    headers = [line for line in DIFF.read_text().splitlines() if line.startswith("diff ")]
    assert headers == ["diff --git a/valve_sim/files/channels.py b/valve_sim/files/channels.py"]


def test_the_channel_of_the_diff_is_written_read_checked_guessed_and_documented(tmp_path: Path) -> None:
    shutil.copytree(ROOT / "valve_sim", tmp_path / "valve_sim", ignore=shutil.ignore_patterns("__pycache__"))
    shutil.copytree(ROOT / "config", tmp_path / "share" / "valve_sim" / "config")
    subprocess.run(["git", "apply", str(DIFF)], cwd=tmp_path, check=True, timeout=60)
    arguments = [sys.executable, "-c", USED_EVERYWHERE, str(tmp_path)]
    run = subprocess.run(arguments, cwd=tmp_path, capture_output=True, text=True, check=False, timeout=600)
    assert run.returncode == 0, run.stderr
    found = json.loads(run.stdout)
    assert Path(found["package"]).is_relative_to(tmp_path)
    assert found["bag"]
    assert found["table"]
    assert found["summary"] == pytest.approx(2e4, rel=1e-6)
    good, *bad = found["findings"]
    assert good == 0
    assert len(bad) == 1
    assert "strain of the housing" in bad[0]
    assert "strain: {topic: /valve/measured/housing_strain, unit: m/m}" in found["draft"]
    assert found["documented"]
