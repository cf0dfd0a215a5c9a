"""Where the numbers of a machine's map come from: columns of a table, or fields of the messages of a bag."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from pathlib import Path
from typing import Any, Final, NamedTuple

import numpy as np
from numpy.typing import NDArray

from valve_sim.files.data_tables import TABLE_SUFFIXES, open_table
from valve_sim.files.entries import Entries, short
from valve_sim.files.recording_map import CLOCKS, Source, time_axis
from valve_sim.files.tables import DataTable
from valve_sim.recordings.clocks import SECOND
from valve_sim.recordings.storage import Recording, read_recording
from valve_sim.recordings.trace import TraceError

Array = NDArray[np.float64]

FEWEST: Final = 3
"""Samples of different times, of which a quantity has at least so many."""


class Series(NamedTuple):
    """Numbers as they were recorded: where, for messages; (n,) times, s, strictly ascending; (n,) NaN where empty."""

    label: str
    times: Array
    readings: Array


def source_of(
    path: Path, map_reader: Entries, found: Mapping[Any, Any] | None
) -> tuple[TableRows | BagTopics, Mapping[Any, Any]]:
    """The recording, opened, and the entries of its map.

    Args:
        found: the map; None: every column of a table by its own name, with `time` or the first column as time in s.

    Raises:
        ValveError: neither a table nor a bag; no map for a bag; no times.
    """
    if path.suffix.lower() in TABLE_SUFFIXES:
        table = open_table(path)
        if found is None:
            time = "time" if "time" in table.names else table.names[0]
            found = {"time": {"column": time}, **{name: {"column": name} for name in table.names if name != time}}
        rows = TableRows(path, table, map_reader, found.get("time"))
        return rows, {name: own for name, own in found.items() if name not in ("time", "use")}
    if found is None:
        raise TraceError(f"{path}: is no table; expected one of {', '.join(TABLE_SUFFIXES)}, or a bag with --map")
    if "time" in found:
        raise map_reader.fail("time", "is for tables; messages of a bag have their own: clock: header or clock: bag")
    entries = {name: own for name, own in found.items() if name not in ("clock", "use")}
    return BagTopics(path, map_reader, entries, found.get("clock", "")), entries


class TableRows:
    """The columns of a table, which share the times of its rows.

    Attributes:
        keys: of an entry, that say where its numbers are. findings: what was dropped, a line each.
    """

    keys: Sequence[str] = ("column",)

    def __init__(self, path: Path, table: DataTable, map_reader: Entries, time: object) -> None:
        self._path, self._table, self._map = path, table, map_reader
        self.findings = list(table.findings)
        self._times, self._kept = self._read_times(time)

    def series(self, key: str, entry: Mapping[str, Any]) -> Series:
        """The numbers of a column."""
        if "column" not in entry:
            raise self._map.fail(key, "names no column; add column:")
        label = self._named(f"{key}.column", entry["column"])
        return Series(f"column {label}", self._times, self._table.column(label)[self._kept])

    def _named(self, key: str, name: object) -> str:
        text = self._map.text(key, name)
        if not self._table.has(text):
            listed = ", ".join(self._table.names[:20])
            raise self._map.fail(key, f"column {text} is not in {self._path}; it has {listed}; name one of these")
        return text

    def _read_times(self, found: object) -> tuple[Array, NDArray[np.bool_]]:
        """(n,) the times of the rows that count, s, and which of the table's rows these are."""
        if found is None:
            raise self._map.fail("time", "is missing; add time: {column: t, unit: s} or time: {rate: 1000}")
        axis = time_axis(self._map, found)
        for column in axis.columns:
            self._named("time.column", column)
        times, kept, _, repeated = self._table.row_times(axis)
        if repeated:
            self.findings.append(f"dropped {repeated} rows with the time of the row before")
        if kept.sum() < FEWEST:
            raise TraceError(
                f"{self._path}: found {int(kept.sum())} rows of different times, expected at least {FEWEST}"
            )
        return times[kept], kept


class BagTopics:
    """Fields of the messages of a bag, each at the times of its own topic, s since the first message of all.

    Attributes:
        keys, findings: as of a table.
    """

    keys: Sequence[str] = ("topic", "field", "joint", "clock")

    def __init__(self, path: Path, map_reader: Entries, entries: Mapping[Any, Any], clock: object) -> None:
        self._path, self._map = path, map_reader
        self._clock = map_reader.choice("clock", clock, ("", *CLOCKS))
        sources = {name: self._source(str(name), own) for name, own in entries.items()}
        fields: dict[str, set[str]] = {}
        for source in sources.values():
            fields.setdefault(source.topic, set()).add(source.path)
        self._recording: Recording = read_recording(path, lambda _: fields)
        self.findings = list(self._recording.findings)
        stamped = {name: self._stamped(str(name), source) for name, source in sources.items()}
        self._begins = min((int(stamps[0]) for stamps, _ in stamped.values()), default=0)
        self._stamps = {name: (sources[name].name, *found) for name, found in stamped.items()}

    def series(self, key: str, entry: Mapping[str, Any]) -> Series:
        """The numbers of a field."""
        label, stamps, readings = self._stamps[key]
        return Series(label, (stamps - self._begins) / SECOND, readings)

    def _source(self, key: str, entry: object) -> Source:
        if isinstance(entry, str):
            entry = {"topic": entry}
        if not isinstance(entry, Mapping) or "topic" not in entry:
            raise self._map.fail(key, f"found {short(entry)}, expected {{topic: /..., field: ..., unit: ...}}")
        texts = {name: self._map.text(f"{key}.{name}", entry[name]) for name in self.keys if name in entry}
        clock = self._map.choice(f"{key}.clock", texts.get("clock", self._clock), ("", *CLOCKS))
        if not texts["topic"].startswith("/"):
            raise self._map.fail(f"{key}.topic", f"found {texts['topic']!r}, expected a name that begins with /")
        return Source(texts["topic"], texts.get("field", ""), texts.get("joint", ""), clock=clock)

    def _stamped(self, key: str, source: Source) -> tuple[NDArray[np.int64], Array]:
        """(n,) strictly ascending stamps, ns, and the numbers of one field."""
        topic, types = source.topic, self._recording.types
        if topic not in types:
            raise self._map.fail(
                f"{key}.topic", f"{topic} is not in {self._path}; it has {', '.join(sorted(types)[:20])}; name one"
            )
        messages = self._recording.topic(self._path, topic)
        readings, without = messages.values(source)
        if without is not None and np.isnan(readings).all():
            raise self._map.fail(key, f"topic {topic} of {self._path} {without.what_lacks(source)}")
        stamps, _, is_stamped = messages.stamps(source.clock)
        if source.clock == "header" and not is_stamped.any():
            raise self._map.fail(
                f"{key}.clock", f"header, but the messages of {topic} ({types[topic]}) have no stamp; use clock: bag"
            )
        order = np.argsort(stamps, kind="stable")
        order = order[np.diff(stamps[order], prepend=stamps[order[0]] - 1) > 0]
        if len(order) < len(stamps):
            self.findings.append(f"{topic}: dropped {len(stamps) - len(order)} messages with the stamp of another")
        if len(order) < FEWEST:
            raise TraceError(f"{self._path}: topic {topic}: found {len(order)} messages, expected at least {FEWEST}")
        return stamps[order], readings[order]
