"""Many messages at once into a recording: the records of rosbags' MCAP writer, each packed by one call.

The rest of the file is written by rosbags: chunks, indexes, summary and metadata.
"""

from __future__ import annotations

import struct
from typing import TYPE_CHECKING, Final

import numpy as np
from rosbags.rosbag2 import StoragePlugin, Writer
from rosbags.rosbag2.storage_mcap import McapWriter

if TYPE_CHECKING:
    from collections.abc import Sequence

    from numpy.typing import NDArray
    from rosbags.interfaces import Connection

_MESSAGE: Final = 0x05
_CHUNK: Final = 2**20
"""Bytes, as rosbags has them: a chunk ends once it is larger."""
_HEAD: Final = struct.Struct("<BQHIQQ")
"""Of a message's record: opcode, length, channel, sequence number, times of the log and of publication."""
_COUNTED: Final = _HEAD.size - 9
"""Bytes of the head that its length counts: all but opcode and length."""


class _ManyToMcap(McapWriter):
    """MCAP storage that takes many messages at once."""

    def write_many(self, channels: list[int], times: list[int], payloads: Sequence[bytes]) -> None:
        """Write (n,) messages in their order: the channel, the stamp in ns and the payload of each."""
        parts: list[bytes] = []
        add, pack, head, first = parts.append, _HEAD.pack, _HEAD.size, 0
        index, offset = self.chunk.msgs, self.chunk.bio.tell()
        for at, (channel, time, payload) in enumerate(zip(channels, times, payloads, strict=True), 1):
            index[channel].append((time, offset))
            size = len(payload)
            add(pack(_MESSAGE, _COUNTED + size, channel, 0, time, time))
            add(payload)
            offset += head + size
            if offset > _CHUNK:
                self._append(parts, times[first:at])
                self.close_chunk()
                parts.clear()
                index, offset, first = self.chunk.msgs, self.chunk.bio.tell(), at
        self._append(parts, times[first:])

    def _append(self, parts: list[bytes], times: list[int]) -> None:
        """Put packed messages of these times into the chunk."""
        if not times:
            return
        chunk, first, last = self.chunk, min(times), max(times)
        chunk.bio.write(b"".join(parts))
        chunk.message_start_time, chunk.message_end_time = (
            min(chunk.message_start_time, first), max(chunk.message_end_time, last),
        )  # fmt: skip
        self.message_start_time, self.message_end_time = (
            min(self.message_start_time, first), max(self.message_end_time, last),
        )  # fmt: skip


class ManyWriter(Writer):
    """rosbags' writer, and `write_many`."""

    STORAGE_PLUGINS = {**Writer.STORAGE_PLUGINS, StoragePlugin.MCAP: _ManyToMcap}  # noqa: RUF012 - as rosbags has it

    def write_many(
        self, connections: Sequence[Connection], places: NDArray[np.int64], times: list[int], payloads: Sequence[bytes]
    ) -> None:
        """Write messages in their order.

        Args:
            connections: of the recording.
            places: (n,) of each message's connection among these.
            times: (n,) stamps, ns. payloads: (n,) serialized messages.
        """
        storage = self.storage
        if not isinstance(storage, _ManyToMcap):
            for place, time, payload in zip(places.tolist(), times, payloads, strict=True):
                self.write(connections[place], time, payload)
            return
        ids = np.array([connection.id for connection in connections])
        storage.write_many(ids[places].tolist(), times, payloads)
        for connection, count in zip(connections, np.bincount(places, minlength=len(ids)).tolist(), strict=True):
            storage.channel_stats[connection.id] += count
            self.counts[connection.id] += count
        self.min_timestamp = min(self.min_timestamp, min(times, default=self.min_timestamp))
        self.max_timestamp = max(self.max_timestamp, max(times, default=self.max_timestamp))
