"""The station's nodes as launch/station.launch.py starts them: their parameters are accepted."""

from __future__ import annotations

from pathlib import Path
from typing import Any

import pytest
import yaml
from nodes.launch_plan import LaunchConfiguration, read_launch_file

from valve_sim.files.parameter_sections import read_sections
from valve_sim.model import ParameterError
from valve_sim.nodes.starting import read_files
from valve_sim.station.tables import ArchiveSettings, OpcUaSettings, PlcSettings

LAUNCH = Path(__file__).parents[2] / "launch"
PLAN = read_launch_file(LAUNCH / "station.launch.py")
CHECKED = {"opcua": OpcUaSettings, "plc": PlcSettings, "archive": ArchiveSettings}


@pytest.mark.parametrize("name", CHECKED)
def test_a_node_is_started_where_it_is_asked_for_with_all_valves(name: str, tmp_path: Path) -> None:
    assert name not in {node.name for node in PLAN.started({})}
    (node,) = [node for node in PLAN.started({name: "true"}) if node.name == name]
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
    plan = read_launch_file(LAUNCH / "valve.launch.py")
    (valve,) = plan.nodes
    with pytest.raises(ParameterError, match=r"nowhere\.yaml: cannot be read"):
        read_files(valve.command_line({**plan.arguments, "params_file": "nowhere.yaml"}))
    assert len(read_files(valve.command_line(plan.arguments))) == 1
