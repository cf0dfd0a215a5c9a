"""The station of launch/station.launch.py: what it starts, and a fault in one valve that its own monitor reports."""

from __future__ import annotations

import json
from collections.abc import Sequence
from pathlib import Path
from typing import Any

import pytest
import yaml

from valve_sim.files.parameter_files import load_valve
from valve_sim.model import ParameterError
from valve_sim.nodes.settings import MonitorNodeSettings
from valve_sim.nodes.starting import read_files
from valve_sim.station.tables import ArchiveSettings, OpcUaSettings, PlcSettings

from .clockwork import Clockwork
from .launch_plan import LaunchPlan, Node, read_launch_file
from .ros_process import Probe

LAUNCH_FILE = Path(__file__).parents[2] / "launch" / "station.launch.py"
TANKS = ("tank_1", "tank_2", "tank_3")
COMMISSIONING = 8
"""Strokes, the fewest that are allowed."""


@pytest.fixture(scope="module")
def plan() -> LaunchPlan:
    return read_launch_file(LAUNCH_FILE)


def test_each_tank_has_a_valve_and_a_monitor_with_one_parameter_file(plan: LaunchPlan, tmp_path: Path) -> None:
    nodes = plan.started()
    assert {(node.full_name, node.executable) for node in nodes} == {
        (f"/{tank}/{name}", f"{name}_node") for tank in TANKS for name in ("valve", "monitor")
    }
    assert {node.executable for node in plan.started(monitors="false")} == {"valve_node"}
    for gas in ("false", "true"):
        for node in plan.started(gas=gas):
            ((file, _),) = read_files(["", *node.command_line(tmp_path)])
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
    assert (valve.given["publish_rate"], monitor.given["commissioning_strokes"]) == (100, 9)
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
    ((file, section),) = read_files(["", *node.command_line(tmp_path)])
    assert "!!python/tuple" in Path(file).read_text()
    assert OpcUaSettings.read(section.values, {}).valves == tuple(f"{tank}/valve" for tank in TANKS)


def test_a_monitor_alone_has_what_its_file_says_unless_an_argument_says_otherwise(tmp_path: Path) -> None:
    alone, file = read_launch_file(LAUNCH_FILE.with_name("monitor.launch.py")), tmp_path / "a.yaml"
    file.write_text("/**: {ros__parameters: {valve: {stroke: 1.2e-3}}}\n/monitor: {ros__parameters: {noise_um: 2.0}}\n")
    (plain,) = alone.started(params_file=str(file))
    assert (plain.full_name, plain.executable) == ("/monitor", "monitor_node")
    assert plain.given == {}, "or the file's settings would not count"
    assert [section.node for _, section in read_files(["", *plain.command_line(tmp_path)])] == ["/**", "/monitor"]
    values = {"valve_node": "/plc/coil", "measured": "coil", "noise_um": "1", "state": "/var/lib/a.json"}
    (other,) = alone.started(namespace="north/a", use_sim_time="True", **values)
    settings = MonitorNodeSettings.of(MonitorNodeSettings.values(without_time(other.given), {}))
    assert (other.full_name, other.given["use_sim_time"]) == ("/north/a/monitor", True)
    assert (settings.valve_node, settings.measured, settings.noise_um, settings.state) == (
        "/plc/coil", "coil", 1.0, "/var/lib/a.json",
    )  # fmt: skip


@pytest.mark.ros
@pytest.mark.parametrize("name", ["valve", "monitor", "station"])
@pytest.mark.parametrize("section", ["/**", "/a/{node}"])
def test_only_what_was_given_counts_before_the_parameter_file(
    name: str, section: str, in_own_domain: None, tmp_path: Path
) -> None:
    launch_file = read_launch_file(LAUNCH_FILE.with_name(f"{name}.launch.py"))
    of_file = {
        "use_sim_time": True, "publish_rate": 100.0, "command_timeout": 2.0, "commissioning_strokes": 30,
        "noise_um": 2.0, "measured": "coil", "valve_node": "other", "state": "a.json",
    }  # fmt: skip
    (tmp_path / "none.yaml").write_text("/**: {ros__parameters: {valve: {stroke: 1.2e-3}}}")
    file = {section.format(node=node): {"ros__parameters": of_file} for node in ("valve", "monitor")}
    (tmp_path / "full.yaml").write_text(json.dumps(file))

    def started(file: str, **given: str) -> dict[str, dict[str, Any]]:
        (tmp_path / "a.yaml").write_text((tmp_path / file).read_text())
        station, alone = (
            {"config": str(tmp_path), "tanks": "a"},
            {"namespace": "a", "params_file": str(tmp_path / "a.yaml")},
        )
        words = station if name == "station" else alone
        return {node.name: as_rclpy_has_it(node, tmp_path) for node in launch_file.started(**words, **given)}

    for node, values in started("full.yaml").items():
        assert {key: values[key] for key in of_file} == of_file, node
    given = {key: value for key, value in GIVEN.items() if key in launch_file.arguments}
    for node, values in started("full.yaml", **given).items():
        for key, value in given.items():
            own = key == "use_sim_time" or (key in ("publish_rate", "command_timeout")) is (node == "valve")
            assert values[key] == (yaml.safe_load(value) if own else of_file[key]), (node, key)
    if name == "station":
        plain = started("none.yaml")
        assert plain["valve"]["publish_rate"] == 500.0
        assert (plain["monitor"]["measured"], plain["monitor"]["noise_um"]) == ("joint_states", 1.0)


GIVEN = {
    "use_sim_time": "false", "publish_rate": "50.0", "command_timeout": "0.5", "commissioning_strokes": "9",
    "noise_um": "0.5", "measured": "positions", "valve_node": "mine",
}  # fmt: skip


def as_rclpy_has_it(node: Node, folder: Path) -> dict[str, Any]:
    """The parameters of a node that is started like this, by rclpy's own reading of its command line."""
    import rclpy

    context = rclpy.Context()
    rclpy.init(args=["node", *node.command_line(folder)], context=context)
    made = rclpy.create_node("node", context=context, automatically_declare_parameters_from_overrides=True)
    try:
        return {key: parameter.value for key, parameter in made.get_parameters_by_prefix("").items()}
    finally:
        made.destroy_node()
        context.shutdown()


def test_a_parameter_file_that_is_not_there_ends_the_node_that_should_have_it(plan: LaunchPlan, tmp_path: Path) -> None:
    values = {"namespace": "", "use_sim_time": "false", "params_file": "nowhere.yaml"}
    valve, monitor = (
        read_launch_file(LAUNCH_FILE.with_name(f"{name}.launch.py")).started(**values)[0]
        for name in ("valve", "monitor")
    )
    lines = [node.command_line(tmp_path) for node in (valve, monitor, plan.started(config="nowhere")[0])]
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
