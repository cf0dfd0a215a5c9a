"""ROS 2 messages (CDR) to arrays and back, many at a time.

Messages of one topic mostly share one layout: the same lengths and names, with different numbers. So one message is
parsed by the definition of its type, and all messages with the same bytes for lengths and names are read as columns of
one matrix. A message that shares no layout is parsed alone, which is some hundred times slower.
"""

from __future__ import annotations

import functools
from typing import TYPE_CHECKING, Any, NamedTuple

import numpy as np
from numpy.lib.stride_tricks import sliding_window_view
from rosbags.interfaces import Nodetype
from rosbags.typesys import Stores, get_typestore

from valve_sim.traces.batches import SECONDS, Batch, Field, Growing, Layout
from valve_sim.traces.clocks import SECOND

if TYPE_CHECKING:
    from collections.abc import Collection, Iterator, Mapping, Sequence

    from numpy.typing import NDArray
    from rosbags.typesys.store import Typestore

    Definitions = Mapping[str, tuple[Any, Any]]

ENCAPSULATION_SIZE = 4
"""Bytes before the message: representation (big or little endian CDR) and options."""

LARGEST_PADDING = 3
"""A middleware may pad a message to 4 bytes; more than this after the last field is invalid."""

NANOSECONDS = "header.stamp.nanosec"
"""Beside `SECONDS`."""

MOST_LAYOUTS = 16
"""Layouts tried on all messages of one length before the rest is read one by one (bounds the work on bad data)."""

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


class MalformedMessage(Exception):  # noqa: N818 -- internal: it is counted, not shown
    """These bytes are not a message of this type."""


class Decoded(NamedTuple):
    """All messages of a topic: batches that could be read, how many could not, how many had bytes to trim."""

    batches: tuple[Batch, ...]
    malformed: int
    trimmed: int


class _Walker:
    """Parses one message by the definition of its type and notes where each field is."""

    def __init__(self, payload: bytes, definitions: Definitions) -> None:
        if len(payload) < ENCAPSULATION_SIZE or payload[0] != 0 or payload[1] not in {0, 1}:
            raise MalformedMessage
        self.payload = payload
        self.definitions = definitions
        self.order = "<" if payload[1] else ">"
        self.position = ENCAPSULATION_SIZE
        self.fields: dict[str, Field] = {}
        self.texts: dict[str, tuple[str, ...]] = {}
        self.fixed: list[tuple[int, int]] = [(0, 2)]

    def walk(self, message_type: str, prefix: str = "") -> None:
        """Take all fields of a message or of a message in it."""
        detail: Any  # its shape depends on the kind, which the library types as a union
        if message_type not in self.definitions:
            raise MalformedMessage
        for name, (kind, detail) in self.definitions[message_type][1]:
            path = prefix + name
            if kind == Nodetype.NAME:
                self.walk(detail, path + ".")
            elif kind == Nodetype.BASE:
                self.take(path, detail[0], count=1, listed=False)
            else:
                (inner, what), length = detail
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
        self.position += -(self.position - ENCAPSULATION_SIZE) % size

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
        MalformedMessage: The bytes end too early, or are no plain CDR.
    """
    walker = _Walker(payload, typestore().fielddefs if definitions is None else definitions)
    walker.walk(message_type)
    return walker.layout()


class Decoder:
    """Reads the messages of one topic as they arrive, many at a time, and keeps only their numbers.

    Args:
        message_type: Their type.
        definitions: Of that type and those in it; None: those of `typestore`.
        keep: Dotted paths of the fields to keep beside the header's stamp; None: all.
    """

    def __init__(
        self, message_type: str, definitions: Definitions | None = None, keep: Collection[str] | None = None
    ) -> None:
        self.message_type = message_type
        self.keep = keep
        self.definitions = typestore().fielddefs if definitions is None else definitions
        self.count = 0
        self._malformed = self._trimmed = 0
        self._grown: dict[bytes, Growing] = {}

    def take(self, raw: NDArray[np.uint8], starts: NDArray[np.int64], stops: NDArray[np.int64]) -> None:
        """Read messages out of a block of bytes.

        Args:
            raw: The block.
            starts, stops: Where in it each message lies, shape (n,).
        """
        lengths = stops - starts
        is_one = len(lengths) > 0 and bool((lengths == lengths[0]).all())
        for length in (lengths[:1] if is_one else np.unique(lengths)).tolist():
            index = np.flatnonzero(lengths == length)
            if length == 0:
                self._malformed += len(index)
                continue
            matrix = sliding_window_view(raw, length)[starts[index]]
            for rows in _split_by_layout(matrix, index, self.message_type, self.definitions):
                if rows is None:
                    self._malformed += 1
                    continue
                if length - rows.layout.end > LARGEST_PADDING:
                    self._trimmed += len(rows.places)
                grown = self._grown.setdefault(rows.kind(), Growing(rows.layout))
                grown.extend(rows.places + self.count, rows.columns(self.keep), rows.stamps())
        self.count += len(starts)

    def take_messages(self, payloads: Sequence[bytes]) -> None:
        """Read messages, each in bytes of its own."""
        stops = np.cumsum(np.fromiter(map(len, payloads), dtype=np.int64, count=len(payloads)))
        raw = np.frombuffer(b"".join(payloads), np.uint8)
        self.take(raw, np.concatenate([np.zeros(1, np.int64), stops[:-1]])[: len(stops)], stops)

    def absorb(self, later: Decoder) -> None:
        """Add what another decoder of the same topic has read after this one, which then holds nothing."""
        while later._grown:
            kind, grown = later._grown.popitem()
            if kind in self._grown:
                self._grown[kind].absorb(grown, self.count)
            else:
                self._grown[kind] = grown.moved(self.count)
        self._malformed += later._malformed
        self._trimmed += later._trimmed
        self.count += later.count

    def decoded(self) -> Decoded:
        """Return all that was read."""
        return Decoded(tuple(grown.batch() for grown in self._grown.values()), self._malformed, self._trimmed)


class _Rows(NamedTuple):
    """Messages of one layout: `places` (n,) in their block, `matrix` (n, length) their raw bytes."""

    places: NDArray[np.intp]
    layout: Layout
    matrix: NDArray[np.uint8]

    def columns(self, keep: Collection[str] | None) -> dict[str, NDArray[Any]]:
        """Return the numbers of the fields to keep, shape (n, size)."""
        found = {}
        for path, field in self.layout.fields.items():
            if keep is None or path in keep:
                found[path] = self.numbers(field)
        return found

    def numbers(self, field: Field) -> NDArray[Any]:
        """Return those of one field, shape (n, size)."""
        stop = field.offset + field.size * np.dtype(field.dtype).itemsize
        raw = np.ascontiguousarray(self.matrix[:, field.offset : stop])
        return raw.view(field.dtype) if field.size else np.empty((len(raw), 0), field.dtype)

    def stamps(self) -> NDArray[np.int64] | None:
        """Return the stamps of the messages' headers, ns, shape (n,); None where they have none."""
        fields = self.layout.fields
        if SECONDS not in fields:
            return None
        seconds, nanoseconds = self.numbers(fields[SECONDS])[:, 0], self.numbers(fields[NANOSECONDS])[:, 0]
        return np.asarray(seconds.astype(np.int64) * SECOND + nanoseconds.astype(np.int64))

    def kind(self) -> bytes:
        """Return what distinguishes this layout from others: its lengths and names, and its end."""
        fixed = b"".join(self.matrix[0, start:stop].tobytes() for start, stop in self.layout.fixed)
        return self.layout.end.to_bytes(8, "little") + fixed


def _split_by_layout(
    matrix: NDArray[np.uint8], index: NDArray[np.intp], message_type: str, definitions: Definitions
) -> Iterator[_Rows | None]:
    """Yield messages that share a layout; None for each message that cannot be read."""
    layouts = 0
    while len(index):
        try:
            layout = find_layout(matrix[0].tobytes(), message_type, definitions)
        except MalformedMessage:
            yield None
            matrix, index = matrix[1:], index[1:]
            continue
        layouts += 1
        same = np.zeros(len(index), dtype=bool)
        same[0] = True
        if layouts <= MOST_LAYOUTS:
            same = _same_layout(matrix, layout)
        if same.all():
            yield _Rows(index, layout, matrix)
            return
        yield _Rows(index[same], layout, matrix[same])
        # A message parsed alone is dropped from the front as a view; copying the rest each time would be quadratic.
        only_first = layouts > MOST_LAYOUTS
        matrix, index = (matrix[1:], index[1:]) if only_first else (matrix[~same], index[~same])


def _same_layout(matrix: NDArray[np.uint8], layout: Layout) -> NDArray[np.bool_]:
    is_fixed = np.zeros(matrix.shape[1], dtype=bool)
    for start, stop in layout.fixed:
        is_fixed[start:stop] = True
    differs = matrix != matrix[0]
    differs &= is_fixed
    # Mostly none does, which all bytes in a row say sooner than those of each message.
    return ~differs.any(axis=1) if differs.any() else np.ones(len(matrix), dtype=bool)


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
