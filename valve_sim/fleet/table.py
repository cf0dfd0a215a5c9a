"""The table on disk: one Parquet file, which a run replaces whole."""

from __future__ import annotations

import fcntl
import os
from collections.abc import Iterable, Iterator
from contextlib import contextmanager
from pathlib import Path
from typing import Any, Final

import pyarrow as pa
import pyarrow.parquet as pq

from valve_sim import __version__
from valve_sim.files.whole_files import atomic_write
from valve_sim.fleet.columns import COUNT, LIST, NUMBER, SCHEMA, TEXT, TIME, TRUTH, columns
from valve_sim.fleet.units import Row
from valve_sim.model.errors import ValveError

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


def read_rows(path: Path) -> list[Row]:
    """The rows of earlier runs, none if there is no file; columns that an earlier version lacks are null.

    Raises:
        ValveError: the file is no table of this program.
    """
    if not path.exists():
        return []
    wanted = schema()
    try:
        table = pq.read_table(path)
        if (table.schema.metadata or {}).get(b"schema") != SCHEMA.encode():
            raise pa.ArrowInvalid(f"its form is not {SCHEMA}")
    except (pa.ArrowException, OSError) as error:
        why = (str(error).splitlines() or [type(error).__name__])[0].rstrip(".")
        raise ValveError(
            f"{path}: cannot be read as a table of this program ({why}); move it away, or choose another --output; "
            "the bags are then examined again"
        ) from error
    for missing in [field for field in wanted if field.name not in table.column_names]:
        table = table.append_column(missing, pa.nulls(len(table), missing.type))
    # As a Python datetime a time would lose its nanoseconds.
    times = table.column("start_time").cast(pa.int64()).to_pylist()
    rows = table.select([name for name in wanted.names if name != "start_time"]).to_pylist()
    return [{**row, "start_time": time} for row, time in zip(rows, times, strict=True)]


def write_rows(path: Path, rows: Iterable[Row]) -> None:
    """Write all rows, by valve and time.

    Raises:
        ValveError: the file cannot be written.
    """
    ordered = sorted(rows, key=lambda row: (row["valve"], row.get("start_time") or 0, row["source"]))
    with atomic_write(path) as partial:
        pq.write_table(pa.Table.from_pylist(ordered, schema=schema()), partial, compression="zstd")


@contextmanager
def locked(folder: Path) -> Iterator[None]:
    """Make a folder, in which only one run writes at a time.

    Raises:
        ValveError: another run writes there, or the folder cannot be written to.
    """
    try:
        folder.mkdir(parents=True, exist_ok=True)
        lock = os.open(folder, os.O_RDONLY)
    except OSError as error:
        raise ValveError(f"{folder}: cannot be written to ({error.strerror}); choose another place") from error
    try:
        fcntl.flock(lock, fcntl.LOCK_EX | fcntl.LOCK_NB)
        yield
    except BlockingIOError as error:
        raise ValveError(f"{folder}: another run writes there; wait for it, or choose another --output") from error
    finally:
        os.close(lock)
