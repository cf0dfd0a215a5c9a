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
PILOT = "pilot_plunger"
MAIN = "main_plunger"

POSITIONS = ("position", "main_position")
INPUTS = ("command", "voltage")
SIGNALS = {
    "current": "coil_current",
    "acceleration": "acceleration",
    "pressure": "inlet_pressure",
    "temperature": "coil_temperature",
}
"""What a map calls a quantity, and what a trace calls it."""


class Channel(NamedTuple):
    """An optional quantity: where it is recorded, as what, and under which field."""

    topic: str
    message_type: str
    path: str


CHANNELS = {
    "coil_current": Channel("measured/coil_current", FLOAT, "data"),
    "acceleration": Channel("measured/acceleration", "sensor_msgs/msg/Imu", "linear_acceleration.x"),
    "inlet_pressure": Channel("measured/inlet_pressure", "sensor_msgs/msg/FluidPressure", "fluid_pressure"),
    "coil_temperature": Channel("measured/coil_temperature", "sensor_msgs/msg/Temperature", "temperature"),
}
LIVE_CURRENT = Channel("coil_current", FLOAT, "data")


class Plan(NamedTuple):
    """What is to be read of one valve.

    Attributes:
        valve: Its name.
        sources: Quantity (of a map) to where it is.
        is_live: Whether a node's own output stands in for measured positions.
        map_path: The map that says so; empty for the topics of this package.
        logs: Topics in which nodes stamped the commands that they sent, to whichever valve.
    """

    valve: str
    sources: Mapping[str, Source]
    is_live: bool = False
    map_path: str = ""
    logs: tuple[str, ...] = ()

    @property
    def fields(self) -> dict[str, frozenset[str] | None]:
        """The topics to read, and the fields to keep of each; None: all."""
        found: dict[str, frozenset[str] | None] = {log: frozenset({"voltage"}) for log in self.logs}
        for source in self.sources.values():
            path = source.field or ("position" if source.joint else None)
            known = found.get(source.topic, frozenset())
            # A place in a list ("position[0]") is kept with its list.
            found[source.topic] = None if path is None or known is None else known | {path, path.partition("[")[0]}
        return found


def valves_among(types: Mapping[str, str]) -> tuple[str, ...]:
    """A valve is known by its command or its measured positions; joint states alone may be anybody's."""
    names = {topic[: -len(end) - 1] for topic in types for end in (COMMAND, MEASURED) if topic.endswith("/" + end)}
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
    if command not in types:
        raise TraceError(
            f"{path}: topic {command} is missing: without the commanded voltage nothing can be fitted; record it"
        )
    positions = measured if measured in types else live
    if positions not in types:
        raise TraceError(f"{path}: neither {measured} nor {live} is in it; record the measured positions")
    for topic, expected in ((command, FLOAT), (positions, JOINT_STATE)):
        if types[topic] != expected:
            raise TraceError(f"{path}: topic {topic} is {types[topic]}, expected {expected}; publish it as that")
    channels = dict(CHANNELS)
    is_live = measured not in types
    if is_live and topic_of(name, CHANNELS["coil_current"].topic) not in types:
        channels["coil_current"] = LIVE_CURRENT
    sources = {
        "command": Source(command, "data", type=FLOAT, clock="bag"),
        "position": Source(positions, "position", PILOT, type=JOINT_STATE),
        "main_position": Source(positions, "position", MAIN, type=JOINT_STATE),
    }
    for key, attribute in SIGNALS.items():
        channel = channels[attribute]
        topic = topic_of(name, channel.topic)
        if topic in types:
            sources[key] = Source(topic, channel.path, type=channel.message_type)
    return Plan(name, sources, is_live, logs=logs_among(types))


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
            f"{path}: no valve in it: no topic ends with /{COMMAND} or /{MEASURED}; topics: {found}; record those two, "
            "or say with --map which topic is what (valve-sim map writes a first map)"
        )
    if valve is None:
        if len(valves) > 1:
            raise TraceError(f"{path}: holds several valves ({', '.join(valves)}); choose one with --valve")
        return valves[0]
    name = "/" + valve.strip("/")
    if name not in valves:
        raise TraceError(f"{path}: holds no valve {name}; it holds {', '.join(valves)}; choose one with --valve")
    return name
