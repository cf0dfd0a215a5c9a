"""The calibration record of a watched valve: expiry, what was declared otherwise since, and what cannot be written."""

from __future__ import annotations

from dataclasses import replace
from datetime import datetime, timedelta, timezone
from pathlib import Path

import pytest

from valve_sim.files.parameter_files import default_valve, save_valve
from valve_sim.model import ValveError
from valve_sim.nodes.calibration_watch import CalibrationWatch
from valve_sim.nodes.diagnostics import Level
from valve_sim.records.calibration import Record, Sensor, journal_path, load_changes, save_record, sign

NOW = datetime(2026, 11, 26, 12, 0, tzinfo=timezone.utc)
REPORT = '{"parameters": {"main_damping": {"value": 4.1, "stderr": 0.2, "ci95": [3.7, 4.5]}}}'
OTHER = replace(default_valve(), parameters=default_valve().parameters._replace(spring_rate=431.0))


def signed(folder: Path, now: datetime = NOW) -> Record:
    (folder / "identify.json").write_text(REPORT)
    save_valve(folder / "valve.yaml", default_valve(), "of a test")
    sensor = Sensor("laser", "L-12", "DKD 1234", "2099-01-01")
    files = folder / "identify.json", folder / "valve.yaml"
    return sign(*files, [sensor], serial_number="SN-7", signed_by="Ada", now=now, days=365, units={})


@pytest.fixture
def path(tmp_path: Path) -> Path:
    save_record(tmp_path / "calibration.json", signed(tmp_path))
    return tmp_path / "calibration.json"


def test_a_calibration_that_holds_says_until_when(path: Path) -> None:
    watch = CalibrationWatch(path, default_valve(), "/monitor", NOW)
    status = watch.status(NOW)
    assert (status.level, status.message) == (Level.OK, "valid until 2027-11-26")
    assert (status.values["serial number"], status.values["changes since"]) == ("SN-7", "0")
    assert watch.lines == [] and watch.new_remarks(NOW) == []


def test_expiry_is_a_warning_and_said_once(path: Path) -> None:
    watch, late = CalibrationWatch(path, default_valve(), "/monitor", NOW), NOW + timedelta(days=366)
    status = watch.status(late)
    assert status.level is Level.WARN
    assert "the calibration of SN-7 expired on 2027-11-26; calibrate it anew" in status.message
    assert watch.new_remarks(late) == ["the calibration of SN-7 expired on 2027-11-26; calibrate it anew"]
    assert watch.new_remarks(late) == []
    early = NOW - timedelta(days=1)
    assert watch.new_remarks(early) and watch.new_remarks(early + timedelta(seconds=1)) == []


def test_what_is_declared_otherwise_is_in_the_journal_once(path: Path) -> None:
    watch = CalibrationWatch(path, OTHER, "/monitor", NOW)
    assert watch.lines == ["changed since the calibration: valve.spring_rate 428.0 → 431.0"]
    again = CalibrationWatch(path, OTHER, "/monitor", NOW)
    assert again.lines == [] and again.status(NOW).values["changes since"] == "1"
    (change,) = load_changes(path)
    assert change.by.startswith("/monitor (")


def test_a_journal_that_cannot_be_written_is_a_warning(path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    with monkeypatch.context() as patch:
        patch.setattr("os.fsync", lambda number: (_ for _ in ()).throw(OSError(28, "No space left on device")))
        watch = CalibrationWatch(path, OTHER, "/monitor", NOW)
    assert "No space left on device" in watch.lines[0]
    status = watch.status(NOW)
    assert status.level is Level.WARN and "changes are not in the journal" in status.message


@pytest.mark.parametrize("place", ["record", "journal"])
def test_what_was_changed_by_hand_is_refused(path: Path, place: str) -> None:
    CalibrationWatch(path, OTHER, "/monitor", NOW)
    file, old, new = {"record": (path, "Ada", "Bob"), "journal": (journal_path(path), "431.0", "430.0")}[place]
    file.write_text(file.read_text().replace(old, new))
    with pytest.raises(ValveError, match="was changed"):
        CalibrationWatch(path, default_valve(), "/monitor", NOW)
