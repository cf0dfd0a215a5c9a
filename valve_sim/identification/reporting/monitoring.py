"""The report on a stroke, and the finding after an alarm, as JSON."""

from __future__ import annotations

from typing import Any

from valve_sim.files.json_text import plain_mapping
from valve_sim.identification.monitoring.fault_isolation import FaultFinding
from valve_sim.identification.monitoring.stroke_monitor import StrokeReport
from valve_sim.identification.reporting.interval_json import intervals_json


def stroke_json(report: StrokeReport) -> dict[str, Any]:
    """Plain numbers in SI units; null for what is not known."""
    largest = sorted(report.scores.items(), key=lambda item: -abs(item[1]))[:3]
    plain = {
        "schema": "valve_sim/stroke/1",
        "stroke": report.record.number,
        "name": report.name,
        "time": report.record.time,
        "state": report.state,
        "remark": report.remark or None,
        "opened": report.record.opened,
        "closed": report.record.closed,
        "fault": report.record.fault or None,
        "opening_delay": report.opening_delay,
        "t1": report.t1,
        "t2": report.t2,
        "closing_time": report.closing_time,
        "residual_rms_um": 1e6 * report.rms,
        "noise_um": 1e6 * report.noise,
        "command_scatter": report.command_scatter,
        "damping": intervals_json(report.damping),
        "scores": dict(largest),
        "alarm": {
            "raised": report.alarm is not None,
            "cause": (report.alarm.cause if report.alarm else report.cause) or None,
            "sum": report.sum,
            "threshold": report.threshold,
        },
    }
    return plain_mapping(plain)


def finding_json(finding: FaultFinding) -> dict[str, Any]:
    """As on ~/finding."""
    plain = {
        "schema": "valve_sim/finding/1",
        "kind": finding.kind,
        "effects": list(finding.effects),
        "summary": finding.summary,
        "confusable_with": {name: list(others) for name, others in finding.confusable_with.items()},
        "parameters": intervals_json(finding.parameters),
        "probability": finding.probability,
        "strokes": finding.strokes,
    }
    return plain_mapping(plain)
