"""Running nodes have the topics, services and parameters of their tables: names, types, QoS, ranges, and no others.

Those of a station have the rights of config/sros2/station.policy.xml: each may do what it does, and nothing else.
"""

from __future__ import annotations

import importlib.util
import itertools
import os
import subprocess
import sys
from collections.abc import Iterator, Sequence
from pathlib import Path
from typing import Any, NamedTuple
from xml.etree import ElementTree

import pytest

from nodes.ros import DescribeParameters
from valve_sim.nodes import topics
from valve_sim.nodes.parameters import NodeSettings, Table
from valve_sim.nodes.profile_playing import ProfileSettings
from valve_sim.nodes.settings import IdentificationSettings, MonitorNodeSettings
from valve_sim.nodes.topics import Topic
from valve_sim.nodes.valve_parameters import ValveSettings
from valve_sim.nodes.wiring import profile
from valve_sim.station import tables as station

from .ros_process import Probe, free_port, running

pytestmark = [pytest.mark.ros, pytest.mark.usefixtures("ros")]

ROOT = Path(__file__).parents[2]
POLICY = ROOT / "config" / "sros2" / "station.policy.xml"
GAS = f"--params-file {ROOT / 'config' / 'gas_tank_1.yaml'}"
TANKS = ("tank_1", "tank_2", "tank_3")
LISTS = {name: f"-p {name}s:=[{','.join(f'{tank}/{name}' for tank in TANKS)}]" for name in ("valve", "monitor")}
OF_ALL = ("/parameter_events", "/rosout", "/clock")
DIRECTIONS = {"publisher": "out", "subscriber": "in", "service": "service", "client": "client"}
"""Words of the graph, and those of the tables."""
RIGHTS = {"publish": "out", "subscribe": "in", "reply": "service", "request": "client"}
"""Words of a policy, and those of the tables."""
TYPES = ("not set", "bool", "integer", "double", "string", "byte array", "bool array", "integer array", "double array")
Names = dict[tuple[str, str], str]
"""Full name and direction of topics and services to their types."""


class Case(NamedTuple):
    """A program: the node's name, its tables, names that stand for words in braces, and what it is started with.

    A valve and its monitor are those of a tank of the station.
    """

    name: str
    topics: Sequence[Topic]
    settings: type[NodeSettings]
    arguments: str
    needs: str = "rclpy"

    @property
    def valves(self) -> list[str]:
        if "/" in self.name[1:]:
            return ["/tank_1/valve"]
        return [f"/{tank}/valve" for tank in TANKS] if self.name in RIGHTS_BY_NODE else ["/valve"]


def rights_of(entry: ElementTree.Element) -> Iterator[tuple[str, str]]:
    namespace, node = entry.attrib["ns"].rstrip("/"), entry.attrib["node"]
    for group in entry:
        for right in set(group.attrib) & RIGHTS.keys():
            for named in group:
                name = (named.text or "").replace("~", f"{namespace}/{node}")
                yield name if name.startswith("/") else f"{namespace}/{name}", RIGHTS[right]


RIGHTS_BY_NODE = {
    f"{entry.attrib['ns'].rstrip('/')}/{entry.attrib['node']}": set(rights_of(entry))
    for entry in ElementTree.parse(POLICY).getroot().iter("profile")
}

CASES = {
    "valve_node": Case("/tank_1/valve", (*topics.VALVE, *topics.GAS), ValveSettings, GAS),
    "monitor_node": Case("/tank_1/monitor", topics.MONITOR, MonitorNodeSettings, f"{GAS} -p measured:=joint_states"),
    "identification_node": Case(
        "/identification", topics.IDENTIFICATION, IdentificationSettings,
        f"-p bag:={ROOT / 'bags' / 'one_opening.mcap'} -p linger:=true -p output:={{folder}}",
    ),
    "command_profile": Case(
        "/command_profile", topics.PROFILE, ProfileSettings, "-p patience:=600.0 -p profile:={folder}/profile.csv"
    ),
    "opcua_node": Case(
        "/opcua", station.OPCUA_TOPICS, station.OpcUaSettings,
        f"{LISTS['valve']} {LISTS['monitor']} -p port:={{port}} -p folder:={{folder}}", needs="asyncua",
    ),
    "plc_node": Case(
        "/plc", station.PLC_TOPICS, station.PlcSettings, f"{LISTS['valve']} -p port:={{port}}"
    ),
    "archive_node": Case(
        "/archive", station.ARCHIVE_TOPICS, station.ArchiveSettings,
        f"{LISTS['valve']} {LISTS['monitor']} -p folder:={{folder}}",
    ),
}  # fmt: skip


def by_table(case: Case) -> dict[tuple[str, str], Topic]:
    """Full name and direction of each topic and service of the table, for this node and its valves."""
    found = {}
    for entry, valve, end in itertools.product(case.topics, case.valves, topics.ENDS):
        monitor, measured = valve.replace("valve", "monitor"), f"{valve}/joint_states"
        places = {"valve": valve, "monitor": monitor, "measured": measured, "sensors": valve, "end": end}
        filled = entry.name.format(**places, alarms="/opcua/alarms")
        found[filled.replace("~", case.name), entry.direction] = entry
    return found


def in_use(node: Any, name: str) -> Names:
    """What a running node has, by the graph that every node knows; nothing while it is not there."""
    namespace, _, base = name.rpartition("/")
    if (base, namespace or "/") not in node.get_node_names_and_namespaces():
        return {}
    return {
        (found, direction): kind
        for word, direction in DIRECTIONS.items()
        for found, (kind, *_) in getattr(node, f"get_{word}_names_and_types_by_node")(base, namespace or "/")
    }


def own(found: Names) -> Names:
    """Without clients, and without what every node has."""
    return {
        (name, direction): kind
        for (name, direction), kind in found.items()
        if direction != "client" and name not in OF_ALL and not kind.startswith(("rcl_interfaces", "type_description"))
    }


def check_qos(probe: Probe, case: Case) -> None:
    base = case.name.rpartition("/")[2]
    for (topic, direction), entry in by_table(case).items():
        if entry.qos is not None:
            word = "publishers" if direction == "out" else "subscriptions"
            known = getattr(probe.node, f"get_{word}_info_by_topic")(topic)
            found, asked = next(one.qos_profile for one in known if one.node_name == base), profile(entry.qos)
            assert (found.reliability, found.durability) == (asked.reliability, asked.durability), topic


def check_parameters(probe: Probe, entries: Table) -> None:
    request = DescribeParameters.Request(names=list(entries))
    told = probe.call("describe_parameters", DescribeParameters, request).descriptors
    for descriptor, entry in zip(told, entries.values(), strict=True):
        assert (descriptor.name, descriptor.description) == (entry.name, entry.description)
        assert descriptor.read_only == entry.read_only
        assert (*TYPES, "string array")[descriptor.type] == entry.type
        ranges = [*descriptor.floating_point_range, *descriptor.integer_range]
        assert [(limits.from_value, limits.to_value) for limits in ranges] == ([entry.range] if entry.range else [])


@pytest.mark.parametrize("program", CASES)
def test_a_node_has_what_its_tables_say_and_the_rights_that_it_uses_and_nothing_else(
    program: str, tmp_path: Path
) -> None:
    case, allowed = CASES[program], RIGHTS_BY_NODE.get(CASES[program].name)
    if importlib.util.find_spec(case.needs) is None:
        pytest.skip(f"{case.needs} is not installed")
    (tmp_path / "profile.csv").write_text("time,volts\n0,9\n0.01,0\n")
    words = case.arguments.format(folder=tmp_path, port=free_port()).split()
    words += ["-r", f"__ns:={case.name.rpartition('/')[0] or '/'}"]
    words += ["-p", "use_sim_time:=true"] if allowed else []  # a right of its own
    wanted = {key: entry.type for key, entry in by_table(case).items()}
    probe = Probe(case.name)
    try:
        with running(tmp_path, ["--ros-args", *words], program) as process:

            def is_there() -> bool:
                found = in_use(probe.node, case.name)
                return own(found) == wanted and allowed in (None, set(found))

            probe.until(is_there)
            found = in_use(probe.node, case.name)
            assert own(found) == wanted, process.output
            assert allowed in (None, set(found)), process.output
            check_qos(probe, case)
            check_parameters(probe, case.settings.table())
    finally:
        probe.close()


def test_the_sequencer_has_the_rights_that_it_uses(probe: Probe, tmp_path: Path) -> None:
    program = [sys.executable, str(ROOT / "docs" / "examples" / "sequencer.py"), "--ros-args"]
    words = ["-p", "patience:=1000.0", "-p", "use_sim_time:=true"]
    with subprocess.Popen([*program, *words], env={**os.environ, "ROS_LOG_DIR": str(tmp_path)}) as process:
        probe.until(lambda: set(in_use(probe.node, "/sequencer")) == RIGHTS_BY_NODE["/sequencer"])
        assert set(in_use(probe.node, "/sequencer")) == RIGHTS_BY_NODE["/sequencer"]
        process.kill()


def test_the_other_tanks_have_the_same_rights() -> None:
    for name, tank in itertools.product(("valve", "monitor"), TANKS):
        first = {(where.replace("tank_1", tank), right) for where, right in RIGHTS_BY_NODE[f"/tank_1/{name}"]}
        assert RIGHTS_BY_NODE[f"/{tank}/{name}"] == first
