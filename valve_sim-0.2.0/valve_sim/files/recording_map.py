"""Maps of foreign recordings: which topic, field or column is which quantity, in which unit, by which clock.

    clock: header
    position: {topic: /lvdt, unit: mm, sign: -1, offset: 12.5}
    voltage: {topic: /daq, field: "channels[2].value", scale: 10}

A reading becomes SI as unit × (sign × scale × reading + offset). A map is read and checked once, here; whether the
recording has what it names is checked when the recording is read. A static table of force has a map of the same form.
"""

from __future__ import annotations

import difflib
import math
from collections.abc import Mapping, Sequence
from dataclasses import dataclass, field, fields, replace
from pathlib import Path
from typing import TYPE_CHECKING, Any, Final, NamedTuple

from valve_sim.files.yaml_files import read_yaml
from valve_sim.model.core.own.units import Unit, parse_unit
from valve_sim.model.errors import ValveError

if TYPE_CHECKING:
    import numpy as np
    from numpy.typing import NDArray


class MapError(ValveError):
    """A map cannot be used: one line that names the file and the key, what was found and what is expected."""


_ALLOWED: Final[Mapping[str, Sequence[str]]] = {
    "voltage": ("V", "mV", "kV"),
    "length": ("m", "cm", "mm", "um", "µm", "nm", "in"),
    "current": ("A", "mA", "uA", "µA"),
    "acceleration": ("m/s2", "m/s²", "mm/s2", "g"),
    "pressure": ("Pa", "hPa", "mbar", "kPa", "bar", "MPa", "psi"),
    "force": ("N", "mN", "kN", "kgf", "lbf"),
    "temperature": ("degC", "°C", "K"),
    "time": ("s", "ms", "us", "µs", "ns", "min"),
}
CELSIUS: Final = 273.15
"""K, of 0 °C: a valve's temperatures are in °C."""


def _unit(name: str, dimension: str) -> Unit:
    """A unit as a quantity of this dimension has it: g is a mass elsewhere, and temperatures are in °C here."""
    unit = parse_unit("g0" if (name, dimension) == ("g", "acceleration") else name)
    return unit._replace(zero=unit.zero - CELSIUS) if dimension == "temperature" else unit


UNITS: Final[Mapping[str, Mapping[str, Unit]]] = {
    dimension: {name: _unit(name, dimension) for name in names} for dimension, names in _ALLOWED.items()
}
"""Units by dimension; the first of each is the default."""


class Quantity(NamedTuple):
    """A quantity that a recording can hold: its dimension, and its name for people."""

    dimension: str
    meaning: str


QUANTITIES: Final[Mapping[str, Quantity]] = {
    "command": Quantity("voltage", "commanded voltage, held until the next message or row"),
    "voltage": Quantity("voltage", "measured at the coil: the input; without a command, its steps are the commands"),
    "position": Quantity("length", "pilot plunger, 0 where the valve is closed, positive towards the core"),
    "main_position": Quantity("length", "main plunger"),
    "current": Quantity("current", "coil current"),
    "acceleration": Quantity("acceleration", "along the axis"),
    "pressure": Quantity("pressure", "inlet pressure, absolute"),
    "outlet_pressure": Quantity("pressure", "behind a valve with gas, absolute"),
    "demand_pressure": Quantity("pressure", "behind the demand's orifice of such a valve, absolute"),
    "temperature": Quantity("temperature", "of the coil"),
}
FORCE_QUANTITIES: Final[Mapping[str, Quantity]] = {
    "displacement": Quantity("length", "of the plunger from its seat, positive towards the core"),
    "force": Quantity("force", "with which the coil attracts the plunger"),
}
"""Quantities of a static table, from load cell and stage."""
MOST_AVERAGED: Final = 1000
"""Readings: a sensor that averages more shows no stroke."""
OF_ANOTHER: Final = "; if it is of a machine that is no valve, give --plant to identify, diagnose, validate or simulate"
"""Of a map with keys that no valve has."""
CLOCKS: Final = ("header", "bag")
DEFAULT_VALVE: Final = "/valve"
_OTHER_KEYS: Final = ("sensor", "clock", "time", "valve", "valves")
_TEXTS: Final = ("topic", "field", "joint", "column", "type", "unit", "clock")


@dataclass(frozen=True)
class Source:
    """Where one quantity is recorded, and what its numbers mean.

    Attributes:
        topic: of a bag.
        field: dotted path in the message, "point.z" or "position[2]"; empty: its only number.
        joint: of a JointState, in place of an index into `field` (default position).
        column: name or number (from 1) of a table's column.
        type: of the message, needed by live nodes only where it cannot be told from `joint`.
        unit: one of `UNITS` of the quantity's dimension.
        scale: of a divider or probe. sign: 1 or −1. offset: in `unit`, added last.
        clock: "header", "bag", or empty: the stamp of the message where it has one.
    """

    topic: str = ""
    field: str = ""
    joint: str = ""
    column: str = ""
    type: str = ""
    unit: str = ""
    scale: float = 1.0
    sign: float = 1.0
    offset: float = 0.0
    clock: str = ""

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
    """The times of a table's rows: from a column, or by a known rate (Hz)."""

    column: str = ""
    unit: str = "s"
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
        valves: valve's name ("/tank_1/valve") to quantity (of `QUANTITIES`) to where it is.
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
    return all(name in QUANTITIES or name in _OTHER_KEYS for name in found)


def map_from(found: object, path: str) -> RecordingMap:
    """Check what a map's YAML holds; errors as `load_map`."""
    if not isinstance(found, Mapping) or not found:
        raise MapError(
            f"{path}: found {_short(found)}; expected keys such as position: {{topic: ..., unit: mm}}; "
            "valve-sim map RECORDING writes a first one"
        )
    _check_keys(found, [*QUANTITIES, *_OTHER_KEYS], path, "", OF_ANOTHER)
    clock = _clock(found.get("clock", ""), f"{path}: clock")
    time = _time_axis(found["time"], f"{path}: time") if "time" in found else None
    if "valves" in found:
        alone = [key for key in found if key in QUANTITIES or key in ("valve", "sensor")]
        if alone:
            raise MapError(f"{path}: {alone[0]}: found beside valves:; expected it below one of them")
        valves = _named_valves(found["valves"], clock, path)
        sensors = {_absolute(name): _sensor(own, path, f"valves.{name}.") for name, own in found["valves"].items()}
    else:
        name = found.get("valve", DEFAULT_VALVE)
        if not isinstance(name, str) or not name.strip("/"):
            raise MapError(f"{path}: valve: found {_short(name)}, expected a name such as {DEFAULT_VALVE}")
        entries = {key: value for key, value in found.items() if key in QUANTITIES}
        valves = {_absolute(name): _sources(entries, clock, path, "")}
        sensors = {_absolute(name): _sensor(found, path, "")}
    _check_kind(valves, time, path)
    return RecordingMap(path, valves, time, sensors)


def load_force_map(path: Path | str) -> Mapping[str, Source]:
    """Read and check the map of a static table: the column of each of `FORCE_QUANTITIES`.

    Raises:
        MapError: it cannot be read, names no column for one of them, or a key, unit or value in it is invalid.
    """
    found = read_yaml(path, "expected a map such as displacement: {column: Weg, unit: mm}", MapError)
    if not isinstance(found, Mapping):
        raise MapError(f"{path}: found {_short(found)}; expected displacement: and force: with the column of each")
    _check_keys(found, list(FORCE_QUANTITIES), str(path), "")
    for key, quantity in FORCE_QUANTITIES.items():
        if key not in found:
            raise MapError(
                f"{path}: names no {key}; add {key}: {{column: ..., unit: {next(iter(UNITS[quantity[0]]))}}}"
            )
    sources = {
        key: _source(quantity.dimension, found[key], "", f"{path}: {key}") for key, quantity in FORCE_QUANTITIES.items()
    }
    for key, source in sources.items():
        if source.topic:
            raise MapError(f"{path}: {key}.topic: found {source.topic}; a table has columns: give column: in its place")
    return sources


def _named_valves(found: object, clock: str, path: str) -> dict[str, Mapping[str, Source]]:
    if not isinstance(found, Mapping) or not found:
        raise MapError(f"{path}: valves: found {_short(found)}, expected names and what is recorded of each")
    valves: dict[str, Mapping[str, Source]] = {}
    for name, entries in found.items():
        if not isinstance(entries, Mapping):
            raise MapError(f"{path}: valves.{name}: found {_short(entries)}, expected keys such as position:")
        _check_keys(entries, [*QUANTITIES, "sensor"], path, f"valves.{name}.")
        own = {key: value for key, value in entries.items() if key in QUANTITIES}
        valves[_absolute(name)] = _sources(own, clock, path, f"valves.{name}.")
    return valves


def _absolute(name: object) -> str:
    """A valve's name, as its topics begin."""
    return "/" + str(name).strip("/")


def _sensor(entries: Mapping[Any, Any], path: str, prefix: str) -> DeclaredSensor:
    """What the entry of a valve says of its position sensor."""
    found, where = entries.get("sensor", {}), f"{path}: {prefix}"
    if not isinstance(found, Mapping):
        raise MapError(f"{where}sensor: found {_short(found)}, expected {{averaging: 10}} or {{bandwidth: 500}}")
    if "sensor" in entries and "position" not in entries:
        raise MapError(
            f"{where}sensor: is that of the position, of which the map names none; add position: or take it out"
        )
    _check_keys(found, ["averaging", "bandwidth"], path, f"{prefix}sensor.")
    count = found.get("averaging", 1)
    if isinstance(count, bool) or not isinstance(count, int) or not 1 <= count <= MOST_AVERAGED:
        raise MapError(
            f"{where}sensor.averaging: found {_short(count)}, expected a whole number of readings from 1 to "
            f"{MOST_AVERAGED}"
        )
    bandwidth = found.get("bandwidth", math.inf)
    if isinstance(bandwidth, bool) or not isinstance(bandwidth, int | float) or not bandwidth >= 1.0:
        raise MapError(f"{where}sensor.bandwidth: found {_short(bandwidth)}, expected a frequency in Hz from 1 on")
    return DeclaredSensor(count, float(bandwidth))


def _sources(entries: Mapping[Any, Any], clock: str, path: str, prefix: str) -> Mapping[str, Source]:
    sources = {
        key: _source(QUANTITIES[key].dimension, value, clock, f"{path}: {prefix}{key}")
        for key, value in entries.items()
    }
    where = f"{path}: {prefix.rstrip('.')}: " if prefix else f"{path}: "
    if not {"position", "current", "outlet_pressure"} & set(sources):
        raise MapError(
            f"{where}names no position; say where it is: position: {{topic: ..., unit: mm}}, or where the coil's "
            "current is: current:"
        )
    inputs = [key for key in ("command", "voltage") if key in sources]
    if not inputs:
        raise MapError(
            f"{where}names neither command nor voltage: without the coil's voltage nothing can be fitted; "
            "add one of them"
        )
    return sources


def _source(dimension: str, found: object, clock: str, where: str) -> Source:
    if isinstance(found, str):
        found = {"topic": found} if found.startswith("/") else {"column": found}
    elif isinstance(found, int) and not isinstance(found, bool):
        found = {"column": found}
    if not isinstance(found, Mapping):
        raise MapError(
            f"{where}: found {_short(found)}, expected {{topic: ..., unit: ...}} or {{column: ..., unit: ...}}"
        )
    names = [entry.name for entry in fields(Source)]
    _check_keys(found, names, where, "")
    values: dict[str, Any] = {}
    for name, value in found.items():
        values[name] = (
            _text(name, value, f"{where}.{name}") if name in _TEXTS else _number(name, value, f"{where}.{name}")
        )
    source = Source(**values)
    if source.unit and source.unit not in UNITS[dimension]:
        raise MapError(f"{where}.unit: found {source.unit!r}, expected one of {', '.join(UNITS[dimension])}")
    if bool(source.topic) == bool(source.column):
        raise MapError(
            f"{where}: found {_short(dict(found))}, expected either topic: (of a bag) or column: (of a table)"
        )
    if source.topic and not source.topic.startswith("/"):
        raise MapError(f"{where}.topic: found {source.topic!r}, expected a name that begins with /")
    if source.joint and "[" in source.field:
        raise MapError(f"{where}: has joint {source.joint} and field {source.field}; give the joint or the index")
    return source if source.clock else replace(source, clock=clock)


def _check_kind(valves: Mapping[str, Mapping[str, Source]], time: TimeAxis | None, path: str) -> None:
    """A map is of a bag (topics) or of a table (columns and time)."""
    entries = [(key, source) for sources in valves.values() for key, source in sources.items()]
    columns = [key for key, source in entries if source.column]
    if columns and len(columns) < len(entries):
        topic = next(key for key, source in entries if source.topic)
        raise MapError(f"{path}: {columns[0]} is a column and {topic} a topic; expected all of one file")
    if columns and time is None:
        raise MapError(f"{path}: names no time; add time: {{column: ..., unit: s}} or time: {{rate: ...}} (Hz)")
    if time is not None and not columns:
        raise MapError(f"{path}: time: is for tables; messages of a bag have their own: clock: header or clock: bag")


def _time_axis(found: object, where: str) -> TimeAxis:
    if isinstance(found, str | int) and not isinstance(found, bool):
        found = {"column": found}
    if not isinstance(found, Mapping):
        raise MapError(f"{where}: found {_short(found)}, expected {{column: ..., unit: s}} or {{rate: ...}}")
    _check_keys(found, ["column", "unit", "rate"], where, "")
    column = _text("column", found.get("column", ""), f"{where}.column")
    unit = found.get("unit", "s")
    if unit not in UNITS["time"]:
        raise MapError(f"{where}.unit: found {unit!r}, expected one of {', '.join(UNITS['time'])}")
    rate = _number("rate", found.get("rate", 0.0), f"{where}.rate") if "rate" in found else 0.0
    if bool(column) == ("rate" in found):
        raise MapError(f"{where}: found {_short(dict(found))}, expected either column: or rate:")
    if rate < 0.0 or ("rate" in found and rate == 0.0):
        raise MapError(f"{where}.rate: found {rate:g}, expected a number of rows a second above 0")
    return TimeAxis(column, str(unit), rate)


def _text(name: str, value: object, where: str) -> str:
    if name == "column" and isinstance(value, int) and not isinstance(value, bool):
        value = str(value)
    if not isinstance(value, str):
        raise MapError(f"{where}: found {_short(value)}, expected text")
    return _clock(value, where) if name == "clock" else value.strip()


def _clock(value: object, where: str) -> str:
    if value != "" and value not in CLOCKS:
        raise MapError(f"{where}: found {_short(value)}, expected {' or '.join(CLOCKS)}")
    return str(value)


def _number(name: str, value: object, where: str) -> float:
    if isinstance(value, bool) or not isinstance(value, int | float) or not math.isfinite(value):
        raise MapError(f"{where}: found {_short(value)}, expected a finite number")
    if name == "sign" and value not in (1, -1):
        raise MapError(f"{where}: found {value:g}, expected 1 or -1; a factor is scale:")
    if name == "scale" and value <= 0:
        raise MapError(f"{where}: found {value:g}, expected a number above 0; sign: -1 turns the direction round")
    return float(value)


def _check_keys(found: Mapping[Any, Any], known: Sequence[str], where: str, prefix: str, hint: str = "") -> None:
    for key in found:
        if key not in known:
            alike = difflib.get_close_matches(str(key), known, n=1, cutoff=0.6)
            mend = f"did you mean {alike[0]}? " if alike else ""
            raise MapError(f"{where}: {prefix}{key}: unknown key; {mend}expected one of {', '.join(known)}{hint}")


def _short(value: object) -> str:
    text = "nothing" if value is None else repr(value)
    return text if len(text) <= 60 else f"{text[:57]}..."
