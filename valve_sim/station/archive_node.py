"""The ROS side of archive_node: what monitors say goes to the archive; all in one thread."""

from __future__ import annotations

import time
from collections import deque
from collections.abc import Sequence
from dataclasses import dataclass
from datetime import datetime, timedelta, timezone
from functools import partial
from pathlib import Path
from typing import Final

from valve_sim.files.parameter_sections import Section
from valve_sim.model.errors import ValveError
from valve_sim.nodes.spinning import every
from valve_sim.nodes.wiring import RosNode, full_name
from valve_sim.records.archive import COLUMNS, Archive, Kind, Row
from valve_sim.station.figures import FIGURES, Report, Values
from valve_sim.station.hearing import StationEar
from valve_sim.station.tables import ARCHIVE_TOPICS, ArchiveSettings

_PERIOD: Final = 0.5
"""s between looks at what was heard."""
_BETWEEN_PRUNINGS: Final = 6.0 * 3600.0
_MOST_WAITING: Final = 10_000
"""Rows that are kept in memory while the archive cannot be written; then the oldest goes."""
SERVICE: Final = "service"
"""The class of a row of alarms that says that a person has serviced the valve."""
ANSWER: Final = "answer"
"""The class of a row of alarms that says what a person has done to an alarm over OPC UA."""
MISSING: Final = "missing"
"""The class of a row of alarms that says which strokes the archive has not heard of."""
_RESOLUTION: Final = timedelta(microseconds=1)
"""Of a time in the archive."""
_CLASSES: Final = {"Health": "health", "Driver": "driver"}
"""Class of alarms by the group of figures that has their level: of the valve, and of its own node."""


@dataclass
class _Kept:
    """What the archive has of a valve, with the rows that wait.

    Attributes:
        earlier: time of the last stroke that an earlier start has kept; None without any.
        stroke: number of the last stroke; None without any. strokes: since the last service, or at all.
        finding: the last summary. levels: the last level of each class of alarms.
    """

    earlier: datetime | None
    stroke: int | None
    strokes: int
    finding: str
    levels: dict[str, int]


class Keeper:
    """Turns reports into rows of an archive, each thing once, and keeps the rows until they are written.

    What was kept by earlier starts counts: a monitor says its last strokes and its finding again to an archive that was
    not there.

    Args:
        archive: is written.
    """

    def __init__(self, archive: Archive) -> None:
        self._archive, self._waiting = archive, deque[Row](maxlen=_MOST_WAITING)
        self._valves: dict[str, _Kept] = {}

    def take(self, report: Report) -> None:
        """Keep what is new in a report."""
        values, kept = report.values, self._kept(report.valve)
        if isinstance(number := values.get("Stroke.Number"), int):
            self._take_stroke(report, number)
        summary = values.get("Finding.Summary")
        if isinstance(summary, str) and kept.finding != summary:
            kept.finding = summary
            self._keep("findings", report, _row("findings", "Finding", values))
        for group, of in _CLASSES.items():
            level = values.get(f"{group}.Level")
            if isinstance(level, int) and kept.levels.get(of, 0) != level:
                kept.levels[of] = level
                self._alarm(report, level, of, values.get(f"{group}.Message"))
        if "Answer.Message" in values:
            told = {"user": values["Answer.User"], "comment": values["Answer.Comment"]}
            self._alarm(report, values["Answer.Level"], ANSWER, values["Answer.Message"], told)

    def _take_stroke(self, report: Report, number: int) -> None:
        """Keep a stroke that was not, and note those before it that were not heard; a new monitor counts from 0."""
        kept = self._kept(report.valve)
        if kept.earlier is not None and report.time <= kept.earlier:
            at_that_time = self._archive.read("strokes", report.valve, report.time, report.time + _RESOLUTION)
            if number in [row["number"] for row in at_that_time]:
                return
        if kept.stroke is not None and number > (next_one := kept.stroke + 1 if number > kept.stroke else 0):
            some = f"stroke {next_one} is" if number == next_one + 1 else f"strokes {next_one} to {number - 1} are"
            self._alarm(report, 0, MISSING, f"{some} missing: no report was heard")
        self._keep("strokes", report, _row("strokes", "Stroke", report.values))
        kept.stroke = number
        kept.strokes += 1

    def note_service(self, valve: str, at: datetime) -> str:
        """Record a service of a valve and count its strokes from 0 again; the record in words."""
        words = f"serviced after {self.strokes_since_service(valve)} strokes"
        self._alarm(Report(valve, at, {}), 0, SERVICE, words)
        self._kept(valve).strokes = 0
        return words

    def write(self) -> None:
        """Write what waits.

        Raises:
            ValveError: it cannot be written, and waits on.
        """
        if self._waiting:
            self._archive.write(self._waiting)
            self._waiting.clear()

    def strokes_since_service(self, valve: str) -> int:
        """How many strokes of a valve were kept since it was serviced, or at all; earlier starts count too."""
        return self._kept(valve).strokes

    def _kept(self, valve: str) -> _Kept:
        if valve not in self._valves:
            alarms = self._archive.read("alarms", valve)
            services = [row["time"] for row in alarms if row["alarm_class"] == SERVICE]
            stroke, finding = self._archive.last("strokes", valve), self._archive.last("findings", valve)
            self._valves[valve] = _Kept(
                stroke.get("time"),
                stroke.get("number"),
                self._archive.count("strokes", valve, services[-1] if services else None),
                finding.get("summary") or "",
                {row["alarm_class"]: row["level"] for row in alarms},
            )
        return self._valves[valve]

    def _alarm(
        self, report: Report, level: object, of: str, message: object, more: dict[str, object] | None = None
    ) -> None:
        since = self.strokes_since_service(report.valve)
        row = {"level": level, "alarm_class": of, "message": message, "strokes_since_service": since, **(more or {})}
        self._keep("alarms", report, row)

    def _keep(self, kind: Kind, report: Report, values: dict[str, object]) -> None:
        self._waiting.append(Row(kind, report.valve, report.time, values))


class ArchiveNode(RosNode[ArchiveSettings]):
    """The node `archive`, with the topics and services `tables.ARCHIVE_TOPICS` of each of `valves` and `monitors`.

    Parameters: `tables.ArchiveSettings`; they are read once, at the start. What cannot be written waits.

    Raises:
        ValveError: a parameter cannot be used, or the archive cannot be written.
    """

    def __init__(self, sections: Sequence[tuple[str, Section]]) -> None:
        super().__init__("archive", sections, ArchiveSettings, ARCHIVE_TOPICS)
        folder, valves = Path(self._settings.folder).expanduser(), self._full_names("valves")
        self._archive, self._prune_at = Archive(folder, is_written=True), time.monotonic()
        self._keeper = Keeper(self._archive)
        for valve in valves:  # so that a damaged archive is reported at the start
            self._keeper.strokes_since_service(valve)
        alarms, monitors = full_name(self._node, self._settings.alarms, "alarms"), self._full_names("monitors")
        self._ear = StationEar(
            self._node, self._clock, self._interface, valves, monitors, self._keeper.take, is_live=False, alarms=alarms
        )
        for valve in valves:
            self._interface.serve("{valve}/serviced", partial(self._note_service, valve), valve=valve)
        every(self._node, _PERIOD, self._look)
        self._node.get_logger().info(f"ready: records strokes, findings and alarms of {len(valves)} valves in {folder}")

    def close(self, timeout: float) -> bool:
        """Write what waits, and release everything."""
        has_ended = super().close(timeout)
        try:
            self._keeper.write()
        except ValveError as error:
            print(f"archive_node: what was not written yet is lost: {error}")
        self._archive.close()
        return has_ended

    def _note_service(self, valve: str) -> tuple[bool, str]:
        self._ear.look()  # strokes that came before
        words = self._keeper.note_service(valve, datetime.now(timezone.utc))
        try:
            self._keeper.write()
        except ValveError as error:
            return False, f"{error}; it is kept when that is possible again"
        return True, f"{valve}: {words}; they count from 0 again"

    def _look(self) -> None:
        self._ear.look()
        now = time.monotonic()
        try:
            self._keeper.write()
            if now >= self._prune_at:
                self._prune_at = now + _BETWEEN_PRUNINGS
                for month in self._archive.prune(self._settings.years, int(1e6 * self._settings.megabytes)):
                    self._node.get_logger().info(f"{month} has been taken out of the archive")
        except ValveError as error:
            self._node.get_logger().error(f"{error}; rows wait", throttle_duration_sec=10.0)


def _row(kind: Kind, group: str, values: Values) -> dict[str, object]:
    """The figures of a group for which the archive has a column."""
    row = {figure.column: values.get(figure.path) for figure in FIGURES if figure.group == group}
    return {column: value for column, value in row.items() if column in COLUMNS[kind]}
