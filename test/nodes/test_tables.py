"""Running nodes have the topics, services and parameters of their tables: names, types, QoS, ranges, and no others."""

from __future__ import annotations

import itertools
from collections.abc import Iterator, Sequence
from pathlib import Path
from typing import Any

import pytest

from valve_sim.nodes import profile_playing, settings, topics
from valve_sim.nodes.parameters import Table
from valve_sim.nodes.topics import Topic
from valve_sim.nodes.valve_parameters import ValveSettings
from valve_sim.station import tables as station

from .ros_process import Probe, running

pytestmark = pytest.mark.ros
pytest.importorskip("rclpy", reason="there is no ROS 2 here: rclpy cannot be imported")

import rclpy  # noqa: E402
from rcl_interfaces.srv import DescribeParameters  # noqa: E402

from valve_sim.nodes.wiring import profile  # noqa: E402

ROOT = Path(__file__).parents[2]
GAS = str(ROOT / "config" / "gas_tank_1.yaml")
ENDS = ("inlet_pressure", "demand_pressure")
ROS_OWN = ("/parameter_events", "/rosout", "/clock")
BESIDE_MEASURED = tuple(topic for topic in topics.MONITOR if "obeyed" not in topic.name)
"""A real valve says nothing of what it obeys."""
TYPES = ("not set", "bool", "integer", "double", "string", "byte array", "bool array", "integer array", "double array")


@pytest.fixture(scope="module", autouse=True)
def ros(in_own_domain: None) -> Iterator[None]:
    rclpy.init()
    yield
    rclpy.try_shutdown()


def resolved(entries: Sequence[Topic], name: str, valves: Sequence[str]) -> dict[tuple[str, str], Topic]:
    """Full name and direction of each topic of a table, for a node of this name and with these valves."""
    found = {}
    for entry, valve, end in itertools.product(entries, valves, ENDS):
        sensors = f"{valve}/measured"
        filled = entry.name.format(valve=valve, measured=f"{sensors}/joint_states", sensors=sensors, end=end)
        found[filled.replace("~", f"/{name}"), entry.direction] = entry
    return found


def offered(probe: Probe, name: str) -> dict[tuple[str, str], str]:
    """Full name, direction and type of each topic and service that a node has beside those of all nodes."""
    node, found = probe.node, {}
    for direction, ask in (
        ("out", node.get_publisher_names_and_types_by_node),
        ("in", node.get_subscriber_names_and_types_by_node),
        ("service", node.get_service_names_and_types_by_node),
    ):
        for topic, (kind, *_) in ask(name, "/"):
            if topic not in ROS_OWN and not ("parameter" in topic or "type_description" in topic):
                found[topic, direction] = kind
    return found


def qos_of(probe: Probe, name: str, topic: str, direction: str) -> Any:
    """The QoS with which a node has a topic."""
    node = probe.node
    ask = node.get_publishers_info_by_topic if direction == "out" else node.get_subscriptions_info_by_topic
    return next(entry.qos_profile for entry in ask(topic) if entry.node_name == name)


def check_parameters(probe: Probe, entries: Table) -> None:
    request = DescribeParameters.Request(names=list(entries))
    told = probe.call("describe_parameters", DescribeParameters, request).descriptors
    for descriptor, entry in zip(told, entries.values(), strict=True):
        assert (descriptor.name, descriptor.description) == (entry.name, entry.description)
        assert descriptor.read_only == entry.read_only
        wanted = "string array" if entry.type == "string array" else entry.type
        assert (*TYPES, "string array")[descriptor.type] == wanted
        ranges = [*descriptor.floating_point_range, *descriptor.integer_range]
        assert [(limits.from_value, limits.to_value) for limits in ranges] == ([entry.range] if entry.range else [])


CASES: dict[str, tuple[str, Sequence[Topic], Table, Sequence[str], Sequence[str]]] = {
    "valve_node": ("valve", (*topics.VALVE, *topics.GAS), ValveSettings.table(), ["/valve"], ["--params-file", GAS]),
    "monitor_node": (
        "monitor",
        BESIDE_MEASURED,
        settings.MonitorNodeSettings.table(),
        ["/valve"],
        ["--params-file", GAS],
    ),
    "identification_node": (
        "identification",
        topics.IDENTIFICATION,
        settings.IdentificationSettings.table(),
        ["/valve"],
        ["-p", f"bag:={ROOT / 'bags' / 'one_opening.mcap'}", "-p", "linger:=true"],
    ),
    "command_profile": (
        "command_profile",
        topics.PROFILE,
        profile_playing.ProfileSettings.table(),
        ["/valve"],
        ["-p", "patience:=600.0"],
    ),
    "dispenser_node": (
        "dispenser",
        station.DISPENSER_TOPICS,
        station.DispenserSettings.table(),
        [f"/tank_{k}/valve" for k in (1, 2, 3)],
        [],
    ),
}


@pytest.mark.parametrize("program", CASES)
def test_a_node_has_what_its_tables_say_and_nothing_else(program: str, tmp_path: Path) -> None:
    name, entries, parameters, valves, arguments = CASES[program]
    (tmp_path / "profile.csv").write_text("time,volts\n0,9\n0.01,0\n")
    own = ["-p", f"profile:={tmp_path / 'profile.csv'}"] if program == "command_profile" else []
    output = ["-p", f"output:={tmp_path}"] if program == "identification_node" else []
    wanted = resolved(entries, name, valves)
    probe = Probe(f"/{name}")
    try:
        with running(tmp_path, ["--ros-args", *arguments, *own, *output], program) as process:
            kinds = {key: entry.type for key, entry in wanted.items()}

            def is_there() -> bool:
                known = (name, "/") in probe.node.get_node_names_and_namespaces()
                return known and offered(probe, name) == kinds

            assert probe.until(is_there), (process.output, {
                key: kind for key, kind in kinds.items() if offered(probe, name).get(key) != kind
            })  # fmt: skip
            for (topic, direction), entry in wanted.items():
                if entry.qos is not None:
                    found, asked = qos_of(probe, name, topic, direction), profile(entry.qos)
                    assert (found.reliability, found.durability) == (asked.reliability, asked.durability), topic
            check_parameters(probe, parameters)
    finally:
        probe.close()
