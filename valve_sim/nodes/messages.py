"""Messages of the model and back. Imports message types, not rclpy."""

from __future__ import annotations

import array
from collections.abc import Sequence
from typing import Final

from builtin_interfaces.msg import Time
from diagnostic_msgs.msg import DiagnosticArray, DiagnosticStatus, KeyValue
from rcl_interfaces.msg import FloatingPointRange, ParameterDescriptor
from sensor_msgs.msg import JointState
from std_msgs.msg import Bool, Float64, UInt8

from valve_sim.model import Phase, Reading
from valve_sim.nodes.diagnostics import Status
from valve_sim.nodes.parameters import NodeParameter
from valve_sim.nodes.realtime import NANOSECONDS

JOINT_NAMES: Final = ("pilot_plunger", "main_plunger")
LAST_STAMP: Final = 2**31 * NANOSECONDS - 1
"""ns, in 2038: a stamp has 32 bits for seconds. A thousand times faster than real time, a node is there in days."""


class ReadingMessages:
    """The two messages of each sample, made once and filled again and again: a publish call copies them.

    Args:
        frame_id: of the joint states; may be set anew.
    """

    def __init__(self, frame_id: str) -> None:
        self._joints = JointState()
        self._joints.name = list(JOINT_NAMES)
        for field in ("position", "velocity", "effort"):
            setattr(self._joints, field, array.array("d", [0.0, 0.0]))
        self._stamp = self._joints.header.stamp
        self._current = Float64()
        self.set_frame_id(frame_id)

    def set_frame_id(self, frame_id: str) -> None:
        """The frame of the joint states from now on."""
        self._joints.header.frame_id = frame_id

    def joint_states(self, stamp: int, reading: Reading) -> JointState:
        """Positions m, velocities m/s, efforts N; `stamp` in ns, LAST_STAMP at most. Valid until the next call."""
        joints = self._joints
        self._stamp.sec, self._stamp.nanosec = divmod(min(stamp, LAST_STAMP), NANOSECONDS)
        joints.position[0], joints.position[1] = reading.pilot_position, reading.main_position
        joints.velocity[0], joints.velocity[1] = reading.pilot_velocity, reading.main_velocity
        joints.effort[0], joints.effort[1] = reading.attraction, reading.main_effort
        return joints

    def coil_current(self, reading: Reading) -> Float64:
        """The coil current, A. Valid until the next call."""
        self._current.data = reading.coil_current
        return self._current


def phase_message(phase: Phase) -> UInt8:
    """~/phase."""
    return UInt8(data=int(phase))


def is_open_message(phase: Phase) -> Bool:
    """~/is_open: the flow path is fully open."""
    return Bool(data=phase is Phase.OPEN)


def diagnostic_array(statuses: Sequence[Status], node: str, stamp: int) -> DiagnosticArray:
    """/diagnostics, as diagnostic_updater writes it; `node` is the full name, `stamp` in ns."""
    name = node.lstrip("/")
    seconds, nanoseconds = divmod(stamp, NANOSECONDS)
    message = DiagnosticArray()
    message.header.stamp = Time(sec=seconds, nanosec=nanoseconds)
    message.status = [
        DiagnosticStatus(
            level=bytes([status.level]),
            name=f"{name}: {status.task}",
            message=status.message,
            hardware_id=name,
            values=[KeyValue(key=key, value=value) for key, value in status.values.items()],
        )
        for status in statuses
    ]
    return message


def descriptor(entry: NodeParameter) -> ParameterDescriptor:
    """What ROS shows of a parameter, and the range that it enforces."""
    message = ParameterDescriptor(name=entry.name, description=entry.description)
    limits = entry.range
    if limits is not None:
        message.floating_point_range = [FloatingPointRange(from_value=float(limits[0]), to_value=float(limits[1]))]
        if entry.rule is not None:
            message.additional_constraints = entry.rule.range_words()
    return message
