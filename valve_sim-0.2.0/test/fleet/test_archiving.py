"""What a fleet finds is kept in the archive of the monitors, once, and printed by `valve-sim history`."""

from __future__ import annotations

import json
from datetime import datetime, timezone
from pathlib import Path

import pytest
from click.testing import CliRunner

from valve_sim.cli import main
from valve_sim.fleet.archiving import archive_rows
from valve_sim.fleet.units import DUPLICATE, EXAMINED, LOST, Row
from valve_sim.records.archive import Archive

from .bags import make_bag

VALVE = "/tank_1/valve"
START = datetime(2026, 11, 30, 12, 0, tzinfo=timezone.utc)


def row(key: str, state: str = EXAMINED, **values: object) -> Row:
    start = round(START.timestamp() * 1e9)
    return {"key": key, "state": state, "valve": VALVE, "source": f"{key}.mcap", "start_time": start, **values}


def test_each_result_is_kept_once_and_what_was_not_examined_is_not(tmp_path: Path) -> None:
    rows = [
        row("a", verdict="effects", effects=["stiction", "drag"], probability=0.98, summary="Stiction.", t1=5.3e-3),
        row("b", verdict="none", effects=[], strokes=8),
        row("c", LOST),
        {**row("d", DUPLICATE), "valve": "", "start_time": None},
    ]
    assert archive_rows(tmp_path, rows) == 2
    assert archive_rows(tmp_path, [*rows, row("e", verdict="none")]) == 1
    found = Archive(tmp_path).read("recordings", VALVE)
    assert [kept["key"] for kept in found] == ["a", "b", "e"]
    assert (found[0]["effects"], found[0]["source"], found[0]["time"]) == ("stiction, drag", "a.mcap", START)
    assert found[0]["t1"] == pytest.approx(5.3e-3) and found[0]["t2"] is None and found[1]["strokes"] == 8


@pytest.mark.long
def test_fleet_writes_an_archive_that_a_monitor_writes_too(tmp_path: Path) -> None:
    make_bag(tmp_path / "day_1", 1.0, VALVE, seed=1)
    archive = Archive(tmp_path / "archive")
    archive.add("strokes", VALVE, START, {"number": 0}, 0.0)
    archive.flush()
    command = ["fleet", str(tmp_path / "day_1"), "--no-search", "--workers", "1", "--output", str(tmp_path / "out")]
    for new in (1, 0):
        ran = CliRunner().invoke(main, [*command, "--archive", str(tmp_path / "archive")])
        assert ran.exit_code == 0, ran.output
        assert f"{new} results are new in {tmp_path / 'archive'}" in ran.stdout
    told = CliRunner().invoke(main, ["history", VALVE, "--archive", str(tmp_path / "archive"), "--json"])
    (recording,) = json.loads(told.stdout)["recordings"]
    assert recording["source"] == str(tmp_path / "day_1") and recording["strokes"] > 0
    text = CliRunner().invoke(main, ["history", VALVE, "--archive", str(tmp_path / "archive")]).stdout
    assert "/tank_1/valve: 1 strokes" in text and "recordings:" in text and recording["summary"] in text
