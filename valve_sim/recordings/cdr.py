"""The layout of ROS 2 messages: where in the bytes of a message each of its numbers is, by its type's definition.

Messages of one topic mostly share one layout: the same lengths and names, with different numbers. So one message is
parsed, and the numbers of all that have the same bytes for lengths and names are read, or written, as columns.
They are written as CDR, of its first or second version (OMG DDS-XTypes 1.3, 7.4).
"""

from __future__ import annotations

import functools
import re
from typing import TYPE_CHECKING, Any, NamedTuple

import numpy as np
from rosbags.interfaces import Nodetype
from rosbags.typesys import Stores, get_typestore

if TYPE_CHECKING:
    from collections.abc import Mapping

    from numpy.typing import NDArray
    from rosbags.typesys.store import Typestore

    Definitions = Mapping[str, tuple[Any, Any]]

ENCAPSULATION_SIZE = 4
"""Bytes before the message: representation (of `READABLE`, odd ones little endian) and options."""
PLAIN, PLAIN_2, DELIMITED_2 = 0, 6, 8
"""CDR; of its second version that of final types; that of types that may grow, each with its size before it."""
READABLE = (PLAIN, PLAIN_2, DELIMITED_2)
UNREADABLE = {2: "PL_CDR", 4: "XML", 10: "PL_CDR2"}
"""Representations in which each field has its number before it, or that are a text."""

MOST_STEPS = 100_000
"""Messages in one message: arrays of arrays of empty ones may be any number."""
_BASE_TYPES = {
    "bool": "u1",
    "byte": "u1",
    "char": "u1",
    "octet": "u1",
    "uint8": "u1",
    "int8": "i1",
    "uint16": "u2",
    "int16": "i2",
    "uint32": "u4",
    "int32": "i4",
    "uint64": "u8",
    "int64": "i8",
    "float32": "f4",
    "float64": "f8",
}


@functools.cache
def typestore() -> Typestore:
    """Return the message definitions that this package reads and writes (the same from Humble to Kilted)."""
    return get_typestore(Stores.ROS2_JAZZY)


def full_type(message_type: str) -> str:
    """Return the type as ROS has it: some recorders leave "msg" out, others write it as the middleware has it."""
    if of_middleware := re.fullmatch(r"(\w+)::msg::dds_::(\w+)_", message_type):
        return f"{of_middleware[1]}/msg/{of_middleware[2]}"
    package, _, name = message_type.rpartition("/")
    return message_type if "/" in package else f"{package}/msg/{name}"


class Field(NamedTuple):
    """Where the numbers of one field are: `size` values of NumPy type `dtype` from byte `offset`."""

    offset: int
    dtype: str
    size: int


class Layout(NamedTuple):
    """The shape of one message.

    Attributes:
        fields: Dotted path ("header.stamp.sec") to the place of its numbers.
        texts: Dotted path to its strings.
        fixed: Byte ranges [start, stop) that another message must share to have this layout: lengths and names.
        end: Where the last field ends; bytes beyond are padding, or invalid.
    """

    fields: Mapping[str, Field]
    texts: Mapping[str, tuple[str, ...]]
    fixed: tuple[tuple[int, int], ...]
    end: int


class MalformedMessage(Exception):  # noqa: N818 -- internal: it is counted, not shown
    """These bytes are not a message of this type."""


def representation(payload: bytes) -> int:
    """How a message is written, by its first bytes, the even number of both orders of bytes; −1: not as one."""
    return payload[1] & ~1 if len(payload) >= ENCAPSULATION_SIZE and payload[0] == 0 else -1


class _Walker:
    """Parses one message by the definition of its type and notes where each field is."""

    def __init__(self, payload: bytes, definitions: Definitions) -> None:
        self.form = representation(payload)
        if self.form not in READABLE:
            raise MalformedMessage
        self.payload = payload
        self.definitions = definitions
        self.order = "<" if payload[1] & 1 else ">"
        self.widest = 8 if self.form == PLAIN else 4
        self.position = ENCAPSULATION_SIZE
        self.steps = 0
        self.fields: dict[str, Field] = {}
        self.texts: dict[str, tuple[str, ...]] = {}
        self.fixed: list[tuple[int, int]] = [(0, 2)]

    def walk(self, message_type: str, prefix: str = "") -> None:
        """Take all fields of a message or of a message in it."""
        detail: Any  # its shape depends on the kind, which the library types as a union
        self.steps += 1
        if message_type not in self.definitions or self.steps > MOST_STEPS:
            raise MalformedMessage
        if self.form == DELIMITED_2:
            self.length()
        for name, (kind, detail) in self.definitions[message_type][1]:
            path = prefix + name
            if kind == Nodetype.NAME:
                self.walk(detail, path + ".")
            elif kind == Nodetype.BASE:
                self.take(path, detail[0], count=1, listed=False)
            else:
                (inner, what), length = detail
                if self.form != PLAIN and (inner != Nodetype.BASE or what[0] == "string"):
                    self.length()  # of all of them, in bytes
                count = self.length() if kind == Nodetype.SEQUENCE else length
                if inner == Nodetype.BASE:
                    self.take(path, what[0], count, listed=True)
                    continue
                self.check_count(count)
                for number in range(count):
                    self.walk(what, f"{path}[{number}].")

    def check_count(self, count: int) -> None:
        """Each message in a list has at least one byte; invalid data may claim billions of them."""
        if count > len(self.payload) - self.position:
            raise MalformedMessage

    def take(self, path: str, base: str, count: int, *, listed: bool) -> None:
        """Take `count` values of a base type; strings in a list are names and so part of the layout."""
        if base == "string":
            self.texts[path] = tuple(self.text(fixed=listed) for _ in range(count))
            return
        if base not in _BASE_TYPES:  # wstring, float128: each middleware writes them in another way
            raise MalformedMessage
        dtype = np.dtype(self.order + _BASE_TYPES[base])
        if count:
            self.align(dtype.itemsize)
        self.fields[path] = Field(self.position, dtype.str, count)
        self.advance(count * dtype.itemsize)

    def length(self) -> int:
        """Take a sequence's or string's length."""
        self.align(4)
        start = self.position
        self.advance(4)
        self.fixed.append((start, self.position))
        return int.from_bytes(self.payload[start : self.position], "little" if self.order == "<" else "big")

    def text(self, *, fixed: bool) -> str:
        """Take one string with its closing zero."""
        length = self.length()
        start = self.position
        self.advance(length)
        if fixed:
            self.fixed.append((start, self.position))
        try:
            return self.payload[start : self.position].rstrip(b"\0").decode()
        except UnicodeDecodeError as error:
            raise MalformedMessage from error

    def align(self, size: int) -> None:
        """Advance to the next multiple of `size`, counted from the end of the encapsulation."""
        self.position += -(self.position - ENCAPSULATION_SIZE) % min(size, self.widest)

    def advance(self, size: int) -> None:
        """Advance, but never beyond the end of the message."""
        self.position += size
        if self.position > len(self.payload):
            raise MalformedMessage

    def layout(self) -> Layout:
        return Layout(self.fields, self.texts, tuple(self.fixed), self.position)


def find_layout(payload: bytes, message_type: str, definitions: Definitions | None = None) -> Layout:
    """Parse one message.

    Raises:
        MalformedMessage: The bytes end too early, or are of no representation in `READABLE`.
    """
    walker = _Walker(payload, typestore().fielddefs if definitions is None else definitions)
    walker.walk(message_type)
    return walker.layout()


def encode_messages(
    template: object, message_type: str, columns: Mapping[str, NDArray[Any]], count: int
) -> list[bytes]:
    """Serialize `count` messages that differ from a template only in some numbers.

    Args:
        template: A message of the typestore with all arrays at their final length.
        message_type: Its type, "sensor_msgs/msg/JointState".
        columns: Dotted path to the numbers, shape (count,) or (count, values of the field).
        count: How many messages.
    """
    payload = bytes(typestore().serialize_cdr(template, message_type))
    layout = find_layout(payload, message_type)
    matrix = np.tile(np.frombuffer(payload, np.uint8), (count, 1))
    for path, values in columns.items():
        field = layout.fields[path]
        numbers = np.ascontiguousarray(np.asarray(values).reshape(count, field.size).astype(field.dtype))
        raw = numbers.view(np.uint8).reshape(count, field.size * numbers.dtype.itemsize)
        matrix[:, field.offset : field.offset + raw.shape[1]] = raw
    everything = matrix.tobytes()
    size = len(payload)
    return [everything[place : place + size] for place in range(0, count * size, size)]
