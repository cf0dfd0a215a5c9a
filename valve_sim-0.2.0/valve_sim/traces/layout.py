"""Where a recording has each quantity: in the topics that this package writes, or in those that a map names."""

from __future__ import annotations

from typing import TYPE_CHECKING, NamedTuple

from valve_sim.files.recording_map import RecordingMap, Source
from valve_sim.traces.command_log import logs_among
from valve_sim.traces.errors import TraceError

if TYPE_CHECKING:
    from collections.abc import Mapping
    from pathlib import Path

FLOAT = "std_msgs/msg/Float64"
JOINT_STATE = "sensor_msgs/msg/JointState"
COMMAND = "coil_voltage"
MEASURED = "measured/joint_states"
LIVE = "joint_states"
COIL = "measured/coil"
LIVE_COIL = "coil"
COIL_STATE = "sensor_msgs/msg/BatteryState"
"""Of both: `current` and `voltage` at the coil's terminals, `temperature`; NaN where it was not measured."""
PILOT = "pilot_plunger"
MAIN = "main_plunger"

POSITIONS = ("position", "main_position")
INPUTS = ("command", "voltage")
JUDGED = ("position", "current", "outlet_pressure")
"""By which of these a valve is judged: the first that is recorded."""
SIGNALS = {
    "current": "coil_current",
    "acceleration": "acceleration",
    "pressure": "inlet_pressure",
    "outlet_pressure": "outlet_pressure",
    "demand_pressure": "demand_pressure",
    "temperature": "coil_temperature",
    "voltage": "coil_voltage",
}
"""What a map calls a quantity, and what a trace calls it."""


class Channel(NamedTuple):
    """An optional quantity: where it is recorded, as what, and under which field."""

    topic: str
    message_type: str
    path: str


PRESSURE = "sensor_msgs/msg/FluidPressure"
CHANNELS = {
    "coil_current": Channel("measured/coil_current", FLOAT, "data"),
    "acceleration": Channel("measured/acceleration", "sensor_msgs/msg/Imu", "linear_acceleration.x"),
    "inlet_pressure": Channel("measured/inlet_pressure", PRESSURE, "fluid_pressure"),
    "outlet_pressure": Channel("measured/outlet_pressure", PRESSURE, "fluid_pressure"),
    "demand_pressure": Channel("measured/demand_pressure", PRESSURE, "fluid_pressure"),
    "coil_temperature": Channel("measured/coil_temperature", "sensor_msgs/msg/Temperature", "temperature"),
}
_ENDS = ("inlet_pressure", "demand_pressure")
OBEYED = {name: Channel(f"obeyed/{name}", PRESSURE, "fluid_pressure") for name in _ENDS}
"""What a node obeys of the pressures at a valve's ends, and from when on; read where they were not measured."""
TOLD = {name: Channel(name, PRESSURE, "fluid_pressure") for name in _ENDS}
"""What a node is told of them; read where that was not recorded."""
NODE_OUTPUTS = {
    "coil_current": Channel("coil_current", FLOAT, "data"),
    "outlet_pressure": Channel("outlet_pressure", PRESSURE, "fluid_pressure"),
}
"""What a node publishes; read, beside its positions, where it was not measured."""


class Plan(NamedTuple):
    """What is to be read of one valve.

    Attributes:
        valve: Its name.
        sources: Quantity (of a map) to where it is.
        is_live: Whether a node's own output stands in for measured positions.
        map_path: The map that says so; empty for the topics of this package.
        logs: Topics in which nodes stamped the commands that they sent, to whichever valve.
        others: Quantity to where else it may be, if it is nowhere in its source.
        ignored: A node's positions that were not taken for measured ones; empty for none.
    """

    valve: str
    sources: Mapping[str, Source]
    is_live: bool = False
    map_path: str = ""
    logs: tuple[str, ...] = ()
    others: Mapping[str, Source] = {}
    ignored: str = ""

    @property
    def has_positions(self) -> bool:
        """Whether positions are recorded; else the current or the outlet's pressure must be."""
        return "position" in self.sources

    @property
    def primary_signal(self) -> str:
        """The quantity by which the valve is judged."""
        return next((key for key in JUDGED if key in self.sources), JUDGED[-1])

    @property
    def fields(self) -> dict[str, frozenset[str] | None]:
        """The topics to read, and the fields to keep of each; None: all."""
        found: dict[str, frozenset[str] | None] = {log: frozenset({"voltage"}) for log in self.logs}
        for source in (*self.sources.values(), *self.others.values()):
            path = source.field or ("position" if source.joint else None)
            known = found.get(source.topic, frozenset())
            # A place in a list ("position[0]") is kept with its list.
            found[source.topic] = None if path is None or known is None else known | {path, path.partition("[")[0]}
        return found


def valves_among(types: Mapping[str, str]) -> tuple[str, ...]:
    """A valve is known by its command, its measured positions or its coil; joint states alone may be anybody's."""
    names = {
        topic[: -len(end) - 1] for topic in types for end in (COMMAND, MEASURED, COIL) if topic.endswith("/" + end)
    }
    live = f"/{LIVE_COIL}"
    names |= {
        topic[: -len(live)]
        for topic, kind in types.items()
        if kind == COIL_STATE and topic.endswith(live) and not topic.endswith("/" + COIL)
    }
    return tuple(sorted(name or "/" for name in names))


def topic_of(valve: str, name: str) -> str:
    """A topic below a valve's name."""
    return f"{valve.rstrip('/')}/{name}"


def standard_plan(path: Path, valve: str | None, types: Mapping[str, str]) -> Plan:
    """The topics of this package, as far as they are recorded.

    Raises:
        TraceError: There is no such valve, or a topic that it needs is missing or of another type.
    """
    name = _choose_valve(path, valve, types)
    command, measured, live = (topic_of(name, end) for end in (COMMAND, MEASURED, LIVE))
    # A node's coil belongs to a node's positions; beside measured ones it is another valve's.
    ends = (COIL,) if measured in types or _has_current(name, types) else (COIL, LIVE_COIL)
    coil = next((topic for end in ends if (topic := topic_of(name, end)) in types), "")
    if command not in types and not coil:
        raise TraceError(
            f"{path}: topic {command} is missing: without the commanded voltage nothing can be fitted; record it"
        )
    is_measured_coil = coil == topic_of(name, COIL)
    positions = measured if measured in types or is_measured_coil else live
    pressure = topic_of(name, CHANNELS["outlet_pressure"].topic)
    if positions not in types and not coil and not _has_current(name, types) and pressure not in types:
        raise TraceError(
            f"{path}: neither {measured} nor {live} is in it, nor the coil's current ({topic_of(name, COIL)}); record "
            f"the measured positions or the current (or, with gas, {pressure})"
        )
    expected = {command: FLOAT, positions: JOINT_STATE, coil: COIL_STATE}
    for topic, kind in expected.items():
        if topic in types and types[topic] != kind:
            raise TraceError(f"{path}: topic {topic} is {types[topic]}, expected {kind}; publish it as that")
    is_live = measured not in types
    sources: dict[str, Source] = {}
    if command in types:
        sources["command"] = Source(command, "data", type=FLOAT, clock="bag")
    if positions in types:
        sources["position"] = Source(positions, "position", PILOT, type=JOINT_STATE)
        sources["main_position"] = Source(positions, "position", MAIN, type=JOINT_STATE)
    others = _optional(name, types, is_live=is_live and not is_measured_coil)
    if coil:
        sources |= {key: Source(coil, key, type=COIL_STATE) for key in ("voltage", "current", "temperature")}
        if is_measured_coil and "temperature" in others:
            sources["temperature"] = others.pop("temperature")
    sources = {**others, **sources}
    others = {key: source for key, source in others.items() if sources[key] != source}
    ignored = live if live in types and is_measured_coil and is_live else ""
    return Plan(name, sources, is_live and positions in types, logs=logs_among(types), others=others, ignored=ignored)


def _has_current(valve: str, types: Mapping[str, str]) -> bool:
    return topic_of(valve, CHANNELS["coil_current"].topic) in types


def _optional(valve: str, types: Mapping[str, str], *, is_live: bool) -> dict[str, Source]:
    """What is recorded in topics of its own, by quantity."""
    of_node = NODE_OUTPUTS if is_live else {}
    found = {}
    for key, attribute in SIGNALS.items():
        for channel in (known.get(attribute) for known in (CHANNELS, OBEYED, TOLD, of_node)):
            if channel is not None and (topic := topic_of(valve, channel.topic)) in types:
                found[key] = Source(topic, channel.path, type=channel.message_type)
                break
    return found


def mapped_plan(path: Path, valve: str | None, recording_map: RecordingMap, types: Mapping[str, str]) -> Plan:
    """What a map names, all of which must be recorded.

    Raises:
        ValveError: The map has no such valve, or names columns, or topics that are not there or of another type.
    """
    name, sources = recording_map.choose(valve)
    for key, source in sources.items():
        where = f"{recording_map.path}: {key}"
        if source.column:
            raise TraceError(f"{where}: names a column, but {path} is a bag of topics; give topic: in its place")
        if source.topic not in types:
            found = ", ".join(sorted(types)) or "no topic"
            raise TraceError(f"{where}: topic {source.topic} is not in {path}; it has {found}; name one of these")
        if source.type and source.type != types[source.topic]:
            raise TraceError(
                f"{where}: topic {source.topic} is {types[source.topic]}, expected {source.type}; correct type:"
            )
    return Plan(name, sources, map_path=recording_map.path)


def _choose_valve(path: Path, valve: str | None, types: Mapping[str, str]) -> str:
    valves = valves_among(types)
    if not valves:
        found = ", ".join(sorted(types)[:8]) or "none"
        raise TraceError(
            f"{path}: no valve in it: no topic ends with /{COMMAND} or /{MEASURED}; topics: {found}; record those two "
            f"(or /{COIL} in place of the latter), or say with --map which topic is what (valve-sim map writes a first "
            "map)"
        )
    if valve is None:
        if len(valves) > 1:
            raise TraceError(f"{path}: holds several valves ({', '.join(valves)}); choose one with --valve")
        return valves[0]
    name = "/" + valve.strip("/")
    if name not in valves:
        raise TraceError(f"{path}: holds no valve {name}; it holds {', '.join(valves)}; choose one with --valve")
    return name
