"""Numbers out of encoded messages, read at the places where they stood in the message before.

rclpy makes a Python object of a message in 10 µs; to take its bytes, and two numbers out of them, takes a quarter of
that. A message whose lengths and names are not those of the one before is parsed anew.
"""

from __future__ import annotations

import struct
from collections.abc import Callable, Sequence
from typing import Any, Final, NamedTuple

from valve_sim.nodes.messages import JOINT_NAMES
from valve_sim.nodes.realtime import NANOSECONDS
from valve_sim.traces.batches import Field, Layout
from valve_sim.traces.cdr import MalformedMessage, find_layout

_STAMP: Final = ("header.stamp.sec", "header.stamp.nanosec")
_KINDS: Final = {"i4": "i", "u4": "I", "f4": "f", "f8": "d"}
_MOST_LAYOUTS: Final = 16
"""Layouts that are remembered: several programs may publish on one topic."""


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
    names, positions = layout.texts["name"], layout.fields["position"]
    if JOINT_NAMES[0] not in names:
        raise UnusableMessageError(f"joints {list(names)}, expected {JOINT_NAMES[0]} among them")
    index = names.index(JOINT_NAMES[0])
    if positions.size <= index:
        raise UnusableMessageError(f"{positions.size} positions for {len(names)} joints")
    width = struct.calcsize(_KINDS[positions.dtype[1:]])
    return [Field(positions.offset + index * width, positions.dtype, 1)]
