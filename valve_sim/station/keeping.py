"""Reports of monitors as rows of the archive: strokes, findings, and each change of the alarm's level."""

from __future__ import annotations

import math
from typing import Any, Final

from valve_sim.records.archive import Archive
from valve_sim.station.figures import Report

_STROKES: Final = {
    "Stroke.Number": "number",
    "Stroke.State": "state",
    "Stroke.OpeningDelay": "opening_delay",
    "Stroke.T1": "t1",
    "Stroke.T1StandardError": "t1_stderr",
    "Stroke.T2": "t2",
    "Stroke.T2StandardError": "t2_stderr",
    "Stroke.ClosingTime": "closing_time",
    "Stroke.ClosingTimeStandardError": "closing_time_stderr",
    "Stroke.PilotDamping": "pilot_damping",
    "Stroke.PilotDampingStandardError": "pilot_damping_stderr",
    "Stroke.MainDamping": "main_damping",
    "Stroke.MainDampingStandardError": "main_damping_stderr",
    "Stroke.Residual": "residual",
    "Stroke.Score": "score",
    "Stroke.Threshold": "threshold",
    "Stroke.Cause": "cause",
}
_FINDINGS: Final = {
    "Finding.Stroke": "stroke",
    "Finding.Effect": "effect",
    "Finding.Parameter": "parameter",
    "Finding.Value": "value",
    "Finding.StandardError": "stderr",
    "Finding.Unit": "unit",
    "Finding.Probability": "probability",
    "Finding.Summary": "summary",
}


class Keeper:
    """Keeps what is reported in an archive, each thing once.

    Args:
        archive: is written.
    """

    def __init__(self, archive: Archive) -> None:
        self._archive = archive
        self._levels: dict[str, int] = {}
        self._strokes: dict[str, int] = {}
        """Number of the last stroke of each valve, which its monitor counts from its commissioning on."""
        self._findings: dict[str, str] = {}

    def take(self, report: Report, now: float) -> None:
        """Keep what is new in a report; `now` in s of a clock that does not go back."""
        values = report.values
        if "Stroke.Number" in values:
            number = values["Stroke.Number"]
            self._strokes[report.valve] = number if isinstance(number, int) else 0
            self._archive.add("strokes", report.valve, report.time, _row(values, _STROKES), now)
        if "Finding.Summary" in values and self._findings.get(report.valve) != values["Finding.Summary"]:
            self._findings[report.valve] = str(values["Finding.Summary"])
            self._archive.add("findings", report.valve, report.time, _row(values, _FINDINGS), now)
        level = values.get("Health.Level")
        if isinstance(level, int) and self._levels.get(report.valve, 0) != level:
            self._levels[report.valve] = level
            row = {
                "level": level,
                "alarm_class": "health",
                "message": values.get("Health.Message"),
                "is_shelved": False,
                "strokes_since_service": self._strokes.get(report.valve),
            }
            self._archive.add("alarms", report.valve, report.time, row, now)


def _row(values: dict[str, object], columns: dict[str, str]) -> dict[str, Any]:
    found = {column: values.get(path) for path, column in columns.items()}
    return {name: None if isinstance(value, float) and math.isnan(value) else value for name, value in found.items()}
