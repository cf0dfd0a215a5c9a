"""The report on a stroke, and the finding after an alarm, as JSON and as keys and values."""

from __future__ import annotations

from collections.abc import Iterator, Mapping
from typing import Any

from valve_sim.files.json_text import plain_mapping
from valve_sim.identification.monitoring.fault_isolation import FaultFinding
from valve_sim.identification.monitoring.findings import Occasion
from valve_sim.identification.monitoring.stroke_monitor import StrokeReport
from valve_sim.identification.reporting.findings import intervals_json
from valve_sim.identification.reporting.monitoring_words import (
    fault_words,
    remark_words,
    state_words,
    stroke_name,
    told_finding,
)


def stroke_json(report: StrokeReport, valve: str) -> dict[str, Any]:
    """Plain numbers in SI units; null for what is not known."""
    plain = {
        "schema": "valve_sim/stroke/1",
        "valve": valve,
        "stroke": report.record.number,
        "name": stroke_name(report),
        "time": report.record.stamp / 1e9,
        "state": state_words(report.state),
        "remark": None if report.remark is None else remark_words(report.remark),
        "opened": report.record.opened,
        "closed": report.record.closed,
        "fault": None if report.record.fault is None else fault_words(report.record.fault),
        "opening_delay": report.opening_delay,
        "t1": report.t1,
        "t2": report.t2,
        "closing_time": report.closing_time,
        **dict(zip(("t1_stderr", "t2_stderr", "closing_time_stderr"), report.errors, strict=True)),
        **_errors(report),
        "command_scatter": report.command_scatter,
        "damping": intervals_json(report.damping),
        "scores": report.scores,
        "alarm": {
            "raised": report.alarm is not None,
            "cause": (report.alarm.cause if report.alarm else report.cause) or None,
            "sum": report.sum,
            "threshold": report.threshold,
        },
    }
    return plain_mapping(plain)


def keys_and_values(report: Mapping[str, Any], prefix: str = "") -> Iterator[tuple[str, str]]:
    """A report as texts: nested names are joined by dots, such as "alarm.sum"; what is not known is left out."""
    for name, value in report.items():
        if isinstance(value, Mapping):
            yield from keys_and_values(value, f"{prefix}{name}.")
        elif value is not None:
            text = ", ".join(map(str, value)) if isinstance(value, list) else str(value)
            yield f"{prefix}{name}", text.lower() if isinstance(value, bool) else text


def _errors(report: StrokeReport) -> dict[str, float]:
    """Residual and noise of the position, µm, or of the current alone, mA."""
    if report.has_positions:
        return {"residual_rms_um": 1e6 * report.rms, "noise_um": 1e6 * report.noise}
    return {"residual_rms_ma": 1e3 * report.rms, "noise_ma": 1e3 * report.noise}


def finding_json(finding: FaultFinding, occasion: Occasion) -> dict[str, Any]:
    """A finding as ~/finding has it; `occasion` is that of the last of the strokes that it rests on."""
    verdict = finding.verdict
    plain = {
        "schema": "valve_sim/finding/1",
        "valve": occasion.valve,
        "stroke": occasion.stroke,
        "time": occasion.stamp / 1e9,
        "kind": verdict.kind,
        "effects": list(verdict.effects),
        "summary": told_finding(finding, occasion),
        "confusable_with": {name: list(others) for name, others in verdict.confusable_with.items()},
        "parameters": intervals_json(finding.parameters),
        "was": {**finding.commissioned, **finding.declared},
        "probability": verdict.probability,
        "unnamed": verdict.unnamed,
        "strokes": finding.strokes,
    }
    return plain_mapping(plain)
