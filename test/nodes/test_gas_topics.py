"""Pressure and flow on valve_node's topics, as a station's software sees them."""

from __future__ import annotations

import math
from pathlib import Path

import pytest

from nodes.ros import Bool, Float64, FluidPressure
from valve_sim.files.resources import config_path

from .ros_process import Diagnostics, Probe, running

pytestmark = pytest.mark.ros


def test_the_line_fills_the_valve_opens_and_the_tank_is_followed(probe: Probe, tmp_path: Path) -> None:
    is_open, flow = probe.hear("is_open", Bool, latched=True), probe.hear("mass_flow", Float64)
    outlet, told = probe.hear("outlet_pressure", FluidPressure), Diagnostics(probe)
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
        assert probe.until(lambda: told.values("inlet pressure").get("rejected") == "3")
        assert is_near(60e6)
        assert "/valve/inlet_pressure: nan Pa is ignored, expected a number from 1000 to 2e+08 Pa" in node.output
        for pressure in (3e6, math.nan):
            line.publish(FluidPressure(fluid_pressure=pressure))
        assert probe.until(lambda: told.values("demand pressure").get("rejected") == "1")
        assert told.values("demand pressure")["pressure (Pa)"] == "3e+06"
        assert "/valve/demand_pressure: nan Pa is ignored, expected a number from 1000 to 2e+08 Pa" in node.output
