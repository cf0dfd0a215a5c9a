"""The station of launch/station.launch.py: what it starts, and a fault in one valve that its own monitor reports."""

from __future__ import annotations

from collections.abc import Sequence
from pathlib import Path
from typing import Any

import pytest
import yaml

from valve_sim.files.parameter_files import load_valve
from valve_sim.files.parameter_sections import read_sections
from valve_sim.model import ParameterError
from valve_sim.nodes.settings import MonitorNodeSettings
from valve_sim.nodes.starting import read_files
from valve_sim.station.tables import ArchiveSettings, OpcUaSettings, PlcSettings

from .clockwork import Clockwork
from .launch_plan import LaunchPlan, read_launch_file
from .ros_process import Probe

LAUNCH_FILE = Path(__file__).parents[2] / "launch" / "station.launch.py"
TANKS = ("tank_1", "tank_2", "tank_3")
COMMISSIONING = 8
"""Strokes, the fewest that are allowed."""


@pytest.fixture(scope="module")
def plan() -> LaunchPlan:
    return read_launch_file(LAUNCH_FILE)


def test_each_tank_has_a_valve_and_a_monitor_with_one_parameter_file(plan: LaunchPlan) -> None:
    nodes = plan.started()
    assert {(node.full_name, node.executable) for node in nodes} == {
        (f"/{tank}/{name}", f"{name}_node") for tank in TANKS for name in ("valve", "monitor")
    }
    assert {node.executable for node in plan.started(monitors="false")} == {"valve_node"}
    for gas in ("false", "true"):
        for node in plan.started(gas=gas):
            ((file, _),) = read_files(["", *node.command_line({})])
            assert file.endswith(f"{'gas_' if gas == 'true' else ''}{node.namespace}.yaml")
            assert (load_valve(file).gas is None) is (gas == "false")


def test_tanks_folders_ports_restarts_and_words_are_arguments(plan: LaunchPlan, tmp_path: Path) -> None:
    (tmp_path / "a.yaml").write_text("/**: {ros__parameters: {valve: {stroke: 1.2e-3}}}")
    values = {
        "tanks": "north/a", "config": str(tmp_path), "state": "/var/lib/x", "publish_rate": "100", "respawn": "true",
        "log_level": "warn", "commissioning_strokes": "9", "opcua": "true", "opcua_port": "5000", "plc": "true",
        "plc_port": "600", "archive": "true", "archive_folder": "/var/lib/y", "use_sim_time": "true",
    }  # fmt: skip
    nodes = {node.full_name: node for node in plan.started(**values)}
    assert list(nodes) == ["/north/a/valve", "/north/a/monitor", "/opcua", "/plc", "/archive"]
    assert all(node.respawn and node.given["use_sim_time"] is True for node in nodes.values())
    assert all(list(node.ros_arguments[:2]) == ["--log-level", "warn"] for node in nodes.values())
    valve, monitor = nodes["/north/a/valve"], nodes["/north/a/monitor"]
    assert (valve.given["publish_rate"], monitor.given["commissioning_strokes"]) == (100.0, 9)
    assert monitor.given["state"] == "/var/lib/x/north_a.json"
    assert str(tmp_path / "a.yaml") in valve.ros_arguments
    opcua = OpcUaSettings.read(without_time(nodes["/opcua"].given), {})
    assert (opcua.valves, opcua.monitors, opcua.port) == (("north/a/valve",), ("north/a/monitor",), 5000)
    assert PlcSettings.read(without_time(nodes["/plc"].given), {}).port == 600
    assert ArchiveSettings.read(without_time(nodes["/archive"].given), {}).folder == "/var/lib/y"
    with pytest.raises(RuntimeError, match="expected namespaces"):
        plan.started(tanks=" , ")


def without_time(given: dict[str, Any]) -> dict[str, Any]:
    return {name: value for name, value in given.items() if name != "use_sim_time"}


def test_every_argument_changes_what_is_started_and_is_on_the_page(plan: LaunchPlan) -> None:
    page = (LAUNCH_FILE.parents[1] / "docs" / "how_to" / "station.md").read_text(encoding="utf-8")
    on = {"opcua": "true", "plc": "true", "archive": "true"}
    others = {"true": "false", "false": "true", "info": "debug", "tank_1,tank_2,tank_3": "tank_1", "": "/x"}
    for name in plan.arguments:
        values = {**on, name: others.get({**plan.arguments, **on}[name], "/etc/x" if name == "config" else "17")}
        assert plan.started(**values) != plan.started(**on), name
        assert f"| `{name}` | " in page


def test_lists_reach_a_node_as_launch_ros_writes_them(plan: LaunchPlan, tmp_path: Path) -> None:
    (node,) = (node for node in plan.started(opcua="true") if node.name == "opcua")
    # launch_ros makes tuples of lists, dumps them with the tag of Python's, and gives the node the name of that file.
    given = {key: tuple(value) if isinstance(value, list) else value for key, value in without_time(node.given).items()}
    file = tmp_path / "launch_params"
    file.write_text(yaml.dump({node.full_name: {"ros__parameters": given}}, default_flow_style=False))
    assert "!!python/tuple" in file.read_text()
    (section,) = read_sections(file)
    assert OpcUaSettings.read(section.values, {}).valves == tuple(f"{tank}/valve" for tank in TANKS)


def test_a_monitor_alone_has_what_its_file_says_unless_an_argument_says_otherwise(tmp_path: Path) -> None:
    alone, file = read_launch_file(LAUNCH_FILE.with_name("monitor.launch.py")), tmp_path / "a.yaml"
    file.write_text("/**: {ros__parameters: {valve: {stroke: 1.2e-3}}}\n/monitor: {ros__parameters: {noise_um: 2.0}}\n")
    (plain,) = alone.started(params_file=str(file))
    assert (plain.full_name, plain.executable) == ("/monitor", "monitor_node")
    assert plain.given == {"use_sim_time": False}, "or the file's settings would not count"
    assert [section.node for _, section in read_files(["", *plain.command_line({})])] == ["/**", "/monitor"]
    values = {"valve_node": "/plc/coil", "measured": "coil", "noise_um": "1", "state": "/var/lib/a.json"}
    (other,) = alone.started(namespace="north/a", use_sim_time="True", **values)
    settings = MonitorNodeSettings.of(MonitorNodeSettings.values(without_time(other.given), {}))
    assert (other.full_name, other.given["use_sim_time"]) == ("/north/a/monitor", True)
    assert (settings.valve_node, settings.measured, settings.noise_um, settings.state) == (
        "/plc/coil", "coil", 1.0, "/var/lib/a.json",
    )  # fmt: skip


def test_a_parameter_file_that_is_not_there_ends_the_node_that_should_have_it(plan: LaunchPlan) -> None:
    values = {"namespace": "", "use_sim_time": "false", "params_file": "nowhere.yaml"}
    valve, monitor = (
        read_launch_file(LAUNCH_FILE.with_name(f"{name}.launch.py")).started(**values)[0]
        for name in ("valve", "monitor")
    )
    lines = [node.command_line(values) for node in (valve, monitor, plan.started(config="nowhere")[0])]
    for words in lines:
        with pytest.raises(ParameterError, match=r"nowhere.*\.yaml: cannot be read"):
            read_files(words)


@pytest.mark.long
@pytest.mark.ros
def test_a_fault_in_one_valve_is_reported_by_its_own_monitor(
    plan: LaunchPlan, in_own_domain: None, tmp_path: Path
) -> None:
    rclpy = pytest.importorskip("rclpy", reason="there is no ROS 2 here: rclpy cannot be imported")
    from diagnostic_msgs.msg import DiagnosticArray

    rclpy.init()
    healthy, faulty = probes = [Probe("/tank_1/valve"), Probe("/tank_2/valve")]
    try:
        values = {"use_sim_time": "true", "commissioning_strokes": str(COMMISSIONING)}
        with plan.running(tmp_path, ("tank_1", "tank_2"), **values):
            heard = healthy.hear("/diagnostics", DiagnosticArray)
            clockwork = Clockwork(probes)
            clockwork.wait_for_all()
            clockwork.commission(COMMISSIONING + 20)
            assert faulty.set_parameters(effects__stiction__force=0.5)[0].successful
            assert clockwork.strokes_until(12, lambda: clockwork.is_alarmed(1)), "no alarm"
            assert not clockwork.is_alarmed(0)
            assert healthy.until(lambda: valves_that_changed(heard)), "nothing on /diagnostics"
            assert valves_that_changed(heard) == {"tank_2/monitor: valve"}
    finally:
        for probe in probes:
            probe.close()
        rclpy.try_shutdown()


def valves_that_changed(heard: Sequence[Any]) -> set[str]:
    """The names of the statuses that warn of a valve that is not as commissioned."""
    return {
        status.name
        for message in heard
        for status in message.status
        if status.level == b"\x01" and "not those of the commissioned valve" in status.message
    }
