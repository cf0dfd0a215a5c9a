"""monitor_node as a user meets it: beside a running valve_node that wears, and beside one that sticks."""

from __future__ import annotations

import contextlib
import signal
import subprocess
import time
from collections.abc import Iterator
from pathlib import Path
from typing import Any

import numpy as np
import pytest
from identification.live_strokes import LiveValve

from nodes.ros import DiagnosticArray, Float64, JointState, Trigger

from .plant_on_topics import PlantOnTopics
from .ros_process import ENDS_WITHIN, PATIENCE, Diagnostics, Probe, ended, piped, report_of, running

pytestmark = [pytest.mark.ros, pytest.mark.usefixtures("ros")]


FEW = 8
"""Commissioning strokes, the fewest that are allowed."""
EXACT: dict[str, object] = {"valve.pilot_mass": 0.109}
"""One declared value, as it is shipped: the others are then exact, and there is less to estimate."""


def monitoring(folder: Path, **parameters: object) -> contextlib.AbstractContextManager[subprocess.Popen[str]]:
    """monitor_node while inside."""
    given: dict[str, object] = {"commissioning_strokes": FEW, "measured": "joint_states", **parameters}
    return piped(folder, ("-m", "valve_sim.nodes", "monitor_node"), **given)


class Ears:
    """What the monitor says, and a hand on the valve."""

    def __init__(self, probe: Probe) -> None:
        self.probe = probe
        self.reports = probe.hear("/monitor/stroke_report", DiagnosticArray)
        self.findings = probe.hear("/monitor/finding", DiagnosticArray, latched=True)
        self.diagnostics = Diagnostics(probe, "monitor")
        self.is_said = self.diagnostics.is_said
        self.voltage = probe.talker("coil_voltage", Float64)

    def input_counts(self) -> tuple[int, int]:
        """How many samples were taken and how many rejected, as was said last."""
        values = self.diagnostics.values("input")
        return int(values["samples"]), int(values["rejected"])

    def ready(self) -> None:
        """Wait until the valve runs and the monitor hears it: it then waits for a command only."""
        assert self.probe.until(lambda: self.voltage.get_subscription_count() == 2)
        assert self.probe.until(lambda: self.is_said("input", 1, "waiting for a command")), "no samples are heard"

    def stroke(self, volts: float = 9.0) -> None:
        """Open and close; 30 ms and 90 ms, give or take what else the machine does."""
        self.voltage.publish(Float64(data=volts))
        self.probe.spin_for(0.03)
        self.voltage.publish(Float64(data=0.0))
        self.probe.spin_for(0.09)

    def strokes(self, count: int) -> list[Any]:
        """So many strokes; their reports."""
        before = len(self.reports)
        for index in range(count):
            self.stroke(9.0 + index % 3)
        assert self.probe.until(lambda: len(self.reports) >= before + count), "a stroke was not reported"
        return [report_of(report) for report in self.reports[before:]]


TWO_WINDOWS, ANOTHER = 10, 3
"""Strokes with friction, the last of which does not end: searches begin with the sixth, the ninth, and the twelfth."""


@pytest.mark.long
@pytest.mark.any_distribution
def test_friction_that_appears_in_a_real_valve_is_warned_of_and_named(probe: Probe, tmp_path: Path) -> None:
    plant = PlantOnTopics(probe, LiveValve(seed=5, rate=5e3, jitter=0.0))
    findings = probe.hear("/monitor/finding", DiagnosticArray, latched=True)
    ears = Ears(probe)
    given: dict[str, object] = {"measured": "measured/joint_states", "use_sim_time": True, "max_rate": 1e5}
    with monitoring(tmp_path, **given, **EXACT) as process:
        plant.wait_for_monitor()
        reports = plant.strokes(FEW)
        before = len(plant.residuals)
        reports += plant.strokes(8)
        assert [report["state"] for report in reports] == ["commissioning"] * FEW + ["watching"] * (len(reports) - FEW)
        assert all(report["opened"] and report["closed"] for report in reports)
        assert not any(report["alarm.raised"] for report in reports)
        assert plant.predicted[-1].name == ["pilot_plunger", "main_plunger"]
        residual = np.array([message.data for message in plant.residuals[before:]])
        assert np.sqrt(np.mean(residual**2)) == pytest.approx(1e-6, rel=0.1)
        rubs = {"coulomb_friction": {"force": 0.3}}
        reports = plant.strokes(TWO_WINDOWS, rubs)
        assert any(report["alarm.raised"] for report in reports[:5])
        assert probe.until(lambda: ears.is_said("valve", 1, "not those of the commissioned valve"))
        assert probe.until(lambda: findings, 2 * PATIENCE), "the fault was not isolated"
        (status,) = findings[0].status
        finding, summary = {item.key: item.value for item in status.values}, status.message
        assert (status.name, status.level) == ("monitor: finding", b"\x01")
        assert (finding["kind"], finding["effects"]) == ("effects", "coulomb_friction")
        assert float(finding["parameters.coulomb_friction.force.value"]) == pytest.approx(0.3, abs=0.05)
        assert ": Coulomb friction 0.3" in summary
        assert summary.startswith(f"/valve, stroke {finding['stroke']} at 1970-01-01T00:00:")
        assert f"; probability {100 * float(finding['probability']):.0f} %" in summary or "> 99 %" in summary
        (last,) = (report for report in reports if report["stroke"] == int(finding["stroke"]))
        assert (last["valve"], last["time"]) == (finding["valve"], float(finding["time"]))
        stamp = findings[0].header.stamp
        assert last["time"] == pytest.approx(stamp.sec + 1e-9 * stamp.nanosec)
        assert 10.0 < last["time"] < 100.0, "of /clock, which begins with the tenth second"
        assert probe.until(lambda: ears.is_said("valve", 1, summary)), "the same words on /diagnostics"
        # Again with more strokes: the same name is on the topic with its new figures, and not logged again.
        plant.strokes(ANOTHER, rubs)
        assert probe.until(lambda: len(findings) > 1, 2 * PATIENCE), "no second finding"
        told = [message.status[0].message for message in findings]
        said = ended(process, signal.SIGTERM)
        assert said.count(told[0]) == 1
        assert not any(words in said for words in told[1:] if words != told[0])


@pytest.mark.any_distribution
def test_what_commissioning_found_survives_a_kill_until_it_is_asked_for_anew(probe: Probe, tmp_path: Path) -> None:
    state = tmp_path / "kept" / "tank.json"
    plant = PlantOnTopics(probe, LiveValve(seed=5, rate=500.0, jitter=0.0))
    given = {"measured": "measured/joint_states", "use_sim_time": True, "max_rate": 1e5, "state": state, **EXACT}
    with monitoring(tmp_path, **given) as process:
        plant.wait_for_monitor()
        plant.strokes(FEW + 3)
        assert probe.until(state.exists)
        process.kill()
        assert process.wait(ENDS_WITHIN) == -signal.SIGKILL
    plant.predicted.clear()
    with monitoring(tmp_path, **given) as process:
        plant.wait_for_monitor()
        reports = plant.strokes(3)
        assert {report["state"] for report in reports} == {"watching"}, reports
        client = probe.node.create_client(Trigger, "/monitor/recommission")
        assert probe.until(client.service_is_ready)
        assert probe.answers([client], Trigger.Request())[0].success
        assert probe.until(lambda: not state.exists())
        assert plant.strokes(3)[-1]["state"] == "commissioning"
        ended(process, signal.SIGTERM)


@pytest.fixture(scope="module")
def valve(ros: None, tmp_path_factory: pytest.TempPathFactory) -> Iterator[None]:
    """One valve_node for all tests that leave its parameters as they were."""
    with running(tmp_path_factory.mktemp("valve")):
        yield


def test_a_stuck_valve_is_an_error(valve: None, probe: Probe, tmp_path: Path) -> None:
    ears = Ears(probe)
    with monitoring(tmp_path):
        ears.ready()
        ears.strokes(2)
        own = probe.parameters()["valve.seat_load"]
        assert probe.set_parameters(valve__seat_load=100.0)[0].successful
        # Held for as long as it takes: the monitor is the more patient, the later this machine is.
        ears.voltage.publish(Float64(data=9.0))
        assert probe.until(lambda: ears.is_said("valve", 2, "did not open"))
        before = len(ears.reports)
        ears.voltage.publish(Float64(data=0.0))
        assert probe.until(lambda: len(ears.reports) > before), "the stroke was not reported"
        report = report_of(ears.reports[-1])
        assert report["opened"] is False
        assert "did not open" in report["fault"]
    assert probe.set_parameters(valve__seat_load=own)[0].successful


@pytest.mark.long
@pytest.mark.any_distribution
def test_with_the_topic_of_the_coil_a_valve_is_watched_by_its_current_alone(
    valve: None, probe: Probe, tmp_path: Path
) -> None:
    ears = Ears(probe)
    with monitoring(tmp_path, measured="coil"):
        ears.ready()
        (report,) = ears.strokes(1)
        topics = [f"{probe.target}/{name}" for name in ("coil", "coil_current", "joint_states")]
        assert probe.until(lambda: [probe.node.count_subscribers(topic) for topic in topics] == [1, 0, 0]), "hears more"
    assert report["opened"] is True and "fault" not in report, "seen by the current alone"


@pytest.mark.any_distribution
def test_bad_samples_are_counted_and_those_of_an_old_recording_warned_of(probe: Probe, tmp_path: Path) -> None:
    ears = Ears(probe)
    samples = probe.talker("measured/joint_states", JointState)
    old = 1_709_390_268

    def play() -> bool:
        """As `ros2 bag play` does without --clock."""
        message = joints(["pilot_plunger"], [0.0])
        message.header.stamp.sec = old
        samples.publish(message)
        ears.voltage.publish(Float64(data=9.0))
        probe.spin_for(0.01)
        days = f"{(time.time() - old) / 86_400:.0f} days behind this node's clock"
        return ears.is_said("input", 1, f"/valve/measured/joint_states is stamped {days}")

    with monitoring(tmp_path, measured="measured/joint_states") as process:
        assert probe.until(lambda: samples.get_subscription_count() == 1)
        # The monitor takes sensors of any reliability: what comes before it has found this publisher is lost.
        assert probe.insist(
            lambda: samples.publish(joints(["pilot_plunger"], [0.0])),
            lambda: ears.is_said("input", 1, "waiting for a command"),
        )
        heard = ears.input_counts()[0]
        samples.publish(joints(["pilot_plunger"], [float("nan")]))
        samples.publish(joints(["elbow"], [0.0]))
        samples.publish(joints(["pilot_plunger"], []))
        samples.publish(joints(["main_plunger", "pilot_plunger"], [0.0, 1e-6]))
        assert probe.until(lambda: sum(ears.input_counts()) == heard + 4), "a message was not counted"
        assert ears.input_counts() == (heard + 1, 3)
        assert probe.until(play)
        said = ended(process, signal.SIGINT)
    assert "use_sim_time:=true, ros2 bag play --clock-topics-all;" in said


def joints(names: list[str], positions: list[float]) -> JointState:
    message = JointState(name=names, position=positions)
    message.header.stamp.sec, message.header.stamp.nanosec = divmod(time.time_ns(), 1_000_000_000)
    return message
