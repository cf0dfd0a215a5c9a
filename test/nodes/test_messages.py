"""Messages of the model and back; wants the message types, not a running ROS."""

from __future__ import annotations

import math
from typing import Any

import pytest

from valve_sim.model import Phase, Reading
from valve_sim.nodes.diagnostics import Level, Status

std_msgs = pytest.importorskip("std_msgs.msg", reason="there is no ROS 2 here: its messages cannot be imported")

from rclpy.serialization import deserialize_message, serialize_message  # noqa: E402
from sensor_msgs.msg import BatteryState, FluidPressure, JointState  # noqa: E402
from std_msgs.msg import Bool, Float64, UInt8  # noqa: E402

from valve_sim.nodes import messages  # noqa: E402

READING = Reading(1.0, 2e-3, 1e-3, 0.5, 0.25, 0.8, 15.0, -3.0, Phase.OPEN, ())


def assert_encoded_as_by_ros(encoded: bytes, kind: type[Any]) -> None:
    """ROS encodes the message to the same bytes, but for those that pad it: these it leaves as memory has them."""
    message = deserialize_message(encoded, kind)
    by_ros = serialize_message(message)
    assert len(by_ros) == len(encoded)
    for place in [at for at, (own, other) in enumerate(zip(encoded, by_ros, strict=True)) if own != other]:
        changed = bytearray(encoded)
        changed[place] ^= 0xFF
        # A byte that pads says nothing, whatever it is.
        assert str(deserialize_message(bytes(changed), kind)) == str(message)


@pytest.mark.parametrize("frame_id", ["", "t", "ta", "tank", "a frame of thirty characters …"])
def test_joint_states_carry_everything_of_both_plungers(frame_id: str) -> None:
    maker = messages.ReadingMessages("")
    maker.set_frame_id(frame_id)
    message = deserialize_message(maker.joint_states(1_500_000_002, READING), JointState)
    assert (message.header.stamp.sec, message.header.stamp.nanosec) == (1, 500_000_002)
    assert message.header.frame_id == frame_id
    assert list(message.name) == ["pilot_plunger", "main_plunger"]
    assert (list(message.position), list(message.velocity)) == ([2e-3, 1e-3], [0.5, 0.25])
    assert list(message.effort) == [15.0, -3.0]
    late = deserialize_message(maker.joint_states(2**31 * 1_000_000_000 + 5, READING), JointState)
    assert (late.header.stamp.sec, late.header.stamp.nanosec) == (2**31 - 1, 999_999_999)
    assert list(late.position) == [2e-3, 1e-3]


def test_what_is_encoded_here_is_what_ros_encodes_to_the_byte() -> None:
    maker = messages.ReadingMessages("tank")
    for reading in (READING, READING._replace(main_effort=math.nan, pilot_position=-math.inf)):
        joints, current = maker.joint_states(7, reading), maker.coil_current(reading)
        assert_encoded_as_by_ros(joints, JointState)
        assert_encoded_as_by_ros(current, Float64)
        assert deserialize_message(current, Float64).data == reading.coil_current


@pytest.mark.parametrize("frame_id", ["", "tank", "a frame of thirty characters …"])
def test_the_coil_carries_current_and_voltage_and_nothing_else(frame_id: str) -> None:
    coil = messages.ReadingMessages(frame_id).coil(1_500_000_002, 0.75, -24.5)
    message = deserialize_message(coil, BatteryState)
    assert_encoded_as_by_ros(coil, BatteryState)
    assert (message.header.stamp.sec, message.header.stamp.nanosec) == (1, 500_000_002)
    assert (message.header.frame_id, message.current, message.voltage) == (frame_id, 0.75, -24.5)
    unmeasured = ("temperature", "charge", "capacity", "design_capacity", "percentage")
    assert all(math.isnan(getattr(message, name)) for name in unmeasured)
    extreme = deserialize_message(messages.ReadingMessages("").coil(7, math.nan, -1e300), BatteryState)
    assert math.isnan(extreme.current)
    assert extreme.voltage == -math.inf


@pytest.mark.parametrize("phase", list(Phase))
def test_phase_and_is_open(phase: Phase) -> None:
    assert deserialize_message(messages.PHASE[phase], UInt8).data == int(phase)
    assert deserialize_message(messages.IS_OPEN[phase], Bool).data is (phase is Phase.OPEN)


def test_diagnostics_are_named_after_the_node() -> None:
    status = Status("timing", Level.WARN, "slow", {"overruns": "3"})
    array = messages.diagnostic_array([status], "/tank_1/valve", 2_000_000_001)
    (found,) = array.status
    assert (found.name, found.hardware_id, found.level) == ("tank_1/valve: timing", "tank_1/valve", b"\x01")
    assert [(item.key, item.value) for item in found.values] == [("overruns", "3")]
    assert (array.header.stamp.sec, array.header.stamp.nanosec) == (2, 1)


@pytest.mark.parametrize("frame_id", ["", "tank", "a frame of thirty characters …"])
def test_pressure_and_flow_are_those_of_the_reading(frame_id: str) -> None:
    maker = messages.ReadingMessages(frame_id)
    reading = READING._replace(outlet_pressure=35.5e6, mass_flow=-1.25e-4)
    encoded = maker.pressure(1_500_000_002, reading.outlet_pressure)
    pressure = deserialize_message(encoded, FluidPressure)
    assert_encoded_as_by_ros(encoded, FluidPressure)
    assert (pressure.header.stamp.sec, pressure.header.stamp.nanosec) == (1, 500_000_002)
    assert (pressure.header.frame_id, pressure.fluid_pressure, pressure.variance) == (frame_id, 35.5e6, 0.0)
    assert deserialize_message(maker.mass_flow(reading), Float64).data == -1.25e-4
