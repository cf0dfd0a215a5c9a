"""archive_node: what monitors say is kept, each thing once, and read after the node has gone."""

from __future__ import annotations

import signal
import sqlite3
from datetime import datetime, timedelta, timezone
from pathlib import Path

import pytest
from nodes.ros import LATCHED, DiagnosticArray, DiagnosticStatus, KeyValue, Trigger
from nodes.ros_process import ENDS_WITHIN, Probe, ended, own_lines, piped

from valve_sim.model import ValveError
from valve_sim.nodes.topics import LAST_STROKES
from valve_sim.nodes.wiring import profile
from valve_sim.records.archive import Archive
from valve_sim.station.archive_node import Keeper
from valve_sim.station.figures import Report, finding_report, stroke_report

from .test_figures import BROKEN, FINDING, STROKE, SUMMARY

VALVE = "/tank_1/valve"
START = datetime(2026, 11, 30, tzinfo=timezone.utc)


def stroke(number: int) -> Report:
    report = stroke_report("watching", {**STROKE, "stroke": str(number)})
    return report._replace(valve=VALVE, time=START + timedelta(minutes=number))


def status(group: str, level: int, message: str, seconds: float) -> Report:
    said = {f"{group}.Level": level, f"{group}.Message": message}
    return Report(VALVE, START + timedelta(seconds=seconds), said)


def test_each_thing_is_kept_once(tmp_path: Path) -> None:
    archive = Archive(tmp_path, is_written=True)
    keeper = Keeper(archive)
    for report in (stroke_report("watching", STROKE), *[finding_report(SUMMARY, FINDING)] * 3):
        keeper.take(report)
    for seconds, (level, message) in enumerate([(0, "fine"), (1, "changed"), (1, "changed: friction"), (0, "fine")]):
        keeper.take(status("Health", level, message, seconds))
        keeper.take(status("Driver", level, "too busy", seconds + 0.5))
    keeper.write()
    (row,) = archive.read("strokes", VALVE)
    assert (row["number"], row["t2"], row["cause"]) == (31, None, "coulomb_friction")
    assert row["t1"] == pytest.approx(5.3e-3) and row["residual"] == pytest.approx(1.5e-6)
    (finding,) = archive.read("findings", VALVE)
    assert (finding["effect"], finding["value"], finding["unit"]) == ("coulomb_friction", 0.31, "N")
    alarms = archive.read("alarms", VALVE)
    assert [(row["alarm_class"], row["level"], row["message"]) for row in alarms] == [
        ("health", 1, "changed"), ("driver", 1, "too busy"), ("health", 0, "fine"), ("driver", 0, "too busy"),
    ]  # fmt: skip
    assert {row["strokes_since_service"] for row in alarms} == {1}


def test_strokes_count_since_the_last_service_over_restarts(tmp_path: Path) -> None:
    for first in (0, 4):
        keeper = Keeper(Archive(tmp_path, is_written=True))
        for number in range(first, first + 4):
            keeper.take(stroke(number))
        assert keeper.strokes_since_service(VALVE) == first + 4
        keeper.write()
    assert keeper.note_service(VALVE, START + timedelta(minutes=7.5)) == "serviced after 8 strokes"
    keeper.take(stroke(8))
    keeper.write()
    archive = Archive(tmp_path)
    assert Keeper(archive).strokes_since_service(VALVE) == 1
    (row,) = archive.read("alarms", VALVE)
    assert (row["alarm_class"], row["level"], row["strokes_since_service"]) == ("service", 0, 8)


def test_what_happened_while_the_archive_was_down_is_kept_or_said_to_be_missing(tmp_path: Path) -> None:
    def heard(strokes: list[int], level: int) -> list[str]:
        archive = Archive(tmp_path, is_written=True)
        keeper = Keeper(archive)
        for number in strokes:
            keeper.take(stroke(number))
        keeper.take(finding_report(SUMMARY, FINDING)._replace(valve=VALVE))
        keeper.take(status("Health", level, "said", 60.0 * strokes[-1]))
        keeper.write()
        return [row["message"] for row in archive.read("alarms", VALVE)]

    assert heard([3, 4, 5], 1) == ["said"], "what was before the first start is not missed"
    assert heard([4, 5, 6, 7], 1) == ["said"], "a monitor says its last strokes, its finding and its state again"
    assert heard([7, 10], 0) == ["said", "strokes 8 to 9 are missing: no report was heard", "said"]
    archive = Archive(tmp_path)
    assert [row["number"] for row in archive.read("strokes", VALVE)] == [3, 4, 5, 6, 7, 10]
    assert len(archive.read("findings", VALVE)) == 1
    restarted = [stroke(number)._replace(time=START + timedelta(hours=1, minutes=number)) for number in (0, 1, 3)]
    keeper = Keeper(Archive(tmp_path, is_written=True))
    for report in restarted:
        keeper.take(report)
    keeper.write()
    (missing,) = archive.read("alarms", VALVE, START + timedelta(hours=1))
    assert (missing["alarm_class"], missing["message"]) == ("missing", "stroke 2 is missing: no report was heard")


def test_rows_wait_while_the_archive_cannot_be_written(tmp_path: Path) -> None:
    archive = Archive(tmp_path, is_written=True)
    keeper, other = Keeper(archive), sqlite3.connect(tmp_path / "archive.sqlite")
    other.execute("BEGIN IMMEDIATE")
    for number in range(3):
        keeper.take(stroke(number))
        if number == 1:
            with pytest.raises(ValveError, match="database is locked"):
                keeper.write()
    other.rollback()
    keeper.write()
    keeper.write()
    assert [row["number"] for row in archive.read("strokes", VALVE)] == [0, 1, 2]


def message_of(values: dict[str, str], words: str = "") -> DiagnosticArray:
    """A message of a monitor."""
    entries = [KeyValue(key=key, value=value) for key, value in values.items()]
    return DiagnosticArray(status=[DiagnosticStatus(message=words, values=entries)])


@pytest.mark.ros
def test_an_archive_that_is_killed_loses_nothing_that_the_monitor_still_says(probe: Probe, tmp_path: Path) -> None:
    strokes, folder = (
        probe.talker("/monitor/stroke_report", DiagnosticArray, profile(LAST_STROKES)),
        tmp_path / "archive",
    )
    program = ("-m", "valve_sim.station", "archive_node", "--ros-args", "-p", f"folder:={folder}")

    def kept() -> list[int]:
        return [row["number"] for row in Archive(folder).read("strokes", "/valve")] if folder.exists() else []

    def say(numbers: range) -> None:
        for number in numbers:
            strokes.publish(message_of({**STROKE, "stroke": str(number)}))

    with piped(tmp_path, program) as process:
        assert probe.until(strokes.get_subscription_count)
        say(range(3))
        assert probe.until(lambda: kept() == [0, 1, 2])
        say(range(3, 6))
        process.kill()
        assert process.wait(ENDS_WITHIN) == -signal.SIGKILL
    say(range(6, 9))
    with piped(tmp_path, program):
        assert probe.until(lambda: kept() == list(range(9)))
    assert not Archive(folder).read("alarms", "/valve"), "nothing is missing"


@pytest.mark.ros
def test_what_a_monitor_said_is_read_after_the_node_has_gone(probe: Probe, tmp_path: Path) -> None:
    strokes = probe.talker("/monitor/stroke_report", DiagnosticArray, LATCHED)
    finding = probe.talker("/monitor/finding", DiagnosticArray, LATCHED)
    answers = probe.talker("/opcua/alarms", DiagnosticArray)
    answer = {"valve": "/valve", "user": "Bob", "comment": "seen"}
    said_of = [KeyValue(key=key, value=value) for key, value in answer.items()]
    answered = DiagnosticStatus(level=b"\x01", message="acknowledged by Bob", values=said_of)
    of_another = DiagnosticStatus(message="of another", values=[KeyValue(key="valve", value="/another")])
    folder = tmp_path / "archive"
    program = ("-m", "valve_sim.station", "archive_node", "--ros-args", "-p", f"folder:={folder}")
    with piped(tmp_path, program) as process:
        talkers = (strokes, finding, answers)
        assert probe.until(lambda: all(talker.get_subscription_count() for talker in talkers))
        for found in BROKEN:
            strokes.publish(message_of(found))
            probe.spin_for(0.1)
        probe.spin_for(1.0)
        for number in range(3):
            strokes.publish(message_of({**STROKE, "stroke": str(number)}))
        finding.publish(message_of(FINDING, SUMMARY))
        answers.publish(DiagnosticArray(status=[of_another, answered]))
        probe.spin_for(2.0)  # all are in the node's queues; the next look takes them
        answer = probe.call("serviced", Trigger)
        assert answer.success and answer.message == "/valve: serviced after 3 strokes; they count from 0 again"
        said = ended(process, signal.SIGINT)
    archive = Archive(folder)
    assert [row["number"] for row in archive.read("strokes", "/valve")] == [0, 1, 2]
    assert [row["effect"] for row in archive.read("findings", "/valve")] == ["coulomb_friction"]
    row = next(row for row in archive.read("alarms", "/valve") if row["alarm_class"] == "answer")
    assert (row["level"], row["message"], row["user"]) == (1, "acknowledged by Bob", "Bob")
    assert row["comment"] == "seen" and not archive.read("alarms", "/another")
    assert any("a report of /valve is left out" in line for line in own_lines(said)), said
