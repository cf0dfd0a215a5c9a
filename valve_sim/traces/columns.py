"""Any recording as columns in SI, by a map: the one reader for machines of a user's own.

    time: {column: t, unit: ms}
    use: "20 < time < 30"                                      # which rows count
    force: {column: vir, unit: N, scale: 35.15}
    position: {column: qm, unit: mm, at_rest: exclude}         # not while it stands
    velocity: {column: qm, unit: mm, derivative: 1, low_pass: 100}

A reading becomes unit × (sign × scale × reading + offset). Names are the machine's: its inputs and outputs.
"""

from __future__ import annotations

import math
import re
from collections.abc import Mapping, Sequence
from dataclasses import dataclass, field
from os import PathLike
from pathlib import Path
from typing import Any, Final

import numpy as np
from numpy.typing import NDArray
from scipy import ndimage, signal
from scipy.interpolate import interp1d

from valve_sim.files.data_tables import TABLE_SUFFIXES, open_table
from valve_sim.files.plant_files import one_line
from valve_sim.files.recording_map import MapError
from valve_sim.files.yaml_files import read_yaml
from valve_sim.model.core.own.grammar import Expr, ExpressionError, names_in, parse
from valve_sim.model.core.own.units import Unit, UnitError, parse_unit
from valve_sim.traces.errors import TraceError

Array = NDArray[np.float64]
Mask = NDArray[np.bool_]

KEYS: Final = (
    "column", "unit", "scale", "sign", "offset", "use", "at_rest", "derivative", "low_pass", "every", "between",
    "tolerance",
)  # fmt: skip
TIME_KEYS: Final = ("column", "unit", "rate")
FILTER_ORDER: Final = 4
"""Of the Butterworth low-pass, which is passed forwards and backwards, so that nothing is delayed."""
REST: Final = 0.1
"""s over which a signal must stand still, or eleven samples where that is longer."""
UNEVEN: Final = 1e-3
"""Of a step: steps that differ by more are brought to a steady rate before they are filtered."""
LONGEST_STEP: Final = 20.0
"""Usual steps that a filter bridges."""
STILL: Final = 6.0
"""Standard deviations of the noise between neighbours, within which a signal stands."""
_COMPARED: Final = re.compile(r"(<=|>=|<|>)")


@dataclass(frozen=True)
class Column:
    """One quantity as it was recorded.

    Attributes:
        name: of the machine's input or output. source: the column or topic, for messages.
        times, readings: (n,) s, and numbers in `unit`; None: in the unit that the machine declares.
        used: (n,) True where a sample counts. low_pass: Hz, infinite: none. every: of how many samples one is compared.
        held: whether it holds between its samples; None: as the machine declares.
        gain, offset: standard deviations of errors of each recording: a factor 1 ± gain, and ± offset in `unit`.
    """

    name: str
    source: str
    times: Array
    readings: Array
    unit: Unit | None
    used: Mask
    low_pass: float = math.inf
    every: int = 1
    held: bool | None = None
    gain: float = 0.0
    offset: float = 0.0

    def si(self, declared: Unit) -> Array:
        """(n,) in SI; what is not used is NaN nowhere, but marked in `used`."""
        return self.readings * (declared if self.unit is None else self.unit).factor

    def filtered(self, values: Array, axis: int = 0) -> Array:
        """Values at the column's samples, low-passed as it is and thinned."""
        return _thinned(_low_passed(values, self.times, self.low_pass, axis), self.every)

    @property
    def compared(self) -> slice:
        """The samples that are compared."""
        return slice(None, None, self.every)


@dataclass(frozen=True)
class Columns:
    """A recording.

    Attributes:
        source: the file. columns: by name. findings: what was dropped or repaired, a line each.
    """

    source: str
    columns: Mapping[str, Column]
    findings: tuple[str, ...] = field(default=())

    def __getitem__(self, name: str) -> Column:
        return self.columns[name]

    def __repr__(self) -> str:
        """Columns(emps.csv: force, position; 24841 rows, 0 to 24.84 s)."""
        own = next(iter(self.columns.values()))
        span = f"{own.times[0]:.6g} to {own.times[-1]:.6g} s"
        return f"Columns({self.source}: {', '.join(self.columns)}; {len(own.times)} rows, {span})"


def read(path: str | PathLike[str], recording_map: str | PathLike[str] | Mapping[str, Any] | None = None) -> Columns:
    """Read any recording of any machine.

    Args:
        path: a table (CSV, Parquet, MATLAB). recording_map: a file, or its content; None: every column of the table by
            its own name, with the column `time` or the first one as time in s.

    Returns:
        columns by the names in the map, with times in s.

    Raises:
        ValveError: recording or map cannot be used; one line with file, key and mend.
    """
    path = Path(path)
    where, found = _map_of(recording_map)
    if path.suffix.lower() not in TABLE_SUFFIXES:
        raise TraceError(f"{path}: is no table; expected one of {', '.join(TABLE_SUFFIXES)}")
    table = open_table(path)
    if found is None:
        time = "time" if "time" in table.names else table.names[0]
        found = {"time": {"column": time}, **{name: {"column": name} for name in table.names if name != time}}
    return _Reading(path, table, where, found).columns()


def _map_of(given: str | PathLike[str] | Mapping[str, Any] | None) -> tuple[str, Mapping[Any, Any] | None]:
    if given is None or isinstance(given, Mapping):
        return "map", given
    found = read_yaml(Path(given), "expected a map of a recording: time: {column: t}, force: {column: F}", MapError)
    if not isinstance(found, Mapping) or not found:
        raise MapError(f"{given}: found {_short(found)}, expected keys such as time: {{column: t}}")
    return str(given), found


class _Reading:
    """One reading of one table."""

    def __init__(self, path: Path, table: Any, where: str, found: Mapping[Any, Any]) -> None:
        self._path, self._table, self._where, self._found = path, table, where, found
        self._findings: list[str] = []

    def columns(self) -> Columns:
        entries = {name: own for name, own in self._found.items() if name not in ("time", "use")}
        for name in entries:
            if not isinstance(name, str):
                raise self._fail(
                    str(name), "expected the name of an input or output (YAML reads on, off, yes, no as true or false)"
                )
        if not entries:
            raise self._fail("", "names no input and no output; add force: {column: F, unit: N}")
        kept, times = self._times()
        read = {name: self._column(name, own, times, kept) for name, own in entries.items()}
        values = {name: column.si(column.unit or parse_unit("")) for name, column in read.items()}
        common = self._mask("use", self._found["use"], times[kept], values) if "use" in self._found else None
        whole = {}
        for name, column in read.items():
            entry = entries[name] if isinstance(entries[name], Mapping) else {}
            used = column.used if common is None else column.used & common
            if "use" in entry:
                used = used & self._mask(f"{name}.use", entry["use"], times[kept], values)
            if self._choice(f"{name}.at_rest", entry.get("at_rest", "use"), ("use", "exclude")) == "exclude":
                used = used & ~at_rest(column.times, column.readings)
            if not used.any():
                raise self._fail(name, "no sample is left; widen use: or take at_rest: exclude out")
            whole[name] = _with(column, used)
        return Columns(str(self._path), whole, tuple(self._findings))

    def _fail(self, key: str, words: str) -> MapError:
        return MapError(one_line(f"{self._where}: {key}: {words}" if key else f"{self._where}: {words}"))

    def _check_keys(self, key: str, entry: Mapping[Any, Any], known: Sequence[str]) -> None:
        for own in entry:
            if own not in known:
                raise self._fail(f"{key}.{own}", f"unknown key; expected one of {', '.join(known)}")

    def _named(self, key: str, name: object) -> str:
        text = str(name) if isinstance(name, int) and not isinstance(name, bool) else name
        if not isinstance(text, str):
            raise self._fail(key, f"found {_short(name)}, expected the name of a column")
        names = self._table.names
        if text not in names and not (text.isdigit() and 1 <= int(text) <= len(names)):
            raise self._fail(
                key, f"column {text} is not in {self._path}; it has {', '.join(names[:20])}; name one of these"
            )
        return text

    def _times(self) -> tuple[Mask, Array]:
        found = self._found.get("time")
        if found is None:
            raise self._fail("time", "is missing; add time: {column: t, unit: s} or time: {rate: 1000}")
        if isinstance(found, str | int) and not isinstance(found, bool):
            found = {"column": found}
        if not isinstance(found, Mapping):
            raise self._fail("time", f"found {_short(found)}, expected {{column: t, unit: s}} or {{rate: 1000}}")
        self._check_keys("time", found, TIME_KEYS)
        if ("rate" in found) == ("column" in found):
            raise self._fail("time", f"found {_short(dict(found))}, expected either column: or rate:")
        if "rate" in found:
            rate = self._number("time.rate", found["rate"])
            if rate <= 0.0:
                raise self._fail("time.rate", f"found {rate:g}, expected rows a second above 0")
            count = len(self._table.column(self._table.names[0]))
            return np.ones(count, dtype=bool), np.arange(count) / rate
        unit = self._unit("time", found) or parse_unit("s")
        if unit.dimension != parse_unit("s").dimension:
            raise self._fail("time.unit", f"found {found['unit']!r}, expected one of time: s, ms, us, min")
        times = unit.factor * self._table.column(self._named("time.column", found["column"]))
        if not np.isfinite(times).all():
            raise TraceError(
                f"{self._path}: {self._table.place(int(np.argmin(np.isfinite(times))))}: holds no time; "
                "take the row out"
            )
        if (np.diff(times) < 0.0).any():
            row = int(np.argmax(np.diff(times) < 0.0)) + 1
            raise TraceError(
                f"{self._path}: {self._table.place(row)}: its time is before that of the row above; sort the rows"
            )
        kept = np.diff(times, prepend=-np.inf) > 0.0
        if not kept.all():
            self._findings.append(f"dropped {int((~kept).sum())} rows with the time of the row before")
        if kept.sum() < 3:
            raise TraceError(f"{self._path}: found {int(kept.sum())} rows of different times, expected at least 3")
        return kept, times

    def _number(self, key: str, found: object) -> float:
        if isinstance(found, bool) or not isinstance(found, int | float) or not math.isfinite(found):
            raise self._fail(key, f"found {_short(found)}, expected a finite number")
        return float(found)

    def _choice(self, key: str, found: object, known: Sequence[str]) -> str:
        if found not in known:
            raise self._fail(key, f"found {_short(found)}, expected {' or '.join(known)}")
        return str(found)

    def _unit(self, key: str, entry: Mapping[str, Any]) -> Unit | None:
        if "unit" not in entry:
            return None
        text = "1" if entry["unit"] == 1 else entry["unit"]
        if not isinstance(text, str):
            raise self._fail(f"{key}.unit", f"found {_short(text)}, expected a text such as mm")
        try:
            return parse_unit(text)
        except UnitError as error:
            raise self._fail(f"{key}.unit", str(error)) from error

    def _column(self, name: str, entry: object, times: Array, kept: Mask) -> Column:
        if isinstance(entry, str | int) and not isinstance(entry, bool):
            entry = {"column": entry}
        if not isinstance(entry, Mapping):
            raise self._fail(name, f"found {_short(entry)}, expected {{column: ..., unit: ...}}")
        self._check_keys(name, entry, KEYS)
        if "column" not in entry:
            raise self._fail(name, "names no column; add column:")
        label = self._named(f"{name}.column", entry["column"])
        scale, offset = (
            self._number(f"{name}.{key}", entry.get(key, off)) for key, off in (("scale", 1.0), ("offset", 0.0))
        )
        sign = self._choice(f"{name}.sign", entry.get("sign", 1), (1, -1))  # type: ignore[arg-type]
        readings = float(sign) * scale * self._table.column(label) + offset
        times, readings = times[kept], readings[kept]
        used = np.isfinite(readings)
        if not used.any():
            raise TraceError(f"{self._path}: column {label}: holds no finite number; name another column")
        if not used.all():
            self._findings.append(
                f"column {label}: {int((~used).sum())} of {len(used)} cells are empty and were left out"
            )
            readings = np.interp(times, times[used], readings[used])
        unit = self._unit(name, entry)
        low_pass, every, order = self._filter(name, entry, times)
        readings = _low_passed(readings, times, low_pass, 0, order)
        if order:
            unit = None if unit is None else _over_time(unit, order)
        between = (
            None if "between" not in entry else self._choice(f"{name}.between", entry["between"], ("held", "straight"))
        )
        gain, zero = self._tolerance(name, entry)
        return Column(
            name, label, times, readings, unit, used, math.inf if order else low_pass, every,
            None if between is None else between == "held", gain, zero,
        )  # fmt: skip

    def _filter(self, name: str, entry: Mapping[str, Any], times: Array) -> tuple[float, int, int]:
        order = entry.get("derivative", 0)
        if isinstance(order, bool) or order not in (0, 1, 2):
            raise self._fail(f"{name}.derivative", f"found {_short(order)}, expected 1 or 2")
        rate = (len(times) - 1) / (times[-1] - times[0])
        low_pass = self._number(f"{name}.low_pass", entry["low_pass"]) if "low_pass" in entry else math.inf
        if low_pass <= 0.0:
            raise self._fail(f"{name}.low_pass", f"found {low_pass:g}, expected a frequency in Hz above 0")
        if low_pass < math.inf and low_pass >= 0.45 * rate:
            raise self._fail(
                f"{name}.low_pass",
                f"found {low_pass:g}, expected below {0.45 * rate:.4g} Hz, as {rate:.4g} rows a second have it",
            )
        every = entry.get("every", 1 if low_pass == math.inf or order else max(1, int(0.5 * rate / low_pass)))
        if isinstance(every, bool) or not isinstance(every, int) or not 1 <= every <= len(times) // 3:
            raise self._fail(f"{name}.every", f"found {_short(every)}, expected a whole number of samples from 1 on")
        if low_pass < math.inf:
            steps = np.diff(times)
            if np.max(steps) > LONGEST_STEP * np.median(steps):
                raise self._fail(
                    f"{name}.low_pass",
                    f"found a gap of {np.max(steps):.4g} s, which no filter bridges; cut the file there",
                )
        return low_pass, every, int(order)

    def _tolerance(self, name: str, entry: Mapping[str, Any]) -> tuple[float, float]:
        found = entry.get("tolerance", {})
        if not isinstance(found, Mapping):
            raise self._fail(f"{name}.tolerance", f"found {_short(found)}, expected {{gain: 0.01, offset: 0.2}}")
        self._check_keys(f"{name}.tolerance", found, ("gain", "offset"))
        sizes = [self._number(f"{name}.tolerance.{key}", found.get(key, 0.0)) for key in ("gain", "offset")]
        if min(sizes) < 0.0:
            raise self._fail(f"{name}.tolerance", f"found {min(sizes):g}, expected standard deviations from 0 on")
        return sizes[0], sizes[1]

    def _mask(self, key: str, text: object, times: Array, values: Mapping[str, Array]) -> Mask:
        if not isinstance(text, str):
            raise self._fail(key, f'found {_short(text)}, expected a condition such as "20 < time < 30"')
        try:
            return chosen(text, {**values, "time": times, "t": times})
        except ExpressionError as error:
            raise self._fail(key, str(error)) from error


def chosen(text: str, values: Mapping[str, Array]) -> Mask:
    """Where a condition holds: comparisons, `20 < time < 30`, joined by `and` or `or`.

    Args:
        values: (n,) in SI by the names that it may use.

    Raises:
        ExpressionError: it cannot be read.
    """
    found: Mask | None = None
    for either in re.split(r"\bor\b", text):
        both: Mask | None = None
        for clause in re.split(r"\band\b", either):
            one = _clause(clause, values)
            both = one if both is None else both & one
        assert both is not None
        found = both if found is None else found | both
    assert found is not None
    return found


def _clause(clause: str, values: Mapping[str, Array]) -> Mask:
    parts = _COMPARED.split(clause)
    if len(parts) < 3 or len(parts) > 5:
        raise ExpressionError(f'found {clause.strip()!r}, expected a comparison such as "20 < time < 30"')
    sides = [_numbers(parse(part), values) for part in parts[::2]]
    found = np.ones(len(values["time"]), dtype=bool)
    for a, op, b in zip(sides, parts[1::2], sides[1:], strict=False):
        compared = {"<": np.less, "<=": np.less_equal, ">": np.greater, ">=": np.greater_equal}[op]
        found &= compared(a, b)
    return found


def _numbers(expression: Expr, values: Mapping[str, Array]) -> Any:
    """An expression of arrays."""
    for name in names_in(expression):
        if name not in values:
            raise ExpressionError(f"uses {name}, expected one of {', '.join(values)}")
    args = [_numbers(own, values) for own in expression.args]
    op = expression.op
    if op == "number":
        return expression.value
    if op == "name":
        return values[expression.value]
    with np.errstate(all="ignore"):
        return _OF_ARRAYS[op](expression, *args)


_OF_ARRAYS: Final[Mapping[str, Any]] = {
    "+": lambda _, a, b: a + b,
    "-": lambda _, a, b: a - b,
    "*": lambda _, a, b: a * b,
    "/": lambda _, a, b: np.divide(a, b),
    "**": lambda e, a: np.power(a, e.value),
    "neg": lambda _, a: -a,
    ">": lambda _, a, b: a > b,
    "where": lambda _, c, a, b: np.where(c, a, b),
    "min": lambda _, *a: np.minimum.reduce(np.broadcast_arrays(*a)),
    "max": lambda _, *a: np.maximum.reduce(np.broadcast_arrays(*a)),
    **{
        name: lambda _, a, name=name: getattr(np, name)(a)
        for name in ("sign", "abs", "sqrt", "exp", "log", "sin", "cos", "tan", "tanh")
    },
}


def at_rest(times: Array, readings: Array) -> Mask:
    """(n,) where a signal stands: over `REST` it changes by no more than its noise between neighbours."""
    steady = float(np.median(np.diff(times)))
    span = max(11, round(REST / steady))
    bends = np.diff(readings, 2)
    noise = 1.4826 * float(np.median(np.abs(bends - np.median(bends)))) / math.sqrt(6.0) if len(bends) else 0.0
    step = np.abs(np.diff(readings))
    quantum = float(np.min(step[step > 0.0], initial=math.inf))
    allowed = max(STILL * noise, 1.5 * quantum if quantum < 0.01 * np.ptp(readings) else 0.0)
    moved = ndimage.maximum_filter1d(readings, span) - ndimage.minimum_filter1d(readings, span)
    still = moved <= allowed
    return np.asarray(ndimage.binary_dilation(still, iterations=span // 2) if still.any() else still)


def _low_passed(values: Array, times: Array, low_pass: float, axis: int, order: int = 0) -> Array:
    """Values behind a zero-phase low-pass, or their derivatives behind it, at the times of the samples.

    Filters know a steady rate. Samples whose steps vary are brought to one, on straight lines, and back again.
    """
    if not low_pass < math.inf:
        for _ in range(order):
            values = np.asarray(np.gradient(values, times, axis=axis), dtype=np.float64)
        return values
    grid, rate = times, (len(times) - 1) / (times[-1] - times[0])
    steps = np.diff(times)
    varies = float(np.ptp(steps)) > UNEVEN * float(np.median(steps))
    if varies:
        grid = np.linspace(times[0], times[-1], len(times))
        values = np.asarray(interp1d(times, values, axis=axis)(grid), dtype=np.float64)
    numerator, denominator = signal.butter(FILTER_ORDER, low_pass / (0.5 * rate))
    found: Array = np.asarray(signal.filtfilt(numerator, denominator, values, axis=axis), dtype=np.float64)
    for _ in range(order):
        found = np.asarray(np.gradient(found, grid, axis=axis), dtype=np.float64)
    return np.asarray(interp1d(grid, found, axis=axis)(times), dtype=np.float64) if varies else found


def _thinned(values: Array, every: int) -> Array:
    return values[::every]


def _over_time(unit: Unit, order: int) -> Unit:
    length, mass, time, current, temperature = unit.dimension
    return Unit(
        unit.factor, (length, mass, time - order, current, temperature), f"{unit.si}/s{'²' if order == 2 else ''}"
    )


def _with(column: Column, used: Mask) -> Column:
    return Column(**{**column.__dict__, "used": used})


def _short(value: object) -> str:
    text = "nothing" if value is None else repr(value)
    return text if len(text) <= 60 else f"{text[:57]}..."
