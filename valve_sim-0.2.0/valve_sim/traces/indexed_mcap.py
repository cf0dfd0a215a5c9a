"""Reading an intact MCAP file by its message indexes: about ten times faster than message by message.

An index lists the times and places of a channel's messages in a chunk as one array, so the messages are cut out of
the unpacked chunk without parsing the records between them.
"""

from __future__ import annotations

from typing import TYPE_CHECKING, BinaryIO

import numpy as np
from mcap.data_stream import ReadDataStream
from mcap.opcode import Opcode
from mcap.reader import make_reader
from mcap.records import Chunk, ChunkIndex
from numpy.lib.stride_tricks import sliding_window_view

from valve_sim.traces.salvage import chunk_is_sound, full_type, unpack_chunk

if TYPE_CHECKING:
    from collections.abc import Callable, Collection, Mapping
    from pathlib import Path

    from numpy.typing import NDArray

    Select = Callable[[Mapping[str, str]], Collection[str]]
    Take = Callable[[str, NDArray[np.int64], NDArray[np.uint8], NDArray[np.int64], NDArray[np.int64]], None]

RECORD_HEAD = 9
"""Bytes of opcode and length before each record."""

MESSAGE_HEAD = RECORD_HEAD + 22
"""Bytes before a message's payload: the record's head, channel, sequence, log time and publish time."""


class NotIndexed(Exception):  # noqa: N818 -- internal: the file is then read in another way
    """The file has no message indexes, or they do not fit the data."""


def read_indexed_mcap(path: Path, select: Select, take: Take) -> dict[str, str]:
    """Read an MCAP file chunk by chunk.

    Args:
        path: The file.
        select: Called with all topics and their types; returns those to read.
        take: Called for each chunk and topic with the topic, bag times in ns (n,), the chunk's bytes, and where in them
            each message starts and stops, (n,) each.

    Returns:
        every topic and its type.

    Raises:
        NotIndexed: It cannot be read this way, damaged or not. What was taken so far must be dropped.
    """
    with path.open("rb") as stream:
        summary = make_reader(stream).get_summary()
        if summary is None or summary.statistics is None:
            raise NotIndexed
        types = {
            channel.topic: full_type(summary.schemas[channel.schema_id].name)
            for channel in summary.channels.values()
            if channel.schema_id in summary.schemas and channel.message_encoding == "cdr"
        }
        if len(types) < len({channel.topic for channel in summary.channels.values()}):
            raise NotIndexed
        wanted = set(select(types))
        topics = {number: channel.topic for number, channel in summary.channels.items() if channel.topic in wanted}
        counts = dict.fromkeys(topics, 0)
        for index in summary.chunk_indexes:
            here = topics.keys() & index.message_index_offsets.keys()
            if here:
                data = _unpacked(stream, index)
                for number in sorted(here):
                    stamps, places = _message_index(stream, index.message_index_offsets[number])
                    take(topics[number], stamps, *_payload_bounds(data, places, number))
                    counts[number] += len(stamps)
        if any(count != summary.statistics.channel_message_counts.get(number, 0) for number, count in counts.items()):
            raise NotIndexed
    return types


def _unpacked(stream: BinaryIO, index: ChunkIndex) -> NDArray[np.uint8]:
    stream.seek(index.chunk_start_offset + RECORD_HEAD)
    chunk = Chunk.read(ReadDataStream(stream))
    data = unpack_chunk(chunk)
    if not chunk_is_sound(chunk, data):
        raise NotIndexed
    return np.frombuffer(data, np.uint8)


def _message_index(stream: BinaryIO, offset: int) -> tuple[NDArray[np.int64], NDArray[np.int64]]:
    """Return times, ns, and places in the unpacked chunk of a channel's messages."""
    stream.seek(offset)
    head = stream.read(RECORD_HEAD + 6)
    if len(head) < RECORD_HEAD + 6 or head[0] != Opcode.MESSAGE_INDEX:
        raise NotIndexed
    raw = stream.read(int.from_bytes(head[RECORD_HEAD + 2 :], "little"))
    if len(raw) % 16:
        raise NotIndexed
    entries = np.frombuffer(raw, dtype="<i8").reshape(-1, 2)
    return entries[:, 0], entries[:, 1]


def _payload_bounds(
    raw: NDArray[np.uint8], places: NDArray[np.int64], channel: int
) -> tuple[NDArray[np.uint8], NDArray[np.int64], NDArray[np.int64]]:
    """Return the bytes, and where in them the payloads of the records at `places` start and stop."""
    if len(places) and not 0 <= places.min() <= places.max() <= len(raw) - MESSAGE_HEAD:
        raise NotIndexed
    heads = sliding_window_view(raw, RECORD_HEAD + 2)[places] if len(places) else np.empty((0, RECORD_HEAD + 2), "u1")
    lengths = np.ascontiguousarray(heads[:, 1:RECORD_HEAD]).view("<i8")[:, 0]
    channels = np.ascontiguousarray(heads[:, RECORD_HEAD:]).view("<u2")[:, 0]
    stops = places + RECORD_HEAD + lengths
    is_no_message = (heads[:, 0] != Opcode.MESSAGE) | (channels != channel) | (lengths < MESSAGE_HEAD - RECORD_HEAD)
    if is_no_message.any() or (stops > len(raw)).any():
        raise NotIndexed
    return raw, places + MESSAGE_HEAD, stops
