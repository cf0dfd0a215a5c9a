"""What the cell of a table says: a number, a date, that there is none, or a word."""

from __future__ import annotations

import re
from datetime import date, datetime
from typing import Final, NamedTuple

import numpy as np

DAY: Final = 86_400.0
HOUR: Final = 3_600.0
"""s."""
SWITCHED: Final = {
    **dict.fromkeys(("true", "on", "wahr", "ein"), 1.0),
    **dict.fromkeys(("false", "off", "falsch", "aus"), 0.0),
}
_MISSING: Final = frozenset(("", "n/a", "na", "null", "none", "invalid", "bad", "no data", "missing"))
_SHEET_ERROR: Final = re.compile(r"#(n/a|nv|num!|div/0!|value!|wert!|ref!|name\?)")
_NO_NUMBER: Final = re.compile(r"-+|[+-]?(nan|1\.#(qnan|snan|ind)0*)(\(\w*\))?")
_BEYOND: Final = re.compile(r"[+-]?(∞|1\.#inf0*|over([ -]?(load|range|flow))?|ovl|ovf|ol|\*{2,})")
_FORTRAN: Final = re.compile(r"([+-]?[\d.]+)d([+-]?\d+)", re.IGNORECASE)
_GROUPED: Final = re.compile(
    r"[+-]?\d{1,3}((,\d{3})+\.\d+|(\.\d{3})+,\d+|(,\d{3}){2,}|(\.\d{3}){2,}|(['\u2019\u00a0\u202f ]\d{3})+([.,]\d+)?)"
)
"""Thousands that are parted, where no decimal point can be meant."""
_QUANTITY: Final = re.compile(
    r"([+-]?\d[\d.,]*(?:e[+-]?\d+)?)\s*([nµuμm]?(?:s|sec|seconds?|V|A)|[nµuμmc]?m|[kM]?Hz|M?Pa|m?bar|°C|degC|m?N)",
    re.IGNORECASE,
)
"""A number with its unit, as MATLAB writes durations ("0.001 sec") and hand-held instruments their readings."""
_DATE: Final = re.compile(r"(\d{4})([-/.]?)(\d\d?)\2(\d\d?)|(\d\d?)\.(\d\d?)\.(\d{4}|\d\d)")
_TIME: Final = re.compile(
    r"(\d\d?)(:?)(\d\d)(?:\2(\d\d(?:[.,]\d+|[:;]\d{3,9})?))?\s*(?:Z|UTC|GMT|([+-]\d\d):?(\d\d)|([ap])m)?", re.IGNORECASE
)
"""Hours, minutes, seconds, of which controllers part milliseconds by a colon or a semicolon, the zone's distance from
UTC, and a half of the day."""
_DAYS: Final = re.compile(r"(\d+)(?: days?,? |:(?=\d\d:\d\d:\d\d))")
"""Before a time of day: of a duration, as pandas and Python write it, or the day of the year, as IRIG has it."""
_MINUTES: Final = re.compile(r"(\d+):(\d\d[.,]\d+)")
"""As a spreadsheet writes the time of day where its hours are not shown."""
_BETWEEN: Final = re.compile(r"(?<=\d)(?:[T ]\s*|,\s+)(?=\d)")
"""A day and a time of day."""
_BEYOND_MICROSECONDS: Final = re.compile(r"(?<=[.,:]\d{6})\d+")
_LIKE_A_TIME: Final = re.compile(r"\d:\d\d")
_NO_YEAR: Final = 1900
"""What Python says of a format without one."""


class Stamp(NamedTuple):
    """A day by its number, 0 for none; seconds since midnight; and the period, s, of a clock that starts again at 0.

    Where a zone is given, they are of UTC. Days of a duration or of a year are counted from 0.
    """

    day: int
    seconds: float
    period: float = DAY


def number_in(cell: str) -> float | None:
    """The number that a cell holds, NaN where it says that there is none; None where it holds something else."""
    text = cell.strip().replace("\u2212", "-")  # a typographic minus
    try:
        if "_" not in text:  # which Python takes for a digit's neighbour
            return float(text.replace(",", ".", 1))
    except ValueError:
        pass
    word = text.lower()
    if word in _MISSING or _NO_NUMBER.fullmatch(word) or _SHEET_ERROR.fullmatch(word):
        return np.nan
    if _BEYOND.fullmatch(word):
        return -np.inf if word.startswith("-") else np.inf
    if fortran := _FORTRAN.fullmatch(word):
        return number_in(f"{fortran[1]}e{fortran[2]}")
    if _GROUPED.fullmatch(word):
        whole, point, part = word, "", ""
        if (last := re.search(r"([.,])(\d+)$", word)) and word.count(last[1]) == 1:
            whole, point, part = word[: last.start()], ".", last[2]
        return float(re.sub(r"[^\d+-]", "", whole) + point + part)
    return SWITCHED.get(word)


def quantity_in(cell: str) -> tuple[float, str] | None:
    """The number and the unit that a cell holds; None where it holds something else."""
    found = _QUANTITY.fullmatch(cell.strip())
    value = None if found is None else number_in(found[1])
    return None if found is None or value is None else (value, "s" if found[2].lower().startswith("sec") else found[2])


def stamp_in(cell: str, form: str = "") -> Stamp | None:
    """The date and the time of day in a cell, or one of them; None where it holds neither.

    Args:
        form: as `datetime.strptime` has it; empty: ISO 8601, German, or a time of day.
    """
    if form:
        return _stamp_by(cell, form)
    if counted := _DAYS.match(cell):
        rest = stamp_in(cell[counted.end() :])
        return rest and Stamp(int(counted[1]), rest.seconds)
    parts = _BETWEEN.split(cell, maxsplit=1)
    dated, timed = _DATE.fullmatch(parts[0]), _TIME.fullmatch(parts[-1])
    if len(parts) == 1 and (minutes := _MINUTES.fullmatch(cell)):
        return Stamp(0, 60.0 * int(minutes[1]) + _seconds(minutes[2]), HOUR)
    if timed is not None and len(parts) == 1 and not timed[2]:
        timed = None  # a plain number
    if (len(parts) == 2 and (dated is None or timed is None)) or (dated is None and timed is None):
        return None
    day, seconds = 0, 0.0
    if dated is not None:
        year, _, month, own, *german = dated.groups()
        if not year:
            own, month, year = german
        try:
            day = date(int(year) + (2000 if len(year) == 2 else 0), int(month), int(own)).toordinal()
        except ValueError:
            return None
    if timed is not None and (len(parts) == 2 or dated is None):
        hours = int(timed[1]) if timed[7] is None else int(timed[1]) % 12 + 12 * (timed[7] in "pP")
        seconds = HOUR * hours + 60.0 * int(timed[3]) + _seconds(timed[4] or "0")
        if timed[5]:
            seconds -= HOUR * int(timed[5]) + 60.0 * int(timed[5][0] + timed[6])
    return Stamp(day, seconds)


def _stamp_by(cell: str, form: str) -> Stamp | None:
    try:
        found = datetime.strptime(_BEYOND_MICROSECONDS.sub("", cell), form)
    except ValueError:
        return None
    day = found.toordinal() if found.year > _NO_YEAR else 0
    return Stamp(day, HOUR * found.hour + 60.0 * found.minute + found.second + 1e-6 * found.microsecond)


def _seconds(text: str) -> float:
    return float(re.sub("[,:;]", ".", text))


def kind_of(cell: str) -> str:
    """number, date (of any form), word; empty where a cell is, or says that there is no number."""
    value = number_in(cell)
    if value is None:
        if quantity_in(cell):
            return "number"
        return "date" if stamp_in(cell) or _LIKE_A_TIME.search(cell) else "word"
    return "" if np.isnan(value) else "number"
