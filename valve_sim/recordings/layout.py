"""Where a recording has each quantity: in the topics or columns that this package writes, or that a map names."""

from __future__ import annotations

from typing import TYPE_CHECKING, NamedTuple

from valve_sim.files.channels import CHANNELS, COIL, COIL_STATE, FLOAT, JOINT_STATE, JUDGED, LIVE_COIL
from valve_sim.files.recording_map import DEFAULT_VALVE, RecordingMap, Source, TimeAxis
from valve_sim.recordings.command_times import logs_among
from valve_sim.recordings.trace import TraceError

if TYPE_CHECKING:
    from collections.abc import Collection, Mapping, Sequence
    from pathlib import Path

COMMAND, MEASURED, LIVE = "coil_voltage", "measured/joint_states", "joint_states"
POSITIONS = ("position", "main_position")
OWN_COLUMNS = {key: channel.column or channel.name for key, channel in CHANNELS.items() if key != "voltage"}
"""By key, of the CSV that `valve-sim simulate` writes; its voltage is the commanded one."""
ALWAYS = ("command", "position", "main_position", "current")
"""The keys of those that every such CSV has."""


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
    def judged(self) -> tuple[str, ...]:
        """The quantities by which the valve can be judged: the first that holds a number.

        A CSV of this package has a column without numbers where no position was measured.
        """
        recorded = tuple(key for key in JUDGED if key in self.sources)
        return recorded if not self.map_path and any(self.sources[key].column for key in recorded) else recorded[:1]

    @property
    def input(self) -> str:
        """The quantity that says what the coil was given."""
        return "command" if "command" in self.sources else "voltage"

    def places(self, key: str) -> tuple[Source, ...]:
        """Where a quantity may be, the place that counts first."""
        return tuple(found[key] for found in (self.sources, self.others) if key in found)

    @property
    def fields(self) -> dict[str, set[str]]:
        """The topics to read, and the fields to keep of each."""
        found = {log: {"voltage"} for log in self.logs}
        for source in (*self.sources.values(), *self.others.values()):
            found.setdefault(source.topic, set()).add(source.path)
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
    ends = (COIL,) if measured in types or _has_current(name, types) else (COIL, LIVE_COIL)
    coil = next((topic for end in ends if (topic := topic_of(name, end)) in types), "")
    if command not in types and not coil:
        raise TraceError(
            f"{path}: topic {command} is missing: without the commanded voltage nothing can be fitted; record it"
        )
    is_measured_coil = coil == topic_of(name, COIL)
    positions = measured if measured in types or is_measured_coil else live
    pressure = _measured_topic(name, "outlet_pressure")
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
    # A node's coil belongs to a node's positions; beside measured ones it is another valve's.
    without = {LIVE_COIL} if coil != topic_of(name, LIVE_COIL) else set()
    found = _recorded_places(name, types, without, with_nodes=is_live and not is_measured_coil)
    sources = {key: places[0] for key, places in found.items()}
    others = {key: places[1] for key, places in found.items() if places[0].type == COIL_STATE and len(places) > 1}
    ignored = live if live in types and is_measured_coil and is_live else ""
    return Plan(name, sources, is_live and positions in types, logs=logs_among(types), others=others, ignored=ignored)


def _measured_topic(valve: str, key: str) -> str:
    """The topic in which a channel is recorded by its own sensor."""
    place = CHANNELS[key].own_topic
    assert place is not None
    return topic_of(valve, place.topic)


def _has_current(valve: str, types: Mapping[str, str]) -> bool:
    return _measured_topic(valve, "current") in types


def _recorded_places(
    valve: str, types: Mapping[str, str], without: Collection[str], *, with_nodes: bool
) -> dict[str, list[Source]]:
    """Where each channel is recorded, the place that counts first, by key.

    Args:
        without: Topics below the valve's name that do not count. with_nodes: Whether what a node computes counts.
    """
    found: dict[str, list[Source]] = {}
    for key, channel in CHANNELS.items():
        # A command says nothing of when it was sent: it counts from when it was recorded.
        clock = "bag" if channel.role == "command" else ""
        for place in channel.places:
            topic = topic_of(valve, place.topic)
            if topic in types and place.topic not in without and (with_nodes or not place.by_node):
                source = Source(topic, place.field, place.joint, type=place.message_type, clock=clock)
                found.setdefault(key, []).append(source)
    return found


def check_topic(path: Path, where: str, topic: str, types: Collection[str]) -> None:
    """Refuse a topic that is not in a bag; `where` is the map and its key, for the message."""
    if topic not in types:
        found = ", ".join(sorted(types)) or "no topic"
        raise TraceError(f"{where}: topic {topic} is not in {path}; it has {found}; name one of these")


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
        check_topic(path, f"{where}.topic", source.topic, types)
        if source.type and source.type != types[source.topic]:
            raise TraceError(
                f"{where}: topic {source.topic} is {types[source.topic]}, expected {source.type}; correct type:"
            )
    return Plan(name, sources, map_path=recording_map.path)


def has_own_columns(names: Collection[str]) -> bool:
    """Whether a table has the columns of `valve-sim simulate`."""
    return {"time", *(OWN_COLUMNS[key] for key in ALWAYS)} <= set(names)


def table_plan(
    path: Path, names: Sequence[str], valve: str | None, recording_map: RecordingMap | None
) -> tuple[Plan, TimeAxis]:
    """The columns that a map names, or those of `valve-sim simulate`, and where the times of their rows are.

    Raises:
        ValveError: The map has no such valve, or names topics; without one, nobody knows which column is what.
    """
    if recording_map is None:
        if not has_own_columns(names):
            listed = ", ".join(names[:12])
            raise TraceError(
                f"{path}: is not a recording of ROS topics but a table ({listed}); say with --map which column is "
                f"what, valve-sim map {path} writes a first map"
            )
        own = {key: Source(column=column) for key, column in OWN_COLUMNS.items() if column in names}
        return Plan(RecordingMap(str(path), {DEFAULT_VALVE: own}).choose(valve)[0], own), TimeAxis(("time",))
    name, sources = recording_map.choose(valve)
    if recording_map.time is None:
        topic = next(iter(sources.values())).topic
        raise TraceError(
            f"{recording_map.path}: names the topic {topic}, but {path} is a table; give column: in its place"
        )
    return Plan(name, sources, map_path=recording_map.path), recording_map.time


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
