"""The calibration record of a valve, without ROS: whether it still holds, and the journal of what was changed since."""

from __future__ import annotations

import getpass
from collections.abc import Callable, Mapping
from datetime import datetime
from pathlib import Path

from valve_sim.model import Valve
from valve_sim.model.errors import ValveError
from valve_sim.nodes.diagnostics import Level, Status
from valve_sim.records.calibration import declared_numbers, load_changes, load_record, note_changes


class CalibrationWatch:
    """A record that was loaded, and its journal, to which a node appends what it declares otherwise.

    Args:
        path: of the record. node: its full name, for the journal. say: logs what a person should know.

    Raises:
        ValveError: the record, or its journal, cannot be read or was changed by hand.
    """

    def __init__(self, path: Path, node: str, say: Callable[[str], object]) -> None:
        self._path, self._node, self._say = path, node, say
        self._record, self._failure = load_record(path), ""
        self._changes, self._said = len(load_changes(path)), list[str]()
        self._noted: Mapping[str, float | None] | None = None

    def note(self, valve: Valve, now: datetime) -> None:
        """Append to the journal, all or nothing, in what a valve differs from the one declared before; `now` in UTC.

        The first one is compared with the record and its journal. What could not be written is part of the next entry.
        """
        declared = declared_numbers(valve)
        try:
            changes = note_changes(self._path, declared, f"{self._node} ({_user()})", now, self._noted)
            self._changes = len(load_changes(self._path))
        except ValveError as error:
            self._failure = f"changes are not in the journal: {error}"
            self._say(self._failure)
            return
        self._noted, self._failure = declared, ""
        for change in changes:
            self._say(f"changed since the calibration: {change.parameter} {change.before} → {change.after}")

    def status(self, now: datetime) -> Status:
        """Whether the calibration holds at a time, in UTC: WARN where something speaks against it, which is said once.

        The time is the system's, which has the date also where that of the node is simulated.
        """
        record, remarks = self._record, self._record.remarks(now)
        for words in remarks:
            if words not in self._said:
                self._say(words)
        self._said = remarks
        values = {
            "serial number": record.serial_number,
            "signed by": record.signed_by,
            "signed at": record.signed_at,
            "valid until": record.valid_until,
            "changes since": str(self._changes),
        }
        against = [*remarks, *([self._failure] if self._failure else [])]
        words = "; ".join(against) or f"valid until {record.valid_until}"
        return Status("calibration", Level.WARN if against else Level.OK, words, values)


def _user() -> str:
    try:
        return getpass.getuser()
    except (OSError, KeyError):
        return "a user without a name"
