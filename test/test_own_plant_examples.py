"""Machines that others have measured, by files alone, on data that are not in the repository."""

import json
import os
import runpy
from pathlib import Path
from typing import Any

import pytest
from click.testing import CliRunner

from valve_sim.cli import main

pytestmark = pytest.mark.long

EXAMPLES = Path(__file__).parents[1] / "docs" / "examples" / "own_plants"
DATA = Path(os.environ.get("VALVE_SIM_DATA", Path(__file__).parents[2] / "shared" / "data"))


@pytest.fixture(scope="module")
def tables(tmp_path_factory: pytest.TempPathFactory) -> list[Path]:
    """What `make_csv.py` makes of the published files."""
    folder = tmp_path_factory.mktemp("tables")
    made: list[Path] = runpy.run_path(str(EXAMPLES / "make_csv.py"))["make"](DATA, folder)
    return made


def report(tables: list[Path], start: str, plant: str, command: str, output: Path, *more: str) -> dict[str, Any]:
    """What a command says of the tables that begin so."""
    logs = [str(path) for path in tables if path.name.startswith(start)]
    if not logs:
        pytest.skip(f"{DATA} has nothing of {plant}: these measurements are not in the repository")
    given = ["--plant", str(EXAMPLES / f"{plant}.yaml"), "--map", str(EXAMPLES / f"{plant}_map.yaml")]
    found = CliRunner().invoke(main, [command, *logs, *given, "--output", str(output), "--json", *more])
    assert found.exit_code == 0, found.output
    return json.loads(found.stdout)  # type: ignore[no-any-return]


def test_the_servo_axis_has_the_published_values(tables: list[Path], tmp_path: Path) -> None:
    free = "mass,viscous,coulomb_friction.level,load.load"
    found = report(tables, "emps", "emps", "identify", tmp_path, "--free", free)["parameters"]
    published = {"mass": (95.1, 0.01), "viscous": (203.5, 0.02), "coulomb_friction.level": (20.39, 0.02)}
    for name, (value, share) in published.items():
        assert found[name]["value"] == pytest.approx(value, rel=share)
    assert found["load.load"]["value"] == pytest.approx(3.16, abs=0.3)


def test_the_servo_axis_rubs(tables: list[Path], tmp_path: Path) -> None:
    verdict = report(tables, "emps", "emps", "diagnose", tmp_path)["verdict"]
    alike = {*verdict["effects"], *(name for names in verdict["confusable_with"].values() for name in names)}
    assert alike & {"coulomb_friction", "asymmetric_friction"}


def test_the_knob_rubs(tables: list[Path], tmp_path: Path) -> None:
    found = report(tables, "knob", "knob", "diagnose", tmp_path)
    assert found["verdict"]["kind"] == "effects"
    assert "coulomb_friction" in found["verdict"]["effects"]
    assert found["after"]["effects"]["coulomb_friction"]["level"]["value"] == pytest.approx(0.0365, rel=0.1)


def test_the_kicker_is_a_resistance_and_an_inductance(tables: list[Path], tmp_path: Path) -> None:
    found = report(tables, "empty", "kicker", "diagnose", tmp_path)
    assert found["verdict"]["kind"] != "effects"
    values = report(tables, "empty", "kicker", "identify", tmp_path)["parameters"]
    assert 0.377 <= values["resistance"]["value"] <= 0.396  # as its owners read it, with 10 mOhm of wiring
    assert 283e-6 <= values["inductance"]["value"] <= 296e-6


def test_the_inductance_of_the_magnet_depends_on_the_ball(tables: list[Path], tmp_path: Path) -> None:
    found = report(tables, "force", "maglev", "diagnose", tmp_path)["verdict"]
    assert "inductance_of_distance" in found["effects"]
    assert found["share"] > 0.9


def test_the_cylinder_is_corrected_by_friction_that_grows_with_pressure(tmp_path: Path) -> None:
    folder = DATA / "pneumatic"
    if not folder.exists():
        pytest.skip(f"{folder} is missing: these measurements are not in the repository")
    logs = [str(folder / f"oring_{bar}bar.csv") for bar in (1, 3, 7)]
    given = ["--plant", str(folder / "plant.yaml"), "--map", str(folder / "map.yaml")]
    held_out = ["--holdout", str(folder / "oring_5bar.csv")]
    found = CliRunner().invoke(main, ["diagnose", *logs, *held_out, *given, "--output", str(tmp_path), "--json"])
    assert found.exit_code == 0, found.output
    result = json.loads(found.stdout)
    assert result["verdict"]["kind"] in ("partly", "effects")
    assert set(result["verdict"]["effects"]) >= {"dry_friction", "pressure_friction"}
    assert result["after"]["rmse"]["holdout"] < 0.25 * result["before"]["rmse"]["holdout"]
