"""Tables of a data logger as columns by name: CSV with preamble, units and decimal commas; Parquet; MATLAB."""

from __future__ import annotations

import math
from collections.abc import Mapping, Sequence
from pathlib import Path
from typing import Any, Final

import numpy as np
from numpy.typing import NDArray

from valve_sim.files.bounded import LARGEST_TEXT, check_expanded, check_file
from valve_sim.files.recording_map import TimeAxis
from valve_sim.files.tables import TableError
from valve_sim.files.text_tables import MOST_COLUMNS, TextFile, number_in
from valve_sim.model.errors import ValveError

Array = NDArray[np.float64]

TEXT_SUFFIXES: Final = (".csv", ".txt", ".tsv", ".dat", ".asc", ".lvm")
PARQUET_SUFFIXES: Final = (".parquet", ".pq")
TABLE_SUFFIXES: Final = (*TEXT_SUFFIXES, *PARQUET_SUFFIXES, ".mat")

MOST_REPEATED: Final = 20
"""Rows, of which one may have the time of the row before: logged twice, that is. More do not know their time."""


class DataTable:
    """Columns of numbers by name; a column is read when it is asked for.

    Attributes:
        path: the file, for messages.
        names: of the columns, in the file's order.
        units: column to unit, where the file says one.
    """

    def __init__(self, path: Path, names: Sequence[str], units: Mapping[str, str]) -> None:
        self.path = path
        self.names = tuple(names)
        self.units = dict(units)

    def has(self, name: str) -> bool:
        """Whether there is a column of this name or number, from 1 on."""
        return name in self.names or (name.isdigit() and 1 <= int(name) <= len(self.names))

    def column(self, name: str) -> Array:
        """The numbers of a column, (n,), NaN where a cell is empty; `name` may be its number, from 1 on.

        Raises:
            TableError: there is no such column, or one of its cells is not a number.
        """
        if not self.has(name):
            raise TableError(f"{self.path}: has no column {name}; it has {', '.join(self.names)}; name one of these")
        if name in self.names:
            return self._numbers(self.names.index(name))
        counted, named = self.names[int(name) - 1], f"channel {name}"
        if named in self.names and named != counted:
            raise TableError(
                f"{self.path}: column {name} is ambiguous, for the file calls column {self.names.index(named) + 1} so; "
                f"write column: {named}, or column: {counted}"
            )
        return self._numbers(int(name) - 1)

    @property
    def rows(self) -> int:
        """How many rows there are."""
        raise NotImplementedError

    def place(self, row: int) -> str:
        """Where a row (from 0 on) is in the file, for messages."""
        return f"row {row + 1}"

    def row_times(self, axis: TimeAxis) -> tuple[Array, NDArray[np.bool_], int]:
        """When each row was taken.

        Args:
            axis: by which column of the table, or at what rate.

        Returns:
            (n,) s; (n,) which rows to keep: a row with the time of the one before goes; how many these are.

        Raises:
            TableError: a cell is empty, time runs backwards, or many rows share one time.
        """
        if axis.rate:
            return np.arange(self.rows) / axis.rate, np.ones(self.rows, dtype=bool), 0
        column = axis.column
        times = axis.unit * self.column(column)
        finite = np.isfinite(times)
        if not finite.all():
            where = self.place(int(np.argmin(finite)))
            raise TableError(f"{self.path}: {where}: column {column} holds no time; take the row out")
        steps = np.diff(times)
        if (steps < 0).any():
            row = int(np.argmax(steps < 0)) + 1
            raise TableError(
                f"{self.path}: {self.place(row)}: time column {column} runs backwards, {times[row]:.9g} s "
                f"after {times[row - 1]:.9g} s; sort the rows, cut the file where the logger began anew, or name "
                "another column"
            )
        kept = np.concatenate([[True], steps > 0])
        repeated = int((~kept).sum())
        if repeated > len(times) // MOST_REPEATED:
            raise TableError(
                f"{self.path}: column {column}: {repeated} of {len(times)} rows have the time of the row before; "
                "write the time with more digits, or give time: {rate: ...} (rows a second)"
            )
        return times, kept, repeated

    def _numbers(self, place: int) -> Array:
        raise NotImplementedError


def open_table(path: Path) -> DataTable:
    """Open a table by its suffix, one of `TABLE_SUFFIXES`.

    Raises:
        TableError: it cannot be read as its suffix says; one line with the remedy.
    """
    suffix = path.suffix.lower()
    try:
        check_file(path, LARGEST_TEXT, TableError)
        if suffix in PARQUET_SUFFIXES:
            return _open_parquet(path)
        return _open_mat(path) if suffix == ".mat" else TextTable(path)
    except OSError as error:
        raise TableError(f"{path}: cannot be read ({error.strerror or error}); give a file of a data logger") from error


class TextTable(DataTable):
    """A text file; see `TextFile`."""

    def __init__(self, path: Path) -> None:
        self._file = TextFile(path)
        super().__init__(path, self._file.layout.names, self._file.layout.units)

    @property
    def rows(self) -> int:
        """How many rows there are."""
        return len(self._file.rows)

    def place(self, row: int) -> str:
        """The file's own line number."""
        return f"line {self._file.line_of(row)}"

    def _numbers(self, place: int) -> Array:
        return self._file.column(place)


# --- Parquet and MATLAB ---


class _ArrayTable(DataTable):
    """Columns that are in memory already."""

    def __init__(self, path: Path, columns: Mapping[str, Any]) -> None:
        super().__init__(path, list(columns), {})
        self._columns = list(columns.values())

    @property
    def rows(self) -> int:
        """How many rows there are."""
        return len(self._columns[0]) if self._columns else 0

    def _numbers(self, place: int) -> Array:
        found = np.asarray(self._columns[place])
        if found.dtype.kind == "M":  # times of day: seconds since 1970
            return np.asarray(found.astype("datetime64[ns]").astype(np.int64) * 1e-9)
        if found.dtype.kind in "biuf":
            return np.asarray(found, dtype=np.float64)
        try:
            return np.array([np.nan if value is None else float(value) for value in found.tolist()])
        except (TypeError, ValueError):
            listed = found.tolist()
            row = next(row for row, value in enumerate(listed) if value is not None and number_in(str(value)) is None)
            raise TableError(
                f"{self.path}: row {row + 1}: column {self.names[place]}: found {str(listed[row])[:40]!r}, expected a "
                "number; name a column of numbers"
            ) from None


def _open_parquet(path: Path) -> DataTable:
    try:
        import pyarrow.parquet
        from pyarrow.lib import ArrowException
    except ImportError as error:
        raise TableError(
            f"{path}: Parquet files need pyarrow, which is not installed; pip install pyarrow, or export it as CSV"
        ) from error
    try:
        about = pyarrow.parquet.ParquetFile(path).metadata
        if about.num_columns > MOST_COLUMNS:
            raise TableError(f"{path}: has {about.num_columns} columns, expected at most {MOST_COLUMNS}; export fewer")
        check_expanded(path, 8.0 * about.num_rows * about.num_columns, TableError)
        table = pyarrow.parquet.read_table(path)
    except ArrowException as error:
        raise TableError(
            f"{path}: is not a Parquet file ({' '.join(str(error).split())[:120]}); export it again"
        ) from error
    return _ArrayTable(path, {name: table.column(name).to_numpy() for name in table.column_names})


def _open_mat(path: Path) -> DataTable:
    from scipy.io import loadmat, whosmat

    try:
        check_expanded(path, 8.0 * sum(math.prod(shape) for _, shape, _ in whosmat(str(path))), TableError)
        found = loadmat(str(path), squeeze_me=True, struct_as_record=False)
    except NotImplementedError as error:
        raise TableError(f"{path}: is a MATLAB 7.3 file, which is not read; save it with: save(file, '-v7')") from error
    except ValveError:
        raise
    except Exception as error:  # SciPy raises what it stumbles over
        raise TableError(
            f"{path}: is not a MATLAB file ({' '.join(str(error).split())[:120]}); save it again"
        ) from error
    columns = {}
    for name, value in found.items():
        if not name.startswith("__"):
            columns.update(_mat_columns(name, value))
    lengths = [len(values) for values in columns.values()]
    rows = max(lengths, default=0)
    if rows < 2:
        raise TableError(f"{path}: holds no column of numbers; save the measured vectors by their names")
    return _ArrayTable(path, {name: values for name, values in columns.items() if len(values) == rows})


def _mat_columns(name: str, value: Any) -> dict[str, NDArray[Any]]:
    """Vectors by their dotted names; a matrix's columns by their numbers: data[1]."""
    if hasattr(value, "_fieldnames"):
        inner: dict[str, NDArray[Any]] = {}
        for field in value._fieldnames:
            inner.update(_mat_columns(f"{name}.{field}", getattr(value, field)))
        return inner
    values = np.asarray(value)
    if values.ndim == 1 and values.dtype.kind in "biuf":
        return {name: values}
    if values.ndim == 2 and values.dtype.kind in "biuf":
        across = values if values.shape[0] >= values.shape[1] else values.T
        return {f"{name}[{number + 1}]": across[:, number] for number in range(across.shape[1])}
    return {}
