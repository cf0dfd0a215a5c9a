"""Text files of data loggers: preamble, names, units, separators, decimal commas, dates."""

from __future__ import annotations

import csv
import io
import re
from collections import Counter
from collections.abc import Mapping, Sequence
from pathlib import Path
from typing import Final, NamedTuple

import numpy as np
from numpy.typing import NDArray

from valve_sim.files.bounded import table_text
from valve_sim.files.cells import kind_of, number_in, quantity_in
from valve_sim.files.channels import UNITS
from valve_sim.files.tables import DataTable, TableError

Array = NDArray[np.float64]
Rows = Sequence[Sequence[str]]

MOST_COLUMNS: Final = 4096
"""Cells of a line; more is no table of a data logger."""
DELIMITERS: Final = (";", "\t", "|", ",", None)
_COMMENTS: Final = ("#", "%", "//", "!")
_DIGITS: Final = frozenset("0123456789+-.")
_LONGEST_PREAMBLE: Final = 500
_LARGEST_PREAMBLE: Final = 500_000
"""Lines, and characters, that are searched for the first numbers."""
_HEADS: Final = 40
"""Lines before the numbers that are searched for names and units."""
_NAMED: Final = 0.5
"""Share of the columns that the line with their names names, at least."""
_JOINED: Final = 4
"""Lines over which a name in quotes may go."""
_WHOLE: Final = 3
"""So many rows whose columns are of the same kinds begin the data."""
_WHOLE_WITH_WORDS: Final = 8
"""And so many where some columns hold words: a preamble has such lines, too."""
_GOES_ON: Final = 0.01
"""Share of its step by which a column may miss the next one, where it goes on in equal steps."""
_MOST_TRAILING: Final = 20
"""Lines without numbers behind the data that are left out: a summary, or a cut last row."""
_INTERVAL: Final = re.compile(
    r"(delta[_ ]?x|([xt][_ ]?)?inc(r(ement)?)?|hresolution|(sampl\w*|time)[_ ]?(interval|period|step)|sample[_ ]?time|"
    r"abtastintervall)( ?[\[(][mµuμn]?s\w*[\])])?",
    re.IGNORECASE,
)
_RATE: Final = re.compile(r"(sampl\w*[_ ]?(rate|frequency)|abtastrate)( ?[\[(][km]?hz[\])])?", re.IGNORECASE)
"""How a head calls the interval between rows, s, and their rate, Hz."""
_HERTZ: Final = {"khz": 1e3, "mhz": 1e6}
_NUMBERS: Final = re.compile(
    r"#|n|nr|no|index|idx|id|rows?|records?|samples?|points?|count(er)?|number|nummer|zeile", re.IGNORECASE
)
"""How a column is called that numbers the rows."""
_UNIT_WORDS: Final = frozenset(
    {unit for units in UNITS.values() for unit in units}
    | {"volt", "volts", "second", "seconds", "sec", "ampere", "amp", "amps", "ohm", "Ω", "N", "Hz", "%", "-"}
)


_LIKE_WORDS: Final = frozenset(("in", "h", "d", "g", "m", "min", "-"))
"""Units that behind a name without brackets are something else: valve_in, mass_m, t_min."""


class Layout(NamedTuple):
    """What parts cells, where the numbers begin, and the columns.

    Attributes:
        delimiter: None: blanks. first: line of the first numbers. names: of the columns. units: by name, as far as
            the file says them. others: what other lines of the head call a column, and its place.
        skipped: what to say of lines before the data that are half of numbers, the first of them.
    """

    delimiter: str | None
    first: int
    names: tuple[str, ...]
    units: Mapping[str, str]
    others: Mapping[str, int]
    skipped: str = ""


class TextTable(DataTable):
    """A text file: rows of numbers after a preamble of any kind.

    Cells are parted by semicolons, tabs, bars, commas or blanks; a comma within a cell is a decimal point. A cell may
    also be a date, a time of day, TRUE or FALSE, beyond the range (∞), or say that there is no number.

    Raises:
        TableError: there is no table of numbers in it, or it is larger than any.
    """

    def __init__(self, path: Path, lines: Sequence[str] | None = None) -> None:
        holes = unread = 0
        if lines is None:
            text = table_text(path, TableError).replace("\r\n", "\n").replace("\r", "\n")
            holes, unread, lines = text.count("\0"), text.count("\ufffd"), text.replace("\0", "").split("\n")
        self._lines = _joined(lines)
        self._layout = _layout(path, self._lines)
        super().__init__(path, self._layout.names, self._layout.units, self._layout.others)
        self.findings = (self._layout.skipped,) if self._layout.skipped else ()
        if unread:
            self.findings += (f"unreadable characters: {unread}, for bytes of the file are missing",)
        if holes:
            self.findings += (f"{holes} zero bytes left out: a logger that loses power leaves them",)
        self._stop = self._end()
        self._rows = self._find_rows()
        self.interval = _stated_interval(
            [cells_of(line, self._layout.delimiter) for line in self._lines[: self._layout.first]]
        )

    @property
    def rows(self) -> int:
        """How many rows there are."""
        return len(self._rows)

    def place(self, row: int) -> str:
        """The file's own line number."""
        return f"line {self._rows[row] + 1}"

    def _find_rows(self) -> list[int]:
        """The numbers of the lines that are rows, from 0 on: not of comments, nor of a head that stands there again."""
        first, blank = self._layout.first, f" \t{self._layout.delimiter or ''}"
        head = {cells_of(line, self._layout.delimiter)[0] for line in self._lines[:first] if line.strip()}
        head = {word for word in head if kind_of(word) == "word"} if self._begins_with_number() else set()
        found: list[int] = []
        others: list[int] = []
        for number in range(first, self._stop):
            line = self._lines[number]
            if line[:1] not in _DIGITS:
                if not line.strip(blank):
                    continue
                if _is_comment(line) or cells_of(line, self._layout.delimiter)[0] in head:
                    others.append(number)
                    continue
            found.append(number)
        if others:
            words = f"{self._lines[others[0]].strip()[:40]!r} in line {others[0] + 1}"
            self.findings += (f"{len(others)} lines among the numbers left out, such as {words}",)
        return found

    def _begins_with_number(self) -> bool:
        return kind_of(cells_of(self._lines[self._layout.first], self._layout.delimiter)[0]) != "word"

    def _end(self) -> int:
        """Where the rows end: lines without any number, or a row that was cut, are left out behind them."""
        stop = len(self._lines)
        while stop > self._layout.first and not self._lines[stop - 1].strip():
            stop -= 1
        whole, words = stop, ""
        begins_with_number = self._begins_with_number()
        while stop > self._layout.first + 1 and whole - stop < _MOST_TRAILING:
            cells, before = (cells_of(self._lines[stop - own], self._layout.delimiter) for own in (1, 2))
            is_cut = stop == whole and len(cells) < len(before)
            is_named = kind_of(cells[0]) == "word" and begins_with_number  # Min;0;3
            if not (is_cut or is_named) and {kind_of(cell) for cell in cells} & {"number", "date"}:
                break
            words = words or " ".join(self._lines[stop - 1].split())[:40]
            stop -= 1
        if stop < whole:
            lines = f"line {whole}" if stop == whole - 1 else f"lines {stop + 1} to {whole}"
            self.findings += (f"{lines} behind the numbers left out: {words!r}",)
        return stop

    def _numbers(self, place: int) -> Array:
        """The numbers of a column; of dates, s since midnight before the first one."""
        delimiter, whole = self._layout.delimiter, self._lines[self._layout.first : self._stop]
        text = "\n".join(whole if len(whole) == self.rows else [self._lines[number] for number in self._rows])
        if delimiter != ",":
            text = text.replace(",", ".")
        try:
            found = np.loadtxt(
                io.StringIO(text), delimiter=delimiter, usecols=place, comments=None, quotechar='"', ndmin=1,
                dtype=np.float64,
            )  # fmt: skip
        except ValueError:
            found = np.empty(0)
        # A quote that is not closed makes one cell of many lines.
        return found if len(found) == self.rows else super()._numbers(place)

    def _cells(self, place: int, most: int | None = None) -> list[str | None]:
        """The first cells of a column, or all; None where a line ends before it."""
        rows = (cells_of(self._lines[number], self._layout.delimiter) for number in self._rows[:most])
        return [row[place] if place < len(row) else None for row in rows]


def _stated_interval(head: Rows) -> tuple[float, str]:
    """The interval between rows that a head states, s, and what it calls it: beside a name, or below; 0 for none."""
    for row, whole in enumerate(head):
        cells = [part for cell in whole for part in re.split(r"[:=]\s+", cell)]  # "Sample rate: 10 kHz" in one cell
        for place, cell in enumerate(cells):
            for pattern, power in ((_INTERVAL, 1), (_RATE, -1)):
                if not pattern.fullmatch(cell.strip(":=#%/!; ")):
                    continue
                below = head[row + 1][place : place + 1] if row + 1 < len(head) and len(cells) == len(whole) else []
                beside = (*cells[place + 1 : place + 3], "", "")
                for text, after in (beside[:2], *((cell, "") for cell in below)):
                    value, unit = quantity_in(text.strip(":=")) or (number_in(text) or 0.0, after)
                    unit = _plain(unit or _unit_in(cell)).lower()
                    factor = _HERTZ.get(unit) or (UNITS["time"][unit].factor if unit in UNITS["time"] else 1.0)
                    if np.isfinite(value) and value > 0.0:
                        return (factor * value) ** power, cell
    return 0.0, ""


def _plain(unit: str) -> str:
    """A unit with the sign of micro that is not the Greek letter."""
    return unit.replace("\u03bc", "\u00b5")


def cells_of(line: str, delimiter: str | None) -> list[str]:
    """The cells of a line; quotes keep what is in them together."""
    if '"' not in line:
        return [cell.strip() for cell in line.split(delimiter)]
    if delimiter is None:
        line, delimiter = " ".join(line.split()), " "
    try:
        return [cell.strip() for cell in next(csv.reader([line], delimiter=delimiter, skipinitialspace=True), [])]
    except csv.Error:
        return [line]


def _joined(lines: Sequence[str]) -> list[str]:
    """The lines; names in quotes that go over several are on the first, and leave empty lines."""
    found = list(lines)
    for first in range(min(len(found), _LONGEST_PREAMBLE)):
        if not re.search(r'(?:^|[;,\t|])\s*"[^"]*$', found[first]):
            continue
        for last in range(first + 1, min(len(found), first + _JOINED)):
            if found[last].count('"') % 2:
                found[first : last + 1] = [" ".join(found[first : last + 1]), *[""] * (last - first)]
                break
    return found


def _layout(path: Path, lines: Sequence[str]) -> Layout:
    head = _searched(lines)
    parted = {
        delimiter: [[] if _is_comment(line) else _checked(path, cells_of(line, delimiter)) for line in head]
        for delimiter in DELIMITERS
    }
    for with_words in (False, True):
        for delimiter, rows in parted.items():
            start = _first_row(head, rows, with_words=with_words)
            if start is not None:
                return _named(path, head, delimiter, rows, start)
    for delimiter, rows in parted.items():  # few rows, one of which is broken
        for start, row in enumerate(rows):
            if len(row) > 1 and {kind_of(cell) for cell in row} == {"number"}:
                return _named(path, head, delimiter, rows, start)
    if not any(line.strip() for line in lines):
        raise TableError(f"{path}: is empty; export the measurement again")
    raise TableError(
        f"{path}: no table of numbers in its first {len(head)} lines; expected rows of at least two numbers, parted by "
        f"; , tabs, bars or blanks, after at most {_LONGEST_PREAMBLE} lines that are no comments: cut off what is more"
    )


def _searched(lines: Sequence[str]) -> Sequence[str]:
    """The lines in which the first rows of numbers must be: so many, and so many characters, without comments."""
    left, size = _LONGEST_PREAMBLE + _WHOLE_WITH_WORDS, _LARGEST_PREAMBLE
    for number, line in enumerate(lines):
        if not _is_comment(line):
            left, size = left - 1, size - len(line)
        if left < 0 or (size < 0 and number >= _WHOLE_WITH_WORDS):
            return lines[:number]
    return lines


def _is_comment(line: str) -> bool:
    return line.lstrip().startswith(_COMMENTS)


def _checked(path: Path, cells: list[str]) -> list[str]:
    if len(cells) > MOST_COLUMNS:
        raise TableError(
            f"{path}: has {len(cells)} columns, expected at most {MOST_COLUMNS}; export those of the valve"
        )
    return cells


def _first_row(lines: Sequence[str], rows: Rows, *, with_words: bool) -> int | None:
    """Where rows begin whose columns are of the same kinds, at least two of them numbers or dates."""
    filled = [n for n, line in enumerate(lines) if line.strip()]
    kinds = {n: [kind_of(c) for c in rows[n]] for n in filled}
    for at, start in enumerate(filled):
        if len(kinds[start]) < 2:
            continue
        run = [kinds[n] for n in filled[at : at + _WHOLE_WITH_WORDS]]
        run = run if with_words else run[:_WHOLE]
        if len({len(row) for row in run}) > 1 or ("word" in run[0] and not with_words):
            continue
        columns = [{kind for kind in column if kind} for column in zip(*run, strict=True)]
        if all(len(found) < 2 for found in columns) and sum(bool(found & {"number", "date"}) for found in columns) > 1:
            return start
    return None


def _named(path: Path, lines: Sequence[str], delimiter: str | None, rows: Rows, start: int) -> Layout:
    """The layout, with names and units from the lines before the numbers."""
    below = [row for row in rows[start : start + _WHOLE_WITH_WORDS] if len(row) == len(rows[start])]
    data = [row for row in below if any(kind_of(cell) in ("number", "date") for cell in row)]
    start, first = _begin(lines, rows, start, data)
    width = len(data[0])
    head = _head(lines[:first], delimiter, width, numbered=[row[0] for row in data[:3]] == ["1", "2", "3"])
    filled = [place for place in range(width) if any(place < len(row) and row[place] for row in (*data, *head))]
    if filled and filled[-1] < width - 1:
        width -= 1  # each line ends with a separator
    numbers = [place for place in range(width) if any(place < len(row) and row[place] for row in data)]
    are_units = [row for row in head if _are_units(row)]
    naming = [row for row in head if row not in are_units and _named_by(row, numbers) >= _NAMED]
    named = {place for row in naming for place in numbers if row[place]}
    if not any({place for place in numbers if row[place]} <= named for row in are_units):
        are_units = []  # volt, sec: they are the names
    units = max(are_units, key=lambda row: len(set(row)), default=None)
    above = None if units is None else next(iter(head[head.index(units) + 1 :]), None)
    if units is not None and above is not None and not all(above[place] for place in numbers if units[place]):
        above = None
    scores = [
        (_named_by(row, numbers) + 0.5 * (row is above) - 0.01 * place, row)
        for place, row in enumerate(head)
        if row not in are_units and _named_by(row, numbers) >= _NAMED
    ]
    if not scores:
        # Without names nobody knows whether rows that are half of numbers are of the data.
        skipped = _skipped(lines, first, start)
        return Layout(delimiter, start, tuple(str(number + 1) for number in range(width)), {}, {}, skipped)
    chosen = max(scores, key=lambda score: score[0])[1]
    if (
        delimiter == ","
        and 2 * sum(map(bool, chosen)) == width
        and all(cell.lstrip("+-").isdigit() for row in data for cell in row)
    ):
        raise TableError(
            f"{path}: line {start + 1} has {width} whole numbers for {width // 2} names: commas part its cells and "
            "are decimal points, too; export it with semicolons, or with points"
        )
    # Cells of a spreadsheet may span two lines of the head.
    place = head.index(chosen)
    spanned = [
        chosen,
        *(row for row in (*head[max(0, place - 1) : place], *head[place + 1 : place + 2]) if row in naming),
    ]
    names = _unique([next(filter(None, cells), "") for cells in zip(*spanned, strict=True)][:width])
    beside = {name: own[1] for name, cell in zip(names, data[0], strict=False) if (own := quantity_in(cell))}
    found = beside if units is None else {name: _bare(cell) for name, cell in zip(names, units, strict=False)}
    for name in names:
        if unit := _unit_in(name):
            found.setdefault(name, unit)
    words = Counter(cell for _, row in scores for cell in set(row) if cell)
    others = {
        cell: place
        for _, row in scores
        for place, cell in enumerate(row[:width])
        if words[cell] == 1 == row.count(cell) and kind_of(cell) == "word"
    }
    begin = first
    while begin and _is_of_numbers(rows[begin - 1]) and rows[begin - 1][:width] != chosen[:width]:
        begin -= 1
    stated = {name: _plain(unit) for name, unit in found.items() if unit}
    return Layout(delimiter, first, tuple(names), stated, others, _skipped(lines, begin, first))


def _skipped(lines: Sequence[str], begin: int, stop: int) -> str:
    """What is said of lines before the data that may be of it."""
    return f"line {begin + 1} before the numbers left out: {lines[begin][:40]!r}" if begin < stop else ""


def _is_of_numbers(cells: Sequence[str]) -> bool:
    """Whether a line begins with a number, and half of its cells are some."""
    are_numbers = [kind_of(cell) in ("number", "date") for cell in cells]
    return len(cells) > 1 and are_numbers[0] and 2 * sum(are_numbers) >= len(cells)


def _begin(lines: Sequence[str], rows: Rows, start: int, data: Rows) -> tuple[int, int]:
    """Where the data begin: with rows that share their line with the preamble, and with such as are broken, too."""
    kinds = [{kind_of(row[place]) for row in data} - {""} for place in range(len(data[0]))]
    known = [place for place, own in enumerate(kinds) if own and own <= {"number", "date"}]
    following = data[0], data[min(1, len(data) - 1)]
    whole = begin = start
    for number in range(start - 1, -1, -1):
        row = rows[number]
        if len(row) != len(data[0]) or not any(row):
            break
        alike = [place for place in known if kind_of(row[place]) in kinds[place]]
        beside = any(row[place] for place, own in enumerate(kinds) if not own)
        is_whole = (len(alike) == len(known) and not beside) or _goes_on(row, following, known)
        is_named = all(row[place].isdigit() for place in alike)  # Columns may be called 1, 2, 3.
        if not (is_whole or (2 * len(alike) >= len(known) and not beside and not is_named)):
            break
        following, begin = (row, following[0]), number
        whole = number if is_whole and whole == number + 1 else whole
    return whole, begin


def _goes_on(row: Sequence[str], following: tuple[Sequence[str], Sequence[str]], places: Sequence[int]) -> bool:
    """Whether a column goes on from a row in the equal steps of those that follow."""
    for place in places:
        values = [number_in(cells[place]) for cells in (row, *following)]
        if None not in values:
            first, second, third = (float(value) for value in values if value is not None)
            step = third - second
            if step and abs(second - first - step) < _GOES_ON * abs(step):
                return True
    return False


def _head(lines: Sequence[str], delimiter: str | None, width: int, *, numbered: bool) -> list[list[str]]:
    """The cells of the lines before the data that may name them, the nearest first.

    A line may name one column more than the rows have cells, as LabVIEW its comments, or one less where rows are
    `numbered`, as R does.
    """
    found: list[list[str]] = []
    for line in reversed(lines[-_HEADS:]):
        text = line.rstrip("\r\n ")
        for mark in _COMMENTS:
            if not text.startswith(f"{mark}{delimiter}"):  # #,CH1,CH2: the name of a column
                text = text.removeprefix(mark)
        cells = cells_of(text if delimiter == "\t" else text.strip(), delimiter)
        while len(cells) > width and not cells[-1]:
            cells.pop()
        if len(cells) == width + 1 and kind_of(cells[-1]) == "word":
            cells.pop()
        if numbered and len(cells) == width - 1 and not _NUMBERS.fullmatch(cells[0]):
            cells.insert(0, "")
        if 2 <= len(cells) <= width and any(cells):
            found.append((cells + [""] * width)[:width])
    return found


def _named_by(row: Sequence[str], places: Sequence[int]) -> float:
    """Which share of the columns a line names, by different words, or by small numbers."""
    cells = {row[place] for place in places}
    words = sum(kind_of(cell) == "word" for cell in cells)
    counted = sum(cell.isdigit() and len(cell) < 4 for cell in cells)
    return (words + 0.6 * counted) / max(1, len(places))


def _are_units(cells: Sequence[str]) -> bool:
    """Whether all words of a line are units, or at least two and the half of them."""
    words = [_bare(cell) for cell in cells if kind_of(cell) == "word"]
    known = sum(word in _UNIT_WORDS or word.lower() in _UNIT_WORDS for word in words)
    return known > 0 and (known == len(words) or (known > 1 and 2 * known >= len(words)))


def _bare(cell: str) -> str:
    return "" if kind_of(cell) != "word" else cell.strip().strip("[]()").strip()


def _unit_in(name: str) -> str:
    """The unit that a name ends with: in brackets, or behind a mark; empty where there is none."""
    if inside := re.search(r"[\[(]([^\])]+)[\])]\s*$", name):
        return inside[1].strip()
    behind = re.search(r"(?: in |\s?/\s?|,\s?|_)([^\s/,_]+)$", name)
    unit = _plain(behind[1]) if behind else ""
    return unit if unit in _UNIT_WORDS and unit not in _LIKE_WORDS else ""


def _unique(names: Sequence[str]) -> list[str]:
    """Names, with a number added to those that are empty or occur twice; a number alone would count columns."""
    result: list[str] = []
    for number, given in enumerate(names, start=1):
        name = f"channel {given}" if given.isdigit() else given
        result.append(name if name and name not in result else f"{name or 'column'}_{number}")
    return result
