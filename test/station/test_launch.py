"""The station's nodes as launch/station.launch.py starts them: their parameters are accepted."""

from __future__ import annotations

from pathlib import Path
from typing import Any

import pytest
from nodes.launch_plan import LaunchConfiguration, read_launch_file

from valve_sim.station.archive_tables import archive_settings
from valve_sim.station.opcua_tables import opcua_settings
from valve_sim.station.plc_tables import plc_settings

PLAN = read_launch_file(Path(__file__).parents[2] / "launch" / "station.launch.py")
CHECKED = {"opcua": opcua_settings, "plc": plc_settings, "archive": archive_settings}


@pytest.mark.parametrize("name", CHECKED)
def test_a_node_is_started_where_it_is_asked_for_with_all_valves(name: str) -> None:
    assert name not in {node.name for node in PLAN.started({})}
    (node,) = [node for node in PLAN.started({name: "true"}) if node.name == name]
    given = {key: value for part in node.parameters if isinstance(part, dict) for key, value in part.items()}
    assert isinstance(given.pop("use_sim_time"), LaunchConfiguration)
    settings: Any = CHECKED[name](given, {})
    assert settings.valves == ("tank_1/valve", "tank_2/valve", "tank_3/valve")
    if hasattr(settings, "monitors"):
        assert settings.monitors == ("tank_1/monitor", "tank_2/monitor", "tank_3/monitor")
