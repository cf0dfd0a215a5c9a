"""What a client sees of a valve follows from what its monitor says."""

from __future__ import annotations

from datetime import datetime, timezone

import pytest

from valve_sim.model import ValveError
from valve_sim.station.figures import BY_PATH, FIGURES, finding_report, stroke_report, worst

STROKE = {
    "schema": "valve_sim/stroke/1", "valve": "/tank_1/valve", "stroke": "31", "time": "1790000000.25",
    "state": "watching", "opening_delay": "0.0012", "t1": "0.0053", "closing_time": "0.004", "t1_stderr": "1e-05",
    "closing_time_stderr": "2e-05", "residual_rms_um": "1.5", "noise_um": "1.0",
    "damping.pilot_damping.value": "1.0", "damping.pilot_damping.stderr": "0.1",
    "damping.pilot_damping.ci95": "0.8, 1.2", "scores.drive_gain": "-1.0", "scores.coulomb_friction": "4.5",
    "scores.stiction": "0.5", "scores.spring": "0.1", "alarm.raised": "true", "alarm.cause": "coulomb_friction",
    "alarm.sum": "12.0", "alarm.threshold": "9.0",
}  # fmt: skip
"""Without t2, which that stroke does not determine."""
SUMMARY = "Coulomb friction 0.310 N"
FINDING = {
    "valve": "/tank_1/valve", "stroke": "36", "time": "1790000030.0", "kind": "effects", "effects": "coulomb_friction",
    "probability": "0.98", "parameters.coulomb_friction.force.value": "0.31",
    "parameters.coulomb_friction.force.stderr": "0.02", "parameters.coulomb_friction.force.ci95": "0.27, 0.35",
}  # fmt: skip


def test_a_stroke_is_shown_in_si_with_its_time() -> None:
    report = stroke_report("watching", STROKE)
    assert report.valve == "/tank_1/valve"
    assert report.time == datetime(2026, 9, 21, 14, 13, 20, 250000, timezone.utc)
    values = report.values
    assert values["Stroke.Residual"] == pytest.approx(1.5e-6)
    assert (values["Stroke.T1"], values["Stroke.T2"], values["Stroke.CurrentResidual"]) == (5.3e-3, None, None)
    assert (values["Stroke.PilotDampingStandardError"], values["Stroke.MainDamping"]) == (0.1, None)
    assert values["Stroke.ScoreNames"] == ["coulomb_friction", "drive_gain", "stiction"]
    assert (values["Stroke.Score"], values["Stroke.Cause"]) == (12.0, "coulomb_friction")
    assert values.keys() <= BY_PATH.keys()


def test_a_finding_is_shown_with_effect_value_unit_and_probability() -> None:
    values = finding_report(SUMMARY, FINDING).values
    assert values["Finding.Effect"] == "coulomb_friction"
    assert (values["Finding.Value"], values["Finding.StandardError"], values["Finding.Unit"]) == (0.31, 0.02, "N")
    assert values["Finding.Probability"] == 0.98
    assert values.keys() == {figure.path for figure in FIGURES if figure.group == "Finding"}


BROKEN: list[dict[str, str]] = [
    {}, {"schema": "valve_sim/stroke/1"}, {"rate": "500"},
    *({**STROKE, "time": value} for value in ("1e308", "-1", "inf", "nan", "soon", "", str(2**60))),
    *({**STROKE, "stroke": value} for value in ("1.5", "-1", str(2**31), "first", "1" * 400)),
    *({**STROKE, "t1": value} for value in ("late", "[0.005]", "True", "nan")),
    {**STROKE, "alarm.sum": "much"}, {**STROKE, "state": "x" * 5000}, {**STROKE, "valve": "x" * 5000},
    {**STROKE, "scores.coulomb_friction": "high"}, {**STROKE, "damping.main_damping.value": "[1]"},
    {**STROKE, "residual_rms_um": "1 µm"},
]  # fmt: skip
"""Reports of a stroke that are none."""


@pytest.mark.parametrize("found", BROKEN)
def test_a_broken_report_is_refused_in_one_short_line(found: dict[str, str]) -> None:
    with pytest.raises(ValveError, match=r"expected|is missing") as refused:
        stroke_report("watching", found)
    assert "\n" not in str(refused.value) and len(str(refused.value)) < 400


@pytest.mark.parametrize(
    "found", [{"rate": "500"}, {**FINDING, "time": "Infinity"}, {**FINDING, "probability": "likely"}, {"stroke": "1"}]
)
def test_a_status_that_is_no_finding_is_refused_in_one_line(found: dict[str, str]) -> None:
    with pytest.raises(ValveError, match=r"expected|is missing"):
        finding_report("on time", found)


def test_half_a_character_is_shown_as_one_that_is_unknown() -> None:
    assert stroke_report("", {**STROKE, "state": "\ud800ok"}).values["Stroke.State"] == "?ok"


def test_the_worst_of_a_nodes_statuses_counts() -> None:
    assert worst([(0, "timing", "on time"), (1, "command", "none yet"), (0, "valve", "closed")]) == (
        1,
        "command: none yet",
    )
