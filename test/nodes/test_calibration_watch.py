"""The calibration record of a watched valve: expiry, what was declared otherwise since, and what cannot be written."""

from __future__ import annotations

from dataclasses import replace
from datetime import datetime, timedelta, timezone
from pathlib import Path

import pytest

from valve_sim.files.parameter_files import default_valve, save_valve
from valve_sim.model import Valve, ValveError
from valve_sim.nodes.diagnostics import CalibrationWatch, Level
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


def watching(path: Path, valve: Valve, now: datetime = NOW) -> tuple[CalibrationWatch, list[str]]:
    """What a node that declares a valve watches, and what it says, which grows."""
    said: list[str] = []
    watch = CalibrationWatch(path, "/monitor", said.append)
    watch.note(valve, now)
    return watch, said


def test_a_calibration_that_holds_says_until_when(path: Path) -> None:
    watch, said = watching(path, default_valve())
    status = watch.status(NOW)
    assert (status.level, status.message) == (Level.OK, "valid until 2027-11-26")
    assert (status.values["serial number"], status.values["changes since"]) == ("SN-7", "0")
    assert said == []


def test_expiry_is_a_warning_and_said_once(path: Path) -> None:
    (watch, said), late = watching(path, default_valve()), NOW + timedelta(days=366)
    status = watch.status(late)
    assert status.level is Level.WARN
    assert "the calibration of SN-7 expired on 2027-11-26; calibrate it anew" in status.message
    watch.status(late)
    assert said == ["the calibration of SN-7 expired on 2027-11-26; calibrate it anew"]
    early = NOW - timedelta(days=1)
    watch.status(early)
    watch.status(early + timedelta(seconds=1))
    assert len(said) == 2


def test_what_is_declared_otherwise_is_in_the_journal_once(path: Path) -> None:
    _, said = watching(path, OTHER)
    assert said == ["changed since the calibration: valve.spring_rate 428.0 → 431.0"]
    again, said = watching(path, OTHER)
    assert said == [] and again.status(NOW).values["changes since"] == "1"
    (change,) = load_changes(path)
    assert change.by.startswith("/monitor (")


def test_each_change_while_the_node_runs_is_in_the_journal_with_what_that_node_had_before(path: Path) -> None:
    watch, _ = watching(path, OTHER)
    another = CalibrationWatch(path, "/valve", lambda words: None)
    another.note(default_valve(), NOW)
    for spring_rate in (435.0, 435.0, 440.0):
        parameters = OTHER.parameters._replace(spring_rate=spring_rate)
        watch.note(replace(OTHER, parameters=parameters), NOW)
    changes = [(change.by.split()[0], change.before, change.after) for change in load_changes(path)]
    assert changes == [
        ("/monitor", 428.0, 431.0),
        ("/valve", 431.0, 428.0),
        ("/monitor", 431.0, 435.0),
        ("/monitor", 435.0, 440.0),
    ]
    assert watch.status(NOW).values["changes since"] == "4"


def test_a_journal_that_cannot_be_written_is_a_warning_until_it_can_and_nothing_is_lost(
    path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    with monkeypatch.context() as patch:
        patch.setattr("os.fsync", lambda number: (_ for _ in ()).throw(OSError(28, "No space left on device")))
        watch, said = watching(path, OTHER)
    assert "No space left on device" in said[0]
    status = watch.status(NOW)
    assert status.level is Level.WARN and "changes are not in the journal" in status.message
    watch.note(OTHER, NOW)
    assert watch.status(NOW).level is Level.OK
    assert [(change.before, change.after) for change in load_changes(path)] == [(428.0, 431.0)]


@pytest.mark.parametrize("place", ["record", "journal"])
def test_what_was_changed_by_hand_is_refused(path: Path, place: str) -> None:
    watching(path, OTHER)
    file, old, new = {"record": (path, "Ada", "Bob"), "journal": (journal_path(path), "431.0", "430.0")}[place]
    file.write_text(file.read_text().replace(old, new))
    with pytest.raises(ValveError, match="was changed"):
        watching(path, default_valve())
