"""A calibration record: signed, loaded, expired, changed by hand, followed by a journal; whole or not at all."""

from __future__ import annotations

import json
import subprocess
import sys
import threading
from dataclasses import replace
from datetime import datetime, timezone
from html.parser import HTMLParser
from pathlib import Path

import pytest
from click.testing import CliRunner

from valve_sim.cli import main
from valve_sim.files.parameter_files import default_valve, save_valve
from valve_sim.model import ValveError
from valve_sim.records.calibration import (
    Change,
    Record,
    Sensor,
    append_changes,
    declared_numbers,
    journal_path,
    load_changes,
    load_record,
    note_changes,
    read_sensors,
    save_record,
    sign,
)
from valve_sim.records.certificate import certificate

NOW = datetime(2026, 11, 26, 12, 0, tzinfo=timezone.utc)
LASER = Sensor("laser", "L-12", "DKD <1234>", "2027-05-01")
REPORT = {
    "schema": "valve_sim/identification/1",
    "parameters": {
        "main_damping": {"value": 4.1, "stderr": 0.2, "ci95": [3.7, 4.5]},
        "coulomb_friction.force": {"value": 0.3, "stderr": None, "ci95": [None, 0.4]},
    },
}


@pytest.fixture
def files(tmp_path: Path) -> tuple[Path, Path]:
    report, parameters = tmp_path / "identify.json", tmp_path / "valve.yaml"
    report.write_text(json.dumps(REPORT))
    save_valve(parameters, default_valve(), "of a test")
    return report, parameters


def signed(files: tuple[Path, Path], days: int = 365) -> Record:
    report, parameters = files
    units = {"main_damping": "N·s/m", "coulomb_friction.force": "N"}
    return sign(
        report, parameters, [LASER], serial_number="SN-7", signed_by="Ada", now=NOW, days=days, units=units, note="new"
    )


def test_a_record_is_loaded_as_it_was_signed(files: tuple[Path, Path], tmp_path: Path) -> None:
    record, path = signed(files), tmp_path / "calibration.json"
    save_record(path, record)
    assert load_record(path) == record
    assert record.valid_until == "2027-05-01", "the sensor's certificate expires before the year is over"
    assert signed(files, days=30).valid_until == "2026-12-26"
    assert [(figure.name, figure.value, figure.unit) for figure in record.figures] == [
        ("main_damping", 4.1, "N·s/m"),
        ("coulomb_friction.force", 0.3, "N"),
    ]


def test_what_speaks_against_a_record_is_said(files: tuple[Path, Path]) -> None:
    record, parameters = signed(files), files[1].read_bytes()
    assert record.remarks(NOW, parameters) == []
    assert record.remarks(datetime(2027, 5, 1, 23, tzinfo=timezone.utc), parameters) == []
    late = record.remarks(datetime(2027, 5, 2, tzinfo=timezone.utc), parameters + b"#")
    assert late == [
        "the calibration of SN-7 expired on 2027-05-01; calibrate it anew",
        "the certificate DKD <1234> of the sensor laser expired on 2027-05-01",
        "the parameter file is not the one that was signed off (valve.yaml)",
    ]


@pytest.mark.parametrize("change", ["value", "name", "cut"])
def test_a_change_by_hand_shows(files: tuple[Path, Path], tmp_path: Path, change: str) -> None:
    path = tmp_path / "calibration.json"
    save_record(path, signed(files))
    text = path.read_text()
    path.write_text(
        {"value": text.replace("4.1", "4.2"), "name": text.replace("Ada", "Bob"), "cut": text[:-20]}[change]
    )
    with pytest.raises(ValveError, match=r"was changed after it was signed|is no JSON"):
        load_record(path)


def test_an_expired_sensor_signs_nothing_and_other_reports_are_refused(
    files: tuple[Path, Path], tmp_path: Path
) -> None:
    report, parameters = files
    old = LASER._replace(expires="2026-11-25")
    with pytest.raises(ValveError, match="its certificate DKD <1234> expired on 2026-11-25"):
        sign(report, parameters, [old], serial_number="S", signed_by="A", now=NOW, days=1, units={})
    other = tmp_path / "other.json"
    for content in ("{}", "[]", '{"parameters": {"a": 1}}', "x"):
        other.write_text(content)
        with pytest.raises(ValveError) as refused:
            sign(other, parameters, [LASER], serial_number="S", signed_by="A", now=NOW, days=1, units={})
        assert str(other) in str(refused.value) and "\n" not in str(refused.value)


def test_later_changes_are_appended_and_cannot_be_taken_out(files: tuple[Path, Path], tmp_path: Path) -> None:
    path = tmp_path / "calibration.json"
    save_record(path, signed(files))
    assert load_changes(path) == ()
    changes = tuple(
        Change(f"2026-12-0{day}T08:00:00Z", "Bob", "valve.spring_rate", 428.0, 428.0 + day) for day in (1, 2, 3)
    )
    for change in changes:
        append_changes(path, [change])
    assert load_changes(path) == changes
    journal = journal_path(path)
    found = json.loads(journal.read_text())
    del found["changes"][1]
    journal.write_text(json.dumps(found))
    with pytest.raises(ValveError, match="entry 2 was changed or taken out"):
        load_changes(path)
    save_record(path, signed(files, days=10))
    with pytest.raises(ValveError, match="is not the journal of"):
        load_changes(path)


def test_what_is_declared_otherwise_later_is_noted_once(files: tuple[Path, Path], tmp_path: Path) -> None:
    path = tmp_path / "calibration.json"
    save_record(path, signed(files))
    valve = default_valve()
    assert note_changes(path, declared_numbers(valve), "monitor", NOW) == ()
    assert not journal_path(path).exists()
    parameters = valve.parameters._replace(spring_rate=431.0, attraction_polynomial=(1.0, 2.0, 3.0, 4.0))
    other = replace(valve, parameters=parameters, effects={"stiction": {"force": 0.2}})
    noted = note_changes(path, declared_numbers(other), "monitor", NOW)
    assert noted == load_changes(path)
    found = {change.parameter: (change.before, change.after) for change in noted}
    assert found["valve.spring_rate"] == (428.0, 431.0)
    assert found["valve.attraction_polynomial[3]"] == (valve.parameters.attraction_polynomial[3], 4.0)
    assert found["effects.stiction.force"] == (None, 0.2)
    assert note_changes(path, declared_numbers(other), "monitor", NOW) == ()
    back = note_changes(path, declared_numbers(valve), "monitor", NOW)
    assert {change.parameter: (change.after, change.before) for change in back} == found
    assert {(change.by, change.at) for change in back} == {("monitor", "2026-11-26T12:00:00Z")}


def test_those_who_append_at_once_lose_nothing_of_each_other(files: tuple[Path, Path], tmp_path: Path) -> None:
    path = tmp_path / "calibration.json"
    save_record(path, signed(files))
    change = Change("2026-12-01T08:00:00Z", "Bob", "valve.spring_rate", 428.0, 431.0)

    def append() -> None:
        for _ in range(10):
            append_changes(path, [change])

    threads = [threading.Thread(target=append) for _ in range(4)]
    for thread in threads:
        thread.start()
    for thread in threads:
        thread.join()
    assert load_changes(path) == (change,) * 40


def test_a_clock_before_the_signature_is_said(files: tuple[Path, Path]) -> None:
    record = signed(files)
    assert record.remarks(NOW) == []
    (words,) = record.remarks(datetime(1970, 1, 1, tzinfo=timezone.utc))
    assert words.endswith("signed at 2026-11-26T12:00:00Z, which this machine's clock has not reached: set the clock")


def test_a_full_disk_leaves_record_and_journal_as_they_were(
    files: tuple[Path, Path], tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    path = tmp_path / "calibration.json"
    save_record(path, signed(files))
    change = Change("2026-12-01T08:00:00Z", "Bob", "valve.stroke", 1.0, 2.0)
    append_changes(path, [change])
    with monkeypatch.context() as patch:
        patch.setattr("os.fsync", lambda number: (_ for _ in ()).throw(OSError(28, "No space left on device")))
        for write in (lambda: append_changes(path, [change]), lambda: save_record(path, signed(files, days=2))):
            with pytest.raises(ValveError, match="No space left on device"):
                write()
    assert (load_record(path), load_changes(path)) == (signed(files), (change,))
    assert {file.name for file in tmp_path.iterdir()} >= {"calibration.json", "calibration.journal.json"}
    assert not list(tmp_path.glob("*.partial*"))


def test_a_kill_while_the_journal_grows_leaves_it_whole(files: tuple[Path, Path], tmp_path: Path) -> None:
    path = tmp_path / "calibration.json"
    save_record(path, signed(files))
    program = """
import sys; from pathlib import Path
from valve_sim.records.calibration import Change, append_changes
for number in range(10_000):
    append_changes(Path(sys.argv[1]), [Change("2026-12-01T08:00:00Z", "Bob", "p", float(number), None)])
    print(number, flush=True)
"""
    reached = -1
    for _ in range(5):
        with subprocess.Popen([sys.executable, "-c", program, str(path)], stdout=subprocess.PIPE, text=True) as process:
            assert process.stdout is not None
            for _ in range(4):
                process.stdout.readline()
            process.kill()
        changes = load_changes(path)
        assert len(changes) >= reached + 4
        reached = len(changes)


def test_the_page_has_all_of_it_and_escapes_names(files: tuple[Path, Path]) -> None:
    class Words(HTMLParser):
        text = ""

        def handle_data(self, data: str) -> None:
            self.text += data

    record = signed(files)
    words = Words()
    words.feed(certificate(record, (Change("2026-12-01T08:00:00Z", "Bob", "valve.stroke", 1.0, None),)))
    for wanted in ("SN-7", "Ada", "DKD <1234>", "main_damping", "4.1", "3.7 to 4.5", record.digest, "valve.stroke"):
        assert wanted in words.text
    assert "http" not in certificate(record)


def test_the_command_writes_record_and_page(files: tuple[Path, Path], tmp_path: Path) -> None:
    sensors = tmp_path / "sensors.yaml"
    sensors.write_text("- {name: laser, serial_number: L-12, certificate: DKD 1234, expires: 2099-05-01}\n")
    report, parameters = map(str, files)
    options = ["--params", parameters, "--serial", "SN-7", "--by", "Ada", "--sensors", str(sensors)]
    done = CliRunner().invoke(main, ["commission", report, *options, "--output", str(tmp_path / "out")])
    assert done.exit_code == 0, done.output
    record = load_record(tmp_path / "out" / "calibration.json")
    assert record.figures[0].unit == "N·s/m" and record.remarks(datetime.now(timezone.utc), files[1].read_bytes()) == []
    assert (tmp_path / "out" / "calibration.html").is_file()
    sensors.write_text("- {name: laser, expires: 2099-05-01}\n")
    with pytest.raises(ValveError, match="sensor 1: found"):
        read_sensors(sensors)
    sensors.write_text("- {name: laser, serial_number: L-12, certificate: DKD 1234, expires: May}\n")
    with pytest.raises(ValveError, match="expires: found 'May', expected a day"):
        read_sensors(sensors)
