"""What can still be read from a damaged storage file: MCAP record by record, SQLite3 row by row."""

from __future__ import annotations

import itertools
import sqlite3
from dataclasses import dataclass, field
from io import BytesIO
from struct import Struct
from typing import TYPE_CHECKING, Any, BinaryIO, Final
from zlib import crc32

import lz4.frame  # type: ignore[import-untyped]
import zstandard
from mcap.data_stream import ReadDataStream
from mcap.opcode import Opcode
from mcap.reader import make_reader
from mcap.records import Channel, Chunk, DataEnd, McapRecord, Message, Schema
from mcap.stream_reader import StreamReader

from valve_sim.traces.cdr import full_type

if TYPE_CHECKING:
    from collections.abc import Callable, Iterator, Mapping
    from pathlib import Path

    from valve_sim.traces.topics import Topic

MCAP_MAGIC: Final = b"\x89MCAP0\r\n"
SQLITE_MAGIC: Final = b"SQLite format 3\0"
ZSTD_MAGIC: Final = b"\x28\xb5\x2f\xfd"
PIECE_SIZE: Final = 1 << 10
"""Compressed bytes are taken in pieces, so that what came before the damage is kept."""
RECORD_HEAD: Final = Struct("<BQ")
"""Opcode and length, before each record of an MCAP file."""
MESSAGE_HEAD: Final = Struct("<HIQQ")
"""Channel, sequence number, times of the log and of publication, before a message's payload."""


@dataclass
class Salvaged:
    """What a damaged file still holds.

    Attributes:
        types: Topic to message type.
        count: How many messages, of topics that are asked for or not.
        complete: Whether the end of the data was reached, so that only an index is missing.
        damaged_chunks: Chunks that were cut, or could not be unpacked whole.
        encodings: Message encodings other than CDR that were met and left out.
    """

    types: dict[str, str] = field(default_factory=dict)
    count: int = 0
    complete: bool = False
    damaged_chunks: int = 0
    encodings: set[str] = field(default_factory=set)


def unpack_zstd(data: bytes) -> bytes:
    """Unpack as much as there is of a zstd frame that may be cut or damaged."""
    return _unpack_pieces(zstandard.ZstdDecompressor().decompressobj().decompress, data)


def _unpack_pieces(unpack: Callable[[bytes], bytes], data: bytes) -> bytes:
    pieces = []
    try:
        for start in range(0, len(data), PIECE_SIZE):
            pieces.append(unpack(data[start : start + PIECE_SIZE]))
    except (zstandard.ZstdError, RuntimeError, EOFError):
        pass
    return b"".join(pieces)


def unpack_chunk(chunk: Chunk) -> bytes:
    """Unpack as much as there is of a chunk."""
    if chunk.compression == "zstd":
        return unpack_zstd(chunk.data)
    if chunk.compression == "lz4":
        return _unpack_pieces(lz4.frame.LZ4FrameDecompressor().decompress, chunk.data)
    return bytes(chunk.data[: chunk.uncompressed_size])


def chunk_is_sound(chunk: Chunk, data: bytes) -> bool:
    """Say whether unpacked data have the size and the checksum (where there is one) that the chunk declares."""
    if len(data) != chunk.uncompressed_size:
        return False
    return not chunk.uncompressed_crc or crc32(data) == chunk.uncompressed_crc


def salvage(path: Path, topics: Mapping[str, Topic]) -> Salvaged:
    """Read a storage file as far as it is valid.

    Args:
        path: A .mcap or .db3 file.
        topics: By name, which take their messages; of others messages are counted only.
    """
    return _salvage_mcap(path, topics) if path.suffix == ".mcap" else _salvage_sqlite(path, topics)


def _salvage_mcap(path: Path, topics: Mapping[str, Topic]) -> Salvaged:
    found = Salvaged()
    schemas: dict[int, str] = {}
    channels: dict[int, str] = {}
    with path.open("rb") as stream:
        for record in itertools.chain(_repeated(stream), _all_records(stream, found)):
            if isinstance(record, Schema):
                schemas[record.id] = record.name
            elif isinstance(record, Channel):
                if record.message_encoding == "cdr":
                    channels[record.id] = record.topic
                    found.types.setdefault(record.topic, full_type(schemas.get(record.schema_id, "")))
                else:
                    found.encodings.add(record.message_encoding)
            elif isinstance(record, Message) and record.channel_id in channels:
                found.count += 1
                topic = topics.get(channels[record.channel_id])
                if topic is not None:
                    topic.add(record.log_time, record.data)
    return found


def _repeated(stream: BinaryIO) -> Iterator[McapRecord]:
    """Yield schemas and channels as the end of a file repeats them, if it is whole: the first chunk may be damaged."""
    try:
        summary = make_reader(stream).get_summary()
    except Exception:  # the library raises what it happens to meet
        summary = None
    stream.seek(0)
    if summary is not None:
        yield from summary.schemas.values()
        yield from summary.channels.values()


def _all_records(stream: BinaryIO, found: Salvaged) -> Iterator[McapRecord]:
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
            yield from _chunk_records(record, found)
            continue
        found.complete |= isinstance(record, DataEnd)
        yield record
        if found.complete:
            return
    chunk = _cut_chunk(stream, good_until)
    if chunk is not None:
        yield from _chunk_records(chunk, found)


def _cut_chunk(stream: BinaryIO, start: int) -> Chunk | None:
    """Read the chunk at the file's cut end, as far as it goes."""
    stream.seek(start)
    head = stream.read(RECORD_HEAD.size)
    if len(head) < RECORD_HEAD.size or head[0] != Opcode.CHUNK:
        return None
    rest = ReadDataStream(stream)
    try:
        start_time, end_time, size = rest.read8(), rest.read8(), rest.read8()
        checksum, compression = rest.read4(), rest.read_prefixed_string()
        rest.read8()
    except Exception:  # cut within the chunk's head, or invalid: nothing to read
        return None
    return Chunk(compression, stream.read(), end_time, start_time, checksum, size)


def _chunk_records(chunk: Chunk, found: Salvaged) -> Iterator[McapRecord]:
    """Yield the records of a chunk, up to its damage."""
    data = unpack_chunk(chunk)
    found.damaged_chunks += not chunk_is_sound(chunk, data)
    if len(data) == chunk.uncompressed_size and not chunk_is_sound(chunk, data):
        # It is unknown which bytes are wrong, and a wrong position is worse than a missing one.
        return
    begin = RECORD_HEAD.size
    while begin <= len(data):
        opcode, length = RECORD_HEAD.unpack_from(data, begin - RECORD_HEAD.size)
        stop = begin + length
        if stop > len(data) or (opcode == Opcode.MESSAGE and length < MESSAGE_HEAD.size):
            return
        try:
            if opcode == Opcode.MESSAGE:  # the library takes ten times as long
                payload = data[begin + MESSAGE_HEAD.size : stop]
                channel, sequence, time, published = MESSAGE_HEAD.unpack_from(data, begin)
                yield Message(channel, time, payload, published, sequence)
            elif opcode in (Opcode.SCHEMA, Opcode.CHANNEL):
                kind = Schema if opcode == Opcode.SCHEMA else Channel
                yield kind.read(ReadDataStream(BytesIO(data[begin:stop])))
        except Exception:  # it is invalid, and so may be what follows
            return
        begin = stop + RECORD_HEAD.size


def _salvage_sqlite(path: Path, topics: Mapping[str, Topic]) -> Salvaged:
    """Read the rows of a rosbag2 database from both ends, without its index."""
    found = Salvaged()
    names: dict[int, str] = {}
    connection = sqlite3.connect(f"{path.absolute().as_uri()}?immutable=1", uri=True)
    try:
        # Without it SQLite refuses a file shorter than its header says, before it reads one row.
        connection.execute("PRAGMA writable_schema=ON")
        found.complete = list(_rows(connection, "PRAGMA quick_check")) == [("ok",)]
        for number, name, message_type in _rows(connection, "SELECT id, name, type FROM topics"):
            if isinstance(name, str) and isinstance(message_type, str):
                names[number] = name
                found.types[name] = full_type(message_type)
        query = "SELECT id, topic_id, timestamp, data FROM messages ORDER BY id"
        rows = {row[0]: row[1:] for row in _rows(connection, query)}
        last = max(rows, default=0)
        for row in _rows(connection, f"{query} DESC"):
            if row[0] <= last:
                break
            rows[row[0]] = row[1:]
    finally:
        connection.close()
    for number, time, payload in rows.values():
        # Of a row on a damaged page, any column may be missing or of another kind.
        if number in names and isinstance(time, int) and isinstance(payload, bytes):
            found.count += 1
            topic = topics.get(names[number])
            if topic is not None:
                topic.add(time, payload)
    return found


def _rows(connection: sqlite3.Connection, query: str) -> Iterator[tuple[Any, ...]]:
    try:
        yield from connection.execute(query)
    except (sqlite3.Error, MemoryError):  # a damaged page, or one that claims terabytes: what came before it is kept
        return
