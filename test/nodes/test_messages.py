"""Messages of the model and back; wants the message types, not a running ROS."""

from __future__ import annotations

import math
from typing import Any

import pytest

from valve_sim.model import Phase, Reading
from valve_sim.nodes.diagnostics import Level, Status
from valve_sim.nodes.heard import UnusableMessageError

pytest.importorskip("std_msgs.msg", reason="there is no ROS 2 here: its messages cannot be imported")

from rclpy.serialization import deserialize_message, serialize_message
from sensor_msgs.msg import JointState

from valve_sim.nodes import messages

READING = Reading(1.0, 2e-3, 1e-3, 0.5, 0.25, 0.8, 15.0, -3.0, Phase.OPEN, ())
LAST = 2**31 * 1_000_000_000 + 5
"""ns, behind the last stamp that a message can have."""


def sent(message: Any) -> Any:
    """What a subscriber gets."""
    return deserialize_message(serialize_message(message), type(message))


def head(message: Any) -> tuple[int, int, str]:
    return message.header.stamp.sec, message.header.stamp.nanosec, message.header.frame_id


def test_each_message_carries_all_of_its_reading_and_nothing_of_the_one_before() -> None:
    maker = messages.ReadingMessages("")
    maker.joint_states(7, READING._replace(main_effort=math.nan, pilot_position=-math.inf))
    maker.set_frame_id("tank …")
    joints = sent(maker.joint_states(1_500_000_002, READING))
    assert head(joints) == (1, 500_000_002, "tank …")
    assert list(joints.name) == ["pilot_plunger", "main_plunger"]
    assert (list(joints.position), list(joints.velocity)) == ([2e-3, 1e-3], [0.5, 0.25])
    assert list(joints.effort) == [15.0, -3.0]
    pressure = sent(maker.pressure(LAST, 35.5e6))
    assert head(pressure) == (2**31 - 1, 999_999_999, "tank …")
    assert (pressure.fluid_pressure, pressure.variance) == (35.5e6, 0.0)
    assert sent(maker.number(-1.25e-4)).data == -1.25e-4


def test_the_coil_carries_current_and_voltage_and_nothing_else() -> None:
    maker = messages.ReadingMessages("tank")
    coil = sent(maker.coil(1_500_000_002, 0.75, -24.5))
    assert (*head(coil), coil.current, coil.voltage, coil.present) == (1, 500_000_002, "tank", 0.75, -24.5, True)
    assert math.isnan(coil.temperature) and math.isnan(coil.percentage)
    extreme = sent(maker.coil(7, math.nan, -1e300))
    assert math.isnan(extreme.current)
    assert extreme.voltage == -math.inf


@pytest.mark.parametrize("phase", list(Phase))
def test_phase_and_is_open(phase: Phase) -> None:
    assert sent(messages.PHASE[phase]).data == int(phase)
    assert sent(messages.IS_OPEN[phase is Phase.OPEN]).data is (phase is Phase.OPEN)


def test_diagnostics_are_named_after_the_node() -> None:
    status = Status("timing", Level.WARN, "slow", {"overruns": "3"})
    array = sent(messages.diagnostic_array([status], "/tank_1/valve", 2_000_000_001))
    (found,) = array.status
    assert (found.name, found.hardware_id, found.level) == ("tank_1/valve: timing", "tank_1/valve", b"\x01")
    assert [(item.key, item.value) for item in found.values] == [("overruns", "3")]
    assert (array.header.stamp.sec, array.header.stamp.nanosec) == (2, 1)


@pytest.mark.parametrize(
    ("names", "positions", "found"),
    [
        (["main_plunger", "pilot_plunger"], [0.0, 1e-6], 1e-6),
        (["pilot_plunger"], [], "0 positions for 1 joints"),
        (["elbow"], [0.0], r"joints \['elbow'\], expected pilot_plunger among them"),
    ],
)
def test_the_position_of_the_pilot_plunger_is_found_by_its_name(
    names: list[str], positions: list[float], found: float | str
) -> None:
    message = sent(JointState(name=names, position=positions))
    if isinstance(found, float):
        assert messages.pilot_position(message) == found
    else:
        with pytest.raises(UnusableMessageError, match=found):
            messages.pilot_position(message)
