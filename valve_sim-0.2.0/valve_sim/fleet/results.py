"""The table on disk: parts while a run goes on, one file when it ends; every one of them whole or not there.

DIR/parts/00003-00017.parquet is the 17th part of the 3rd run. A later part replaces rows of an earlier one, and parts
those of DIR/fleet.parquet. The parts are deleted when the table that holds them has taken its name.
"""

from __future__ import annotations

import fcntl
import os
from collections.abc import Iterable, Iterator, Sequence
from contextlib import contextmanager, suppress
from pathlib import Path
from typing import Any, Final

import pyarrow as pa
import pyarrow.parquet as pq

from valve_sim import __version__
from valve_sim.files.whole_files import atomic_write
from valve_sim.fleet.columns import COUNT, LIST, NUMBER, SCHEMA, TEXT, TIME, TRUTH, columns
from valve_sim.fleet.units import Row
from valve_sim.model.errors import ValveError

TABLE: Final = "fleet.parquet"
PARTS: Final = "parts"

_TYPES: Final = {
    TEXT: pa.string(),
    NUMBER: pa.float64(),
    COUNT: pa.int64(),
    TIME: pa.timestamp("ns", tz="UTC"),
    LIST: pa.list_(pa.string()),
    TRUTH: pa.bool_(),
}


def schema() -> Any:
    """The table's schema: each column's unit and meaning are its metadata."""
    fields = [
        pa.field(column.name, _TYPES[column.type], metadata={"unit": column.unit, "meaning": column.meaning})
        for column in columns()
    ]
    return pa.schema(fields, metadata={"schema": SCHEMA, "valve_sim": __version__})


class Results:
    """The rows of a folder.

    Args:
        folder: DIR; made if need be.
    """

    def __init__(self, folder: Path) -> None:
        self.folder = folder
        self._schema = schema()
        self._run = 1 + max((int(part.name[:5]) for part in self._parts()), default=0)
        self._count = 0

    @property
    def table(self) -> Path:
        """The file that holds all rows when a run has ended."""
        return self.folder / TABLE

    def rows(self) -> list[Row]:
        """All rows of earlier runs, ended or not; the newest of each bag and valve.

        Raises:
            ValveError: the table is none of this program.
        """
        found: dict[tuple[str, str], Row] = {}
        if self.table.exists():
            try:
                _take(found, _read(self.table, self._schema))
            except (pa.ArrowException, OSError) as error:
                raise ValveError(
                    f"{self.table}: cannot be read as a table of this program ({_first_line(error)}); move it away, or "
                    "choose another --output, and the bags are examined anew"
                ) from error
        for part in self._parts():
            # A part that a failing disk has damaged is done without: its units are examined again.
            with suppress(pa.ArrowException, OSError):
                _take(found, _read(part, self._schema))
        return list(found.values())

    def add(self, rows: Sequence[Row]) -> None:
        """Write some rows as one more part.

        Raises:
            ValveError: it cannot be written.
        """
        if not rows:
            return
        self._count += 1
        self._write(self.folder / PARTS / f"{self._run:05d}-{self._count:05d}.parquet", rows)

    def compact(self, rows: Iterable[Row]) -> None:
        """Write all rows as the table, and delete the parts.

        Raises:
            ValveError: it cannot be written; the parts stay.
        """
        ordered = sorted(rows, key=lambda row: (row["valve"], row.get("start_time") or 0, row["source"]))
        parts = self._parts()
        self._write(self.table, ordered)
        for part in parts:
            part.unlink(missing_ok=True)
        with suppress(OSError):
            (self.folder / PARTS).rmdir()

    def _parts(self) -> list[Path]:
        return sorted((self.folder / PARTS).glob("[0-9][0-9][0-9][0-9][0-9]-*.parquet"))

    def _write(self, path: Path, rows: Sequence[Row]) -> None:
        table = pa.Table.from_pylist(list(rows), schema=self._schema)
        with atomic_write(path) as partial:
            pq.write_table(table, partial, compression="zstd")

    @contextmanager
    def locked(self) -> Iterator[None]:
        """Only one run writes to a folder at a time.

        Raises:
            ValveError: another one does, or the folder cannot be written to.
        """
        try:
            self.folder.mkdir(parents=True, exist_ok=True)
            lock = os.open(self.folder / ".lock", os.O_RDWR | os.O_CREAT, 0o644)
        except OSError as error:
            raise ValveError(f"{self.folder}: cannot be written to ({error.strerror}); choose another place") from error
        try:
            try:
                fcntl.flock(lock, fcntl.LOCK_EX | fcntl.LOCK_NB)
            except BlockingIOError as error:
                raise ValveError(
                    f"{self.folder}: another run writes there; wait for it, or choose another --output"
                ) from error
            yield
        finally:
            os.close(lock)


def _take(found: dict[tuple[str, str], Row], rows: Iterable[Row]) -> None:
    found.update(((row["source"], row["valve"]), row) for row in rows)


def _read(path: Path, wanted: Any) -> list[Row]:
    """The rows of a file, of this version or an earlier one: columns that it lacks are null."""
    table = pq.read_table(path)
    if (table.schema.metadata or {}).get(b"schema") != SCHEMA.encode():
        raise pa.ArrowInvalid(f"its form is not {SCHEMA}")
    for missing in [field for field in wanted if field.name not in table.column_names]:
        table = table.append_column(missing, pa.nulls(len(table), missing.type))
    times = table.column("start_time").cast(pa.int64())
    rows: list[Row] = table.drop_columns(["start_time"]).select(
        [field.name for field in wanted if field.name != "start_time"]
    ).to_pylist()  # fmt: skip
    for row, time in zip(rows, times.to_pylist(), strict=True):
        row["start_time"] = time
    return rows


def _first_line(error: BaseException) -> str:
    return (str(error).splitlines() or [type(error).__name__])[0].rstrip(".")
