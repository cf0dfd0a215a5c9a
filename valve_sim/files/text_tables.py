"""Text files of data loggers as columns of cells: preamble, names, units, separators, decimal commas, dates."""

from __future__ import annotations

import csv
import functools
import io
import re
from collections.abc import Sequence
from datetime import date
from pathlib import Path
from typing import Final, NamedTuple

import numpy as np
from numpy.typing import NDArray

from valve_sim.files.bounded import table_text
from valve_sim.files.channels import UNITS
from valve_sim.files.tables import TableError

Array = NDArray[np.float64]

MOST_COLUMNS: Final = 4096
"""Cells of a line; more is no table of a data logger."""
_DELIMITERS: Final = (";", "\t", ",", None)
_COMMENTS: Final = ("#", "%", "//", "!")
_LONGEST_PREAMBLE: Final = 500
_LARGEST_PREAMBLE: Final = 500_000
"""Lines, and characters, that are searched for the first numbers."""
_HEADS: Final = 4
"""Lines with names, units and the like, at most, before the numbers."""
_WHOLE: Final = 3
"""So many rows whose columns are of the same kinds begin the data."""
_WHOLE_WITH_WORDS: Final = 8
"""And so many where some columns hold words: a preamble has such lines, too."""
_UNIT_WORDS: Final = frozenset(
    {unit for units in UNITS.values() for unit in units}
    | {"volt", "volts", "second", "seconds", "sec", "ampere", "amp", "amps", "ohm", "Ω", "N", "Hz", "%", "-"}
)
_SWITCHED: Final = {"true": 1.0, "false": 0.0, "on": 1.0, "off": 0.0}
_MISSING: Final = ("", "-", "--", "---", "#n/a", "#nv", "n/a", "na", "null", "none", "#num!", "#div/0!", "#value!")
_DATE: Final = re.compile(r"(\d{4})[-/](\d\d?)[-/](\d\d?)|(\d\d?)\.(\d\d?)\.(\d{4})")
_TIME: Final = re.compile(r"(\d\d?):(\d\d)(?::(\d\d(?:[.,]\d+)?))?\s*(?:Z|[+-]\d\d:?\d\d)?")
_DAY: Final = 86_400


class Layout(NamedTuple):
    """What parts cells, where the numbers begin, and the columns.

    Attributes:
        delimiter: None: blanks. first: line of the first numbers. names: of the columns. units: by name, as far as
            the file says them.
    """

    delimiter: str | None
    first: int
    names: tuple[str, ...]
    units: dict[str, str]


class TextFile:
    """A text file: rows of numbers after a preamble of any kind.

    Cells are parted by semicolons, tabs, commas or blanks; a comma within a cell is a decimal point. A cell may also be
    a date, a time of day, TRUE or FALSE, the sign of infinity, or say that there is no number.

    Raises:
        TableError: there is no table of numbers in it, or it is larger than any.
    """

    def __init__(self, path: Path) -> None:
        self.path = path
        self.lines = table_text(path, TableError).splitlines()
        self.layout = _layout(path, self.lines)

    def column(self, place: int) -> Array:
        """The numbers of a column, (n,), NaN where a cell is empty; dates are s since midnight before the first one.

        Raises:
            TableError: one of its cells is not a number.
        """
        delimiter = self.layout.delimiter
        text = "\n".join(self.lines[self.layout.first :])
        if delimiter != ",":
            text = text.replace(",", ".")
        try:
            found = np.loadtxt(
                io.StringIO(text), delimiter=delimiter, usecols=place, comments=None, ndmin=1, dtype=np.float64
            )
        except ValueError:
            return self._cell_by_cell(place)
        return np.asarray(found)

    def _cell_by_cell(self, place: int) -> Array:
        """The same, slowly, where not all cells are plain numbers; a cell that is none is named with its line."""
        values, first_day = [], None
        for number, row in self.rows:
            cell = row[place] if place < len(row) else None
            value = None if cell is None else number_in(cell)
            if value is None and cell and (stamp := _date_in(cell)):
                first_day = stamp[0] if first_day is None else first_day
                value = _DAY * (stamp[0] - first_day) + stamp[1]
            if value is None:
                found = "nothing" if cell is None else repr(cell[:40])
                raise TableError(
                    f"{self.path}: line {number + 1}: column {self.layout.names[place]}: found {found}, expected a "
                    "number; correct the line or take it out"
                )
            values.append(value)
        return np.array(values, dtype=np.float64)

    @functools.cached_property
    def rows(self) -> list[tuple[int, list[str]]]:
        """Number of each line that is not empty, from 0 on, and its cells."""
        return [
            (number, cells_of(line, self.layout.delimiter))
            for number, line in enumerate(self.lines)
            if number >= self.layout.first and line.strip()
        ]

    def line_of(self, row: int) -> int:
        """The number of a row's line, from 1 on."""
        return self.rows[row][0] + 1


def number_in(cell: str) -> float | None:
    """The number that a cell holds, NaN where it says that there is none; None where it holds something else."""
    text = cell.strip()
    try:
        if "_" not in text:  # which Python takes for a digit's neighbour
            return float(text.replace(",", ".", 1))
    except ValueError:
        pass
    word = text.lower()
    if word in _MISSING:
        return np.nan
    if word.lstrip("+-") == "∞":
        return -np.inf if word.startswith("-") else np.inf
    return _SWITCHED.get(word)


def _date_in(cell: str) -> tuple[int, float] | None:
    """A date and a time of day, or one of them, as day (0: no date) and seconds; None where it is neither."""
    day, clock = re.split(r"[T ]", cell, maxsplit=1) if re.search(r"\d[T ]\d", cell) else (cell, "")
    dated, timed = _DATE.fullmatch(day), _TIME.fullmatch(clock or day)
    if (dated is None and clock) or (timed is None and (clock or dated is None)):
        return None
    number, seconds = 0, 0.0
    if dated is not None:
        year, month, own, *german = dated.groups()
        try:
            number = date(*(int(part) for part in ((year, month, own) if year else german[::-1]))).toordinal()
        except ValueError:
            return None
    if timed is not None:
        hours, minutes, rest = timed.groups()
        seconds = 3600.0 * int(hours) + 60.0 * int(minutes) + float((rest or "0").replace(",", "."))
    return number, seconds


def cells_of(line: str, delimiter: str | None) -> list[str]:
    """The cells of a line; quotes keep what is in them together."""
    if delimiter is None or '"' not in line:
        return [cell.strip() for cell in line.split(delimiter)]
    try:
        return [cell.strip() for cell in next(csv.reader([line], delimiter=delimiter, skipinitialspace=True), [])]
    except csv.Error:
        return [line]


def _kind(cell: str) -> str:
    """number, date, word; empty where a cell is."""
    value = number_in(cell)
    if value is None:
        return "date" if _date_in(cell) else "word"
    return "" if np.isnan(value) else "number"


def _layout(path: Path, lines: Sequence[str]) -> Layout:
    ends = np.cumsum([len(line) for line in lines[: _LONGEST_PREAMBLE + _WHOLE_WITH_WORDS]])
    head = lines[: max(_WHOLE_WITH_WORDS, int(np.searchsorted(ends, _LARGEST_PREAMBLE)))]
    parted = {delimiter: [_checked(path, cells_of(line, delimiter)) for line in head] for delimiter in _DELIMITERS}
    for with_words in (False, True):
        for delimiter, rows in parted.items():
            start = _first_row(head, rows, with_words=with_words)
            if start is not None:
                return _named(lines[:start], delimiter, start, rows[start : start + _WHOLE_WITH_WORDS])
    if not any(line.strip() for line in lines):
        raise TableError(f"{path}: is empty; export the measurement again")
    raise TableError(
        f"{path}: no table of numbers in its first {min(len(lines), _LONGEST_PREAMBLE)} lines; "
        "expected rows of at least two numbers, parted by ; , tabs or blanks"
    )


def _checked(path: Path, cells: list[str]) -> list[str]:
    if len(cells) > MOST_COLUMNS:
        raise TableError(
            f"{path}: has {len(cells)} columns, expected at most {MOST_COLUMNS}; export those of the valve"
        )
    return cells


def _first_row(lines: Sequence[str], rows: Sequence[Sequence[str]], *, with_words: bool) -> int | None:
    """Where rows begin whose columns are of the same kinds, at least two of them numbers or dates."""
    filled = [n for n, line in enumerate(lines) if line.strip()]
    kinds = {n: ["comment"] if lines[n].lstrip().startswith(_COMMENTS) else [_kind(c) for c in rows[n]] for n in filled}
    for at, start in enumerate(filled):
        if start >= _LONGEST_PREAMBLE or len(kinds[start]) < 2:
            continue
        run = [kinds[n] for n in filled[at : at + _WHOLE_WITH_WORDS]]
        run = run if with_words else run[:_WHOLE]
        if len({len(row) for row in run}) > 1 or ("word" in run[0] and not with_words):
            continue
        columns = [{kind for kind in column if kind} for column in zip(*run, strict=True)]
        if all(len(found) < 2 for found in columns) and sum(bool(found & {"number", "date"}) for found in columns) > 1:
            return start
    return None


def _named(lines: Sequence[str], delimiter: str | None, start: int, data: Sequence[Sequence[str]]) -> Layout:
    """The layout with names and units from the lines before the numbers."""
    width = len(data[0])
    widths = (width, width - 1) if not any(row[-1] for row in data if row) else (width,)
    rows: list[list[str]] = []
    for line in reversed(lines):
        text = line.rstrip()
        for mark in _COMMENTS:
            text = text.removeprefix(mark)
        cells = cells_of(text if delimiter == "\t" else text.strip(), delimiter)
        is_head = len(cells) in widths or (len(cells) == width + 1 and not cells[-1])
        if rows and (not is_head or len(rows) == _HEADS):
            break
        if is_head and any(cells):
            rows.append((cells + [""] * width)[:width])
    ends_empty = all(not row[-1] for row in (*data, *rows) if len(row) == width)
    width -= ends_empty  # each line ends with a separator
    if not rows:
        return Layout(delimiter, start, tuple(str(number + 1) for number in range(width)), {})
    units = next((n for n in range(len(rows) - 1) if _are_units(rows[n])), None)
    names = _unique(rows[0 if units is None else units + 1][:width])
    found = {} if units is None else {name: _bare(cell) for name, cell in zip(names, rows[units], strict=False)}
    for name in names:
        inside = re.search(r"[\[(]([^\])]+)[\])]\s*$", name)
        if inside:
            found.setdefault(name, inside[1].strip())
    return Layout(delimiter, start, tuple(names), {name: unit for name, unit in found.items() if unit})


def _are_units(cells: Sequence[str]) -> bool:
    """Whether all words of a line are units, or at least two and the half of them."""
    words = [_bare(cell) for cell in cells if _kind(cell) == "word"]
    known = sum(word in _UNIT_WORDS or word.lower() in _UNIT_WORDS for word in words)
    return known > 0 and (known == len(words) or (known > 1 and 2 * known >= len(words)))


def _bare(cell: str) -> str:
    return "" if _kind(cell) != "word" else cell.strip().strip("[]()").strip()


def _unique(names: Sequence[str]) -> list[str]:
    """Names, with a number added to those that are empty or occur twice; a number alone would count columns."""
    result: list[str] = []
    for number, given in enumerate(names, start=1):
        name = f"channel {given}" if given.isdigit() else given
        result.append(name if name and name not in result else f"{name or 'column'}_{number}")
    return result
