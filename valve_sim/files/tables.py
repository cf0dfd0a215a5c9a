"""Small tables that people write by hand or export from a spreadsheet: CSV in, columns of numbers out."""

from __future__ import annotations

import math
from collections.abc import Mapping, Sequence
from pathlib import Path
from typing import Final

import numpy as np
from numpy.typing import NDArray

from valve_sim.files.bounded import table_text
from valve_sim.model.errors import ValveError

Array = NDArray[np.float64]

_DELIMITERS: Final = (";", "\t", ",")


class TableError(ValveError):
    """A table cannot be used: one line that names the file and the line, what was found and what is expected."""


def read_table(path: Path | str, columns: Mapping[str, Sequence[str]], otherwise: str = "") -> dict[str, Array]:
    """Columns of numbers from a CSV file.

    Cells are separated by commas, semicolons, tabs or blanks; beside semicolons or tabs, a comma is a decimal point. A
    first line of names selects the columns and may name others; without it, columns are in the order of `columns`.
    Empty lines and lines that begin with # are ignored.

    Args:
        path: the file.
        columns: the columns to read, each with the names that a header may give it.
        otherwise: what else would do where the header has none of these names, for the message.

    Returns:
        by the same keys, (n,) each.

    Raises:
        TableError: the file cannot be read, a column is missing, or a cell is not a finite number.
    """
    lines = _content(path, columns)
    delimiter = next((mark for mark in _DELIMITERS if mark in lines[0][1]), None)
    rows = [(number, _cells(line, delimiter)) for number, line in lines]
    places = dict(zip(columns, range(len(columns)), strict=True))
    if any(number_in(cell) is None for cell in rows[0][1]):
        places = _places(path, rows.pop(0)[1], columns, otherwise)
    values = [[_cell(path, number, cells, name, place) for name, place in places.items()] for number, cells in rows]
    if not values:
        raise TableError(f"{path}: has no row of numbers; expected columns {', '.join(columns)}")
    return dict(zip(columns, np.array(values).T.copy(), strict=True))


def _content(path: Path | str, columns: Mapping[str, Sequence[str]]) -> list[tuple[int, str]]:
    try:
        text = table_text(Path(path), TableError)
    except OSError as error:
        raise TableError(f"{path}: cannot be read ({error.strerror}); expected a CSV file") from error
    lines = [(number, line.strip()) for number, line in enumerate(text.splitlines(), start=1)]
    lines = [(number, line) for number, line in lines if line and not line.startswith("#")]
    if not lines:
        raise TableError(f"{path}: is empty; expected columns {', '.join(columns)}")
    return lines


def _cells(line: str, delimiter: str | None) -> list[str]:
    cells = [cell.strip().strip('"') for cell in line.split(delimiter)]
    return cells if delimiter in (",", None) else [cell.replace(",", ".") for cell in cells]


def _places(
    path: Path | str, header: Sequence[str], columns: Mapping[str, Sequence[str]], otherwise: str
) -> dict[str, int]:
    found = [name.lower() for name in header]
    places = {}
    for column, names in columns.items():
        matches = [found.index(name) for name in names if name in found]
        if not matches:
            expected = ", ".join(filter(None, (" or ".join(names), otherwise)))
            raise TableError(f"{path}: has the columns {', '.join(header)}; expected one named {expected}")
        places[column] = matches[0]
    return places


def _cell(path: Path | str, line: int, cells: Sequence[str], name: str, place: int) -> float:
    if place >= len(cells):
        raise TableError(f"{path}: line {line}: has {len(cells)} cells, expected {name} in cell {place + 1}")
    value = number_in(cells[place])
    if value is None or not math.isfinite(value):
        raise TableError(f"{path}: line {line}: {name}: found {cells[place]!r}, expected a finite number")
    return value


def number_in(cell: str) -> float | None:
    """The number that a cell holds; None where it holds none."""
    try:
        return float(cell)
    except ValueError:
        return None
