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
from valve_sim.nodes.starting import read_files
from valve_sim.station.tables import ArchiveSettings, OpcUaSettings, PlcSettings

from .clockwork import Clockwork
from .launch_plan import IfElseSubstitution, LaunchConfiguration, LaunchPlan, read_launch_file
from .ros_process import Probe

LAUNCH_FILE = Path(__file__).parents[2] / "launch" / "station.launch.py"
TANKS = ("tank_1", "tank_2", "tank_3")
CHECKED = {"opcua": OpcUaSettings, "plc": PlcSettings, "archive": ArchiveSettings}
COMMISSIONING = 8
"""Strokes, the fewest that are allowed."""
WITH_GAS = (0.1, 0.12, 0.1)
"""s of rest, of voltage, and without it again: the pressure takes 80 ms to equalise."""
LEAK = 2e-9
"""m², 6 % of the pilot's orifice."""


@pytest.fixture(scope="module")
def plan() -> LaunchPlan:
    return read_launch_file(LAUNCH_FILE)


def test_each_tank_has_a_valve_and_a_monitor(plan: LaunchPlan) -> None:
    assert {(node.full_name, node.executable) for node in plan.started({})} == {
        (f"/{tank}/{name}", f"{name}_node") for tank in TANKS for name in ("valve", "monitor")
    }
    assert {node.executable for node in plan.started({"monitors": "false"})} == {"valve_node"}


def test_both_nodes_of_a_tank_have_its_parameter_file(plan: LaunchPlan) -> None:
    for node in (node for node in plan.nodes if node.namespace):
        for gas, name in (("false", f"{node.namespace}.yaml"), ("true", f"gas_{node.namespace}.yaml")):
            file = node.file({"gas": gas})
            assert file.is_file()
            assert file.name == name
            assert (load_valve(file).gas is None) is (gas == "false")


def test_every_argument_sets_the_parameter_of_its_name(plan: LaunchPlan) -> None:
    used = {name for node in plan.nodes if node.condition for name in node.condition.names}
    for node in plan.nodes:
        for given in node.parameters:
            if isinstance(given, list):
                used |= {part.condition.name for part in given if isinstance(part, IfElseSubstitution)}
                continue
            for name, value in given.items():
                if isinstance(value, LaunchConfiguration):
                    assert value.name == name
                    used.add(name)
    assert used == set(plan.arguments)


def test_the_page_names_every_argument_with_its_default(plan: LaunchPlan) -> None:
    page = (LAUNCH_FILE.parents[1] / "docs" / "how_to" / "station.md").read_text(encoding="utf-8")
    for name, default in plan.arguments.items():
        assert f"| `{name}` | `{default}` |" in page


@pytest.mark.parametrize("name", CHECKED)
def test_a_node_is_started_where_it_is_asked_for_with_all_valves(plan: LaunchPlan, name: str, tmp_path: Path) -> None:
    assert name not in {node.name for node in plan.started({})}
    (node,) = [node for node in plan.started({name: "true"}) if node.name == name]
    given = {key: value for part in node.parameters if isinstance(part, dict) for key, value in part.items()}
    assert isinstance(given.pop("use_sim_time"), LaunchConfiguration)
    # launch_ros makes tuples of lists, dumps them with the tag of Python's, and gives the node the name of that file.
    evaluated = {key: tuple(value) if isinstance(value, list) else value for key, value in given.items()}
    file = tmp_path / "launch_params"
    file.write_text(yaml.dump({node.full_name: {"ros__parameters": evaluated}}, default_flow_style=False))
    assert "!!python/tuple" in file.read_text()
    (section,) = read_sections(file)
    settings: Any = CHECKED[name].read(section.values, {})
    assert settings.valves == ("tank_1/valve", "tank_2/valve", "tank_3/valve")
    if hasattr(settings, "monitors"):
        assert settings.monitors == ("tank_1/monitor", "tank_2/monitor", "tank_3/monitor")


def test_a_parameter_file_that_is_not_there_ends_the_valve_that_should_have_it() -> None:
    plan = read_launch_file(LAUNCH_FILE.with_name("valve.launch.py"))
    (valve,) = plan.nodes
    with pytest.raises(ParameterError, match=r"nowhere\.yaml: cannot be read"):
        read_files(valve.command_line({**plan.arguments, "params_file": "nowhere.yaml"}))
    assert len(read_files(valve.command_line(plan.arguments))) == 1


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
        with plan.running(tmp_path, ("tank_1", "tank_2"), values):
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


@pytest.mark.long
@pytest.mark.any_distribution
@pytest.mark.ros
def test_with_gas_a_leak_is_an_alarm_and_a_healthy_valve_is_none(
    plan: LaunchPlan, in_own_domain: None, tmp_path: Path
) -> None:
    rclpy = pytest.importorskip("rclpy", reason="there is no ROS 2 here: rclpy cannot be imported")
    rclpy.init()
    probe = Probe("/tank_2/valve")
    try:
        values = {"gas": "true", "use_sim_time": "true", "commissioning_strokes": str(COMMISSIONING)}
        with plan.running(tmp_path, ("tank_2",), values):
            clockwork = Clockwork([probe], WITH_GAS)
            clockwork.wait_for_all()
            clockwork.reported_strokes(COMMISSIONING)
            told = clockwork.reported_strokes(4)
            assert {report["state"] for report in told[COMMISSIONING:]} == {"watching"}
            assert all(report["opened"] and report["closed"] for report in told)
            assert not clockwork.is_alarmed(0)
            assert probe.set_parameters(effects__seat_leak__area=LEAK)[0].successful
            clockwork.reported_strokes(6)
            assert clockwork.is_alarmed(0), "no alarm"
    finally:
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
