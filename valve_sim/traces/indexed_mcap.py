"""Reading an intact MCAP file by its message indexes: about ten times faster than message by message.

An index lists the times and places of a channel's messages in a chunk as one array, so the messages are cut out of
the unpacked chunk without parsing the records between them.
"""

from __future__ import annotations

from struct import Struct
from typing import TYPE_CHECKING, BinaryIO, Final

import numpy as np
from mcap.data_stream import ReadDataStream
from mcap.opcode import Opcode
from mcap.reader import make_reader
from mcap.records import Chunk, ChunkIndex
from numpy.lib.stride_tricks import sliding_window_view

from valve_sim.traces.cdr import full_type
from valve_sim.traces.salvage import RECORD_HEAD, chunk_is_sound, unpack_chunk

if TYPE_CHECKING:
    from collections.abc import Mapping
    from pathlib import Path

    from numpy.typing import NDArray

    from valve_sim.traces.topics import Topic

    Bytes = NDArray[np.uint8]
    Places = NDArray[np.int64]

INDEX_HEAD: Final = Struct("<BQHI")
"""Opcode and length of a message index, its channel, and the bytes of what follows."""
MESSAGE: Final = np.dtype(
    [("opcode", "u1"), ("length", "<i8"), ("channel", "<u2"), ("sequence", "<u4"), ("times", "<u8", 2)]
)
"""What stands before a message's payload."""


class NotIndexed(Exception):  # noqa: N818 -- internal: the file is then read in another way
    """The file has no message indexes, or they do not fit the data."""


class IndexedMcap:
    """An MCAP file with its summary.

    Args:
        path: The file.

    Raises:
        NotIndexed: It has none, or holds other messages than ROS 2 has.
    """

    def __init__(self, path: Path) -> None:
        self._path = path
        with path.open("rb") as stream:
            summary = make_reader(stream).get_summary()
        if summary is None or summary.statistics is None:
            raise NotIndexed
        self._summary = summary
        self.types = {
            channel.topic: full_type(summary.schemas[channel.schema_id].name)
            for channel in summary.channels.values()
            if channel.schema_id in summary.schemas and channel.message_encoding == "cdr"
        }
        """Every topic and its message type."""
        if len(self.types) < len({channel.topic for channel in summary.channels.values()}):
            raise NotIndexed
        self.count = summary.statistics.message_count
        """How many messages it holds, of all topics."""

    def read(self, topics: Mapping[str, Topic]) -> None:
        """Give topics, by name, their messages, chunk by chunk.

        Raises:
            NotIndexed: The index does not fit the data. What was taken so far must be dropped.
        """
        channels = {
            n: topics[channel.topic] for n, channel in self._summary.channels.items() if channel.topic in topics
        }
        assert self._summary.statistics is not None
        declared = self._summary.statistics.channel_message_counts
        left = {number: declared.get(number, 0) for number in channels}
        with self._path.open("rb") as stream:
            for index in self._summary.chunk_indexes:
                here = sorted(channels.keys() & index.message_index_offsets.keys())
                if here:
                    raw = _unpacked(stream, index)
                    for number in here:
                        times, places = _message_index(stream, index.message_index_offsets[number])
                        channels[number].take(times, raw, *_payload_bounds(raw, places, number))
                        left[number] -= len(times)
        if any(left.values()):
            raise NotIndexed


def _unpacked(stream: BinaryIO, index: ChunkIndex) -> Bytes:
    stream.seek(index.chunk_start_offset + RECORD_HEAD.size)
    chunk = Chunk.read(ReadDataStream(stream))
    data = unpack_chunk(chunk)
    if not chunk_is_sound(chunk, data):
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
    return entries[:, 0], entries[:, 1]


def _payload_bounds(raw: Bytes, places: Places, channel: int) -> tuple[Places, Places]:
    """Return where in a chunk's bytes the payloads of the records at `places` start and stop."""
    if not len(places):
        return places, places
    if not 0 <= places.min() <= places.max() <= len(raw) - MESSAGE.itemsize:
        raise NotIndexed
    heads = sliding_window_view(raw, MESSAGE.itemsize)[places].view(MESSAGE)[:, 0]
    starts, stops = places + MESSAGE.itemsize, places + RECORD_HEAD.size + heads["length"]
    is_message = (heads["opcode"] == Opcode.MESSAGE) & (heads["channel"] == channel)
    if not (is_message & (starts <= stops) & (stops <= len(raw))).all():
        raise NotIndexed
    return starts, stops
