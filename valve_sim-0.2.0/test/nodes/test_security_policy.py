"""config/sros2/station.policy.xml against the running nodes: each may do what it does, and nothing else."""

from __future__ import annotations

import os
import socket
import subprocess
import sys
from collections.abc import Iterator
from pathlib import Path
from typing import Any
from xml.etree import ElementTree

import pytest

from .launch_plan import read_launch_file
from .ros_process import Probe, running

pytestmark = pytest.mark.ros
pytest.importorskip("rclpy", reason="there is no ROS 2 here: rclpy cannot be imported")

import rclpy  # noqa: E402

ROOT = Path(__file__).parents[2]
POLICY = ROOT / "config" / "sros2" / "station.policy.xml"
WORDS = {"publish": "publisher", "subscribe": "subscriber", "reply": "service", "request": "client"}
"""A policy's words, and those of the graph."""

Rights = set[tuple[str, str]]
"""What is allowed, and on which topic or service."""


def rights_by_policy() -> dict[str, Rights]:
    """By full name of a node."""
    return {
        full_name(profile.attrib["ns"], profile.attrib["node"]): set(rights_of(profile))
        for profile in ElementTree.parse(POLICY).getroot().iter("profile")
    }


def rights_of(profile: ElementTree.Element) -> Iterator[tuple[str, str]]:
    namespace = profile.attrib["ns"]
    own = full_name(namespace, profile.attrib["node"])
    for group in profile:
        for right in group.attrib:
            for entry in group:
                name = entry.text or ""
                yield right, own + name[1:] if name.startswith("~") else full_name(namespace, name)


def full_name(namespace: str, name: str) -> str:
    return name if name.startswith("/") else f"{namespace.rstrip('/')}/{name}"


def rights_in_use(node: Any, name: str) -> Rights:
    """What a running node has, by the graph that every node knows; nothing while it is not there."""
    namespace, _, base = name.rpartition("/")
    if (base, namespace or "/") not in node.get_node_names_and_namespaces():
        return set()
    return {
        (right, found)
        for right, kind in WORDS.items()
        for found, _ in getattr(node, f"get_{kind}_names_and_types_by_node")(base, namespace or "/")
    }


@pytest.fixture
def station(in_own_domain: None, tmp_path: Path) -> Iterator[Probe]:
    """A tank with gas; dispenser and sequencer wait for the others; on simulated time, a right of its own."""
    plan = read_launch_file(ROOT / "launch" / "station.launch.py")
    sequencer = [sys.executable, str(ROOT / "docs" / "examples" / "sequencer.py"), "--ros-args"]
    words = ["-p", "patience:=1000.0", "-p", "use_sim_time:=true"]
    rclpy.init()
    probe = Probe()
    with plan.running(tmp_path, ("tank_1", ""), {"gas": "true", "dispenser": "true", "use_sim_time": "true"}):
        process = subprocess.Popen([*sequencer, *words], env={**os.environ, "ROS_LOG_DIR": str(tmp_path)})
        yield probe
        process.kill()
        process.wait()
    probe.close()
    rclpy.try_shutdown()


def test_each_node_has_the_rights_that_it_uses_and_no_others(station: Probe) -> None:
    allowed = rights_by_policy()
    for name in ("/tank_1/valve", "/tank_1/monitor", "/sequencer", "/dispenser"):
        station.until(lambda name=name: rights_in_use(station.node, name) == allowed[name])
        assert rights_in_use(station.node, name) == allowed[name], name


def test_the_other_tanks_have_the_same_rights() -> None:
    allowed = rights_by_policy()
    for name in ("valve", "monitor"):
        first = allowed[f"/tank_1/{name}"]
        for tank in ("tank_2", "tank_3"):
            assert allowed[f"/{tank}/{name}"] == {(right, where.replace("tank_1", tank)) for right, where in first}


VALVES = "valves:=[tank_1/valve, tank_2/valve, tank_3/valve]"
MONITORS = ("-p", "monitors:=[tank_1/monitor, tank_2/monitor, tank_3/monitor]")


@pytest.mark.parametrize(
    ("name", "extra", "arguments"),
    [("opcua", "asyncua", MONITORS), ("plc", "pymodbus", ()), ("archive", "pyarrow", MONITORS)],
)
def test_the_nodes_of_the_whole_station_too(
    in_own_domain: None, tmp_path: Path, name: str, extra: str, arguments: tuple[str, ...]
) -> None:
    pytest.importorskip(extra, reason=f"{extra} is not installed")
    words = ["--ros-args", "-p", VALVES, *arguments, "-p", "use_sim_time:=true"]
    words += ["-p", f"port:={free_port()}"] if name != "archive" else []
    words += ["-p", f"folder:={tmp_path / name}"] if name != "plc" else []
    allowed = rights_by_policy()[f"/{name}"]
    rclpy.init()
    probe = Probe(f"/{name}")
    try:
        with running(tmp_path, words, f"{name}_node") as process:
            probe.until(lambda: rights_in_use(probe.node, f"/{name}") == allowed)
            assert rights_in_use(probe.node, f"/{name}") == allowed, process.output
    finally:
        probe.close()
        rclpy.try_shutdown()


def free_port() -> int:
    with socket.socket() as found:
        found.bind(("127.0.0.1", 0))
        return int(found.getsockname()[1])
