"""MCAP files: by their message indexes, which is ten times as fast, or else record by record, up to a damage.

An index lists the times and places of a channel's messages in a chunk as one array, so the messages are cut out of
the unpacked chunk without parsing the records between them.
"""

from __future__ import annotations

import os
from dataclasses import dataclass, field
from io import BytesIO
from struct import Struct
from typing import TYPE_CHECKING, Any, BinaryIO, Final, NamedTuple
from zlib import crc32

import lz4.frame  # type: ignore[import-untyped]
import numpy as np
import zstandard
from mcap.data_stream import ReadDataStream
from mcap.opcode import Opcode
from mcap.reader import make_reader
from mcap.records import Channel, Chunk, ChunkIndex, Schema

from valve_sim.files.bounded import MOST_EXPANDED
from valve_sim.recordings.cdr import full_type

if TYPE_CHECKING:
    from collections.abc import Callable, Iterator, Mapping
    from pathlib import Path

    from mcap.summary import Summary
    from numpy.typing import NDArray

    from valve_sim.recordings.topics import Topic

    Bytes = NDArray[np.uint8]
    Places = NDArray[np.int64]

MCAP_MAGIC: Final = b"\x89MCAP0\r\n"
ZSTD_MAGIC: Final = b"\x28\xb5\x2f\xfd"
PIECE_SIZE: Final = 1 << 10
"""Compressed bytes are taken in pieces, so that what came before the damage is kept."""
LARGEST_CHUNK: Final = 1 << 27
"""Bytes that a chunk, or a message that is packed by itself, unpacks to at most: recorders write a few million."""
SMALL_CHUNK: Final = 1 << 23
"""Bytes that any chunk may unpack to."""
MOST_UNKNOWN: Final = 10_000
"""Records of other kinds that a file may have."""
RECORD_HEAD: Final = Struct("<BQ")
"""Opcode and length, before each record of an MCAP file."""
CHUNK_HEAD: Final = Struct("<QQQII")
"""First and last time, unpacked size, checksum and the length of the compression's name, at the start of a chunk."""
MESSAGE_HEAD: Final = Struct("<HIQQ")
"""Channel, sequence number, times of the log and of publication, before a message's payload."""
INDEX_HEAD: Final = Struct("<BQHI")
"""Opcode and length of a message index, its channel, and the bytes of what follows."""
MESSAGE: Final = np.dtype(
    [("opcode", "u1"), ("length", "<i8"), ("channel", "<u2"), ("sequence", "<u4"), ("logged", "<i8"), ("sent", "<i8")]
)
"""What stands before a message's payload."""


class NotIndexed(Exception):  # noqa: N818 -- internal: the file is then read in another way
    """The file has no message indexes, or they do not fit the data."""


class TooLargeError(Exception):
    """A chunk or a message unpacks to more than `LARGEST_CHUNK`: in words, with the mend."""


@dataclass
class Contents:
    """What a storage file holds.

    Attributes:
        types: Topic to message type. definitions: Message type to its definition's format ("ros2msg") and text.
        count: How many messages, of topics that are asked for or not.
        complete: Whether the end of the data was reached. damaged_chunks: That were cut, or do not unpack whole.
        encodings: Of messages that are no CDR and were left out.
    """

    types: dict[str, str] = field(default_factory=dict)
    definitions: dict[str, tuple[str, str]] = field(default_factory=dict)
    count: int = 0
    complete: bool = False
    damaged_chunks: int = 0
    encodings: set[str] = field(default_factory=set)

    def add_channel(self, channel: Channel, schema: Schema | None) -> str:
        """Note a channel; its topic if its messages can be read, else empty."""
        if channel.message_encoding != "cdr":
            self.encodings.add(channel.message_encoding)
        elif schema is not None:
            kind = full_type(schema.name)
            self.definitions.setdefault(kind, (schema.encoding, schema.data.decode("utf-8", "replace")))
            return self.add_topic(channel.topic, kind)
        return ""

    def add_topic(self, name: str, kind: str) -> str:
        """Note a topic and its type; its name as ROS has it, where a recorder wrote that of the middleware."""
        topic = "/" + name.removeprefix("rt/").lstrip("/")
        self.types.setdefault(topic, kind)
        return topic


class Sent(NamedTuple):
    """A message: its channel's number, times of the log and of publication, ns, and payload."""

    channel: int
    logged: int
    published: int
    payload: bytes


class IndexedMcap:
    """An MCAP file with its summary.

    Raises:
        NotIndexed: It has none, or one that does not repeat all channels and schemas.
    """

    def __init__(self, path: Path) -> None:
        self._path = path
        with path.open("rb") as stream:
            summary = _summary(stream)
        if summary is None or summary.statistics is None:
            raise NotIndexed
        if len(summary.channels) < summary.statistics.channel_count:
            raise NotIndexed
        self.contents = Contents(count=summary.statistics.message_count, complete=True)
        self._chunks = summary.chunk_indexes
        counts = summary.statistics.channel_message_counts
        self._left, self._topics = dict(counts), {}
        if any(own.schema_id and own.schema_id not in summary.schemas for own in summary.channels.values()):
            raise NotIndexed
        for number, channel in summary.channels.items():
            if topic := self.contents.add_channel(channel, summary.schemas.get(channel.schema_id)):
                self._topics[number] = topic
        if sum(counts.values()) < self.contents.count:
            raise NotIndexed

    def read(self, topics: Mapping[str, Topic]) -> None:
        """Give topics, by name, their messages, chunk by chunk.

        Raises:
            NotIndexed: The index does not fit the data. What was taken so far must be dropped.
        """
        channels = {number: topics[name] for number, name in self._topics.items() if name in topics}
        left = {number: self._left.get(number, 0) for number in channels}
        with self._path.open("rb") as stream:
            for index in self._chunks:
                here = sorted(channels.keys() & index.message_index_offsets.keys())
                if here:
                    raw = _unpacked(stream, index)
                    for number in here:
                        times, places = _message_index(stream, index.message_index_offsets[number])
                        starts, stops, published = _payload_bounds(raw, places, number)
                        if (stops - starts).sum() > len(raw):
                            raise NotIndexed
                        channels[number].take(times, raw, starts, stops, published)
                        left[number] -= len(times)
        if any(left.values()):
            raise NotIndexed


def _summary(stream: BinaryIO) -> Summary | None:
    try:
        return make_reader(stream).get_summary()
    except Exception:  # the library raises what it happens to meet
        return None


def _unpacked(stream: BinaryIO, index: ChunkIndex) -> Bytes:
    stream.seek(index.chunk_start_offset + RECORD_HEAD.size)
    chunk = Chunk.read(ReadDataStream(stream))
    data = unpack_chunk(chunk)
    if not _is_sound(chunk, data):
        raise NotIndexed
    return np.frombuffer(data, np.uint8)


def _message_index(stream: BinaryIO, offset: int) -> tuple[Places, Places]:
    """Return times, ns, and places in the unpacked chunk of a channel's messages."""
    stream.seek(offset)
    opcode, _, _, size = INDEX_HEAD.unpack(stream.read(INDEX_HEAD.size))
    raw = stream.read(size)
    if opcode != Opcode.MESSAGE_INDEX or len(raw) % 16:
        raise NotIndexed
    entries = np.frombuffer(raw, dtype="<i8").reshape(-1, 2)
    return entries[:, 0].copy(), entries[:, 1].copy()


def cut_out(raw: Bytes, starts: NDArray[np.integer], dtype: np.dtype[Any]) -> NDArray[Any]:
    """Copy what lies in bytes from each of some places on, shape (n,); all of it must be in them.

    Each is copied whole, which is three times as fast as a window of bytes.
    """
    from_each: NDArray[Any] = np.ndarray(len(raw) - dtype.itemsize + 1, dtype, raw, 0, (1,))
    return np.asarray(from_each[starts])


def _payload_bounds(raw: Bytes, places: Places, channel: int) -> tuple[Places, Places, Places]:
    """Return where in a chunk's bytes the payloads of the records at `places` start and stop, and when published."""
    if not len(places):
        return places, places, places
    if not 0 <= places.min() <= places.max() <= len(raw) - MESSAGE.itemsize:
        raise NotIndexed
    heads = cut_out(raw, places, MESSAGE)
    starts, lengths = places + MESSAGE.itemsize, heads["length"].copy()
    stops = places + RECORD_HEAD.size + lengths
    if not (MESSAGE_HEAD.size <= lengths.min() <= lengths.max() <= len(raw) and stops.max() <= len(raw)):
        raise NotIndexed
    if not ((heads["opcode"] == Opcode.MESSAGE).all() and (heads["channel"] == channel).all()):
        raise NotIndexed
    return starts, stops, np.ascontiguousarray(heads["sent"])


# --- record by record ---


def read_records(path: Path, topics: Mapping[str, Topic]) -> Contents:
    """Read a file as far as it is valid.

    Args:
        path: The file.
        topics: By name, which take their messages; of others messages are counted only.

    Raises:
        TooLargeError: A chunk is.
    """
    found = Contents()
    schemas: dict[int, Schema] = {}
    channels: dict[int, str] = {}
    with path.open("rb") as stream:
        for record in _all_records(stream, found):
            if isinstance(record, Schema):
                schemas[record.id] = record
            elif isinstance(record, Channel):
                if name := found.add_channel(record, schemas.get(record.schema_id)):
                    channels[record.id] = name
            elif record.channel in channels:
                found.count += 1
                topic = topics.get(channels[record.channel])
                if topic is not None:
                    topic.add(record.logged, record.payload, record.published)
    return found


def _all_records(stream: BinaryIO, found: Contents) -> Iterator[Schema | Channel | Sent]:
    """Yield schemas, channels and messages, those inside of chunks too, up to the damage.

    Before them come the schemas and channels that the end of a whole file repeats: the first chunk may be damaged.
    """
    summary, size = _summary(stream), stream.seek(0, os.SEEK_END)
    if summary is not None:
        yield from summary.schemas.values()
        yield from summary.channels.values()
    stream.seek(len(MCAP_MAGIC))
    others = 0
    while len(head := stream.read(RECORD_HEAD.size)) == RECORD_HEAD.size:
        opcode, length = RECORD_HEAD.unpack(head)
        is_cut = length > size - stream.tell()
        if opcode == Opcode.DATA_END:
            found.complete = not is_cut
            return
        if opcode == Opcode.CHUNK:
            yield from _chunk_records(stream.read(size if is_cut else length), found)
        elif is_cut:
            return
        elif opcode in (Opcode.SCHEMA, Opcode.CHANNEL, Opcode.MESSAGE):
            record = _record(opcode, stream.read(length))
            if record is None:
                return
            yield record
        else:
            others += 1
            if opcode == 0 or others > MOST_UNKNOWN:
                return
            stream.seek(length, os.SEEK_CUR)


def _chunk_records(data: bytes, found: Contents) -> Iterator[Schema | Channel | Sent]:
    """Yield the records of a chunk that may be cut, up to its damage."""
    if len(data) < CHUNK_HEAD.size:
        found.damaged_chunks += 1
        return
    first, last, size, checksum, name = CHUNK_HEAD.unpack_from(data)
    begin = CHUNK_HEAD.size + name
    compression = data[CHUNK_HEAD.size : begin].decode("utf-8", "replace")
    chunk = Chunk(compression, data[begin + 8 :], last, first, checksum, size)
    unpacked = unpack_chunk(chunk)
    if not _is_sound(chunk, unpacked):
        found.damaged_chunks += 1
        if len(unpacked) == size:  # any byte may be wrong, and a wrong position is worse than a missing one
            return
    unpacked, begin = unpacked[:size], RECORD_HEAD.size
    while begin <= len(unpacked):
        opcode, length = RECORD_HEAD.unpack_from(unpacked, begin - RECORD_HEAD.size)
        stop = begin + length
        if stop > len(unpacked):
            return
        if opcode in (Opcode.SCHEMA, Opcode.CHANNEL, Opcode.MESSAGE):
            record = _record(opcode, unpacked[begin:stop])
            if record is None:  # it is invalid, and so may be what follows
                return
            yield record
        else:  # no other is allowed here
            return
        begin = stop + RECORD_HEAD.size


def _record(opcode: int, data: bytes) -> Schema | Channel | Sent | None:
    """A record by its bytes; None where they are invalid."""
    if opcode == Opcode.MESSAGE:
        if len(data) < MESSAGE_HEAD.size:
            return None
        number, _, logged, published = MESSAGE_HEAD.unpack_from(data)
        return Sent(number, logged, published, data[MESSAGE_HEAD.size :])
    stream = ReadDataStream(BytesIO(data))
    try:
        found: Schema | Channel = Schema.read(stream) if opcode == Opcode.SCHEMA else Channel.read(stream)
    except Exception:  # the library raises what it happens to meet
        return None
    return found


# --- what is packed ---


def unpack_zstd(data: bytes, most: int = LARGEST_CHUNK) -> bytes:
    """Unpack as much as there is of a zstd frame that may be cut or damaged, and hardly more than `most` bytes."""
    return _unpack_pieces(zstandard.ZstdDecompressor().decompressobj().decompress, data, most)


def _unpack_pieces(unpack: Callable[[bytes], bytes], data: bytes, most: int) -> bytes:
    pieces, size = [], 0
    try:
        for start in range(0, len(data), PIECE_SIZE):
            pieces.append(unpack(data[start : start + PIECE_SIZE]))
            size += len(pieces[-1])
            if size > most:
                break
    except (zstandard.ZstdError, RuntimeError, EOFError):
        pass
    return b"".join(pieces)


def unpack_chunk(chunk: Chunk) -> bytes:
    """Unpack as much as there is of a chunk.

    Raises:
        TooLargeError: It says that it is larger than `LARGEST_CHUNK`.
    """
    size = chunk.uncompressed_size
    if size > min(LARGEST_CHUNK, MOST_EXPANDED * len(chunk.data) + SMALL_CHUNK):
        raise TooLargeError(
            f"a chunk of {len(chunk.data)} bytes unpacks to {size / 1e6:.6g} MB, expected at most "
            f"{LARGEST_CHUNK / 1e6:.0f} MB and {MOST_EXPANDED} times its size; write the recording again with smaller "
            "chunks (ros2 bag convert)"
        )
    if chunk.compression == "zstd":
        return unpack_zstd(chunk.data, size)
    if chunk.compression == "lz4":
        return _unpack_pieces(lz4.frame.LZ4FrameDecompressor().decompress, chunk.data, size)
    return bytes(chunk.data[:size])


def _is_sound(chunk: Chunk, data: bytes) -> bool:
    """Whether unpacked data have the size and the checksum (where there is one) that the chunk declares."""
    if len(data) != chunk.uncompressed_size:
        return False
    return not chunk.uncompressed_crc or crc32(data) == chunk.uncompressed_crc
