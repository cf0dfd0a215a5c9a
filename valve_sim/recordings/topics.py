"""The messages of one topic as columns: only their times and the numbers that are asked for are kept.

They are decoded as they come out of a file, many at a time: those of one length are the rows of a matrix of bytes, and
those of one layout have each number in the same columns of it.
"""

from __future__ import annotations

import itertools
import re
from contextlib import suppress
from typing import TYPE_CHECKING, Any, Final, NamedTuple

import numpy as np

from valve_sim.recordings.cdr import UNREADABLE, MalformedMessage, find_layout, representation
from valve_sim.recordings.clocks import SECOND
from valve_sim.recordings.mcap_files import LARGEST_CHUNK, ZSTD_MAGIC, TooLargeError, cut_out, unpack_zstd

if TYPE_CHECKING:
    from collections.abc import Collection, Iterator, Sequence

    from numpy.typing import NDArray

    from valve_sim.files.recording_map import Source
    from valve_sim.recordings.cdr import Definitions, Layout

    Times = NDArray[np.int64]
    Column = NDArray[Any]
    Place = tuple[str, int]
    """A number of a message: the path of its field, and which one of the field's numbers it is."""

SECONDS: Final = "header.stamp.sec"
NANOSECONDS: Final = "header.stamp.nanosec"
"""Where messages with a header have their stamp."""
ONLY: Final = ""
"""In place of a path: the only number of messages that hold one beside their header."""
INDEXED: Final = re.compile(r"(.+)\[(\d+)\]")
LISTS: Final = ("position", "velocity", "effort")
"""Fields that have an index even where they hold one number now: that of the next message may hold more."""
MOST_NUMBERS: Final = 10_000
"""Numbers of one field that are kept where all of them are asked for: an image has millions."""
MOST_LAYOUTS: Final = 16
"""Layouts tried on all messages of one length before the rest is read one by one (bounds the work on bad data)."""
LARGEST_PADDING: Final = 3
"""A middleware may pad a message to 4 bytes; more than this after the last field is invalid."""
AT_ONCE: Final = 4096
"""Messages that come one by one are decoded so many together, or fewer where they have `LARGEST_CHUNK` bytes."""


class Batch(NamedTuple):
    """Messages of one layout.

    Attributes:
        layout: Of each.
        where: Which of the topic's messages they are: a slice, or their indices, shape (n,).
        columns: The numbers that were kept, shape (n,) each, by their places.
    """

    layout: Layout
    where: slice | NDArray[np.intp]
    columns: dict[Place, Column]

    @property
    def indices(self) -> NDArray[np.intp]:
        """Where in the topic they are, shape (n,)."""
        return np.arange(self.where.start, self.where.stop) if isinstance(self.where, slice) else self.where

    @property
    def size(self) -> int:
        """How many they are."""
        return len(self.indices)

    @property
    def joints(self) -> tuple[str, ...]:
        """The names of a JointState's joints; none of other messages."""
        return self.layout.texts.get("name", ())

    def number(self, source: Source) -> NDArray[np.float64] | None:
        """The number that a source names, shape (n,), a double's as it lies in memory; None where there is none."""
        path, place = source.path, 0
        if source.joint:
            if source.joint not in self.joints:
                return None
            place = self.joints.index(source.joint)
        else:
            if path == ONLY and _count(self.layout) == 1:
                (path,) = number_paths(self.layout)
            if path in self.layout.fields and self.layout.fields[path].size != 1:
                return None
            if path not in self.layout.fields and (indexed := INDEXED.fullmatch(path)):
                path, place = indexed[1], int(indexed[2])
        column = self.columns.get((path, place))
        return None if column is None else np.asarray(column, dtype=np.float64)

    def what_lacks(self, source: Source) -> str:
        """What to say of a source that these messages do not have: what was asked for, and what there is."""
        if source.joint and "name" in self.layout.texts:
            return f"names {', '.join(self.joints) or 'no joint'}, expected {source.joint}"
        listed = number_paths(self.layout)
        has = ", ".join(listed[:24]) + (f" and {len(listed) - 24} more" if len(listed) > 24 else "") or "no number"
        if source.joint:
            return (
                f"has no joint names, expected {source.joint} among them; it has {has}; give field: in place of joint:"
            )
        if not source.field:
            return f"holds several numbers ({has}); choose one with field:"
        return f"has no number {source.field}; it has {has}; choose one with field:"


class Ways(NamedTuple):
    """How long the messages of a topic took from publication to the log.

    Attributes:
        shortest, longest: ns.
        standing: How many messages were logged at the time of the one before.
        apart: How many of these were published at another time than the one before.
    """

    shortest: int
    longest: int
    standing: int
    apart: int


class Stamps(NamedTuple):
    """When each of n messages was taken.

    Attributes:
        taken: By its header, or where it has none when it was recorded, ns, shape (n,).
        delays: By how much later it was recorded, ns, shape (n,); bag times, which are these later, ascend.
        is_stamped: Whether its header says so, shape (n,).
    """

    taken: Times
    delays: NDArray[np.integer]
    is_stamped: NDArray[np.bool_]


def number_paths(layout: Layout) -> list[str]:
    """Every number that messages of a layout hold beside their header: "point.x", "position[0]"."""
    paths = []
    for path, field in layout.fields.items():
        if path.startswith("header."):
            continue
        is_list = field.size != 1 or path in LISTS
        paths += [f"{path}[{place}]" for place in range(field.size)] if is_list else [path]
    return paths


def _count(layout: Layout) -> int:
    """How many numbers messages of a layout hold beside their header."""
    return sum(field.size for path, field in layout.fields.items() if not path.startswith("header."))


class _Block(NamedTuple):
    """When each of n messages was logged and published, its header's stamp, all ns, and whether it has a header."""

    times: Times
    published: Times
    stamps: Times
    has_header: NDArray[np.bool_]


class Topic:
    """Takes the messages of a topic in the order of its files; `finish` puts them into the order of their times.

    Args:
        message_type: Theirs.
        definitions: Of that type and those in it; None where nobody knows them: messages are then counted only.
        keep: Paths of the numbers to keep beside the header's stamp: "point.x", "data[3]", all of "position", or
            `ONLY`; None: all.
        most: How many messages are enough; None: all.

    Attributes:
        size: How many messages there are.
        batches: What could be read.
        malformed: How many messages could not be read.
        trimmed: How many had bytes behind their last field.
        unreadable: Representations of messages that could not be read for these.
    """

    def __init__(
        self,
        message_type: str,
        definitions: Definitions | None,
        keep: Collection[str] | None = None,
        most: int | None = None,
    ) -> None:
        self.batches: tuple[Batch, ...] = ()
        self.malformed = self.trimmed = 0
        self.unreadable: set[str] = set()
        self.is_known = definitions is not None
        self._type, self._definitions, self._keep, self._most = message_type, definitions, keep, most
        self.size = 0
        self._blocks: list[_Block] = []
        self._batches: dict[bytes, list[Batch]] = {}
        self._layouts: dict[int, tuple[Layout, NDArray[np.uint8]]] = {}
        """By the length of a message: the last layout of such, and a message that has it."""
        self._waiting: list[tuple[int, int, bytes]] = []
        self._waiting_bytes = 0

    def take(self, times: Times, raw: NDArray[np.uint8], starts: Times, stops: Times, published: Times) -> None:
        """Take messages that lie in a block of bytes.

        Args:
            times: When each was recorded, ns, shape (n,).
            raw: The block.
            starts, stops: Where in it each message lies, shape (n,).
            published: When each was published by its sender's clock, ns, shape (n,).
        """
        if len(times) and raw[starts[0] : starts[0] + len(ZSTD_MAGIC)].tobytes() == ZSTD_MAGIC:
            for time, sent, start, stop in zip(*(x.tolist() for x in (times, published, starts, stops)), strict=True):
                self.add(time, raw[start:stop].tobytes(), sent)
        else:
            self._take(times, raw, starts, stops, published)

    def _take(self, times: Times, raw: NDArray[np.uint8], starts: Times, stops: Times, published: Times) -> None:
        if not len(times) or (self._most is not None and self.size >= self._most):
            return
        stamps, has_header = np.zeros_like(times), np.zeros(len(times), dtype=bool)
        if self._definitions is not None:
            for layout, rows, index in self._decoded(raw, starts, stops - starts, self._definitions):
                if SECONDS in layout.fields:
                    seconds, rest = (_number(rows, layout, path, 0).astype(np.int64) for path in (SECONDS, NANOSECONDS))
                    stamps[index], has_header[index] = seconds * SECOND + rest, True
                columns = {place: _number(rows, layout, *place) for place in _kept(layout, self._keep)}
                batch = Batch(layout, _where(index + self.size), columns)
                self._batches.setdefault(_kind(rows[0], layout), []).append(batch)
        self._blocks.append(_Block(times, published, stamps, has_header))
        self.size += len(times)

    def add(self, time: int, payload: bytes, published: int | None = None) -> None:
        """Take one message, unpacking it where the recorder packed each message.

        Raises:
            TooLargeError: it unpacks to more than `LARGEST_CHUNK`.
        """
        if payload.startswith(ZSTD_MAGIC):
            unpacked = unpack_zstd(payload)
            if len(unpacked) > LARGEST_CHUNK:
                raise TooLargeError(
                    f"a message of {len(payload)} bytes unpacks to more than {LARGEST_CHUNK / 1e6:.0f} MB, expected "
                    "less; record numbers, not this"
                )
            payload = unpacked
        self._waiting.append((time, time if published is None else published, payload))
        self._waiting_bytes += len(payload)
        if len(self._waiting) >= AT_ONCE or self._waiting_bytes > LARGEST_CHUNK:
            self._take_waiting()

    def _take_waiting(self) -> None:
        if self._waiting:
            times, published, payloads = zip(*self._waiting, strict=True)
            self._waiting, self._waiting_bytes = [], 0
            stops = np.cumsum([len(payload) for payload in payloads])
            raw = np.frombuffer(b"".join(payloads), np.uint8)
            starts = np.concatenate([[0], stops[:-1]])
            self._take(_whole(times), raw, starts, stops, _whole(published))

    def _decoded(
        self, raw: NDArray[np.uint8], starts: Times, lengths: NDArray[np.integer], definitions: Definitions
    ) -> Iterator[tuple[Layout, NDArray[np.uint8], NDArray[np.intp]]]:
        """Yield layouts, the bytes of the messages that share one, and their indices; count what is no message."""
        is_one = bool((lengths == lengths[:1]).all())
        for length in (lengths[:1] if is_one else np.unique(lengths)).tolist():
            index = np.flatnonzero(lengths == length)
            if length == 0:
                self.malformed += len(index)
                continue
            matrix = cut_out(raw, starts[index], np.dtype(f"V{length}")).view(np.uint8).reshape(-1, length)
            for layout, rows, own in self._split_by_layout(matrix, index, definitions):
                if layout is None:
                    self.malformed += len(own)
                    self.unreadable |= {UNREADABLE.get(representation(rows[0].tobytes()), "")} - {""}
                    continue
                if length - layout.end > LARGEST_PADDING:
                    self.trimmed += len(own)
                yield layout, rows, own

    def _split_by_layout(
        self, matrix: NDArray[np.uint8], index: NDArray[np.intp], definitions: Definitions
    ) -> Iterator[tuple[Layout | None, NDArray[np.uint8], NDArray[np.intp]]]:
        """Yield layouts, the messages that share one, and their indices; None in place of one that cannot be read."""
        length, layouts = matrix.shape[1], 0
        known = self._layouts.get(length)  # of the messages before, which most are like
        while len(index):
            if known is None:
                with suppress(MalformedMessage):
                    known = find_layout(matrix[0].tobytes(), self._type, definitions), matrix[0].copy()
                    layouts += 1
            if known is None or layouts > MOST_LAYOUTS:
                yield known and known[0], matrix[:1], index[:1]
                # What is parsed alone is dropped from the front as a view; copying the rest each time would be
                # quadratic.
                matrix, index, known = matrix[1:], index[1:], None
                continue
            same = _same_layout(matrix, *known)
            if same.all():
                self._layouts[length] = known
                yield known[0], matrix, index
                return
            if same.any():
                yield known[0], matrix[same], index[same]
            matrix, index, known = matrix[~same], index[~same], None

    @property
    def logged(self) -> Times:
        """When each message was logged, ns, shape (n,), in the order of the files."""
        self._take_waiting()
        return np.concatenate([np.empty(0, dtype=np.int64), *(block.times for block in self._blocks)])

    @property
    def is_stamped(self) -> bool:
        """Whether a message has a header."""
        return any(block.has_header.any() for block in self._blocks)

    @property
    def ways(self) -> Ways | None:
        """How long messages took to the log, and how long it stood still; None where there is no message."""
        self._take_waiting()
        if not self._blocks:
            return None
        shortest, longest, standing, apart = [], [], 0, 0
        for block in self._blocks:
            way = block.times - block.published
            shortest.append(int(way.min()))
            longest.append(int(way.max()))
            stood = np.flatnonzero(block.times[1:] == block.times[:-1])
            standing += len(stood)
            apart += int(np.count_nonzero(block.published[stood + 1] != block.published[stood]))
        return Ways(min(shortest), max(longest), standing, apart)

    def finish(self, *, by_publication: bool = False) -> None:
        """Put what was taken into the order of time; later messages would be lost.

        Args:
            by_publication: whether messages count as recorded when they were published.
        """
        self._take_waiting()
        self.batches, self._batches = tuple(map(_joined, self._batches.values())), {}
        nothing = np.empty(0, dtype=np.int64)
        blocks = self._blocks or [_Block(nothing, nothing, nothing, nothing.astype(bool))]
        logged, published, stamps, has_header = (np.concatenate(parts) for parts in zip(*blocks, strict=True))
        recorded = published if by_publication else logged
        taken = np.where(has_header, stamps, recorded)
        if (recorded[1:] < recorded[:-1]).any():
            order = np.argsort(recorded, kind="stable")
            taken, recorded, has_header, rank = taken[order], recorded[order], has_header[order], np.argsort(order)
            self.batches = tuple(batch._replace(where=rank[batch.indices]) for batch in self.batches)
        self._stamps = Stamps(taken, recorded - taken, has_header)
        self._blocks = []

    def values(self, source: Source) -> tuple[NDArray[np.float64], Batch | None]:
        """Return the numbers that a source names, shape (n,), NaN in messages without it; and the last such messages.

        Where all messages are of one layout it is a view of what was read: of a long recording a copy is large.
        """
        parts = [(batch, batch.number(source)) for batch in self.batches]
        without = [batch for batch, found in parts if found is None]
        batch, found = parts[0]
        if found is not None and len(found) == self.size and isinstance(batch.where, slice):
            return found, None
        values = np.full(self.size, np.nan)
        for batch, found in parts:
            if found is not None:
                values[batch.where] = found
        return values, without[-1] if without else None

    def stamps(self, clock: str = "", *, may_be_zero: bool = False) -> Stamps:
        """Return when each message was taken by its header, or else recorded.

        Args:
            clock: "bag": no header is looked at.
            may_be_zero: Whether a stamp of 0 is one; else it was not filled.
        """
        taken, delays, has_header = self._stamps
        is_stamped = has_header & (clock != "bag") & (may_be_zero | (taken != 0))
        if is_stamped.all():
            return Stamps(taken.copy(), delays, is_stamped)
        return Stamps(np.where(is_stamped, taken, taken + delays), np.where(is_stamped, delays, 0), is_stamped)


def _whole(values: Sequence[int]) -> Times:
    """Times of messages as an array; a damaged file may have some that no clock has."""
    try:
        whole = np.array(values, dtype=np.int64)
    except OverflowError:
        whole = np.array([min(value, 2**63 - 1) for value in values], dtype=np.int64)
    return np.maximum(whole, 0)


def _kept(layout: Layout, keep: Collection[str] | None) -> Iterator[Place]:
    """The numbers of a layout that are to be kept, by field and place."""
    is_all = keep is None or (ONLY in keep and _count(layout) == 1)
    indexed = [found for path in keep or () if (found := INDEXED.fullmatch(path))]
    for path, field in layout.fields.items():
        if is_all or path in (keep or ()):
            yield from ((path, place) for place in range(min(field.size, MOST_NUMBERS)))
        else:
            places = {int(found[2]) for found in indexed if found[1] == path}
            yield from ((path, place) for place in places if place < field.size)


def _number(rows: NDArray[np.uint8], layout: Layout, path: str, place: int) -> Column:
    """One number of each message, shape (n,), out of their bytes, shape (n, length)."""
    offset, dtype, _ = layout.fields[path]
    begin = offset + place * np.dtype(dtype).itemsize
    return np.ndarray(len(rows), dtype, rows, begin, rows.strides[:1]).copy()


def _kind(message: NDArray[np.uint8], layout: Layout) -> bytes:
    """What distinguishes a layout from others: its lengths and names, and its end."""
    fixed = b"".join(message[start:stop].tobytes() for start, stop in layout.fixed)
    return layout.end.to_bytes(8, "little") + fixed


def _joined(parts: Sequence[Batch]) -> Batch:
    """Batches of one layout as one; the parts are emptied, so that little is held twice."""
    columns = {place: np.concatenate([own.columns.pop(place) for own in parts]) for place in list(parts[0].columns)}
    edges = [(own.where.start, own.where.stop) for own in parts if isinstance(own.where, slice)]
    if len(edges) == len(parts) and all(before[1] == after[0] for before, after in itertools.pairwise(edges)):
        return Batch(parts[0].layout, slice(edges[0][0], edges[-1][1]), columns)
    return Batch(parts[0].layout, np.concatenate([own.indices for own in parts]), columns)


def _where(indices: NDArray[np.intp]) -> slice | NDArray[np.intp]:
    """Indices, (n,) with n > 0, as a slice where each is one more than the one before."""
    is_row = bool((indices[1:] - indices[:-1] == 1).all())
    return slice(int(indices[0]), int(indices[-1]) + 1) if is_row else indices


def _same_layout(matrix: NDArray[np.uint8], layout: Layout, message: NDArray[np.uint8]) -> NDArray[np.bool_]:
    """(n,) which messages have the lengths and names of a layout, which another message has."""
    is_fixed = np.zeros(matrix.shape[1], dtype=bool)
    for start, stop in layout.fixed:
        is_fixed[start:stop] = True
    differs = matrix != message
    differs &= is_fixed
    # Mostly none does, which all bytes in a row say sooner than those of each message.
    return ~differs.any(axis=1) if differs.any() else np.ones(len(matrix), dtype=bool)
