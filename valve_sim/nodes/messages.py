"""ROS messages from the model's readings, and numbers out of encoded ones; of rclpy, only the encoding is used.

rclpy makes a Python object of a message in 10 µs; to take its bytes, and two numbers out of them, takes a quarter of
that: they are read at the places where they stood in the message before. A message whose lengths and names are not
those of the one before is parsed anew.
"""

from __future__ import annotations

import array
import math
import struct
from collections.abc import Callable, Iterable, Sequence
from typing import TYPE_CHECKING, Any, Final, NamedTuple

from builtin_interfaces.msg import Time
from diagnostic_msgs.msg import DiagnosticArray, DiagnosticStatus, KeyValue
from rclpy.serialization import serialize_message
from sensor_msgs.msg import BatteryState, FluidPressure, JointState
from std_msgs.msg import Bool, Float64, UInt8

from valve_sim.model import Phase, Reading
from valve_sim.nodes.diagnostics import Status
from valve_sim.nodes.realtime import LAST_STAMP, NANOSECONDS

if TYPE_CHECKING:
    from valve_sim.traces.cdr import Field, Layout

JOINT_NAMES: Final = ("pilot_plunger", "main_plunger")
_STAMP_MARKS: Final = (1_234_567_891, 123_456_789)
_MARKS: Final = (-1.1e301, -2.2e302, -3.3e303, -4.4e304, -5.5e305, -6.6e306)
_SINGLE_MARKS: Final = struct.unpack("=ff", b"\xa1\xb2\xc3\x74\xa5\xb6\xc7\x75")
"""Placeholders: numbers that occur in no reading and no other field of a message. The latter are in single precision,
and no byte of them is 0: what pads a message is whatever was in memory, such as a mark of the one before."""
_LARGEST_SINGLE: Final = 3e38


_STAMP: Final = ("header.stamp.sec", "header.stamp.nanosec")
_KINDS: Final = {"i4": "i", "u4": "I", "f4": "f", "f8": "d"}
_MOST_LAYOUTS: Final = 16
"""Layouts that are remembered: several programs may publish on one topic."""


class ReadingMessages:
    """The messages of each sample, encoded: `publish` takes bytes, which cost a third of a message.

    Args:
        frame_id: of joint states, coil and pressures; may be set anew.
    """

    def __init__(self, frame_id: str) -> None:
        self._number = _Encoding(Float64(data=_MARKS[0]), ["d"], _MARKS[:1])
        self.set_frame_id(frame_id)

    def set_frame_id(self, frame_id: str) -> None:
        """Set the frame of joint states, coil and pressures."""
        joints = JointState(name=list(JOINT_NAMES))
        joints.header.frame_id = frame_id
        joints.header.stamp.sec, joints.header.stamp.nanosec = _STAMP_MARKS
        joints.position, joints.velocity, joints.effort = (array.array("d", _MARKS[at : at + 2]) for at in (0, 2, 4))
        self._joints = _Encoding(joints, ["i", "I", *"dddddd"], [*_STAMP_MARKS, *_MARKS])
        coil = _blank_coil()
        coil.header = joints.header
        coil.voltage, coil.current = _SINGLE_MARKS
        self._coil = _Encoding(coil, ["i", "I", *"ff"], [*_STAMP_MARKS, *_SINGLE_MARKS])
        pressure = FluidPressure(header=joints.header, fluid_pressure=_MARKS[0])
        self._pressure = _Encoding(pressure, ["i", "I", "d"], [*_STAMP_MARKS, _MARKS[0]])

    def joint_states(self, stamp: int, reading: Reading) -> bytes:
        """Positions m, velocities m/s, efforts N; `stamp` in ns, LAST_STAMP at most."""
        seconds, nanoseconds = divmod(min(stamp, LAST_STAMP), NANOSECONDS)
        return self._joints.filled(
            seconds,
            nanoseconds,
            reading.pilot_position,
            reading.main_position,
            reading.pilot_velocity,
            reading.main_velocity,
            reading.attraction,
            reading.main_effort,
        )

    def coil(self, stamp: int, current: float, voltage: float) -> bytes:
        """Current A and voltage V at the coil's terminals; `stamp` in ns, LAST_STAMP at most."""
        seconds, nanoseconds = divmod(min(stamp, LAST_STAMP), NANOSECONDS)
        return self._coil.filled(seconds, nanoseconds, _single(voltage), _single(current))

    def coil_current(self, reading: Reading) -> bytes:
        """The coil current, A."""
        return self._number.filled(reading.coil_current)

    def pressure(self, stamp: int, pressure: float) -> bytes:
        """A pressure, Pa, absolute; its variance is 0; `stamp` in ns, LAST_STAMP at most."""
        seconds, nanoseconds = divmod(min(stamp, LAST_STAMP), NANOSECONDS)
        return self._pressure.filled(seconds, nanoseconds, pressure)

    def mass_flow(self, reading: Reading) -> bytes:
        """Mass flow through the valve from inlet to outlet, kg/s."""
        return self._number.filled(reading.mass_flow)


def _blank_coil() -> BatteryState:
    """A message of a coil: what nobody measures is NaN."""
    nothing = math.nan
    return BatteryState(
        temperature=nothing, charge=nothing, capacity=nothing, design_capacity=nothing, percentage=nothing, present=True
    )


def _single(number: float) -> float:
    """A number within the range of single precision."""
    return number if abs(number) < _LARGEST_SINGLE or math.isnan(number) else math.copysign(math.inf, number)


class _Encoding:
    """An encoded message in which some numbers are replaced for each sample.

    Where they stand is read off a message that rclpy has encoded, with marks in their place: nothing here knows CDR.

    Args:
        message: with the marks. kinds: of each number, as in `struct`. marks: what stands there, in order.
    """

    def __init__(self, message: object, kinds: Sequence[str], marks: Sequence[float]) -> None:
        encoded = serialize_message(message)
        form, fixed, done = "=", [], 0
        for kind, mark in zip(kinds, marks, strict=True):
            at = encoded.index(struct.pack("=" + kind, mark), done)
            form += f"{at - done}s{kind}"
            fixed.append(encoded[done:at])
            done = at + struct.calcsize("=" + kind)
        self._pack = struct.Struct(form + f"{len(encoded) - done}s").pack
        self._parts: list[bytes | float] = [*(part for before in fixed for part in (before, 0.0)), encoded[done:]]

    def filled(self, *numbers: float) -> bytes:
        """The message with these numbers."""
        self._parts[1::2] = numbers
        return self._pack(*self._parts)


PHASE: Final = {phase: serialize_message(UInt8(data=int(phase))) for phase in Phase}
"""~/phase, encoded."""
IS_OPEN: Final = {phase: serialize_message(Bool(data=phase is Phase.OPEN)) for phase in Phase}
"""~/is_open, encoded: the flow path is fully open."""


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


class UnusableMessageError(Exception):
    """A message that does not hold what is wanted; the text says why."""


class _Places(NamedTuple):
    """Where numbers stand: `fixed_of` gives what messages of this layout have in common, `numbers_of` the numbers."""

    fixed_of: Callable[[bytes], tuple[Any, ...]]
    fixed: tuple[Any, ...]
    numbers_of: Callable[[bytes], tuple[Any, ...]]


class EncodedReader:
    """Reads the messages of one topic.

    Args:
        message_type: with a header, "sensor_msgs/msg/JointState".
        choose: the fields whose first numbers are wanted, in the order in which they stand in a message; raises
            UnusableMessageError where they are missing.
    """

    def __init__(self, message_type: str, choose: Callable[[Layout], Sequence[Field]]) -> None:
        self._type, self._choose = message_type, choose
        self._known: dict[int, _Places] = {}

    def read(self, encoded: bytes) -> tuple[Any, ...]:
        """The header's stamp, ns, and the numbers.

        Raises:
            UnusableMessageError: they are not there, or these bytes are not a message of this type.
        """
        places = self._known.get(len(encoded))
        if places is None or places.fixed_of(encoded) != places.fixed:
            places = self._parsed(encoded)
        seconds, nanoseconds, *numbers = places.numbers_of(encoded)
        return (seconds * NANOSECONDS + nanoseconds, *numbers)

    def _parsed(self, encoded: bytes) -> _Places:
        # Libraries that read bags take 8 MB; a node that hears no sensors does without.
        from valve_sim.traces.cdr import MalformedMessage, find_layout

        try:
            layout = find_layout(encoded, self._type)
        except MalformedMessage:
            raise UnusableMessageError(f"{len(encoded)} bytes that are no {self._type}") from None
        fields = [*(layout.fields[path] for path in _STAMP), *self._choose(layout)]
        spans = [(start, f"{stop - start}s") for start, stop in layout.fixed]
        numbers = [(field.offset, _KINDS[field.dtype[1:]]) for field in fields]
        fixed_of = _unpacker("=", spans)
        if len(self._known) >= _MOST_LAYOUTS:
            self._known.clear()
        places = _Places(fixed_of, fixed_of(encoded), _unpacker(fields[0].dtype[0], numbers))
        self._known[len(encoded)] = places
        return places


def _unpacker(order: str, items: Sequence[tuple[int, str]]) -> Callable[[bytes], tuple[Any, ...]]:
    """What unpacks items, each of which stands at a byte, and leaves out what is between them."""
    form, done = order, 0
    for offset, kind in items:
        form += f"{offset - done}x{kind}"
        done = offset + struct.calcsize(order + kind)
    return struct.Struct(form).unpack_from


def joint_states() -> EncodedReader:
    """Reads the stamp, ns, and the pilot plunger's position, m, of sensor_msgs/JointState."""
    return EncodedReader("sensor_msgs/msg/JointState", _position)


def coils() -> EncodedReader:
    """Reads the stamp, ns, the voltage, V, and the current, A, of sensor_msgs/BatteryState."""
    return EncodedReader(
        "sensor_msgs/msg/BatteryState", lambda layout: [layout.fields["voltage"], layout.fields["current"]]
    )


def pressures() -> EncodedReader:
    """Reads the stamp, ns, and the pressure, Pa, of sensor_msgs/FluidPressure."""
    return EncodedReader("sensor_msgs/msg/FluidPressure", lambda layout: [layout.fields["fluid_pressure"]])


def _position(layout: Layout) -> Sequence[Field]:
    from valve_sim.traces.cdr import Field

    names, positions = layout.texts["name"], layout.fields["position"]
    if JOINT_NAMES[0] not in names:
        raise UnusableMessageError(f"joints {list(names)}, expected {JOINT_NAMES[0]} among them")
    index = names.index(JOINT_NAMES[0])
    if positions.size <= index:
        raise UnusableMessageError(f"{positions.size} positions for {len(names)} joints")
    width = struct.calcsize(_KINDS[positions.dtype[1:]])
    return [Field(positions.offset + index * width, positions.dtype, 1)]
