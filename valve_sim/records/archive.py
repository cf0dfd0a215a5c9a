"""The archive of valves: strokes, findings and alarms of years, in one SQLite file.

`<folder>/archive.sqlite` has a table for each kind. Times are text in UTC, such as 2026-11-29 12:00:00.250000, which
SQLite, DuckDB and pandas read as times. Its write-ahead log lets programs read while one writes.
"""

from __future__ import annotations

import contextlib
import math
import sqlite3
from collections.abc import Iterable, Iterator, Mapping
from datetime import datetime, timezone
from pathlib import Path
from typing import Any, Final, Literal, NamedTuple

from valve_sim.model.errors import ValveError

Kind = Literal["strokes", "findings", "alarms"]

COLUMNS: Final[dict[Kind, dict[str, str]]] = {
    "strokes": {
        "number": "INTEGER", "volts": "REAL", "opening_delay": "REAL", "t1": "REAL", "t1_stderr": "REAL",
        "t2": "REAL", "t2_stderr": "REAL", "closing_time": "REAL", "closing_time_stderr": "REAL",
        "pilot_damping": "REAL", "pilot_damping_stderr": "REAL", "main_damping": "REAL",
        "main_damping_stderr": "REAL", "residual": "REAL", "score": "REAL", "threshold": "REAL", "cause": "TEXT",
        "state": "TEXT",
    },
    "findings": {
        "stroke": "INTEGER", "effect": "TEXT", "parameter": "TEXT", "value": "REAL", "stderr": "REAL", "unit": "TEXT",
        "probability": "REAL", "summary": "TEXT",
    },
    "alarms": {
        "level": "INTEGER", "alarm_class": "TEXT", "message": "TEXT", "user": "TEXT", "comment": "TEXT",
        "strokes_since_service": "INTEGER",
    },
}  # fmt: skip
"""Columns of each kind beside `valve` and `time`, in SI."""
_AFTER_MONTH: Final = "~"
"""Sorts after each time of a month that it is appended to."""


class Row(NamedTuple):
    """A row that waits for the archive: its kind, the full name of the valve's node, its time, and values by column."""

    kind: Kind
    valve: str
    at: datetime
    values: Mapping[str, object]


class Archive:
    """One archive, of which one program writes and any number read.

    Args:
        folder: of the archive. is_written: whether to make it where there is none.

    Raises:
        ValveError: there is none, or it cannot be used.
    """

    def __init__(self, folder: Path, *, is_written: bool = False) -> None:
        self._path = folder / "archive.sqlite"
        if not is_written and not self._path.exists():
            raise ValveError(f"{self._path}: there is no archive; expected the folder that archive_node writes")
        with self._named():
            address = f"{self._path.absolute().as_uri()}?mode={'rwc' if is_written else 'ro'}"
            if is_written:
                folder.mkdir(parents=True, exist_ok=True)
            # Made and closed by the thread that starts a node, written by the one that answers ROS.
            self._base = sqlite3.connect(address, timeout=2.0, uri=True, check_same_thread=False)
            if is_written:
                self._base.execute("PRAGMA journal_mode=WAL")
                self._base.execute("PRAGMA synchronous=FULL")  # a commit is on the disk: power cuts lose no row
                for kind, columns in COLUMNS.items():
                    listed = ", ".join(f"{name} {of}" for name, of in columns.items())
                    self._base.execute(f"CREATE TABLE IF NOT EXISTS {kind} (valve TEXT, time TIMESTAMP, {listed})")
                    self._base.execute(f"CREATE INDEX IF NOT EXISTS {kind}_of_valve ON {kind} (valve, time)")

    def close(self) -> None:
        """Release the file."""
        self._base.close()

    def write(self, rows: Iterable[Row]) -> None:
        """Add rows, all or none; they are on the disk afterwards.

        Raises:
            ValveError: they cannot be written, as where the disk is full.
        """
        with self._named(), self._base:
            for kind, valve, at, values in rows:
                entries = {"valve": valve, "time": _text(at), **values}
                places = ", ".join("?" * len(entries))
                statement = f"INSERT INTO {kind} ({', '.join(entries)}) VALUES ({places})"
                self._base.execute(statement, list(entries.values()))

    def valves(self) -> list[str]:
        """Full names of all valves that have an entry."""
        return sorted({valve for kind in COLUMNS for valve in self._valves(kind)})

    def read(
        self, kind: Kind, valve: str, since: datetime | None = None, until: datetime | None = None
    ) -> list[dict[str, Any]]:
        """Rows of a valve in order of time, from a time on (that one too) until before another.

        Raises:
            ValveError: the file is damaged.
        """
        first, last = "" if since is None else _text(since), _AFTER_MONTH if until is None else _text(until)
        return self._rows(kind, "time>=? AND time<? ORDER BY time", valve, first, last)

    def last(self, kind: Kind, valve: str) -> dict[str, Any]:
        """The last row of a valve in order of time; empty where there is none."""
        rows = self._rows(kind, "TRUE ORDER BY time DESC, rowid DESC LIMIT 1", valve)
        return rows[0] if rows else {}

    def _rows(self, kind: Kind, which: str, valve: str, *values: object) -> list[dict[str, Any]]:
        columns = ("time", *COLUMNS[kind])
        rows = self._ask(f"SELECT {', '.join(columns)} FROM {kind} WHERE valve=? AND {which}", valve, *values)
        return [dict(zip(columns, (_time(row[0]), *row[1:]), strict=True)) for row in rows]

    def count(self, kind: Kind, valve: str, since: datetime | None = None) -> int:
        """How many rows of a valve there are from a time on (that one too)."""
        first = "" if since is None else _text(since)
        return int(self._ask(f"SELECT count(*) FROM {kind} WHERE valve=? AND time>=?", valve, first)[0][0])

    def size(self) -> int:
        """Bytes that rows take; what pruned rows took is used again."""
        total, free, page = (
            self._ask(f"PRAGMA {name}")[0][0] for name in ("page_count", "freelist_count", "page_size")
        )
        return int((total - free) * page)

    def prune(self, years: float, most_bytes: int) -> list[str]:
        """Delete the oldest months beyond so many years and so many bytes; which, such as 2016-11.

        Counts months and asks no clock, because a clock that is wrong by decades would delete all of them.
        """
        months = self._months()
        kept = 1 + math.ceil(12.0 * years)  # that of today has just begun
        gone: list[str] = []
        for month in months[:-1]:
            if len(months) - len(gone) <= kept and self.size() <= most_bytes:
                break
            gone.append(month)
            with self._named(), self._base:
                for kind in COLUMNS:
                    for valve in self._valves(kind):
                        self._base.execute(
                            f"DELETE FROM {kind} WHERE valve=? AND time<?", (valve, month + _AFTER_MONTH)
                        )
        return gone

    def _months(self) -> list[str]:
        """All months of which there is a row, each found by one look into the index."""
        months = set()
        for kind in COLUMNS:
            for valve in self._valves(kind):
                after = ""
                while found := self._ask(f"SELECT min(time) FROM {kind} WHERE valve=? AND time>?", valve, after)[0][0]:
                    months.add(found[:7])
                    after = found[:7] + _AFTER_MONTH
        return sorted(months)

    def _valves(self, kind: Kind) -> list[str]:
        found, last = [], ""
        while name := self._ask(f"SELECT min(valve) FROM {kind} WHERE valve>?", last)[0][0]:
            found.append(last := str(name))
        return found

    def _ask(self, question: str, *values: object) -> list[tuple[Any, ...]]:
        with self._named():
            return self._base.execute(question, values).fetchall()

    @contextlib.contextmanager
    def _named(self) -> Iterator[None]:
        """Context whose errors name the file."""
        try:
            yield
        except (sqlite3.OperationalError, OSError) as error:
            raise ValveError(f"{self._path}: cannot be used ({error}); choose another folder, or make room") from error
        except sqlite3.DatabaseError as error:
            raise ValveError(f"{self._path}: is damaged ({error}); restore it, or move it away") from error


def _text(at: datetime) -> str:
    return at.astimezone(timezone.utc).replace(tzinfo=None).isoformat(" ", "microseconds")


def _time(text: str) -> datetime:
    return datetime.fromisoformat(text).replace(tzinfo=timezone.utc)
