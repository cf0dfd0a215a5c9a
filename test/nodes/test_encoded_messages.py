"""Numbers read out of encoded messages, against rclpy's own decoding."""

from __future__ import annotations

import array
import struct
from collections.abc import Sequence

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from nodes.ros import BatteryState, JointState, deserialize_message, serialize_message
from valve_sim.nodes.messages import UnusableMessageError, coils, joint_states
from valve_sim.traces.cdr import find_layout, typestore

pytestmark = pytest.mark.ros


PILOT = "pilot_plunger"
NUMBERS = st.floats(width=64)
SINGLE = st.floats(width=32)
TEXTS = st.text(st.characters(codec="utf-8", exclude_characters="\0"), max_size=9)
STAMPS = st.tuples(st.integers(-(2**31), 2**31 - 1), st.integers(0, 2**32 - 1))


@st.composite
def made_joint_states(draw: st.DrawFn) -> JointState:
    """Any joints, mostly with the pilot plunger among them."""
    message = JointState(name=draw(st.lists(st.sampled_from([PILOT, "main_plunger", "", "ä"]), max_size=3)))
    message.header.frame_id = draw(TEXTS)
    message.header.stamp.sec, message.header.stamp.nanosec = draw(STAMPS)
    for part in ("position", "velocity", "effort"):
        setattr(message, part, array.array("d", draw(st.lists(NUMBERS, max_size=3))))
    return message


@st.composite
def made_coils(draw: st.DrawFn) -> BatteryState:
    message = BatteryState(location=draw(TEXTS), serial_number=draw(TEXTS), present=draw(st.booleans()))
    message.header.frame_id = draw(TEXTS)
    message.header.stamp.sec, message.header.stamp.nanosec = draw(STAMPS)
    message.voltage, message.current = draw(SINGLE), draw(SINGLE)
    message.cell_voltage = array.array("f", draw(st.lists(SINGLE, max_size=3)))
    return message


def stamp_of(message: JointState | BatteryState) -> int:
    return int(message.header.stamp.sec) * 10**9 + int(message.header.stamp.nanosec)


def as_bytes(numbers: Sequence[float]) -> bytes:
    """NaN equals NaN, and -0 is not 0."""
    return np.array(numbers, dtype=np.float64).tobytes()


@settings(max_examples=40)
@given(st.lists(made_joint_states(), min_size=1, max_size=6))
def test_joint_states_are_read_as_rclpy_decodes_them_whatever_came_before(messages: list[JointState]) -> None:
    reader = joint_states()
    for encoded in [serialize_message(message) for message in messages] * 2:
        message = deserialize_message(encoded, JointState)
        names, positions = list(message.name), list(message.position)
        if PILOT in names and len(positions) > names.index(PILOT):
            stamp, position = reader.read(encoded)
            assert stamp == stamp_of(message)
            assert as_bytes([position]) == as_bytes([positions[names.index(PILOT)]])
        else:
            with pytest.raises(UnusableMessageError, match=r"^joints \[|^\d positions for \d joints$"):
                reader.read(encoded)


@settings(max_examples=40)
@given(st.lists(made_coils(), min_size=1, max_size=6))
def test_coils_are_read_as_rclpy_decodes_them(messages: list[BatteryState]) -> None:
    reader = coils()
    for encoded in [serialize_message(message) for message in messages] * 2:
        message = deserialize_message(encoded, BatteryState)
        stamp, *numbers = reader.read(encoded)
        assert stamp == stamp_of(message)
        assert as_bytes(numbers) == as_bytes([message.voltage, message.current])


def joints(*positions: float) -> bytes:
    """A message without the bytes that pad it."""
    numbers = array.array("d", positions)
    encoded = serialize_message(JointState(name=[PILOT, "main_plunger"], position=numbers, effort=numbers))
    return encoded[: find_layout(encoded, "sensor_msgs/msg/JointState").end]


def test_either_order_of_bytes_is_read() -> None:
    reader, little = joint_states(), joints(1.5e-3, 0.5)
    store = typestore()
    message = store.deserialize_cdr(little, "sensor_msgs/msg/JointState")
    big = bytes(store.serialize_cdr(message, "sensor_msgs/msg/JointState", little_endian=False))
    assert len(big) == len(little)
    assert big != little
    assert [reader.read(encoded) for encoded in (little, big, little)] == [(0, 1.5e-3)] * 3


def test_bytes_that_are_no_message_are_refused_in_words() -> None:
    reader, whole = joint_states(), joints(1.0, 2.0)
    assert reader.read(whole + bytes(4)) == (0, 1.0), "a middleware may pad"
    cuts = [whole[:size] for size in range(len(whole))]
    lies = whole.replace(struct.pack("<I", 2), struct.pack("<I", 2**31))
    for encoded in (*cuts, lies, b"\xff" * len(whole)):
        with pytest.raises(
            UnusableMessageError, match=rf"^{len(encoded)} bytes that are no sensor_msgs/msg/JointState$"
        ):
            reader.read(encoded)
    assert reader.read(whole) == (0, 1.0)
