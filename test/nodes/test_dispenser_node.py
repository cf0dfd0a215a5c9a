"""dispenser_node on topics: it waits for its valves, opens the first one, and leaves every coil without voltage."""

from __future__ import annotations

import contextlib
import signal
from pathlib import Path
from typing import Any

import pytest

from nodes.ros import Float64, FluidPressure

from .ros_process import Probe, ended, piped

pytestmark = pytest.mark.ros
TARGET = "/tank_1/valve"


MEGA = 1e6


def dispensing(folder: Path, **parameters: object) -> contextlib.AbstractContextManager[Any]:
    return piped(folder, ("-m", "valve_sim.station", "dispenser_node"), **parameters)


def test_it_opens_the_first_tank_once_all_are_heard_and_ends_with_all_coils_off(probe: Probe, tmp_path: Path) -> None:
    names = ("coil_voltage", "demand_pressure", "inlet_pressure")
    kinds = (Float64, FluidPressure, FluidPressure)
    volts, line, tank = (probe.hear(name, kind) for name, kind in zip(names, kinds, strict=True))
    other = probe.hear("/tank_2/valve/coil_voltage", Float64)
    outlets = [probe.talker(f"/tank_{number}/valve/outlet_pressure", FluidPressure) for number in (1, 2)]
    lists = {"valves": "[tank_1/valve, tank_2/valve]", "tank_volumes": "[0.05, 0.0]"}

    def publish(*which: int) -> None:
        for number in which:
            outlets[number].publish(FluidPressure(fluid_pressure=(20.0, 5.0)[number] * MEGA))

    with dispensing(tmp_path, tank_pressures="[20.0e+6, 26.0e+6]", **lists) as process:
        assert probe.until(lambda: all(outlet.get_subscription_count() for outlet in outlets))
        assert probe.insist(lambda: publish(0, 1), lambda: volts and volts[-1].data == 9.0)
        first = line[-1].fluid_pressure if line else 2.0 * MEGA
        assert probe.until(lambda: line and line[-1].fluid_pressure > first + 0.2 * MEGA)
        assert probe.until(lambda: tank and 19.0 * MEGA < tank[-1].fluid_pressure < 20.0 * MEGA)
        said = ended(process, signal.SIGINT)
        assert probe.until(lambda: volts[-1].data == 0.0), said
    assert "opens tank_1/valve, its tank at 20.0 MPa, the vehicle at 2.0 MPa" in said
    assert {message.data for message in other} <= {0.0}
