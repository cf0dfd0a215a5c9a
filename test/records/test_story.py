"""`valve-sim history`: what an archive holds of a valve, printed, as JSON and as a picture."""

from __future__ import annotations

import json
from datetime import datetime, timedelta, timezone
from pathlib import Path

import pytest
from click.testing import CliRunner, Result

from valve_sim.cli import main
from valve_sim.records.archive import Archive, Row

VALVE = "/tank_1/valve"
START = datetime(2026, 11, 30, 23, 0, tzinfo=timezone.utc)


@pytest.fixture
def folder(tmp_path: Path) -> Path:
    archive = Archive(tmp_path / "archive", is_written=True)
    for number in range(4):
        row = {"number": number, "t1": (5.2 + 0.1 * number) * 1e-3, "main_damping": 4.0, "residual": 1e-6}
        archive.write([Row("strokes", VALVE, START + timedelta(hours=number // 2 * 2, minutes=number), row)])
    finding = {"effect": "coulomb_friction", "summary": "Coulomb friction 0.3 N"}
    alarm = {"level": 1, "message": "has changed"}
    archive.write([Row("findings", VALVE, START, finding), Row("alarms", VALVE, START, alarm)])
    return tmp_path / "archive"


def history(folder: Path, *options: str, valve: str = "tank_1/valve") -> Result:
    return CliRunner().invoke(main, ["history", valve, "--archive", str(folder), *options])


def test_months_findings_and_alarms_are_printed(folder: Path) -> None:
    lines = history(folder).stdout.splitlines()
    assert lines[0] == "/tank_1/valve: 4 strokes, 1 findings, 1 alarms"
    assert [line.split() for line in lines[3:5]] == [
        ["2026-11", "2", "5.250", "–", "–", "4.000", "1.000"],
        ["2026-12", "2", "5.450", "–", "–", "4.000", "1.000"],
    ]
    assert "  2026-11-30 23:00:00Z  Coulomb friction 0.3 N" in lines
    assert "  2026-11-30 23:00:00Z  WARN has changed" in lines


def test_json_has_the_same_of_the_time_that_is_asked_for(folder: Path) -> None:
    found = json.loads(history(folder, "--since", "2026-12-01", "--json").stdout)
    assert [month["month"] for month in found["months"]] == ["2026-12"]
    assert found["months"][0]["t1"] == pytest.approx(5.45e-3) and found["alarms"] == []
    whole = json.loads(history(folder, "--until", "2026-12-01", "--json").stdout)
    assert whole["alarms"][0]["time"] == "2026-11-30T23:00:00+00:00"


def test_a_picture_is_drawn(folder: Path, tmp_path: Path) -> None:
    assert history(folder, "--plot", str(tmp_path / "x.png")).exit_code == 0
    assert (tmp_path / "x.png").read_bytes().startswith(b"\x89PNG")
    nothing = history(folder, "--since", "2030-01-01", "--plot", str(tmp_path / "y.png"))
    assert nothing.exit_code == 2 and "there is no stroke" in nothing.stderr and not (tmp_path / "y.png").exists()


def test_a_valve_or_an_archive_that_is_not_there_is_one_line(folder: Path, tmp_path: Path) -> None:
    done = history(folder, valve="tank_9/valve")
    assert done.exit_code == 2
    assert done.stderr.strip().endswith("nothing of this valve is in the archive; expected one of /tank_1/valve")
    done = history(tmp_path / "none")
    assert done.exit_code == 2 and not (tmp_path / "none").exists()
    assert done.stderr.strip().endswith("there is no archive; expected the folder that archive_node writes")
