"""A table of any kind as columns of numbers by name, and the times of its rows."""

from __future__ import annotations

import re
from collections.abc import Mapping, Sequence
from pathlib import Path
from typing import Final, NamedTuple

import numpy as np
from numpy.typing import NDArray

from valve_sim.files.cells import DAY, Stamp, kind_of, number_in, quantity_in, stamp_in
from valve_sim.files.channels import UNITS
from valve_sim.files.recording_map import TimeAxis
from valve_sim.model.errors import ValveError

Array = NDArray[np.float64]

MOST_REPEATED: Final = 20
"""Rows, of which one may have the time of the row before: logged twice, that is. More do not know their time."""
_WHOLE: Final = re.compile(r"[+-]?\d+")
_THOUSANDS: Final = re.compile(r"[+-]?[1-9]\d{0,2}((,\d{3})+|(\.\d{3})+)")
"""A number without a mark, and one whose mark may part thousands."""
_LARGEST, _INFINITE, _NO_NUMBER = 9.8e37, 9.9e37, 9.91e37
"""What instruments write for no reading (SCPI-1999, 7.2.1): ±9.9E+37 is beyond the range, 9.91E+37 no number. Readings
are smaller than the first."""
_EXACT: Final = 2.0**53
"""Beyond it not every whole number is one of floating point."""
_EPOCH_DAY: Final = 719_163
_EXCEL_EPOCH: Final = 25_569
"""The number of 1970-01-01, in Python and in a spreadsheet."""
EXCEL_DAYS: Final = (2e4, 8e4)
"""Days since 1899, of 1954 to 2119: a spreadsheet's dates as numbers."""
PARTS: Final = {
    "ns": re.compile(r"(.*[^a-z])?(ns|nsecs?|nano.*)", re.IGNORECASE),
    "us": re.compile(r"(.*[^a-z])?([uµ]s|usecs?|micro.*)", re.IGNORECASE),
    "ms": re.compile(r"(.*[^a-z])?(ms|msecs?|milli.*)", re.IGNORECASE),
}
"""How columns with parts of seconds are called."""


class TableError(ValveError):
    """A table cannot be used: one line that names the file and the line, what was found and what is expected."""


class RowTimes(NamedTuple):
    """When the rows of a table were taken.

    Attributes:
        times: (n,) s since `origin`. kept: (n,) which rows to keep: one with the time of the row before goes.
        origin: s since 1970 where the file says the date, or a multiple of a second. repeated: how many rows go.
    """

    times: Array
    kept: NDArray[np.bool_]
    origin: float = 0.0
    repeated: int = 0


class DataTable:
    """Columns of numbers by name; a column is read when it is asked for.

    Attributes:
        path: the file, for messages. names: of the columns, in the file's order.
        units: column to unit, where the file says one. others: what else its head calls a column, and its place.
        findings: what of the file was left out, a line each. interval: s from row to row, as the head says it, and
            where; 0 where it does not.
    """

    def __init__(
        self, path: Path, names: Sequence[str], units: Mapping[str, str], others: Mapping[str, int] | None = None
    ) -> None:
        self.path, self.names, self.units = path, tuple(names), dict(units)
        self.others = {name: place for name, place in (others or {}).items() if name not in self.names}
        self.findings: tuple[str, ...] = ()
        self.interval: tuple[float, str] = (0.0, "")

    def has(self, name: str) -> bool:
        """Whether there is a column of this name or number, from 1 on."""
        is_counted = name.isdigit() and 1 <= int(name) <= len(self.names)
        return name in self.names or name in self.others or is_counted

    def column(self, name: str) -> Array:
        """The numbers of a column, (n,), NaN where a cell is empty; `name` may be its number, from 1 on.

        Raises:
            TableError: there is no such column, or one of its cells is not a number.
        """
        place = self._place(name)
        values = self._numbers(place)
        self._refuse_thousands(place, values)
        return _decoded(values)

    def _refuse_thousands(self, place: int, values: Array) -> None:
        """Refuse a column that may be of thousands: 998, 999, "1,000", "1,001", where all that have a mark could be."""
        sizes = np.abs(values[np.isfinite(values)])
        is_whole = sizes == np.round(sizes)
        is_plain = is_whole & (sizes >= 100.0) & (sizes < 1000.0)
        if is_whole.all() or not is_plain.any() or sizes[~is_whole].min() < 1.0:
            return
        written = [cell for cell in self._cells(place) if cell]
        cells = [cell for cell in written if not _WHOLE.fullmatch(cell)]
        # 150.000 among 149.985 and 150.015 has its mark: each is written with three decimals.
        has_plain = any(100.0 <= abs(float(cell)) < 1000.0 for cell in written if _WHOLE.fullmatch(cell))
        if (
            cells
            and has_plain
            and all(_THOUSANDS.fullmatch(cell) or np.isnan(number_in(cell) or 0.0) for cell in cells)
        ):
            raise TableError(
                f"{self.path}: column {self.names[place]}: {cells[0]} beside numbers without a mark may be a number or "
                "thousands; export it without marks for thousands"
            )

    def holds_dates(self, name: str) -> bool:
        """Whether a column begins with a date or a time of day."""
        return self._are_stamps([self._place(name)], TimeAxis())

    def texts(self, name: str) -> list[str]:
        """The cells of a column as they are written, empty where there is none."""
        return [cell or "" for cell in self._cells(self._place(name))]

    def _place(self, name: str) -> int:
        if not self.has(name):
            raise TableError(f"{self.path}: has no column {name}; it has {', '.join(self.names)}; name one of these")
        if name in self.names:
            return self.names.index(name)
        if name in self.others:
            return self.others[name]
        counted, named = self.names[int(name) - 1], f"channel {name}"
        if named in self.names and named != counted:
            raise TableError(
                f"{self.path}: column {name} is ambiguous, for the file calls column {self.names.index(named) + 1} so; "
                f"write column: {named}, or column: {counted}"
            )
        return int(name) - 1

    @property
    def rows(self) -> int:
        """How many rows there are."""
        raise NotImplementedError

    def place(self, row: int) -> str:
        """Where a row (from 0 on) is in the file, for messages."""
        return f"row {row + 1}"

    def row_times(self, axis: TimeAxis, *, may_end: bool = False) -> RowTimes:
        """When each row was taken.

        Args:
            axis: which columns say it. may_end: whether they may end before others do; rows after that are not kept.

        Raises:
            TableError: a cell holds no time, time runs backwards, or many rows share one time.
        """
        if axis.rate:
            return RowTimes(np.arange(self.rows) / axis.rate, np.ones(self.rows, dtype=bool))
        where = f"column{'s' if len(axis.columns) > 1 else ''} {' and '.join(axis.columns)}"
        places = [self._place(name) for name in axis.columns]
        times, origin = self._seconds(places, axis) if self._are_stamps(places, axis) else self._sum(places, axis)
        finite = np.isfinite(times)
        count = len(times) - int(np.argmax(finite[::-1])) if may_end and finite.any() else len(times)
        if not finite[:count].all():
            raise TableError(
                f"{self.path}: {self.place(int(np.argmin(finite)))}: {where} holds no time; take the row out"
            )
        steps = np.diff(times)
        if (steps < 0).any():
            row = int(np.argmax(steps < 0)) + 1
            raise TableError(
                f"{self.path}: {self.place(row)}: time {where} runs backwards, {times[row]:.9g} s after "
                f"{times[row - 1]:.9g} s; sort the rows, cut the file where the logger started again, or name "
                "another column"
            )
        kept = np.concatenate([[True], steps > 0])
        repeated = int((~kept[:count]).sum())
        if repeated > len(times) // MOST_REPEATED:
            raise TableError(
                f"{self.path}: {where}: {repeated} of {len(times)} rows have the time of the row before; "
                "write the time with more digits, name the column of its fractions too, as in "
                "time: {column: [sec, nanosec]}, or give time: {rate: ...} (rows a second)"
            )
        return RowTimes(times, kept, origin, repeated)

    def _sum(self, places: Sequence[int], axis: TimeAxis) -> tuple[Array, float]:
        """Times of columns of numbers; the first of two goes into the origin, or its whole digits would cost others."""
        units = [self._unit(axis, number, self.names[place]) for number, place in enumerate(places)]
        parts = [self._numbers(place) for place in places]
        if len(parts) == 1:
            if len(parts[0]) and parts[0].max() > _EXACT and (exact := self._whole_times(places[0], units[0])):
                return exact
            is_calendar = units[0] == DAY and len(parts[0]) and EXCEL_DAYS[0] < parts[0][0] < EXCEL_DAYS[1]
            return units[0] * parts[0], -DAY * _EXCEL_EPOCH if is_calendar else 0.0
        origin = float(parts[0][0])
        return units[0] * (parts[0] - origin) + units[1] * parts[1], units[0] * origin

    def _whole_times(self, place: int, unit: float) -> tuple[Array, float] | None:
        """Times of a column of whole numbers that floating point rounds; None where they are none."""
        cells = [cell or "" for cell in self._cells(place)]
        if not all(map(_WHOLE.fullmatch, cells)):
            return None
        counts = [int(cell) for cell in cells]
        origin, rest = divmod(counts[0], round(1.0 / unit))
        return unit * np.array([count - counts[0] + rest for count in counts], dtype=np.float64), float(origin)

    def _unit(self, axis: TimeAxis, number: int, name: str) -> float:
        """The unit of a time column, s: as the map says, else s, and of a second one as its name says."""
        if number < len(axis.units):
            return axis.units[number]
        if number == 0:
            return 1.0
        for unit, words in PARTS.items():
            if words.fullmatch(name):
                return UNITS["time"][unit].factor
        raise TableError(
            f"{self.path}: column {name}: its name does not say which part of a second it counts; add to the map "
            "time: {column: [..., ...], unit: [s, ns]}"
        )

    def _numbers(self, place: int) -> Array:
        """The numbers of a column; of dates, s since midnight before the first one."""
        cells = self._cells(place)
        values = [None if cell is None else number_in(cell) for cell in cells]
        if None not in values:
            return np.array(values, dtype=np.float64)
        quantities = [
            (value, "") if value is not None else quantity_in(cell or "")
            for cell, value in zip(cells, values, strict=True)
        ]
        units = {own[1] for own in quantities if own and np.isfinite(own[0])}
        if None not in quantities and len(units) == 1:
            return np.array([own[0] for own in quantities if own], dtype=np.float64)
        stamps = [stamp_in(cell) if cell else None for cell in cells]
        if None not in stamps:
            return _since_the_first_day([stamp for stamp in stamps if stamp])[0]
        raise self._is_none(place, (stamps if stamps[0] else values).index(None), "number")

    def _are_stamps(self, places: Sequence[int], axis: TimeAxis) -> bool:
        """Whether columns hold dates or times of day."""
        cells = [cell for place in places for cell in self._cells(place, 1) if cell]
        return bool(axis.form) or any(kind_of(cell) == "date" for cell in cells)

    def _seconds(self, places: Sequence[int], axis: TimeAxis) -> tuple[Array, float]:
        """Times of such columns: (n,) s, and since when; the second may hold parts of a second."""
        part = self.names[places[1]] if len(places) > 1 else ""
        if not axis.form and any(own.fullmatch(part) for own in PARTS.values()):
            times, origin = self._seconds(places[:1], axis)
            return times + self._unit(axis, 1, part) * self._numbers(places[1]), origin
        stamps = []
        for row, cells in enumerate(zip(*(self._cells(place) for place in places), strict=True)):
            stamp = None if None in cells else stamp_in(" ".join(cell for cell in cells if cell), axis.form)
            if stamp is None:
                form = f"time as {axis.form}" if axis.form else "date or a time of day, or its form in time: format:"
                raise self._is_none(places[0], row, form)
            stamps.append(stamp)
        return _since_the_first_day(stamps)

    def _is_none(self, place: int, row: int, expected: str) -> TableError:
        cell = self._cells(place)[row]
        found = "nothing" if cell is None else repr(cell[:40])
        return TableError(
            f"{self.path}: {self.place(row)}: column {self.names[place]}: found {found}, expected a {expected}; "
            "correct the line or take it out"
        )

    def _cells(self, place: int, most: int | None = None) -> list[str | None]:
        """The first cells of a column, or all, as text; None where there is none."""
        raise NotImplementedError


def _decoded(values: Array) -> Array:
    """Numbers, (n,), with ∞ and NaN for what instruments write in their place by SCPI (1999, 7.2.1.4 and 5)."""
    sizes = np.abs(values)
    if not (sizes > _LARGEST).any():
        return values
    is_infinite, is_none = (np.isclose(sizes, code, rtol=1e-6) for code in (_INFINITE, _NO_NUMBER))
    return np.where(is_infinite, np.copysign(np.inf, values), np.where(is_none, np.nan, values))


def _since_the_first_day(stamps: Sequence[Stamp]) -> tuple[Array, float]:
    """(n,) s since midnight before the first stamp, and when that was, s since 1970; 0 where nothing says the day.

    Without days, each time that they start again a period is over.
    """
    if not stamps:
        return np.empty(0), 0.0
    first = stamps[0].day
    seconds = np.array([DAY * (stamp.day - first) + stamp.seconds for stamp in stamps])
    if not first:
        period = stamps[0].period
        seconds[1:] += period * np.cumsum(np.diff(seconds) < -0.5 * period)
    return seconds, DAY * max(0, first - _EPOCH_DAY)
