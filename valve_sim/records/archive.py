"""The archive of valves: strokes, findings and alarms of years, as Parquet by valve and month, bounded in size.

    <folder>/<kind>/valve=<name>/month=2026-11/00000017-00000048.parquet

A file's name says which writes it holds, by number. Rows are kept in memory for a minute at most and then written as
one small file, whole or not at all; each 32 files of a size become one. A file whose numbers another one holds too is
left over from a merger that was cut off, and is passed over. So a kill or a power cut loses what was not written yet
and nothing else. Whoever writes holds the lock of the file `.lock`, so that archive_node and a fleet share an archive.
"""

from __future__ import annotations

import contextlib
import fcntl
import math
import os
import re
import time
import urllib.parse
from collections import defaultdict
from collections.abc import Iterator, Mapping, Sequence
from datetime import datetime, timezone
from pathlib import Path
from typing import Any, Final, Literal, NamedTuple, get_args

from valve_sim.files.whole_files import atomic_write
from valve_sim.model.errors import ValveError

Kind = Literal["strokes", "findings", "alarms", "recordings"]
Row = Mapping[str, object]

COLUMNS: Final[dict[Kind, dict[str, str]]] = {
    "strokes": {
        "number": "int32", "volts": "float32", "opening_delay": "float32", "t1": "float32", "t1_stderr": "float32",
        "t2": "float32", "t2_stderr": "float32", "closing_time": "float32", "closing_time_stderr": "float32",
        "pilot_damping": "float32", "pilot_damping_stderr": "float32", "main_damping": "float32",
        "main_damping_stderr": "float32", "residual": "float32", "score": "float32", "threshold": "float32",
        "cause": "word", "state": "word",
    },
    "findings": {
        "stroke": "int32", "effect": "word", "parameter": "word", "value": "float64", "stderr": "float64",
        "unit": "word", "probability": "float32", "summary": "string",
    },
    "alarms": {
        "level": "int8", "alarm_class": "word", "message": "string", "user": "word", "comment": "string",
        "is_shelved": "bool", "strokes_since_service": "int32",
    },
    "recordings": {
        "key": "string", "source": "string", "strokes": "int32", "verdict": "word", "effects": "string",
        "probability": "float32", "summary": "string", "opening_delay": "float32", "opening_delay_stderr": "float32",
        "t1": "float32", "t1_stderr": "float32", "t2": "float32", "t2_stderr": "float32", "closing_time": "float32",
        "closing_time_stderr": "float32", "pilot_damping": "float32", "pilot_damping_stderr": "float32",
        "main_damping": "float32", "main_damping_stderr": "float32",
    },
}  # fmt: skip
"""Columns of each kind beside time, in SI; a word is one of few, of which each is kept once."""
_NAME: Final = re.compile(r"(\d{8})-(\d{8})\.parquet")
_MERGED: Final = 32
"""Files of a size that become one."""
_LONGEST: Final = 60.0
"""s that rows wait in memory."""
_MOST_WAITING: Final = 10_000
_LOCK_SECONDS: Final = 2.0
"""s that another writer is waited for, which takes some milliseconds to write."""


class _File(NamedTuple):
    """A file of rows: path, and the first and last number of the writes that it holds."""

    path: Path
    first: int
    last: int

    @property
    def writes(self) -> int:
        """How many writes it holds."""
        return self.last - self.first + 1


class Archive:
    """One archive, for any number of writers and readers on one machine.

    Args:
        folder: of the archive. years: of which as many months are kept as they have, and the present one.
        most_bytes: beyond which the oldest months go, of all valves.

    Raises:
        ValveError: pyarrow is not installed.
    """

    def __init__(self, folder: Path, years: float = 10.0, most_bytes: int = 2_000_000_000) -> None:
        try:
            import pyarrow
            import pyarrow.parquet
        except ImportError as error:
            raise ValveError(f"{folder}: an archive needs pyarrow; pip install '.[parquet]' in a checkout") from error
        self._arrow, self._parquet = pyarrow, pyarrow.parquet
        self._folder, self._years, self._most = folder, years, most_bytes
        self._waiting: dict[tuple[Kind, str, str], list[dict[str, object]]] = defaultdict(list)
        self._since: float | None = None

    def add(self, kind: Kind, valve: str, at: datetime, row: Row, now: float) -> None:
        """Take a row; it is on the disk a minute later at most, if `tick` is called.

        Args:
            kind: of the row. valve: full name of its node. at: its time, in UTC.
            row: values by column; others are null.
            now: s of a clock that does not go back, for the minute.

        Raises:
            ValueError: a column that the kind does not have.
        """
        if unknown := set(row) - set(COLUMNS[kind]):
            raise ValueError(f"{kind} have no column {', '.join(sorted(unknown))}")
        month = at.astimezone(timezone.utc).strftime("%Y-%m")
        self._waiting[kind, valve, month].append({"time": at, **row})
        self._since = now if self._since is None else self._since

    def tick(self, now: float) -> None:
        """Write what has waited for a minute, or is a lot; `now` as in `add`.

        Raises:
            ValveError: it cannot be written; it waits on, and is tried again.
        """
        waiting = sum(map(len, self._waiting.values()))
        if self._since is not None and (now - self._since >= _LONGEST or waiting >= _MOST_WAITING):
            self.flush()

    def flush(self) -> None:
        """Write all that waits.

        Raises:
            ValveError: it cannot be written, as where the disk is full or another writer does not end; what was not
                written waits on.
        """
        if self._waiting:
            with self._locked():
                self._write_waiting()
        self._since = None

    def _write_waiting(self) -> None:
        for place in list(self._waiting):
            kind, valve, month = place
            folder = self._place(kind, valve) / f"month={month}"
            files = _held(folder)
            number = files[-1].last + 1 if files else 0
            self._write(folder, number, number, self._table(kind, self._waiting[place]))
            del self._waiting[place]
            self._merge(folder)

    @contextlib.contextmanager
    def _locked(self) -> Iterator[None]:
        """While no other writer writes; the kernel lets go of the lock of a process that ends."""
        path = self._folder / ".lock"
        try:
            self._folder.mkdir(parents=True, exist_ok=True)
            lock = os.open(path, os.O_RDWR | os.O_CREAT, 0o644)
        except OSError as error:
            raise ValveError(f"{path}: cannot be written ({error.strerror}); choose another folder") from error
        try:
            latest = time.monotonic() + _LOCK_SECONDS
            while True:
                try:
                    fcntl.flock(lock, fcntl.LOCK_EX | fcntl.LOCK_NB)
                    break
                except BlockingIOError as error:
                    if time.monotonic() > latest:
                        raise ValveError(f"{path}: another program has been writing for seconds; end it") from error
                    time.sleep(0.005)
            yield
        finally:
            os.close(lock)

    def valves(self) -> list[str]:
        """Full names of all valves of which there is something."""
        names = {
            urllib.parse.unquote(path.name.removeprefix("valve="))
            for kind in get_args(Kind)
            for path in (self._folder / kind).glob("valve=*")
        }
        return sorted(names)

    def read(
        self, kind: Kind, valve: str, since: datetime | None = None, until: datetime | None = None
    ) -> list[dict[str, Any]]:
        """Rows of a valve in order of time, from a time on (that one too) until before another.

        Raises:
            ValveError: a file is damaged; the message names it.
        """
        rows = [row for table in self._tables(kind, valve, since, until) for row in table.to_pylist()]
        return sorted(rows, key=lambda row: row["time"])

    def count(self, kind: Kind, valve: str, since: datetime | None = None) -> int:
        """How many rows of a valve there are on the disk, from a time on (that one too).

        Raises:
            ValveError: a file is damaged; the message names it.
        """
        first = "" if since is None else since.astimezone(timezone.utc).strftime("month=%Y-%m")
        count = 0
        for month in self._place(kind, valve).glob("month=*"):
            if month.name > first:
                count += sum(self._rows(file) for file in _held(month))
            elif month.name == first:
                count += sum(len(self._load(file, [("time", ">=", since)], ["time"])) for file in _held(month))
        return count

    def _tables(self, kind: Kind, valve: str, since: datetime | None, until: datetime | None) -> Iterator[Any]:
        months = sorted(self._place(kind, valve).glob("month=*"))
        first = None if since is None else since.astimezone(timezone.utc).strftime("month=%Y-%m")
        last = None if until is None else until.astimezone(timezone.utc).strftime("month=%Y-%m")
        limits = ((">=", since), ("<", until))
        wanted = [("time", sign, limit) for sign, limit in limits if limit is not None]
        for month in months:
            if (first is None or month.name >= first) and (last is None or month.name <= last):
                for file in _held(month):
                    yield self._load(file, wanted or None)

    def size(self) -> int:
        """Bytes of all files."""
        return sum(path.stat().st_size for path in self._folder.rglob("*.parquet"))

    def prune(self) -> list[str]:
        """Take out months beyond those that are kept, the oldest ones, and of what is too much.

        Months are counted, and no clock is asked: one that is wrong by decades would take out all of them.

        Returns:
            the months that went, such as 2016-11.

        Raises:
            ValveError: another writer does not end.
        """
        with self._locked():
            return self._prune()

    def _prune(self) -> list[str]:
        months = sorted({path.name for path in self._folder.glob("*/valve=*/month=*")})
        kept = 1 + math.ceil(12.0 * self._years)  # that of today has just begun
        gone = months[: max(0, len(months) - kept)]
        size = self.size()
        for month in months:
            files = [path for path in self._folder.glob(f"*/valve=*/{month}/*.parquet") if path.is_file()]
            if month not in gone and size <= self._most:
                break
            if month == months[-1] and month not in gone:
                break  # what is being written stays
            size -= sum(path.stat().st_size for path in files)
            for path in files:
                path.unlink()
            for folder in self._folder.glob(f"*/valve=*/{month}"):
                if not any(folder.iterdir()):
                    folder.rmdir()
            if month not in gone:
                gone.append(month)
        return [month.removeprefix("month=") for month in gone]

    def _place(self, kind: Kind, valve: str) -> Path:
        return self._folder / kind / f"valve={urllib.parse.quote(valve, safe='')}"

    def _table(self, kind: Kind, rows: Sequence[Row]) -> Any:
        arrow = self._arrow
        types = {"word": arrow.dictionary(arrow.int32(), arrow.string()), "bool": arrow.bool_()}
        fields = [("time", arrow.timestamp("us", tz="UTC"))]
        fields += [(name, types.get(of) or getattr(arrow, of)()) for name, of in COLUMNS[kind].items()]
        return arrow.Table.from_pylist([dict(row) for row in rows], schema=arrow.schema(fields))

    def _write(self, folder: Path, first: int, last: int, table: Any) -> None:
        with atomic_write(folder / f"{first:08d}-{last:08d}.parquet", durable=True) as partial:
            self._parquet.write_table(table, partial, compression="zstd", compression_level=9)

    def _merge(self, folder: Path) -> None:
        """Make one of the last 32 files, as often as there are so many of one size."""
        while True:
            files = _held(folder)
            last = files[-_MERGED:]
            if len(last) < _MERGED or len({file.writes for file in last}) > 1:
                break
            tables = [self._load(file) for file in last]
            whole = self._arrow.concat_tables(tables).unify_dictionaries().sort_by("time")
            self._write(folder, last[0].first, last[-1].last, whole)
        _sweep(folder)

    def _load(self, file: _File, wanted: Any = None, columns: list[str] | None = None) -> Any:
        with self._named(file):
            return self._parquet.read_table(file.path, partitioning=None, filters=wanted, columns=columns)

    def _rows(self, file: _File) -> int:
        """How many rows a file says that it has, without reading them."""
        with self._named(file):
            return int(self._parquet.read_metadata(file.path).num_rows)

    @contextlib.contextmanager
    def _named(self, file: _File) -> Iterator[None]:
        try:
            yield
        except (OSError, self._arrow.ArrowException) as error:
            raise ValveError(
                f"{file.path}: cannot be read ({' '.join(str(error).split())[:120]}); restore it, or take it away: "
                "the rest of the archive is independent of it"
            ) from error


def _all(folder: Path) -> Iterator[_File]:
    for path in sorted(folder.glob("*.parquet")) if folder.is_dir() else ():
        if found := _NAME.fullmatch(path.name):
            yield _File(path, int(found[1]), int(found[2]))


def _held(folder: Path) -> list[_File]:
    """The files that count, in order: none that another one holds."""
    held: list[_File] = []
    for file in sorted(_all(folder), key=lambda file: (file.first, -file.last)):
        if not held or file.last > held[-1].last:
            held.append(file)
    return held


def _sweep(folder: Path) -> None:
    """Take away files that another one holds."""
    held = {file.path for file in _held(folder)}
    for file in list(_all(folder)):
        if file.path not in held:
            file.path.unlink(missing_ok=True)
