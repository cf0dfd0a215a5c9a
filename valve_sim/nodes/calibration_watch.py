"""The calibration record of a watched valve, without ROS: whether it still holds, and what was changed since."""

from __future__ import annotations

import getpass
from datetime import datetime
from pathlib import Path

from valve_sim.model import Valve
from valve_sim.model.errors import ValveError
from valve_sim.nodes.diagnostics import Level, Status
from valve_sim.records.calibration import declared_numbers, load_changes, load_record, note_changes


class CalibrationWatch:
    """A record that was loaded, and its journal, to which the changes of the declared valve have been appended.

    Args:
        path: of the record. valve: as it is declared now. node: its full name, for the journal. now: in UTC.

    Attributes:
        lines: what is to be logged now: changes, and what could not be written.

    Raises:
        ValveError: the record, or its journal, cannot be read or was changed by hand.
    """

    def __init__(self, path: Path, valve: Valve, node: str, now: datetime) -> None:
        self._record, self._failure, self.lines = load_record(path), "", list[str]()
        load_changes(path)  # a journal that was changed by hand is refused; one that cannot be written is not
        try:
            for change in note_changes(path, declared_numbers(valve), f"{node} ({_user()})", now):
                self.lines.append(f"changed since the calibration: {change.parameter} {change.before} → {change.after}")
        except ValveError as error:
            self._failure = f"changes are not in the journal: {error}"
            self.lines.append(self._failure)
        self._changes = len(load_changes(path))
        self._said: list[str] = []

    def status(self, now: datetime) -> Status:
        """Whether the calibration holds at a time, in UTC: WARN where something speaks against it."""
        record = self._record
        values = {
            "serial number": record.serial_number,
            "signed by": record.signed_by,
            "signed at": record.signed_at,
            "valid until": record.valid_until,
            "changes since": str(self._changes),
        }
        against = [*record.remarks(now), *([self._failure] if self._failure else [])]
        words = "; ".join(against) or f"valid until {record.valid_until}"
        return Status("calibration", Level.WARN if against else Level.OK, words, values)

    def new_remarks(self, now: datetime) -> list[str]:
        """What speaks against the calibration at a time, in UTC, and has not been said before."""
        found = self._record.remarks(now)
        new = [words for words in found if words not in self._said]
        self._said = found
        return new


def _user() -> str:
    try:
        return getpass.getuser()
    except (OSError, KeyError):
        return "a user without a name"
