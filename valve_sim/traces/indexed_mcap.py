"""Reading an intact MCAP file by its message indexes: about ten times faster than message by message.

An index lists the time and place of a channel's messages in a chunk as one array, so that the messages are cut out of
the unpacked chunk without a look at the records between them.
"""

from __future__ import annotations

from typing import TYPE_CHECKING, BinaryIO

import numpy as np
from mcap.data_stream import ReadDataStream
from mcap.opcode import Opcode
from mcap.reader import make_reader
from mcap.records import Chunk, ChunkIndex

from valve_sim.traces.salvage import chunk_is_sound, full_type, unpack_chunk

if TYPE_CHECKING:
    from collections.abc import Callable, Collection, Mapping
    from pathlib import Path

    from numpy.typing import NDArray

RECORD_HEAD = 9
"""Bytes of opcode and length before each record."""

MESSAGE_HEAD = RECORD_HEAD + 22
"""Bytes before a message's payload: the record's head, channel, sequence, log time and publish time."""


class NotIndexed(Exception):  # noqa: N818 -- never leaves this room: the file is read in another way
    """The file has no message indexes, or they do not fit the data."""


def read_indexed_mcap(
    path: Path, select: Callable[[Mapping[str, str]], Collection[str]]
) -> tuple[dict[str, str], list[tuple[str, list[int], list[bytes]]]]:
    """Read topics' types, and for each channel wanted its topic, bag times in ns, and serialized messages.

    Raises:
        NotIndexed: It cannot be read so; nothing is said about whether it is damaged.
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
        parts: dict[int, tuple[str, list[int], list[bytes]]] = {
            number: (channel.topic, [], []) for number, channel in summary.channels.items() if channel.topic in wanted
        }
        for index in summary.chunk_indexes:
            _read_chunk(stream, index, parts)
        for number, (_, times, _) in parts.items():
            if len(times) != summary.statistics.channel_message_counts.get(number, 0):
                raise NotIndexed
    return types, list(parts.values())


def _read_chunk(stream: BinaryIO, index: ChunkIndex, parts: Mapping[int, tuple[str, list[int], list[bytes]]]) -> None:
    here = parts.keys() & index.message_index_offsets.keys()
    if not here:
        return
    stream.seek(index.chunk_start_offset + RECORD_HEAD)
    chunk = Chunk.read(ReadDataStream(stream))
    data = unpack_chunk(chunk)
    if not chunk_is_sound(chunk, data):
        raise NotIndexed
    for number in here:
        _, times, payloads = parts[number]
        stamps, places = _message_index(stream, index.message_index_offsets[number])
        starts, stops = _payload_bounds(data, places, number)
        times += stamps.tolist()
        payloads += [data[start:stop] for start, stop in zip(starts.tolist(), stops.tolist(), strict=True)]


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
    data: bytes, places: NDArray[np.int64], channel: int
) -> tuple[NDArray[np.int64], NDArray[np.int64]]:
    """Return where the payloads of the records at `places` start and stop."""
    raw = np.frombuffer(data, np.uint8)
    if len(places) and not 0 <= places.min() <= places.max() <= len(raw) - MESSAGE_HEAD:
        raise NotIndexed
    heads = raw[places[:, None] + np.arange(RECORD_HEAD + 2)]
    lengths = np.ascontiguousarray(heads[:, 1:RECORD_HEAD]).view("<i8")[:, 0]
    channels = np.ascontiguousarray(heads[:, RECORD_HEAD:]).view("<u2")[:, 0]
    stops = places + RECORD_HEAD + lengths
    if (heads[:, 0] != Opcode.MESSAGE).any() or (channels != channel).any() or (stops > len(raw)).any():
        raise NotIndexed
    return places + MESSAGE_HEAD, stops
