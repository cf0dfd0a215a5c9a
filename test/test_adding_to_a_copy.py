"""The diffs of the how-tos, applied to a copy of the package: one row is a channel everywhere, one file an effect."""

from __future__ import annotations

import json
import os
import shutil
import subprocess
import sys
from pathlib import Path
from typing import Any

import pytest

pytestmark = pytest.mark.long

ROOT = Path(__file__).resolve().parents[1]
EXAMPLES = ROOT / "docs" / "examples"
NAME, STIFFNESS = "flow_force", 500.0  # N/m
CHANNEL_EVERYWHERE = """
import json, sys
from dataclasses import replace
from pathlib import Path
import numpy as np
import valve_sim
from valve_sim.files.parameter_files import default_valve
from valve_sim.model import Drive
from reference_tables import pages
from valve_sim.recordings import Signal, describe, read_trace, write_bag, write_csv
from valve_sim.recordings.map_draft import draft_map
from valve_sim.recordings.synthetic import Recording, Sensor, record

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
EFFECT_EVERYWHERE = """
import json, sys
from dataclasses import replace
import numpy as np
import valve_sim
from valve_sim.files.parameter_files import default_valve, load_valve, save_valve
from valve_sim.identification.diagnosis.identify import check_free
from valve_sim.identification.plants.valve import ValvePlant
from valve_sim.model import CATALOGUE, Drive, published_times, simulate
from reference_tables import pages
from valve_sim.recordings import Trace

folder, name, stiffness = sys.argv[1], sys.argv[2], float(sys.argv[3])
plain = default_valve()
save_valve(folder + "/with.yaml", replace(plain, effects={name: {"stiffness": stiffness}}), "by a test")
valve = load_valve(folder + "/with.yaml")
drive, times = Drive.of([0.0], [9.0]), np.linspace(0.0, 20e-3, 401)
without, response = simulate(plain, drive, times), simulate(valve, drive, times)
check_free([name + ".stiffness"])
trace = Trace("simulated", drive, times, response.pilot_position)
plant = ValvePlant([trace], plain)
print(json.dumps({
    "package": valve_sim.__file__,
    "without": published_times(without),
    "with": published_times(response),
    "candidates": sorted(plant.effects),
    "predicted": float(np.max(np.abs(plant.predict({name + ".stiffness": stiffness})[0] - response.pilot_position))),
    "look_alikes": CATALOGUE[name].confused_with,
    "mutual": name in CATALOGUE["spring_hardening"].confused_with,
    "documented": name in "".join(pages().values()),
}))
"""


def used(folder: Path, diff: str, script: str, *arguments: object) -> dict[str, Any]:
    """What a script prints of the package with a diff of the examples, which is in a folder of its own."""
    shutil.copytree(ROOT / "valve_sim", folder / "valve_sim", ignore=shutil.ignore_patterns("__pycache__"))
    shutil.copytree(ROOT / "config", folder / "share" / "valve_sim" / "config")
    subprocess.run(["git", "apply", str(EXAMPLES / diff)], cwd=folder, check=True, timeout=60)
    command = [sys.executable, "-c", script, str(folder), *map(str, arguments)]
    places = os.pathsep.join([str(folder), str(ROOT / "docs" / "_ext")])
    environment = {**os.environ, "PYTHONPATH": places}
    run = subprocess.run(command, cwd=folder, env=environment, capture_output=True, text=True, check=False, timeout=600)
    assert run.returncode == 0, run.stderr
    found: dict[str, Any] = json.loads(run.stdout)
    assert Path(found["package"]).is_relative_to(folder)
    return found


def test_the_channel_of_the_diff_is_written_read_checked_guessed_and_documented(tmp_path: Path) -> None:
    found = used(tmp_path, "housing_strain.diff", CHANNEL_EVERYWHERE)
    assert found["bag"]
    assert found["table"]
    assert found["summary"] == pytest.approx(2e4, rel=1e-6)
    good, *bad = found["findings"]
    assert good == 0
    assert len(bad) == 1
    assert "strain of the housing" in bad[0]
    assert "strain: {topic: /valve/measured/housing_strain, unit: m/m}" in found["draft"]
    assert found["documented"]


def test_the_effect_of_the_diff_is_simulated_freed_tried_and_documented(tmp_path: Path) -> None:
    found = used(tmp_path, "flow_force.diff", EFFECT_EVERYWHERE, NAME, STIFFNESS)
    # It acts once the main plunger moves, and against the opening.
    assert found["with"][0] == pytest.approx(found["without"][0], abs=1e-9)
    assert found["with"][1] > found["without"][1] + 1e-5
    assert NAME in found["candidates"]
    assert found["predicted"] < 1e-9
    assert set(found["look_alikes"]) >= {"spring_hardening", "pressure_force"}
    assert found["mutual"]
    assert found["documented"]
