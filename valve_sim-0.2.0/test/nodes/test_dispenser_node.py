"""dispenser_node on topics: it waits for its valves, opens the first one, and leaves every coil without voltage."""

from __future__ import annotations

import contextlib
import signal
from collections.abc import Iterator
from pathlib import Path
from typing import Any

import pytest

from .ros_process import ENDS_WITHIN, Probe, own_lines, piped

pytestmark = pytest.mark.ros
pytest.importorskip("rclpy", reason="there is no ROS 2 here: rclpy cannot be imported")

import rclpy  # noqa: E402
from sensor_msgs.msg import FluidPressure  # noqa: E402
from std_msgs.msg import Float64  # noqa: E402

MEGA = 1e6


@pytest.fixture
def probe(in_own_domain: None) -> Iterator[Probe]:
    rclpy.init()
    probe = Probe("/tank_1/valve")
    yield probe
    probe.close()
    rclpy.try_shutdown()


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
        process.send_signal(signal.SIGINT)
        _, said = process.communicate(timeout=ENDS_WITHIN)
        assert process.returncode == 0, said
        assert probe.until(lambda: volts[-1].data == 0.0), said
    assert "opens tank_1/valve, its tank at 20.0 MPa, the vehicle at 2.0 MPa" in said
    assert {message.data for message in other} <= {0.0}


def test_lists_that_do_not_fit_are_refused(in_own_domain: None, tmp_path: Path) -> None:
    with dispensing(tmp_path, tank_volumes="[0.1, 0.1]") as process:
        _, said = process.communicate(timeout=ENDS_WITHIN)
    assert process.returncode == 2
    assert own_lines(said) == ["dispenser_node: tank_volumes: found 2 numbers, expected 3, one for each of valves"]
