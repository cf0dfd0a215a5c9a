"""Pressure and flow on valve_node's topics, as a station's software sees them."""

from __future__ import annotations

import math
from collections.abc import Iterator
from pathlib import Path
from typing import Any

import pytest

from valve_sim.files.resources import config_path

from .ros_process import Probe, running

pytestmark = pytest.mark.ros
pytest.importorskip("rclpy", reason="there is no ROS 2 here: rclpy cannot be imported")

import rclpy  # noqa: E402
from diagnostic_msgs.msg import DiagnosticArray  # noqa: E402
from sensor_msgs.msg import FluidPressure  # noqa: E402
from std_msgs.msg import Bool, Float64  # noqa: E402


@pytest.fixture
def probe(in_own_domain: None) -> Iterator[Probe]:
    rclpy.init()
    probe = Probe()
    yield probe
    probe.close()
    rclpy.try_shutdown()


def last_word(heard: list[Any], task: str, key: str) -> float:
    """What the node has said last on /diagnostics; 0 before it has."""
    found = [
        float(item.value)
        for message in heard
        for status in message.status
        if status.name == f"valve: {task}"
        for item in status.values
        if item.key == key
    ]
    return found[-1] if found else 0.0


def test_the_line_fills_the_valve_opens_and_the_tank_is_followed(probe: Probe, tmp_path: Path) -> None:
    is_open, flow = probe.hear("is_open", Bool, latched=True), probe.hear("mass_flow", Float64)
    outlet, told = probe.hear("outlet_pressure", FluidPressure), probe.hear("/diagnostics", DiagnosticArray)
    coil, tank = probe.talker("coil_voltage", Float64), probe.talker("inlet_pressure", FluidPressure)
    line = probe.talker("demand_pressure", FluidPressure)

    def is_near(pressure: float) -> bool:
        return bool(outlet) and abs(outlet[-1].fluid_pressure / pressure - 1.0) < 1e-3

    file = str(config_path("hydrogen_70mpa.yaml"))
    with running(tmp_path, ["--ros-args", "--params-file", file, "-p", "time_scale:=2.0"]) as node:
        assert probe.until(lambda: is_near(0.1e6)), node.output
        assert probe.until(lambda: flow and is_open)
        assert not is_open[-1].data
        assert probe.insist(lambda: coil.publish(Float64(data=9.0)), lambda: is_open[-1].data)
        assert probe.until(lambda: is_near(70e6))
        assert max(message.data for message in flow) > 1e-5
        assert probe.insist(lambda: tank.publish(FluidPressure(fluid_pressure=60e6)), lambda: is_near(60e6))
        for pressure in (math.nan, -1.0, math.inf):
            tank.publish(FluidPressure(fluid_pressure=pressure))
        assert probe.until(lambda: last_word(told, "inlet pressure", "rejected") == 3)
        assert is_near(60e6)
        assert "/valve/inlet_pressure: nan Pa is ignored, expected a number from 1000 to 2e+08 Pa" in node.output
        for pressure in (3e6, math.nan):
            line.publish(FluidPressure(fluid_pressure=pressure))
        assert probe.until(lambda: last_word(told, "demand pressure", "rejected") == 1)
        assert last_word(told, "demand pressure", "pressure (Pa)") == 3e6
        assert "/valve/demand_pressure: nan Pa is ignored, expected a number from 1000 to 2e+08 Pa" in node.output
