"""ROS messages from the model's readings, and numbers out of messages that were heard."""

from __future__ import annotations

import array
import math
from collections.abc import Iterable, Mapping, Sequence
from operator import attrgetter
from typing import TYPE_CHECKING, Any, Final

from builtin_interfaces.msg import Time
from diagnostic_msgs.msg import DiagnosticArray, DiagnosticStatus, KeyValue
from sensor_msgs.msg import BatteryState, FluidPressure, JointState
from std_msgs.msg import Bool, Float64, Header, UInt8

from valve_sim.model.core.hybrid.layout import MOST_MODES
from valve_sim.nodes.diagnostics import Status
from valve_sim.nodes.heard import UnusableMessageError
from valve_sim.nodes.realtime import LAST_STAMP, NANOSECONDS

if TYPE_CHECKING:
    from valve_sim.model import Reading
    from valve_sim.model.machine_stepper import MachineReading

JOINT_NAMES: Final = ("pilot_plunger", "main_plunger")
JOINTS_OF: Final = dict(zip(("position", "main_position"), JOINT_NAMES, strict=True))
"""The joint that a channel of a machine is shown as."""
_JOINTS: Final[Mapping[str, attrgetter[tuple[float, float, float]]]] = dict(
    zip(
        JOINT_NAMES,
        (
            attrgetter("pilot_position", "pilot_velocity", "attraction"),
            attrgetter("main_position", "main_velocity", "main_effort"),
        ),
        strict=True,
    )
)
"""What of a reading is the position, velocity and effort of a joint."""
_LARGEST_SINGLE: Final = 3e38


class ReadingMessages:
    """The messages of each sample. Each object is used again: publish one before you ask for the next.

    Args:
        frame_id: of joint states, coil and pressures; may be changed. joints: names of the joints, of `JOINT_NAMES`.
    """

    def __init__(self, frame_id: str, joints: Sequence[str] = JOINT_NAMES) -> None:
        self._stamp = Time()
        self._header = Header(stamp=self._stamp, frame_id=frame_id)
        self._number = Float64()
        zeros, self._read = (0.0,) * len(joints), [_JOINTS[name] for name in joints]
        self._joints = message = JointState(header=self._header, name=list(joints))
        message.position, message.velocity, message.effort = (array.array("d", zeros) for _ in range(3))
        # What a message holds may be a copy of what it was given.
        self._position, self._velocity, self._effort = message.position, message.velocity, message.effort
        self._coil = blank_battery()
        self._coil.header, self._coil.present = self._header, True
        self._pressure = FluidPressure(header=self._header)

    def set_frame_id(self, frame_id: str) -> None:
        """Set the frame of joint states, coil and pressures."""
        self._header.frame_id = frame_id

    def joint_states(self, stamp: int, reading: Reading | MachineReading) -> JointState:
        """Positions m, velocities m/s, efforts N; `stamp` in ns, LAST_STAMP at most."""
        self._date(stamp)
        for place, read in enumerate(self._read):
            self._position[place], self._velocity[place], self._effort[place] = read(reading)
        return self._joints

    def coil(self, stamp: int, current: float, voltage: float) -> BatteryState:
        """Current A and voltage V at the coil's terminals; `stamp` in ns, LAST_STAMP at most."""
        self._date(stamp)
        self._coil.voltage, self._coil.current = _single(voltage), _single(current)
        return self._coil

    def number(self, value: float) -> Float64:
        """A coil current, A, or a mass flow, kg/s."""
        self._number.data = value
        return self._number

    def pressure(self, stamp: int, pressure: float) -> FluidPressure:
        """A pressure, Pa, absolute; its variance is 0; `stamp` in ns, LAST_STAMP at most."""
        self._date(stamp)
        self._pressure.fluid_pressure = pressure
        return self._pressure

    def _date(self, stamp: int) -> None:
        self._stamp.sec, self._stamp.nanosec = divmod(min(stamp, LAST_STAMP), NANOSECONDS)


def blank_battery() -> BatteryState:
    """An empty message: NaN stands for a number that nobody measures."""
    names = ("voltage", "temperature", "current", "charge", "capacity", "design_capacity", "percentage")
    return BatteryState(**dict.fromkeys(names, math.nan))


def _single(number: float) -> float:
    """A number within the range of single precision."""
    return number if abs(number) < _LARGEST_SINGLE or math.isnan(number) else math.copysign(math.inf, number)


PHASE: Final = [UInt8(data=number) for number in range(MOST_MODES)]
"""~/phase: the number of a phase, or of a mode."""
IS_OPEN: Final = (Bool(data=False), Bool(data=True))
"""~/is_open: the flow path is fully open."""


def diagnostic_array(statuses: Iterable[Status], node: str, stamp: int) -> DiagnosticArray:
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


def stamp_of(message: Any) -> int:
    """The header's stamp, ns."""
    stamp = message.header.stamp
    return int(stamp.sec) * NANOSECONDS + int(stamp.nanosec)


def pilot_position(message: JointState) -> float:
    """The pilot plunger's position, m. Raises UnusableMessageError: the message has none."""
    if JOINT_NAMES[0] not in message.name:
        raise UnusableMessageError(f"joints {list(message.name)[:8]}, expected {JOINT_NAMES[0]} among them")
    index = message.name.index(JOINT_NAMES[0])
    if len(message.position) <= index:
        raise UnusableMessageError(f"{len(message.position)} positions for {len(message.name)} joints")
    return float(message.position[index])
