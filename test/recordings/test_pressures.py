"""The pressures before and behind a valve with gas: where they are read from in a bag."""

from __future__ import annotations

from pathlib import Path

import numpy as np
import pytest

from valve_sim.recordings import read_trace

from .bag_makers import EPOCH, STORE, Message, good_messages, header, make_mcap

PRESSURE = "sensor_msgs/msg/FluidPressure"


def pressures(name: str, first: float, period_ms: int = 10) -> list[Message]:
    """Over 0.1 s, each 1 kPa more than the one before."""
    found = []
    for count, at in enumerate(range(0, 100, period_ms)):
        time = EPOCH + 1_000_000 * at
        message = STORE.types[PRESSURE](header(time), first + 1e3 * count, 0.0)
        found.append(Message(f"/valve/{name}", PRESSURE, time, bytes(STORE.serialize_cdr(message, PRESSURE))))
    return found


def recorded(path: Path, *others: list[Message], measured: str = "measured/joint_states") -> Path:
    every = [*good_messages(measured=measured), *(message for messages in others for message in messages)]
    return make_mcap(path, sorted(every, key=lambda message: message.time))


def test_what_a_running_node_obeys_and_shows_is_read_beside_its_positions(tmp_path: Path) -> None:
    ends = pressures("inlet_pressure", 26e6, 50), pressures("demand_pressure", 14e6, 50)
    path = recorded(tmp_path / "a.mcap", *ends, pressures("outlet_pressure", 20e6), measured="joint_states")
    found = read_trace(path)
    assert found.inlet_pressure is not None and found.demand_pressure is not None and found.outlet_pressure is not None
    assert found.inlet_pressure.values.tolist() == [26e6, 26.001e6]
    assert found.demand_pressure.values.tolist() == [14e6, 14.001e6]
    np.testing.assert_allclose(found.outlet_pressure.times, np.arange(10) * 0.01, atol=1e-9)
    assert found.outlet_start == 20e6


def test_what_a_node_obeyed_goes_before_what_it_was_told(tmp_path: Path) -> None:
    """It counts from when the node heard it on."""
    told, obeyed = pressures("demand_pressure", 14e6, 50), pressures("obeyed/demand_pressure", 13e6, 50)
    found = read_trace(recorded(tmp_path / "a.mcap", told, obeyed, measured="joint_states"))
    assert found.demand_pressure is not None
    assert found.demand_pressure.values.tolist() == [13e6, 13.001e6]


def test_measured_pressures_go_before_those_of_a_node(tmp_path: Path) -> None:
    both = [
        pressures(f"{place}{name}_pressure", pressure)
        for place, pressure in (("", 1e6), ("measured/", 2e6))
        for name in ("inlet", "demand", "outlet")
    ]
    found = read_trace(recorded(tmp_path / "a.mcap", *both))
    for signal in (found.inlet_pressure, found.demand_pressure, found.outlet_pressure):
        assert signal is not None
        assert signal.values[0] == 2e6
    # Where a sensor is noisy, the start is as declared.
    assert found.outlet_start is None


def test_the_pressure_that_a_node_shows_is_none_of_the_real_valve_beside_it(tmp_path: Path) -> None:
    path = recorded(tmp_path / "a.mcap", pressures("outlet_pressure", 20e6), pressures("inlet_pressure", 26e6))
    found = read_trace(path)
    assert found.outlet_pressure is None
    assert found.inlet_pressure is not None
    assert found.inlet_pressure.values[0] == pytest.approx(26e6)
