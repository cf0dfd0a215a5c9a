"""The monitor in a laboratory: dampings that differ from stroke to stroke, a zero that walks, and hum of the mains."""

from __future__ import annotations

import numpy as np
import pytest

from identification.live_strokes import LiveValve, feed
from identification.one_thread import Monitor
from valve_sim.files.parameter_files import default_valve
from valve_sim.identification.monitoring.fault_isolation import isolate_fault
from valve_sim.identification.monitoring.findings import StrokeState

pytestmark = pytest.mark.long

EXACT_VALVE = default_valve().exact()
HEALTHY = {"pilot_damping": 1.3, "main_damping": 3.5}
COMMISSIONING = 20
FRICTION = 0.2
"""N, some five limits beside dampings that vary by 10 %: those of eight strokes at 1 kHz are 30 to 60 mN."""


@pytest.fixture(scope="module")
def watched() -> tuple[Monitor, LiveValve, list[dict[str, float]]]:
    """A monitor that has seen 15 healthy strokes after commissioning, its valve, and their scores."""
    monitor = Monitor(EXACT_VALVE, refit=False)
    valve = LiveValve(4, HEALTHY, rate=1000.0, variation=0.1, drift=1e-6, hum=0.5e-6)
    reports = [report for _ in range(COMMISSIONING + 16) for report in feed(monitor, valve.stroke())]
    scores = [dict(report.scores) for report in reports if report.state is StrokeState.WATCHING]
    assert len(scores) == 15
    return monitor, valve, scores


def test_commissioning_learns_what_differs_from_stroke_to_stroke(
    watched: tuple[Monitor, LiveValve, list[dict[str, float]]],
) -> None:
    baseline = watched[0].stroke_monitor.baseline
    assert baseline is not None
    # Of twenty draws the standard deviation is known to 16 %.
    assert baseline.error_sizes["stroke_variation damping"] == pytest.approx(0.1, rel=0.35)
    assert baseline.error_sizes["stroke_variation spring_preload"] == pytest.approx(0.1 / 3.0, rel=0.4)
    assert baseline.error_sizes["drift"] == pytest.approx(1e-6, rel=0.4)
    assert baseline.noise.sigma == pytest.approx(1e-6, rel=0.15)
    errors = np.sqrt(np.diag(baseline.covariance))
    for name, error in zip(HEALTHY, errors.tolist(), strict=True):
        assert abs(getattr(baseline.valve.parameters, name) - HEALTHY[name]) < 4.0 * error


def test_a_healthy_valve_that_varies_raises_no_alarm(
    watched: tuple[Monitor, LiveValve, list[dict[str, float]]],
) -> None:
    monitor, _, scores = watched
    assert monitor.stroke_monitor.alarms == 0
    spread = float(np.std([score for own in scores for score in own.values()]))
    assert 0.7 < spread < 1.3


@pytest.mark.long
def test_a_valve_that_does_not_vary_is_not_taken_to(watched: tuple[Monitor, LiveValve, list[dict[str, float]]]) -> None:
    monitor, valve = Monitor(EXACT_VALVE, refit=False), LiveValve(4, HEALTHY, rate=1000.0)
    for _ in range(COMMISSIONING + 1):
        list(feed(monitor, valve.stroke()))
    plain, varying = monitor.stroke_monitor.baseline, watched[0].stroke_monitor.baseline
    assert plain is not None
    assert varying is not None
    assert plain.error_sizes["stroke_variation damping"] < 0.1 * varying.error_sizes["stroke_variation damping"]
    assert plain.error_sizes["drift"] < 0.3 * varying.error_sizes["drift"]


@pytest.mark.long
def test_friction_is_named_beside_what_varies(watched: tuple[Monitor, LiveValve, list[dict[str, float]]]) -> None:
    monitor, valve, _ = watched
    assert monitor.stroke_monitor.baseline is not None
    found = None
    for _ in range(14):
        list(feed(monitor, valve.stroke({"coulomb_friction": {"force": FRICTION}})))
        if evidence := monitor.stroke_monitor.take_evidence():
            found = isolate_fault(evidence, monitor.stroke_monitor.with_present_scatter())
    assert monitor.stroke_monitor.alarms > 0
    assert found is not None
    assert found.verdict.kind == "effects"
    assert found.verdict.effects == ("coulomb_friction",)
    assert found.parameters["coulomb_friction.force"].value == pytest.approx(FRICTION, abs=0.05)
