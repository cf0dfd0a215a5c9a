"""The ROS side of archive_node: what monitors say goes to the archive; all in one thread."""

from __future__ import annotations

import time
from collections.abc import Sequence
from datetime import datetime, timezone
from functools import partial
from pathlib import Path
from typing import Final

from valve_sim.files.parameter_sections import Section
from valve_sim.files.whole_files import refuse_unwritable
from valve_sim.model.errors import ValveError
from valve_sim.nodes.spinning import every
from valve_sim.nodes.wiring import RosNode, full_name
from valve_sim.records.archive import Archive
from valve_sim.station.figures import Report
from valve_sim.station.hearing import StationEar
from valve_sim.station.keeping import Keeper
from valve_sim.station.tables import ARCHIVE_TOPICS, ArchiveSettings

_PERIOD: Final = 0.5
"""s between looks at what was heard."""
_BETWEEN_PRUNINGS: Final = 6.0 * 3600.0


class ArchiveNode(RosNode[ArchiveSettings]):
    """The node `archive`, with the topics and services `tables.ARCHIVE_TOPICS` of each of `valves` and `monitors`.

    Parameters: `tables.ArchiveSettings`; they are read once, at the start. What cannot be written waits.

    Raises:
        ValveError: a parameter cannot be used, or the folder cannot be written.
    """

    def __init__(self, sections: Sequence[tuple[str, Section]]) -> None:
        super().__init__("archive", sections, ArchiveSettings, ARCHIVE_TOPICS)
        settings = self._settings
        folder = Path(settings.folder).expanduser()
        refuse_unwritable(folder / "any.parquet")
        self._archive = Archive(folder, settings.years, int(1e6 * settings.megabytes))
        self._keeper, self._prune_at = Keeper(self._archive), time.monotonic()
        valves, monitors = self._full_names("valves"), self._full_names("monitors")
        alarms = full_name(self._node, settings.alarms, "alarms")
        self._ear = StationEar(
            self._node, self._clock, self._interface, valves, monitors, self._take, is_live=False, alarms=alarms
        )
        for valve in valves:
            self._interface.serve("{valve}/serviced", partial(self._note_service, valve), valve=valve)
        every(self._node, _PERIOD, self._look)
        self._node.get_logger().info(f"ready: keeps what is said of {len(valves)} valves in {folder}")

    def close(self, timeout: float) -> bool:
        """Write what waits, and release everything."""
        try:
            self._archive.flush()
        except ValveError as error:
            print(f"archive_node: what was not written yet is lost: {error}")
        return super().close(timeout)

    def _take(self, report: Report) -> None:
        self._keeper.take(report, time.monotonic())

    def _note_service(self, valve: str) -> tuple[bool, str]:
        self._ear.look()  # strokes that came before
        try:
            words = self._keeper.note_service(valve, datetime.now(timezone.utc), time.monotonic())
            self._archive.flush()
        except ValveError as error:
            return False, f"{error}; it is kept when that is possible again"
        return True, f"{valve}: {words}; they count from 0 again"

    def _look(self) -> None:
        self._ear.look()
        now = time.monotonic()
        try:
            self._archive.tick(now)
            if now >= self._prune_at:
                self._prune_at = now + _BETWEEN_PRUNINGS
                for month in self._archive.prune():
                    self._node.get_logger().info(f"{month} has been taken out of the archive")
        except ValveError as error:
            self._node.get_logger().error(f"{error}; rows wait", throttle_duration_sec=10.0)
