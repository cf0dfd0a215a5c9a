"""The diff of the how-to, applied to a copy of the package: one new file, and the effect is everywhere."""

from __future__ import annotations

import json
import shutil
import subprocess
import sys
from pathlib import Path

import pytest

pytestmark = pytest.mark.long

ROOT = Path(__file__).resolve().parents[1]
DIFF = ROOT / "docs" / "examples" / "flow_force.diff"
NAME, STIFFNESS = "flow_force", 500.0  # N/m
USED_EVERYWHERE = """
import json, sys
from dataclasses import replace
import numpy as np
import valve_sim
from valve_sim.files.parameter_files import default_valve, load_valve, save_valve
from valve_sim.identification.diagnosis.identify import check_free
from valve_sim.identification.plants.valve import ValvePlant
from valve_sim.model import CATALOGUE, Drive, published_times, simulate
from valve_sim.reference import pages
from valve_sim.traces import Trace

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


@pytest.fixture(scope="module")
def copied(tmp_path_factory: pytest.TempPathFactory) -> Path:
    """A folder with a copy of the package to which the diff has been applied."""
    folder = tmp_path_factory.mktemp("copy")
    shutil.copytree(ROOT / "valve_sim", folder / "valve_sim", ignore=shutil.ignore_patterns("__pycache__"))
    shutil.copytree(ROOT / "config", folder / "share" / "valve_sim" / "config")
    subprocess.run(["git", "apply", str(DIFF)], cwd=folder, check=True, timeout=60)
    return folder


def test_the_diff_adds_one_file_and_changes_none() -> None:
    headers = [line for line in DIFF.read_text().splitlines() if line.startswith(("diff ", "--- ", "+++ ", "@@ "))]
    path = f"valve_sim/model/effects/{NAME}.py"
    assert headers[:3] == [f"diff --git a/{path} b/{path}", "--- /dev/null", f"+++ b/{path}"]
    assert len(headers) == 4


def test_the_effect_of_the_diff_is_simulated_freed_tried_and_documented(copied: Path) -> None:
    arguments = [sys.executable, "-c", USED_EVERYWHERE, str(copied), NAME, str(STIFFNESS)]
    run = subprocess.run(arguments, cwd=copied, capture_output=True, text=True, check=False, timeout=600)
    assert run.returncode == 0, run.stderr
    found = json.loads(run.stdout)
    assert Path(found["package"]).is_relative_to(copied)
    # It acts once the main plunger moves, and against the opening.
    assert found["with"][0] == pytest.approx(found["without"][0], abs=1e-9)
    assert found["with"][1] > found["without"][1] + 1e-5
    assert NAME in found["candidates"]
    assert found["predicted"] < 1e-9
    assert set(found["look_alikes"]) >= {"spring_hardening", "pressure_force"}
    assert found["mutual"]
    assert found["documented"]
