"""Maps of foreign recordings: which topic, field or column is which quantity, in which unit, by which clock.

    clock: header
    position: {topic: /lvdt, unit: mm, sign: -1, offset: 12.5}
    voltage: {topic: /daq, field: "channels[2].value", scale: 10}

A reading becomes SI as unit × (sign × scale × reading + offset). A map is read and checked once, here; whether the
recording has what it names is checked when the recording is read. A static table of force has a map of the same form.
"""

from __future__ import annotations

import math
from collections.abc import Mapping
from dataclasses import dataclass, field, fields
from pathlib import Path
from typing import TYPE_CHECKING, Any, Final

from valve_sim.files.channels import CHANNELS, JUDGED, UNITS
from valve_sim.files.entries import Entries, short
from valve_sim.files.yaml_files import read_yaml
from valve_sim.model.errors import ValveError

if TYPE_CHECKING:
    import numpy as np
    from numpy.typing import NDArray


class MapError(ValveError):
    """A map cannot be used: one line that names the file and the key, what was found and what is expected."""


FORCE_QUANTITIES: Final[Mapping[str, str]] = {"displacement": "length", "force": "force"}
"""Columns of a static table, from stage (from the plunger's seat, positive towards the core) and load cell (with which
the coil attracts the plunger), and the dimension of each."""
MOST_AVERAGED: Final = 1000
"""Readings: a sensor that averages more shows no stroke."""
OF_ANOTHER: Final = "; if it is of a machine that is no valve, give --plant to identify, diagnose, validate or simulate"
"""Of a map with keys that no valve has."""
CLOCKS: Final = ("header", "bag")
DEFAULT_VALVE: Final = "/valve"
_OTHER_KEYS: Final = ("sensor", "clock", "time", "valve", "valves")
_TEXTS: Final = ("topic", "field", "joint", "column", "time", "type", "unit", "clock")
_NUMBERS: Final = ("scale", "sign", "offset")


@dataclass(frozen=True)
class Source:
    """Where one quantity is recorded, and what its numbers mean.

    Attributes:
        topic: of a bag.
        field: dotted path in the message, "point.z" or "position[2]"; empty: its only number.
        joint: of a JointState, in place of an index into `field` (default position).
        column: name or number (from 1) of a table's column. time: that of its times, where these are not the rows'.
        type: of the message, needed by live nodes only where it cannot be told from `joint`.
        unit: one of `UNITS` of the quantity's dimension.
        scale: of a divider or probe. sign: 1 or −1. offset: in `unit`, added last.
        clock: "header", "bag", or empty: the stamp of the message where it has one.
    """

    topic: str = ""
    field: str = ""
    joint: str = ""
    column: str = ""
    time: str = ""
    type: str = ""
    unit: str = ""
    scale: float = 1.0
    sign: float = 1.0
    offset: float = 0.0
    clock: str = ""

    @property
    def path(self) -> str:
        """Dotted path of its numbers in a message, of a joint that of the list; empty: the only number."""
        return self.field or ("position" if self.joint else "")

    @property
    def name(self) -> str:
        """Where this entry is, for messages."""
        if self.column:
            return f"column {self.column}"
        what = self.joint or self.field
        return f"topic {self.topic}" + (f" ({what})" if what else "")

    def to_si(self, readings: NDArray[np.float64], dimension: str) -> NDArray[np.float64]:
        """Readings in SI (°C for temperatures), same shape."""
        units = UNITS[dimension]
        unit = units[self.unit] if self.unit else next(iter(units.values()))
        factor, zero = unit.factor, unit.zero
        if (factor, zero, self.scale, self.sign, self.offset) == (1.0, 0.0, 1.0, 1.0, 0.0):
            return readings
        return factor * (self.sign * self.scale * readings + self.offset) + zero


@dataclass(frozen=True)
class TimeAxis:
    """The times of a table's rows.

    Attributes:
        columns: which hold them: one, or two that are added or read together. units: of each, s; of one that is
            missing, as its name says. form: of dates, as `datetime.strptime` has it. rate: Hz, in place of columns.
    """

    columns: tuple[str, ...] = ()
    units: tuple[float, ...] = ()
    form: str = ""
    rate: float = 0.0


@dataclass(frozen=True)
class DeclaredSensor:
    """What is known of a position sensor.

    Attributes:
        averaging: of how many readings, the last one included, each recorded position is the mean.
        bandwidth: of its low-pass of first order, Hz; infinite: it has none.
    """

    averaging: int = 1
    bandwidth: float = math.inf


@dataclass(frozen=True)
class RecordingMap:
    """What a recording holds about each valve.

    Attributes:
        path: the file that it was read from, for messages.
        valves: valve's name ("/tank_1/valve") to channel's key (of `CHANNELS`) to where it is.
        time: of a table; None for bags.
        sensors: by valve's name, what is known of its position sensor; of those that are not there, nothing.
    """

    path: str
    valves: Mapping[str, Mapping[str, Source]]
    time: TimeAxis | None = None
    sensors: Mapping[str, DeclaredSensor] = field(default_factory=dict)

    def choose(self, valve: str | None) -> tuple[str, Mapping[str, Source]]:
        """The valve of this name, or the only one: its name and what is recorded of it.

        Raises:
            MapError: there is none of this name, or several and no name is given.
        """
        listed = ", ".join(self.valves)
        if valve is None:
            if len(self.valves) > 1:
                raise MapError(f"{self.path}: describes several valves ({listed}); choose one with --valve")
            return next(iter(self.valves.items()))
        name = _absolute(valve)
        if name not in self.valves:
            raise MapError(f"{self.path}: describes no valve {name}; it has {listed}; choose one with --valve")
        return name, self.valves[name]


def load_map(path: Path | str) -> RecordingMap:
    """Read and check a map.

    Raises:
        MapError: it cannot be read, or a key, unit or value in it is invalid; one line with file, key and remedy.
    """
    found = read_yaml(path, "expected a map of a recording; valve-sim map RECORDING writes a first one", MapError)
    return map_from(found, str(path))


def is_of_valve(found: Mapping[Any, Any]) -> bool:
    """Whether all that a map names is recorded of a valve; else it is the map of another machine."""
    return all(name in CHANNELS or name in _OTHER_KEYS for name in found)


def map_from(found: object, path: str) -> RecordingMap:
    """Check what a map's YAML holds; errors as `load_map`."""
    return _MapReader(path).whole(found)


def load_force_map(path: Path | str) -> Mapping[str, Source]:
    """Read and check the map of a static table: the column of each of `FORCE_QUANTITIES`.

    Raises:
        MapError: it cannot be read, names no column for one of them, or a key, unit or value in it is invalid.
    """
    found = read_yaml(path, "expected a map such as displacement: {column: Weg, unit: mm}", MapError)
    reader = _MapReader(str(path))
    entries = reader.mapping("", found, "displacement: and force: with the column of each")
    reader.check_keys("", entries, list(FORCE_QUANTITIES))
    for key, dimension in FORCE_QUANTITIES.items():
        if key not in entries:
            unit = next(iter(UNITS[dimension]))
            raise reader.fail("", f"names no {key}; add {key}: {{column: ..., unit: {unit}}}")
    sources = {key: reader.source(key, entries[key], dimension) for key, dimension in FORCE_QUANTITIES.items()}
    for key, source in sources.items():
        if source.topic:
            raise reader.fail(f"{key}.topic", f"found {source.topic}; a table has columns: give column: in its place")
    return sources


def place_of(reader: Entries, key: str, entry: Mapping[str, Any], clock: str) -> dict[str, str]:
    """Check the texts of an entry, which say where its numbers are; `clock` is that of an entry that names none.

    Raises:
        MapError: It does not have exactly one of topic and column, or a text is not valid.
    """
    texts = {name: reader.text(f"{key}.{name}", found) for name, found in entry.items()}
    reader.choice(f"{key}.clock", texts.setdefault("clock", clock), ("", *CLOCKS))
    topic, joint, index = (texts.get(name, "") for name in ("topic", "joint", "field"))
    if bool(topic) == bool(texts.get("column")):
        raise reader.fail(key, f"found {short(dict(entry))}, expected either topic: (of a bag) or column: (of a table)")
    if topic and texts.get("time"):
        raise reader.fail(f"{key}.time", "is a column; messages of a bag have their own: clock: header or clock: bag")
    if topic and not topic.startswith("/"):
        raise reader.fail(f"{key}.topic", f"found {topic!r}, expected a name that begins with /")
    if joint and "[" in index:
        raise reader.fail(key, f"has joint {joint} and field {index}; give the joint or the index")
    return texts


def time_axis(reader: Entries, found: object) -> TimeAxis:
    """Check where a map has the times of a table's rows.

    Raises:
        MapError: It does not have exactly one of column and rate, or its unit is not one of time.
    """
    if isinstance(found, str | int | list) and not isinstance(found, bool):
        found = {"column": found}
    entry = reader.mapping("time", found, "{column: t, unit: s} or {rate: 1000}")
    reader.check_keys("time", entry, ["column", "unit", "format", "rate"])
    if ("rate" in entry) == ("column" in entry):
        raise reader.fail("time", f"found {short(dict(entry))}, expected either column: or rate:")
    if "rate" in entry:
        rate = reader.number("time.rate", entry["rate"])
        if rate <= 0.0:
            raise reader.fail("time.rate", f"found {rate:g}, expected a number of rows a second above 0")
        return TimeAxis(rate=rate)
    columns, units = (own if isinstance(own, list) else [own] for own in (entry["column"], entry.get("unit", [])))
    if not 1 <= len(columns) <= 2 or len(units) > len(columns):
        raise reader.fail("time", f"found {short(dict(entry))}, expected one or two columns and a unit of each")
    form = reader.text("time.format", entry.get("format", ""))
    if form and (units or "%" not in form):
        raise reader.fail(
            "time.format", f'found {short(form)}, expected the form of dates, "%d.%m.%Y %H:%M:%S.%f"; no unit'
        )
    return TimeAxis(
        tuple(reader.text("time.column", own) for own in columns), tuple(_time_unit(reader, own) for own in units), form
    )


def _time_unit(reader: Entries, found: object) -> float:
    unit = UNITS["time"][found] if found == "100ns" else reader.unit("time.unit", found)
    if unit.dimension != UNITS["time"]["s"].dimension:
        raise reader.fail("time.unit", f"found {found!r}, expected one of {', '.join(UNITS['time'])}")
    return unit.factor


def _absolute(name: object) -> str:
    """A valve's name, as its topics begin."""
    return "/" + str(name).strip("/")


class _MapReader(Entries):
    """Reads one map."""

    def __init__(self, path: str) -> None:
        super().__init__(path, MapError)

    def whole(self, found: object) -> RecordingMap:
        """All of it."""
        if not isinstance(found, Mapping) or not found:
            raise self.fail(
                "",
                f"found {short(found)}; expected keys such as position: {{topic: ..., unit: mm}}; "
                "valve-sim map RECORDING writes a first one",
            )
        self.check_keys("", found, [*CHANNELS, *_OTHER_KEYS], OF_ANOTHER)
        clock = self.choice("clock", found.get("clock", ""), ("", *CLOCKS))
        time = time_axis(self, found["time"]) if "time" in found else None
        if "valves" in found:
            alone = [key for key in found if key in CHANNELS or key in ("valve", "sensor")]
            if alone:
                raise self.fail(alone[0], "found beside valves:; expected it below one of them")
            named = self.mapping("valves", found["valves"], "names and what is recorded of each")
            if not named:
                raise self.fail("valves", "found {}, expected names and what is recorded of each")
            entries = {f"valves.{name}.": (name, own) for name, own in named.items()}
            for prefix, (_, own) in entries.items():
                self.mapping(prefix.rstrip("."), own, "keys such as position:")
                self.check_keys(prefix.rstrip("."), own, [*CHANNELS, "sensor"])
        else:
            name = found.get("valve", DEFAULT_VALVE)
            if not isinstance(name, str) or not name.strip("/"):
                raise self.fail("valve", f"found {short(name)}, expected a name such as {DEFAULT_VALVE}")
            entries = {"": (name, found)}
        valves = {_absolute(name): self._sources(prefix, own, clock) for prefix, (name, own) in entries.items()}
        sensors = {_absolute(name): self._sensor(prefix, own) for prefix, (name, own) in entries.items()}
        self._check_kind(valves, time)
        return RecordingMap(self.where, valves, time, sensors)

    def _sensor(self, prefix: str, entries: Mapping[Any, Any]) -> DeclaredSensor:
        """What the entry of a valve says of its position sensor."""
        key = f"{prefix}sensor"
        found = self.mapping(key, entries.get("sensor", {}), "{averaging: 10} or {bandwidth: 500}")
        if "sensor" in entries and "position" not in entries:
            raise self.fail(key, "is that of the position, of which the map names none; add position: or take it out")
        self.check_keys(key, found, ["averaging", "bandwidth"])
        count = found.get("averaging", 1)
        if isinstance(count, bool) or not isinstance(count, int) or not 1 <= count <= MOST_AVERAGED:
            raise self.fail(
                f"{key}.averaging",
                f"found {short(count)}, expected a whole number of readings from 1 to {MOST_AVERAGED}",
            )
        bandwidth = found.get("bandwidth", math.inf)
        if isinstance(bandwidth, bool) or not isinstance(bandwidth, int | float) or not bandwidth >= 1.0:
            raise self.fail(f"{key}.bandwidth", f"found {short(bandwidth)}, expected a frequency in Hz from 1 on")
        return DeclaredSensor(count, float(bandwidth))

    def _sources(self, prefix: str, entries: Mapping[Any, Any], clock: str) -> Mapping[str, Source]:
        """What is recorded of one valve."""
        sources = {
            key: self.source(f"{prefix}{key}", own, CHANNELS[key].dimension, clock)
            for key, own in entries.items()
            if key in CHANNELS
        }
        where = prefix.rstrip(".")
        if not set(JUDGED) & set(sources):
            raise self.fail(
                where,
                "names no position; say where it is: position: {topic: ..., unit: mm}, or where the coil's current "
                "is: current:",
            )
        if not {"command", "voltage"} & set(sources):
            raise self.fail(
                where,
                "names neither command nor voltage: without the coil's voltage nothing can be fitted; add one of them",
            )
        return sources

    def source(self, key: str, found: object, dimension: str, clock: str = "") -> Source:
        """Where one channel is; `clock` is that of an entry that names none."""
        if isinstance(found, str):
            found = {"topic": found} if found.startswith("/") else {"column": found}
        elif isinstance(found, int) and not isinstance(found, bool):
            found = {"column": found}
        entry = self.mapping(key, found, "{topic: ..., unit: ...} or {column: ..., unit: ...}")
        self.check_keys(key, entry, [own.name for own in fields(Source)])
        numbers = {name: self.number(f"{key}.{name}", entry[name]) for name in _NUMBERS if name in entry}
        if numbers.get("sign", 1.0) not in (1.0, -1.0):
            raise self.fail(f"{key}.sign", f"found {numbers['sign']:g}, expected 1 or -1; a factor is scale:")
        if numbers.get("scale", 1.0) <= 0.0:
            raise self.fail(
                f"{key}.scale",
                f"found {numbers['scale']:g}, expected a number above 0; sign: -1 turns the direction round",
            )
        texts = place_of(self, key, {name: entry[name] for name in _TEXTS if name in entry}, clock)
        source = Source(**texts, **numbers)  # type: ignore[arg-type] # texts and numbers by their names
        if source.unit and source.unit not in UNITS[dimension]:
            raise self.fail(f"{key}.unit", f"found {source.unit!r}, expected one of {', '.join(UNITS[dimension])}")
        return source

    def _check_kind(self, valves: Mapping[str, Mapping[str, Source]], time: TimeAxis | None) -> None:
        """A map is of a bag (topics) or of a table (columns and time)."""
        entries = [(key, source) for sources in valves.values() for key, source in sources.items()]
        columns = [key for key, source in entries if source.column]
        if columns and len(columns) < len(entries):
            topic = next(key for key, source in entries if source.topic)
            raise self.fail("", f"{columns[0]} is a column and {topic} a topic; expected all of one file")
        if columns and time is None:
            raise self.fail("", "names no time; add time: {column: ..., unit: s} or time: {rate: ...} (Hz)")
        if time is not None and not columns:
            raise self.fail("time", "is for tables; messages of a bag have their own: clock: header or clock: bag")
