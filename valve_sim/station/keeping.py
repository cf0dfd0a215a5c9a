"""Reports of monitors as rows of the archive: strokes, findings, each change of an alarm's level, and services."""

from __future__ import annotations

import math
from datetime import datetime
from typing import Final

from valve_sim.model.errors import ValveError
from valve_sim.records.archive import COLUMNS, Archive, Kind
from valve_sim.station.figures import FIGURES, Report, Values

SERVICE: Final = "service"
"""The class of a row of alarms that says that a person has serviced the valve."""
ANSWER: Final = "answer"
"""The class of one that says that a person has acknowledged an alarm."""
_CLASSES: Final = {"Health": "health", "Driver": "driver"}
"""Class of alarms by the group of figures that has their level: of the valve, and of its own node."""


class Keeper:
    """Keeps what is reported in an archive, each thing once.

    Args:
        archive: is written.
    """

    def __init__(self, archive: Archive) -> None:
        self._archive = archive
        self._levels: dict[tuple[str, str], int] = {}
        self._since_service: dict[str, int | None] = {}
        self._findings: dict[str, str] = {}

    def take(self, report: Report, now: float) -> None:
        """Keep what is new in a report; `now` in s of a clock that does not go back."""
        values = report.values
        if "Stroke.Number" in values:
            before = self.strokes_since_service(report.valve)
            self._since_service[report.valve] = None if before is None else before + 1
            self._archive.add("strokes", report.valve, report.time, _row("strokes", "Stroke", values), now)
        if "Finding.Summary" in values and self._findings.get(report.valve) != values["Finding.Summary"]:
            self._findings[report.valve] = str(values["Finding.Summary"])
            self._archive.add("findings", report.valve, report.time, _row("findings", "Finding", values), now)
        for group in _CLASSES:
            level = values.get(f"{group}.Level")
            if isinstance(level, int) and self._levels.get((report.valve, group), 0) != level:
                self._levels[report.valve, group] = level
                self._add(report.valve, report.time, level, _CLASSES[group], values.get(f"{group}.Message"), now)

        if "Answer.Message" in values:
            told = {"user": values["Answer.User"], "comment": values["Answer.Comment"]}
            level, message = values["Answer.Level"], values["Answer.Message"]
            self._add(report.valve, report.time, level, ANSWER, message, now, **told)

    def note_service(self, valve: str, at: datetime, now: float) -> str:
        """Keep that a valve was serviced, and count its strokes anew; what is kept, in words."""
        made = self.strokes_since_service(valve)
        words = f"serviced after {'an unknown number of' if made is None else made} strokes"
        self._add(valve, at, 0, SERVICE, words, now)
        self._since_service[valve] = 0
        return words

    def strokes_since_service(self, valve: str) -> int | None:
        """How many strokes of a valve were kept since it was serviced, or at all; earlier starts count too.

        None where the archive is damaged there: a stroke is kept all the same.
        """
        if valve not in self._since_service:
            try:
                services = [row["time"] for row in self._archive.read("alarms", valve) if row["alarm_class"] == SERVICE]
                self._since_service[valve] = self._archive.count("strokes", valve, services[-1] if services else None)
            except ValveError:
                self._since_service[valve] = None
        return self._since_service[valve]

    def _add(
        self, valve: str, at: datetime, level: object, alarm_class: str, message: object, now: float, **more: object
    ) -> None:
        row = {
            **more,
            "level": level,
            "alarm_class": alarm_class,
            "message": message,
            "strokes_since_service": self.strokes_since_service(valve),
        }
        self._archive.add("alarms", valve, at, row, now)


def _row(kind: Kind, group: str, values: Values) -> dict[str, object]:
    """The figures of a group for which the archive has a column; null for what is not known."""
    row = {figure.column: values.get(figure.path) for figure in FIGURES if figure.group == group}
    return {
        column: None if isinstance(value, float) and math.isnan(value) else value
        for column, value in row.items()
        if column in COLUMNS[kind]
    }
