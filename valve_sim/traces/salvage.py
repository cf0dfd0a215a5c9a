"""What can still be read from a damaged storage file: MCAP record by record, SQLite3 row by row."""

from __future__ import annotations

import sqlite3
from collections import defaultdict
from dataclasses import dataclass, field
from io import BytesIO
from operator import itemgetter
from typing import TYPE_CHECKING, Any, BinaryIO
from zlib import crc32

import lz4.frame  # type: ignore[import-untyped]
import zstandard
from mcap.data_stream import ReadDataStream
from mcap.opcode import Opcode
from mcap.records import Channel, Chunk, DataEnd, McapRecord, Message, Schema
from mcap.stream_reader import StreamReader

from valve_sim.files.channels import CHANNELS

if TYPE_CHECKING:
    from collections.abc import Iterator
    from pathlib import Path

MCAP_MAGIC = b"\x89MCAP0\r\n"
SQLITE_MAGIC = b"SQLite format 3\0"
ZSTD_MAGIC = b"\x28\xb5\x2f\xfd"
PIECE_SIZE = 1 << 16
"""Compressed bytes are taken in pieces, so that what came before the damage is kept."""

KEPT_TYPES = frozenset(place.message_type for channel in CHANNELS.values() for place in channel.places)
"""Types this package reads; a salvage is held in memory, which the images of a camera must not fill."""


@dataclass
class Salvaged:
    """Messages that a damaged file still holds.

    Attributes:
        types: Topic to message type.
        times: Topic to bag times, ns.
        payloads: Topic to serialized messages.
        complete: Whether the end of the data was reached, so that only an index is missing.
        damaged_chunks: Chunks that were cut, or could not be unpacked whole.
        encodings: Message encodings other than CDR that were met and left out.
        others: Messages of other types, counted but not kept.
        wanted: Topics that are kept whatever their type.
    """

    types: dict[str, str] = field(default_factory=dict)
    times: dict[str, list[int]] = field(default_factory=lambda: defaultdict(list))
    payloads: dict[str, list[bytes]] = field(default_factory=lambda: defaultdict(list))
    complete: bool = False
    damaged_chunks: int = 0
    encodings: set[str] = field(default_factory=set)
    others: int = 0
    wanted: frozenset[str] = frozenset()

    @property
    def count(self) -> int:
        """All messages that could be read."""
        return self.others + sum(map(len, self.times.values()))

    def add(self, topic: str, time: int, payload: bytes) -> None:
        """Keep one message, unpacking it where the recorder packed each message."""
        if self.types[topic] not in KEPT_TYPES and topic not in self.wanted:
            self.others += 1
            return
        packed = payload.startswith(ZSTD_MAGIC)
        self.times[topic].append(time)
        self.payloads[topic].append(unpack_zstd(payload) if packed else payload)


def full_type(message_type: str) -> str:
    """Return the type with its "msg" part, which some recorders leave out."""
    package, _, name = message_type.rpartition("/")
    return message_type if "/" in package else f"{package}/msg/{name}"


def unpack_zstd(data: bytes) -> bytes:
    """Unpack as much as there is of a zstd frame that may be cut or damaged."""
    unpacker = zstandard.ZstdDecompressor().decompressobj()
    return _unpack_pieces(unpacker.decompress, data)


def _unpack_lz4(data: bytes) -> bytes:
    return _unpack_pieces(lz4.frame.LZ4FrameDecompressor().decompress, data)


def _unpack_pieces(unpack: object, data: bytes) -> bytes:
    assert callable(unpack)
    pieces = []
    try:
        for start in range(0, len(data), PIECE_SIZE):
            pieces.append(unpack(data[start : start + PIECE_SIZE]))
    except (zstandard.ZstdError, RuntimeError, EOFError):
        pass
    return b"".join(pieces)


def salvage_mcap(path: Path, wanted: frozenset[str] = frozenset()) -> Salvaged:
    """Read an MCAP file from its start as far as it is valid; messages of a topic are in the order of bag time."""
    salvaged = Salvaged(wanted=wanted)
    channels: dict[int, str] = {}
    with path.open("rb") as stream:
        schemas: dict[int, str] = {}
        for record in _all_records(stream, salvaged):
            if isinstance(record, Schema):
                schemas[record.id] = record.name
            elif isinstance(record, Channel):
                if record.message_encoding != "cdr":
                    salvaged.encodings.add(record.message_encoding)
                    continue
                channels[record.id] = record.topic
                salvaged.types.setdefault(record.topic, full_type(schemas.get(record.schema_id, "")))
            elif isinstance(record, Message) and record.channel_id in channels:
                salvaged.add(channels[record.channel_id], record.log_time, record.data)
    for topic, times in salvaged.times.items():
        order = sorted(range(len(times)), key=times.__getitem__)
        salvaged.payloads[topic] = [salvaged.payloads[topic][place] for place in order]
        salvaged.times[topic] = [times[place] for place in order]
    return salvaged


def _all_records(stream: BinaryIO, salvaged: Salvaged) -> Iterator[McapRecord]:
    """Yield schemas, channels and messages, those inside of chunks too, up to the damage."""
    good_until = len(MCAP_MAGIC)
    records = StreamReader(stream, emit_chunks=True).records
    while True:
        try:
            record = next(records)
        except Exception:  # the library raises what it happens to meet: EndOfFile, struct.error, ValueError ...
            break
        good_until = stream.tell()
        if isinstance(record, Chunk):
            yield from _chunk_records(record, salvaged)
            continue
        salvaged.complete |= isinstance(record, DataEnd)
        yield record
        if salvaged.complete:
            return
    chunk = _cut_chunk(stream, good_until)
    if chunk is not None:
        yield from _chunk_records(chunk, salvaged)


def _cut_chunk(stream: BinaryIO, start: int) -> Chunk | None:
    """Read the chunk at the file's cut end, as far as it goes."""
    stream.seek(start)
    head = stream.read(9)
    if len(head) < 9 or head[0] != Opcode.CHUNK:
        return None
    rest = ReadDataStream(stream)
    try:
        start_time, end_time, size = rest.read8(), rest.read8(), rest.read8()
        checksum, compression = rest.read4(), rest.read_prefixed_string()
        rest.read8()
    except Exception:  # cut within the chunk's head, or invalid: nothing to read
        return None
    return Chunk(compression, stream.read(), end_time, start_time, checksum, size)


def _chunk_records(chunk: Chunk, salvaged: Salvaged) -> Iterator[McapRecord]:
    data = unpack_chunk(chunk)
    salvaged.damaged_chunks += not chunk_is_sound(chunk, data)
    if len(data) == chunk.uncompressed_size and not chunk_is_sound(chunk, data):
        # It is unknown which bytes are wrong, and a wrong position is worse than a missing one.
        return
    records = StreamReader(BytesIO(data), skip_magic=True).records
    while True:
        try:
            yield next(records)
        except Exception:  # the end of the chunk, or of what is left of it
            return


def unpack_chunk(chunk: Chunk) -> bytes:
    """Unpack as much as there is of a chunk."""
    if chunk.compression == "zstd":
        return unpack_zstd(chunk.data)
    if chunk.compression == "lz4":
        return _unpack_lz4(chunk.data)
    return bytes(chunk.data[: chunk.uncompressed_size])


def chunk_is_sound(chunk: Chunk, data: bytes) -> bool:
    """Say whether unpacked data have the size and the checksum (where there is one) that the chunk declares."""
    if len(data) != chunk.uncompressed_size:
        return False
    return not chunk.uncompressed_crc or crc32(data) == chunk.uncompressed_crc


def salvage_sqlite(path: Path, wanted: frozenset[str] = frozenset()) -> Salvaged:
    """Read the rows of a damaged rosbag2 database from both ends, without its index."""
    salvaged = Salvaged(wanted=wanted)
    names: dict[int, str] = {}
    connection = sqlite3.connect(f"{path.absolute().as_uri()}?immutable=1", uri=True)
    try:
        # Without it SQLite refuses a file shorter than its header says, before it reads one row.
        connection.execute("PRAGMA writable_schema=ON")
        for number, name, message_type in _rows(connection, "SELECT id, name, type FROM topics"):
            if isinstance(name, str) and isinstance(message_type, str):
                names[number] = name
                salvaged.types[name] = full_type(message_type)
        query = "SELECT id, topic_id, timestamp, data FROM messages ORDER BY id"
        rows = {row[0]: row[1:] for row in _rows(connection, query)}
        last = max(rows, default=0)
        for row in _rows(connection, f"{query} DESC"):
            if row[0] <= last:
                break
            rows[row[0]] = row[1:]
    finally:
        connection.close()
    # Of a row on a damaged page, any column may be missing or of another kind.
    sound = (row for row in rows.values() if row[0] in names and isinstance(row[1], int) and isinstance(row[2], bytes))
    for number, time, payload in sorted(sound, key=itemgetter(1)):
        salvaged.add(names[number], time, payload)
    return salvaged


def _rows(connection: sqlite3.Connection, query: str) -> Iterator[tuple[Any, ...]]:
    try:
        yield from connection.execute(query)
    except (sqlite3.Error, MemoryError):  # a damaged page, or one that claims terabytes: what came before it is kept
        return
