"""Tables of a data logger as columns by name: CSV with preamble, units and decimal commas; Parquet; MATLAB."""

from __future__ import annotations

import io
import re
from collections.abc import Mapping, Sequence
from pathlib import Path
from typing import Any, Final

import numpy as np
from numpy.typing import NDArray

from valve_sim.files.channels import UNITS
from valve_sim.files.recording_map import TimeAxis
from valve_sim.files.tables import TableError, number_in

Array = NDArray[np.float64]

TEXT_SUFFIXES: Final = (".csv", ".txt", ".tsv", ".dat", ".asc")
PARQUET_SUFFIXES: Final = (".parquet", ".pq")
TABLE_SUFFIXES: Final = (*TEXT_SUFFIXES, *PARQUET_SUFFIXES, ".mat")

_DELIMITERS: Final = (";", "\t", ",", None)
_COMMENTS: Final = ("#", "%", "//", "!")
_LONGEST_PREAMBLE: Final = 500
"""Lines that are searched for the first numbers."""
_UNIT_WORDS: Final = frozenset(
    {unit for units in UNITS.values() for unit in units}
    | {"volt", "volts", "second", "seconds", "sec", "ampere", "amp", "amps", "ohm", "Ω", "N", "Hz", "%", "-", ""}
)
MOST_REPEATED: Final = 20
"""Rows, of which one may have the time of the row before: logged twice, that is. More do not know their time."""
_WHOLE: Final = 3
"""So many lines of numbers in a row begin the data."""


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
        return self._numbers(self.names.index(name) if name in self.names else int(name) - 1)

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
            rows = len(self.column(self.names[0]))
            return np.arange(rows) / axis.rate, np.ones(rows, dtype=bool), 0
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
        if suffix in PARQUET_SUFFIXES:
            return _open_parquet(path)
        return _open_mat(path) if suffix == ".mat" else TextTable(path)
    except OSError as error:
        raise TableError(f"{path}: cannot be read ({error.strerror or error}); give a file of a data logger") from error


# --- text ---


class TextTable(DataTable):
    """A text file: lines of numbers after a preamble of any kind.

    Cells are separated by semicolons, tabs, commas or blanks; commas that are not separators are decimal points. Names
    are in the last line before the numbers that has as many cells, or in the one before if the last one holds units.
    """

    def __init__(self, path: Path) -> None:
        lines = _decoded(path.read_bytes()).splitlines()
        self._delimiter, self._first, width = _find_data(path, lines)
        self._lines = lines
        names, units = _find_names(lines[: self._first], self._delimiter, width)
        names = names or [str(number + 1) for number in range(width)]
        if all(line.rstrip().endswith(self._delimiter or "\n") for line in lines[self._first : self._first + _WHOLE]):
            names.pop()  # each line ends with a separator
        super().__init__(path, names, units)

    def place(self, row: int) -> str:
        """The file's own line number."""
        numbers = [number for number, line in enumerate(self._lines) if number >= self._first and line.strip()]
        return f"line {numbers[row] + 1}"

    def _numbers(self, place: int) -> Array:
        text = "\n".join(self._lines[self._first :])
        if self._delimiter != ",":
            text = text.replace(",", ".")
        try:
            found = np.loadtxt(
                io.StringIO(text), delimiter=self._delimiter, usecols=place, comments=None, ndmin=1, dtype=np.float64
            )
        except ValueError:
            return self._one_by_one(place)
        return np.asarray(found)

    def _one_by_one(self, place: int) -> Array:
        """Cell by cell, slowly: empty cells are allowed, and a cell that is not a number is named with its line."""
        values = []
        for number, line in enumerate(self._lines[self._first :], start=self._first + 1):
            if not line.strip():
                continue
            cells = _cells(line, self._delimiter)
            cell = cells[place] if place < len(cells) else None
            value = np.nan if cell == "" else number_in(cell or "")
            if value is None:
                found = "nothing" if cell is None else repr(cell[:40])
                raise TableError(
                    f"{self.path}: line {number}: column {self.names[place]}: found {found}, expected a number; "
                    "correct the line or take it out"
                )
            values.append(value)
        return np.array(values)


def _decoded(data: bytes) -> str:
    """UTF-8 or UTF-16 by its mark; else Latin-1, in which loggers write µ and °."""
    if data.startswith((b"\xff\xfe", b"\xfe\xff")):
        return data.decode("utf-16", "replace")
    try:
        return data.decode("utf-8-sig")
    except UnicodeDecodeError:
        return data.decode("latin-1")


def _cells(line: str, delimiter: str | None) -> list[str]:
    cells = [cell.strip().strip('"').strip() for cell in line.strip().split(delimiter)]
    return cells if delimiter == "," else [cell.replace(",", ".") for cell in cells]


def _find_data(path: Path, lines: Sequence[str]) -> tuple[str | None, int, int]:
    """The delimiter, the first line of numbers, and how many cells it has."""
    head = lines[: _LONGEST_PREAMBLE + _WHOLE]
    for words in (0, 1):  # one column of text, such as a time of day, is allowed if nothing else fits
        for delimiter in _DELIMITERS:
            widths = [_width_of_numbers(line, delimiter, words) for line in head]
            start = _first_run(widths)
            if start is not None:
                return delimiter, start, widths[start] or 0
    if not any(line.strip() for line in lines):
        raise TableError(f"{path}: is empty; export the measurement again")
    raise TableError(
        f"{path}: no table of numbers in its first {min(len(lines), _LONGEST_PREAMBLE)} lines; "
        "expected rows of at least two numbers, parted by ; , tabs or blanks"
    )


def _first_run(widths: Sequence[int | None]) -> int | None:
    """Where lines of numbers of one width begin."""
    for start, width in enumerate(widths[:_LONGEST_PREAMBLE]):
        if not width:
            continue
        run = [found for found in widths[start:] if found is not None][:_WHOLE]
        if len(set(run)) == 1 and (len(run) == _WHOLE or start + len(run) >= len(widths) - 1):
            return start
    return None


def _width_of_numbers(line: str, delimiter: str | None, words: int) -> int | None:
    """How many cells a line of numbers has, of which `words` may be text; 0 for another line, None for an empty one."""
    if not line.strip():
        return None
    if line.lstrip().startswith(_COMMENTS):
        return 0
    cells = _cells(line, delimiter)
    numbers = sum(cell == "" or number_in(cell) is not None for cell in cells)
    return len(cells) if len(cells) > 1 and numbers >= max(2, len(cells) - words) else 0


def _find_names(lines: Sequence[str], delimiter: str | None, width: int) -> tuple[list[str], dict[str, str]]:
    """Names and units from the lines before the numbers."""
    rows: list[list[str]] = []
    for line in reversed(lines):
        text = line.strip()
        for mark in _COMMENTS:
            text = text.removeprefix(mark)
        cells = [cell.strip().strip('"').strip() for cell in text.strip().split(delimiter)]
        if len(cells) != width:
            if text.strip() and rows:
                break
            continue
        rows.append(cells)
        if len(rows) == 2:
            break
    if not rows:
        return [], {}
    is_units = len(rows) == 2 and any(rows[0]) and all(_is_unit(cell) for cell in rows[0])
    names = _unique(rows[1] if is_units else rows[0])
    units = {name: _bare(cell) for name, cell in zip(names, rows[0], strict=True)} if is_units else {}
    for name in names:
        inside = re.search(r"[\[(]([^\])]+)[\])]\s*$", name)
        if inside:
            units.setdefault(name, inside[1].strip())
    return names, {name: unit for name, unit in units.items() if unit}


def _is_unit(cell: str) -> bool:
    return _bare(cell) in _UNIT_WORDS or _bare(cell).lower() in _UNIT_WORDS


def _bare(cell: str) -> str:
    return cell.strip().strip("[]()").strip()


def _unique(names: Sequence[str]) -> list[str]:
    """Names, with a number added to those that are empty or occur twice."""
    result: list[str] = []
    for number, name in enumerate(names, start=1):
        result.append(name if name and name not in result else f"{name or 'column'}_{number}")
    return result


# --- Parquet and MATLAB ---


class _ArrayTable(DataTable):
    """Columns that are in memory already."""

    def __init__(self, path: Path, columns: Mapping[str, Any]) -> None:
        super().__init__(path, list(columns), {})
        self._columns = list(columns.values())

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
        table = pyarrow.parquet.read_table(path)
    except ArrowException as error:
        raise TableError(
            f"{path}: is not a Parquet file ({' '.join(str(error).split())[:120]}); export it again"
        ) from error
    return _ArrayTable(path, {name: table.column(name).to_numpy() for name in table.column_names})


def _open_mat(path: Path) -> DataTable:
    from scipy.io import loadmat
    from scipy.io.matlab import MatReadError

    try:
        found = loadmat(str(path), squeeze_me=True, struct_as_record=False)
    except NotImplementedError as error:
        raise TableError(f"{path}: is a MATLAB 7.3 file, which is not read; save it with: save(file, '-v7')") from error
    except (MatReadError, ValueError, TypeError) as error:
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
