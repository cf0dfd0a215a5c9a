"""archive_node: what monitors say is kept, each thing once, and read after the node has gone."""

from __future__ import annotations

import json
import signal
from datetime import datetime, timedelta, timezone
from pathlib import Path

import pytest
from nodes.ros_process import Probe, ended, own_lines, piped

from valve_sim.station.figures import Report, finding_report, stroke_report
from valve_sim.station.keeping import Keeper

from .test_figures import FINDING, STROKE, SUMMARY

pytest.importorskip("pyarrow", reason="pyarrow is not installed: pip install '.[parquet]'")

from valve_sim.records.archive import Archive

VALVE = "/tank_1/valve"
START = datetime(2026, 11, 30, tzinfo=timezone.utc)


def health(level: int, message: str, seconds: float) -> Report:
    return Report(VALVE, START + timedelta(seconds=seconds), {"Health.Level": level, "Health.Message": message})


def test_each_thing_is_kept_once(tmp_path: Path) -> None:
    archive = Archive(tmp_path)
    keeper = Keeper(archive)
    for report in (stroke_report(json.dumps(STROKE)), *[finding_report(SUMMARY, FINDING)] * 3):
        keeper.take(report, 0.0)
    for seconds, (level, message) in enumerate([(0, "fine"), (1, "changed"), (1, "changed: friction"), (0, "fine")]):
        keeper.take(health(level, message, seconds), 0.0)
    archive.flush()
    (stroke,) = archive.read("strokes", VALVE)
    assert (stroke["number"], stroke["t2"], stroke["cause"]) == (31, None, "coulomb_friction")
    assert stroke["t1"] == pytest.approx(5.3e-3) and stroke["residual"] == pytest.approx(1.5e-6)
    (finding,) = archive.read("findings", VALVE)
    assert (finding["effect"], finding["value"], finding["unit"]) == ("coulomb_friction", 0.31, "N")
    alarms = archive.read("alarms", VALVE)
    assert [(row["level"], row["message"]) for row in alarms] == [(1, "changed"), (0, "fine")]
    assert {row["strokes_since_service"] for row in alarms} == {1}
    assert {row["alarm_class"] for row in alarms} == {"health"}


def test_strokes_count_since_the_last_service_over_restarts(tmp_path: Path) -> None:
    def stroke(number: int) -> Report:
        return stroke_report(json.dumps({**STROKE, "stroke": number}))._replace(
            valve=VALVE, time=START + timedelta(minutes=number)
        )

    for first in (0, 4):
        archive = Archive(tmp_path)
        keeper = Keeper(archive)
        for number in range(first, first + 4):
            keeper.take(stroke(number), 0.0)
        assert keeper.strokes_since_service(VALVE) == first + 4
        archive.flush()
    assert keeper.note_service(VALVE, START + timedelta(minutes=7.5), 0.0) == "serviced after 8 strokes"
    keeper.take(stroke(8), 0.0)
    archive.flush()
    again = Keeper(Archive(tmp_path))
    assert again.strokes_since_service(VALVE) == 1
    (row,) = archive.read("alarms", VALVE)
    assert (row["alarm_class"], row["level"], row["strokes_since_service"]) == ("service", 0, 8)
    next(tmp_path.glob("strokes/*/*/*.parquet")).write_bytes(b"damaged")
    damaged = Keeper(Archive(tmp_path))
    damaged.take(stroke(9), 0.0)
    assert damaged.strokes_since_service(VALVE) is None


def test_what_a_valves_own_node_says_is_a_class_of_its_own(tmp_path: Path) -> None:
    archive = Archive(tmp_path)
    keeper = Keeper(archive)
    for level in (1, 1, 0):
        keeper.take(Report(VALVE, START, {"Driver.Level": level, "Driver.Message": "too busy"}), 0.0)
    archive.flush()
    assert [(row["alarm_class"], row["level"]) for row in archive.read("alarms", VALVE)] == [
        ("driver", 1),
        ("driver", 0),
    ]


@pytest.mark.ros
def test_what_a_monitor_said_is_read_after_the_node_has_gone(probe: Probe, tmp_path: Path) -> None:
    from nodes.ros import LATCHED, DiagnosticArray, DiagnosticStatus, KeyValue, String, Trigger

    entries = [KeyValue(key=key, value=value) for key, value in FINDING.items()]
    strokes = probe.talker("/monitor/stroke_report", String)
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
        for number in range(3):
            strokes.publish(String(data=json.dumps({**STROKE, "stroke": number})))
        strokes.publish(String(data="nonsense"))
        finding.publish(DiagnosticArray(status=[DiagnosticStatus(message=SUMMARY, values=entries)]))
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
