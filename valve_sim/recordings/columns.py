"""Any recording as columns in SI, by a map: the one reader for machines of a user's own.

    time: {column: t, unit: ms}
    use: "20 < time < 30"                                      # which rows count
    force: {column: vir, unit: N, scale: 35.15}
    position: {column: qm, unit: mm, at_rest: exclude}         # not while it stands
    velocity: {column: qm, unit: mm, derivative: 1, low_pass: 100}

A reading becomes unit × (sign × scale × reading + offset). Names are the machine's: its inputs and outputs. Of a bag
each entry has topic and field, or joint, in place of column, and its own times:

    torque: {topic: /motor/torque, field: data, unit: N*m}
    angle: {topic: /joint_states, joint: hinge, unit: rad}
"""

from __future__ import annotations

import math
import re
from collections.abc import Mapping
from dataclasses import dataclass, field, replace
from os import PathLike
from pathlib import Path
from typing import Any, Final

import numpy as np
from numpy.typing import NDArray

from valve_sim.files.data_tables import TABLE_SUFFIXES, open_table
from valve_sim.files.entries import Entries, short
from valve_sim.files.recording_map import CLOCKS, MapError, Source, place_of, time_axis
from valve_sim.files.yaml_files import read_yaml
from valve_sim.model.core.own.grammar import ExpressionError, evaluate, names_in, parse
from valve_sim.model.core.own.units import Unit, parse_unit
from valve_sim.model.core.tracer import Trace
from valve_sim.model.core.tracer import evaluate as numbers_of
from valve_sim.recordings.bag_columns import BagColumns
from valve_sim.recordings.clocks import find_gaps
from valve_sim.recordings.layout import check_topic
from valve_sim.recordings.motion import sample_noise
from valve_sim.recordings.open_recording import OpenRecording
from valve_sim.recordings.resting_noise import step_of
from valve_sim.recordings.storage import read_recording
from valve_sim.recordings.table_columns import TableColumns
from valve_sim.recordings.trace import TraceError

Array = NDArray[np.float64]
Mask = NDArray[np.bool_]

KEYS: Final = (
    "unit", "scale", "sign", "offset", "use", "at_rest", "derivative", "low_pass", "every", "between",
    "tolerance", "turns",
)  # fmt: skip
FILTER_ORDER: Final = 4
"""Of the Butterworth low-pass, which is passed forwards and backwards, so that nothing is delayed."""
REST: Final = 0.1
"""s over which a signal must stand still, or eleven samples where that is longer."""
UNEVEN: Final = 1e-3
"""Of a step: steps that differ by more are brought to a steady rate before they are filtered."""
LONGEST_STEP: Final = 20.0
"""Usual steps that a filter bridges: on either side of a longer gap it starts again."""
DISTORTED: Final = 2.0
"""Periods of the filter's corner on either side of a gap in which it shows its beginning rather than the signal."""
FEWEST: Final = 3 * (FILTER_ORDER + 1)
"""Samples between two gaps, of which the filter needs more."""
FEWEST_TIMES: Final = 3
"""Readings of different times, of which a quantity has at least so many."""
STILL: Final = 6.0
"""Standard deviations of the noise between neighbours, within which a signal stands."""
_COMPARISONS: Final = {"<=": np.less_equal, ">=": np.greater_equal, "<": np.less, ">": np.greater}
_COMPARED: Final = re.compile(rf"({'|'.join(_COMPARISONS)})")


@dataclass(frozen=True)
class Column:
    """One quantity as it was recorded.

    Attributes:
        name: of the machine's input or output. source: the column or topic, for messages.
        times, readings: (n,) s, and numbers in `unit`; None: in the unit that the machine declares.
        used: (n,) True where a sample counts. low_pass: Hz, infinite: none. every: of how many samples one is compared.
        held: whether it holds between its samples; None: as the machine declares.
        turns: whether what is compared takes part where this passes through 0.
        smoothing: Hz, of the low-pass that its readings have passed.
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
    smoothing: float = math.inf
    turns: bool = True

    def si(self, declared: Unit) -> Array:
        """(n,) in SI; what is not used is NaN nowhere, but marked in `used`."""
        unit = declared if self.unit is None else self.unit
        return self.readings * unit.factor + unit.zero

    def filtered(self, values: Array) -> Array:
        """(n, ...) values at the column's samples, low-passed as it is and thinned."""
        return _low_passed(values, self.times, self.low_pass)[self.compared]

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
        path: a table (CSV, Parquet, MATLAB), or a bag (a rosbag2 folder, .mcap or .db3). recording_map: a file, or its
            content; None: every column of a table by its own name, with `time` or the first column as time in s.

    Returns:
        columns by the names in the map, with times in s.

    Raises:
        ValveError: recording or map cannot be used; one line with file, key and mend.
    """
    where, found = _map_of(recording_map)
    return _Reading(Path(path), where, found).columns()


def _map_of(given: str | PathLike[str] | Mapping[str, Any] | None) -> tuple[str, Mapping[Any, Any] | None]:
    if given is None or isinstance(given, Mapping):
        return "map", given
    found = read_yaml(Path(given), "expected a map of a recording: time: {column: t}, force: {column: F}", MapError)
    if not isinstance(found, Mapping) or not found:
        raise MapError(f"{given}: found {short(found)}, expected keys such as time: {{column: t}}")
    return str(given), found


class _Reading:
    """One reading of one recording by one map."""

    def __init__(self, path: Path, where: str, found: Mapping[Any, Any] | None) -> None:
        self._path, self._map = path, Entries(where, MapError)
        self._findings: list[str] = []
        if path.suffix.lower() in TABLE_SUFFIXES:
            table = open_table(path)
            if found is None:
                time = "time" if "time" in table.names else table.names[0]
                found = {"time": {"column": time}, **{name: {"column": name} for name in table.names if name != time}}
            if "time" not in found:
                raise self._map.fail("time", "is missing; add time: {column: t, unit: s} or time: {rate: 1000}")
            self._keys: tuple[str, ...] = ("column", "time")
            self._entries = self._places(found, "")
            axis, sources = time_axis(self._map, found["time"]), [source for source, _ in self._entries.values()]
            self._recorded: OpenRecording = TableColumns(table, axis, where, sources)
        else:
            if found is None:
                raise TraceError(
                    f"{path}: is no table; expected one of {', '.join(TABLE_SUFFIXES)}, or a bag with --map"
                )
            if "time" in found:
                raise self._map.fail(
                    "time", "is for tables; messages of a bag have their own: clock: header or clock: bag"
                )
            self._keys = ("topic", "field", "joint", "clock")
            self._entries = self._places(found, self._map.choice("clock", found.get("clock", ""), ("", *CLOCKS)))
            self._recorded = BagColumns(path, read_recording(path, self._fields), where)
        self._use = found.get("use")
        self._recorded.begin((name, source) for name, (source, _) in self._entries.items())

    def _places(self, found: Mapping[Any, Any], clock: str) -> dict[str, tuple[Source, Mapping[str, Any]]]:
        """Where each quantity is, and its whole entry."""
        places = {}
        for name, given in found.items():
            if name in ("time", "use") or (name == "clock" and "clock" in self._keys):
                continue
            if not isinstance(name, str):
                raise self._map.fail(
                    str(name), "expected the name of an input or output (YAML reads on, off, yes, no as true or false)"
                )
            kind = self._keys[0]
            entry = {kind: given} if isinstance(given, str | int) and not isinstance(given, bool) else given
            if not isinstance(entry, Mapping) or kind not in entry:
                raise self._map.fail(name, f"found {short(entry)}, expected {{{kind}: ..., unit: ...}}")
            self._map.check_keys(name, entry, (*self._keys, *KEYS))
            texts = {key: own for key, own in entry.items() if key in self._keys}
            found_at = place_of(self._map, name, texts, clock)
            places[name] = Source(**found_at), entry  # type: ignore[arg-type] # texts by their names
        if not places:
            raise self._map.fail("", "names no input and no output; add force: {column: F, unit: N}")
        return places

    def _fields(self, types: Mapping[str, str]) -> dict[str, set[str]]:
        """The topics to read, and the fields to keep of each."""
        fields: dict[str, set[str]] = {}
        for name, (source, _) in self._entries.items():
            check_topic(self._path, f"{self._map.where}: {name}.topic", source.topic, types)
            fields.setdefault(source.topic, set()).add(source.path)
        return fields

    def columns(self) -> Columns:
        read = {name: self._column(name, *own) for name, own in self._entries.items()}
        values = {name: column.si(column.unit or parse_unit("")) for name, column in read.items()}
        whole = {}
        for name, column in read.items():
            _, entry = self._entries[name]
            used = column.used
            for key, text in (("use", self._use), (f"{name}.use", entry.get("use"))):
                if text is not None:
                    used = used & self._mask(key, text, column.times, read, values)
            if self._map.choice(f"{name}.at_rest", entry.get("at_rest", "use"), ("use", "exclude")) == "exclude":
                used = used & ~at_rest(column.times, column.readings)
            if not used.any():
                raise self._map.fail(name, "no sample is left; widen use: or take at_rest: exclude out")
            whole[name] = replace(column, used=used, turns=self._turns(name, entry))
        return Columns(str(self._path), whole, (*self._recorded.findings, *self._findings))

    def _column(self, name: str, source: Source, entry: Mapping[str, Any]) -> Column:
        times, recorded, repeated = self._recorded.readings(name, source)
        label = source.name
        if repeated:
            self._findings.append(f"{source.topic}: dropped {repeated} messages with the stamp of another")
        if len(times) < FEWEST_TIMES:
            raise TraceError(
                f"{self._path}: {label}: found {len(times)} readings of different times, expected at least "
                f"{FEWEST_TIMES}; record it for longer"
            )
        scale, offset = (
            self._map.number(f"{name}.{key}", entry.get(key, off)) for key, off in (("scale", 1.0), ("offset", 0.0))
        )
        sign = self._map.choice(f"{name}.sign", entry.get("sign", 1), (1, -1))
        readings = float(sign) * scale * recorded + offset
        used = np.isfinite(readings)
        if not used.any():
            raise TraceError(f"{self._path}: {label}: holds no finite number; name another {self._keys[0]}")
        if not used.all():
            self._findings.append(f"{label}: {int((~used).sum())} of {len(used)} cells are empty and were left out")
            readings = np.interp(times, times[used], readings[used])
        unit = self._map.unit(f"{name}.unit", entry["unit"]) if "unit" in entry else None
        low_pass, every, order = self._filter(name, entry, times)
        if low_pass < math.inf:
            near = _near_gaps(times, low_pass)
            if near.any():
                gap = float(np.max(np.diff(times)))
                self._findings.append(
                    f"{name}: {int((used & near).sum())} samples beside gaps (the longest {gap:.3g} s) were left out, "
                    "since a filter starts again after each"
                )
                used &= ~near
        readings = _low_passed(readings, times, low_pass, order)
        if order:
            unit = None if unit is None else _over_time(unit, order)
        between = self._map.choice(f"{name}.between", entry.get("between", ""), ("held", "straight", ""))
        gain, zero = self._tolerance(name, entry)
        return Column(
            name, label, times, readings, unit, used, math.inf if order else low_pass, every,
            between == "held" if between else None, gain, zero, low_pass,
        )  # fmt: skip

    def _turns(self, name: str, entry: Mapping[str, Any]) -> bool:
        """Whether samples count where a column passes through 0: by default where a mask has its name anyway."""
        chosen_by_user = self._map.choice(f"{name}.turns", entry.get("turns", ""), ("use", "exclude", ""))
        if chosen_by_user:
            return bool(chosen_by_user == "use")
        masks = [self._use, *(own.get("use") for _, own in self._entries.values())]
        return any(isinstance(mask, str) and re.search(rf"\b{re.escape(name)}\b", mask) for mask in masks)

    def _filter(self, name: str, entry: Mapping[str, Any], times: Array) -> tuple[float, int, int]:
        order = entry.get("derivative", 0)
        if isinstance(order, bool) or order not in (0, 1, 2):
            raise self._map.fail(f"{name}.derivative", f"found {short(order)}, expected 1 or 2")
        rate = (len(times) - 1) / (times[-1] - times[0])
        low_pass = self._map.number(f"{name}.low_pass", entry["low_pass"]) if "low_pass" in entry else math.inf
        if low_pass <= 0.0:
            raise self._map.fail(f"{name}.low_pass", f"found {low_pass:g}, expected a frequency in Hz above 0")
        if low_pass < math.inf and low_pass >= 0.45 * rate:
            raise self._map.fail(
                f"{name}.low_pass",
                f"found {low_pass:g}, expected below {0.45 * rate:.4g} Hz, as {rate:.4g} rows a second have it",
            )
        every = entry.get("every", 1 if low_pass == math.inf or order else max(1, int(0.5 * rate / low_pass)))
        if isinstance(every, bool) or not isinstance(every, int) or not 1 <= every <= len(times) // 3:
            raise self._map.fail(f"{name}.every", f"found {short(every)}, expected a whole number of samples from 1 on")
        return low_pass, every, int(order)

    def _tolerance(self, name: str, entry: Mapping[str, Any]) -> tuple[float, float]:
        found = entry.get("tolerance", {})
        if not isinstance(found, Mapping):
            raise self._map.fail(f"{name}.tolerance", f"found {short(found)}, expected {{gain: 0.01, offset: 0.2}}")
        self._map.check_keys(f"{name}.tolerance", found, ("gain", "offset"))
        sizes = [self._map.number(f"{name}.tolerance.{key}", found.get(key, 0.0)) for key in ("gain", "offset")]
        if min(sizes) < 0.0:
            raise self._map.fail(f"{name}.tolerance", f"found {min(sizes):g}, expected standard deviations from 0 on")
        return sizes[0], sizes[1]

    def _mask(
        self, key: str, text: object, times: Array, read: Mapping[str, Column], values: Mapping[str, Array]
    ) -> Mask:
        """(n,) where a condition holds, at the times of one column; what others read then is on straight lines."""
        if not isinstance(text, str):
            raise self._map.fail(key, f'found {short(text)}, expected a condition such as "20 < time < 30"')
        here = {
            name: own if read[name].times is times else np.interp(times, read[name].times, own)
            for name, own in values.items()
        }
        try:
            return chosen(text, {**here, "time": times, "t": times})
        except ExpressionError as error:
            raise self._map.fail(key, str(error)) from error


def chosen(text: str, values: Mapping[str, Array]) -> Mask:
    """Where a condition holds: comparisons, `20 < time < 30`, joined by `and` or `or`.

    Args:
        values: (n,) in SI by the names that it may use.

    Raises:
        ExpressionError: it is no such condition, or uses another name; in one line.
    """
    either = re.split(r"\bor\b", text)
    both = [[_compared(clause, values) for clause in re.split(r"\band\b", own)] for own in either]
    return np.asarray(np.logical_or.reduce([np.logical_and.reduce(clauses) for clauses in both]))


def _compared(clause: str, values: Mapping[str, Array]) -> Mask:
    """(n,) where one comparison holds."""
    parts = _COMPARED.split(clause)
    if len(parts) < 3 or len(parts) > 5:
        raise ExpressionError(f'found {clause.strip()!r}, expected a comparison such as "20 < time < 30"')
    graph, sides = Trace(), [parse(part) for part in parts[::2]]
    for name in (name for side in sides for name in names_in(side)):
        if name not in values:
            raise ExpressionError(f"uses {name}, expected one of {', '.join(values)}")
    symbols = {name: graph.number(name) for name in values}
    numbers = numbers_of([graph.lift(evaluate(side, symbols)) for side in sides], values)
    found = np.ones(len(values["time"]), dtype=bool)
    for a, op, b in zip(numbers, parts[1::2], numbers[1:], strict=False):
        found &= _COMPARISONS[op](a, b)
    return found


def at_rest(times: Array, readings: Array) -> Mask:
    """(n,) where a signal stands: over `REST` it changes by no more than its noise between neighbours."""
    from scipy import ndimage  # here and below: SciPy takes a second to load, which no node waits for

    steady = float(np.median(np.diff(times)))
    span = max(11, round(REST / steady))
    step = step_of(readings)
    allowed = max(STILL * sample_noise(readings), 1.5 * step if step < 0.01 * np.ptp(readings) else 0.0)
    moved = ndimage.maximum_filter1d(readings, span) - ndimage.minimum_filter1d(readings, span)
    still = moved <= allowed
    return np.asarray(ndimage.binary_dilation(still, iterations=span // 2) if still.any() else still)


def _low_passed(values: Array, times: Array, low_pass: float, order: int = 0) -> Array:
    """Values behind a zero-phase low-pass, or their derivatives behind it, at the times of the samples.

    Filters know a steady rate. Samples whose steps vary are brought to one, on straight lines, and back again. After a
    gap the filter starts again; too few samples between two gaps stay as they are.
    """
    edges = _gaps(times) if low_pass < math.inf else []
    if edges:
        pieces = zip([0, *edges], [*edges, len(times)], strict=True)
        return np.concatenate(
            [_low_passed(values[i:k], times[i:k], low_pass if k - i > FEWEST else math.inf, order) for i, k in pieces]
        )
    if not low_pass < math.inf:
        for _ in range(order):
            values = np.gradient(values, times, axis=0) if len(times) > 1 else np.zeros_like(values)
        return values
    from scipy.interpolate import interp1d
    from scipy.signal import butter, filtfilt

    grid, rate = times, (len(times) - 1) / (times[-1] - times[0])
    steps = np.diff(times)
    varies = float(np.ptp(steps)) > UNEVEN * float(np.median(steps))
    if varies:
        grid = np.linspace(times[0], times[-1], len(times))
        values = np.asarray(interp1d(times, values, axis=0)(grid), dtype=np.float64)
    numerator, denominator = butter(FILTER_ORDER, low_pass / (0.5 * rate))
    found: Array = np.asarray(filtfilt(numerator, denominator, values, axis=0), dtype=np.float64)
    for _ in range(order):
        found = np.asarray(np.gradient(found, grid, axis=0), dtype=np.float64)
    return np.asarray(interp1d(grid, found, axis=0)(times), dtype=np.float64) if varies else found


def _gaps(times: Array) -> list[int]:
    """Where samples start again after more than `LONGEST_STEP` usual steps without one."""
    return [1 + place for place in find_gaps(times, LONGEST_STEP).tolist()]


def _near_gaps(times: Array, low_pass: float) -> Mask:
    """(n,) samples that a filter beside a gap distorts, or all between gaps that are too near."""
    near, edges = np.zeros(len(times), dtype=bool), _gaps(times)
    for i, k in zip([0, *edges], [*edges, len(times)], strict=True):
        own = times[i:k]
        near[i:k] |= (i > 0) & (own < own[0] + DISTORTED / low_pass)
        near[i:k] |= (k < len(times)) & (own > own[-1] - DISTORTED / low_pass)
        near[i:k] |= bool(edges) and k - i <= FEWEST
    return near


def _over_time(unit: Unit, order: int) -> Unit:
    length, mass, time, current, temperature = unit.dimension
    return Unit(
        unit.factor, (length, mass, time - order, current, temperature), f"{unit.si}/s{'²' if order == 2 else ''}"
    )
