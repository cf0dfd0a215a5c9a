"""The example files of a servo axis and of a magnet, on such machines that independent simulators make up."""

from __future__ import annotations

from pathlib import Path
from typing import Any

import numpy as np
import pytest
from plants import magnet
from plants.driven_axis import MASS, moves

from valve_sim.files.plant_files import load_plant
from valve_sim.identification.diagnosis.identify import identify_plant
from valve_sim.identification.diagnosis.run import diagnose_plant
from valve_sim.identification.plants.own import OwnPlant
from valve_sim.identification.reporting.diagnosis_document import diagnosis_document
from valve_sim.identification.reporting.page import write_page
from valve_sim.recordings.columns import read

EXAMPLES = Path(__file__).parents[1] / "docs" / "examples" / "own_plants"
STARTS = (0.018, 0.015, 0.012, 0.009, 0.006, 0.004)
"""m, of the ball's support."""


def written(path: Path, **columns: Any) -> Path:
    table = np.column_stack(list(columns.values()))
    np.savetxt(path, table, delimiter=",", header=",".join(columns), comments="", fmt="%.10g")
    return path


def axis(folder: Path, friction: float, load: float) -> OwnPlant:
    """The axis of docs/examples, that moves and rubs so, N."""
    found = moves(lambda v: friction, load)
    log = written(folder / "log.csv", t=found.times, qm=found.position, vir=found.force / 35.15065188)
    recording_map = (EXAMPLES / "emps_map.yaml").read_text().replace("24.79", "19.95").replace(", turns: use", "")
    (folder / "map.yaml").write_text(recording_map)
    return OwnPlant(load_plant(EXAMPLES / "emps.yaml"), [read(log, folder / "map.yaml")])


def test_friction_and_a_load_of_an_axis_are_found_and_measured(tmp_path: Path) -> None:
    plant = axis(tmp_path, 8.0, 3.0)
    diagnosis = diagnose_plant(plant, None)
    named = set(diagnosis.verdict.effects)
    assert named in ({"coulomb_friction", "load"}, {"asymmetric_friction"})
    found = identify_plant(plant, ("mass", "viscous", "coulomb_friction.level", "load.load")).intervals
    assert found["mass"].value == pytest.approx(MASS, rel=0.02)
    assert found["coulomb_friction.level"].value == pytest.approx(8.0, rel=0.05)
    assert found["load.load"].value == pytest.approx(3.0, rel=0.05)
    # An axis that never stands shows no noise of its sensor: nothing may say what that is, nor that only it is left.
    document = diagnosis_document(diagnosis)
    write_page(document, tmp_path / "report.html")
    page = (tmp_path / "report.html").read_text()
    assert "The sensor's noise is not known" in page.replace("&#39;", "'")
    assert "The noise of the sensor is" not in page
    assert "The best model leaves" in document.to_text()


@pytest.mark.long
def test_an_axis_that_does_not_rub_lacks_nothing_and_is_reported_in_newtons(tmp_path: Path) -> None:
    diagnosis = diagnose_plant(axis(tmp_path, 0.0, 0.0), None)
    assert diagnosis.verdict.effects == ()
    report = diagnosis_document(diagnosis).to_json()
    assert report["unit"] == "N"
    assert not [name for name in report["before"] if name.endswith("_um")]


@pytest.mark.long
@pytest.mark.parametrize(
    ("rig", "missing"),
    [
        (magnet.Rig(), "inductance_of_distance"),
        (magnet.Rig(lifting=0.0), None),
        (magnet.Rig(lifting=0.0, warming=3.0), "heating"),
    ],
    ids=["a ball that the coil feels", "a ball that it does not feel", "a warm coil"],
)  # fmt: skip
def test_what_a_magnet_has_is_named(rig: magnet.Rig, missing: str | None, tmp_path: Path) -> None:
    file, recordings = load_plant(EXAMPLES / "maglev.yaml"), []
    for seed, start in enumerate(STARTS):
        seen = magnet.recorded(rig, start, seed)
        jump = int(np.argmin(np.diff(seen.distance))) + 1
        log = written(
            tmp_path / f"{seed}.csv", t=seen.times - seen.times[jump], distance=seen.distance, current=seen.current,
            duty=seen.duty,
        )  # fmt: skip
        recordings.append(read(log, EXAMPLES / "maglev_map.yaml"))
    verdict = diagnose_plant(OwnPlant(file, recordings), None).verdict
    if missing is None:
        assert verdict.kind == "none"
    else:
        assert missing in verdict.effects
