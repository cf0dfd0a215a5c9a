"""A monitor by the coil's current alone, beside an independent plant of which nothing else is measured."""

from __future__ import annotations

import math
from pathlib import Path

import numpy as np
import pytest
from plants.coil_alone import Build

from identification.live_coil import NOISE, LiveCoil
from identification.one_thread import Monitor
from identification.test_current_alone import declared
from valve_sim.identification.monitoring.commissioning import Commissioning
from valve_sim.identification.monitoring.fault_isolation import isolate_fault
from valve_sim.identification.monitoring.findings import DidNotClose, DidNotOpen, Fault, OpenedPartly, Unusable
from valve_sim.identification.monitoring.memory import load_commissioning, save_commissioning
from valve_sim.identification.monitoring.segmenter import ALONE, StrokeSegmenter
from valve_sim.identification.monitoring.settings import MonitorSettings
from valve_sim.identification.reporting.monitor_messages import stroke_json

BUILD = Build(eddy_resistance=40.0)
VALVE = declared(BUILD)
SETTINGS = MonitorSettings(commissioning_strokes=8)
LEVELS = (9.0, 12.0, 7.5, 14.0)
WORN = 0.02
"""N of friction."""


def coil_of(monitor: Monitor, *, has_voltage: bool = True) -> LiveCoil:
    return LiveCoil(monitor, np.random.default_rng(18), LEVELS, 0.080, has_voltage=has_voltage)


@pytest.fixture(scope="module")
def commissioning() -> Commissioning:
    """Of a healthy valve."""
    monitor = Monitor(VALVE, SETTINGS, refit=False)
    coil_of(monitor).strokes(SETTINGS.commissioning_strokes + 1, BUILD)
    found = monitor.stroke_monitor.commissioning
    assert found is not None
    return found


@pytest.fixture
def monitor(commissioning: Commissioning) -> Monitor:
    """One that knows the healthy valve."""
    monitor = Monitor(VALVE, SETTINGS, refit=False)
    monitor.stroke_monitor.use(commissioning)
    return monitor


def test_what_commissioning_finds_is_true(commissioning: Commissioning) -> None:
    baseline = commissioning.baseline
    assert not baseline.has_positions
    # Its rests last for a few milliseconds of each stroke.
    assert baseline.noise.sigma == pytest.approx(NOISE, rel=0.2)
    found, error = baseline.valve.parameters.main_damping, math.sqrt(baseline.covariance[1, 1])
    assert abs(found - BUILD.main_damping) < 4 * error < 0.4
    assert baseline.scatter < 50e-6, "the measured voltage dates commands that came late"


def test_a_healthy_valve_raises_no_alarm_and_its_reports_are_in_milliamperes(monitor: Monitor) -> None:
    healthy = coil_of(monitor).strokes(9, BUILD)
    assert monitor.stroke_monitor.alarms == 0
    assert np.mean([report.rms for report in healthy]) == pytest.approx(NOISE, rel=0.1)
    report = stroke_json(healthy[-1], "/valve")
    assert report["residual_rms_ma"] == pytest.approx(1.0, rel=0.2)
    assert "residual_rms_um" not in report
    assert (report["opened"], report["closed"], report["fault"]) == (True, None, None)


@pytest.mark.long
def test_friction_that_grows_raises_an_alarm_and_is_named() -> None:
    monitor = Monitor(VALVE, SETTINGS, refit=False)
    coil = coil_of(monitor, has_voltage=False)
    coil.strokes(SETTINGS.commissioning_strokes + 2, BUILD)
    assert monitor.stroke_monitor.alarms == 0
    for share in (0.25, 0.5, 0.75):
        coil.stroke(BUILD._replace(friction=share * WORN))
    coil.strokes(9, BUILD._replace(friction=WORN))
    assert monitor.stroke_monitor.alarms > 0
    assert monitor.stroke_monitor.take_evidence()
    finding = isolate_fault(monitor.stroke_monitor.evidence()[-8:], monitor.stroke_monitor.with_present_scatter())
    verdict = finding.verdict
    assert verdict.kind == "effects"
    names = {*verdict.effects, *(name for others in verdict.confusable_with.values() for name in others)}
    assert "coulomb_friction" in names
    assert len(names) <= 4


@pytest.mark.parametrize(
    ("build", "expected"),
    [
        (BUILD._replace(seat_load=100.0), DidNotOpen(0.0)),
        (BUILD._replace(stroke=BUILD.pilot_gap + 1e-9), OpenedPartly(BUILD.pilot_gap, BUILD.stroke)),
        (BUILD._replace(extra_force=30.0), DidNotClose(BUILD.stroke)),
    ],
)
def test_a_valve_that_is_held_is_told_by_its_current(monitor: Monitor, build: Build, expected: Fault) -> None:
    coil = coil_of(monitor)
    coil.stroke(build)
    (held,), (after, *_) = coil.stroke(BUILD), coil.strokes(2, BUILD)
    assert held.record.fault == expected
    assert held.remark == expected
    assert after.record.fault is None
    assert after.rms < 1.5 * NOISE


def test_what_was_commissioned_by_the_current_is_kept_and_is_not_for_positions(
    commissioning: Commissioning, tmp_path: Path
) -> None:
    save_commissioning(tmp_path / "state.json", commissioning, VALVE)
    kept = load_commissioning(tmp_path / "state.json", VALVE)
    assert kept is not None
    assert not kept.baseline.has_positions
    again = Monitor(VALVE, SETTINGS, refit=False)
    again.stroke_monitor.use(kept)
    reports = again.command(0.05, 9.0)
    for time in np.arange(0.0, 0.3, 1e-3):
        if time > 0.08:
            reports += again.command(0.08, 0.0)
        reports += again.measure(time, 1.23e-3 if 0.06 < time < 0.09 else 0.0)
    assert [report.remark for report in reports] == [Unusable.OTHER_SENSOR]


def test_the_current_is_gone_by_once_no_position_has_come_for_a_while_and_until_one_does() -> None:
    segmenter = StrokeSegmenter(VALVE, SETTINGS)
    times = np.arange(0.0, 1.2 * ALONE, 0.01)
    shown = [segmenter.measure_current(time, 0.0) for time in times]
    assert [prediction is not None for prediction in shown] == (times > ALONE).tolist()
    assert segmenter.by_current
    assert segmenter.measure(1.5, 0.0) is not None
    assert not segmenter.by_current
    assert segmenter.measure_current(3.5, 0.0) is None
    assert not segmenter.by_current
