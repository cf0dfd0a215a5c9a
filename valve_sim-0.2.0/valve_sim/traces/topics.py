"""The messages of a recording's topics, decoded while they are read: only times and numbers are kept."""

from __future__ import annotations

from typing import TYPE_CHECKING, NamedTuple

import numpy as np

from valve_sim.traces.cdr import Decoded, Decoder
from valve_sim.traces.message_fields import definitions_of
from valve_sim.traces.packed_times import PackedTimes
from valve_sim.traces.salvage import ZSTD_MAGIC, unpack_zstd

if TYPE_CHECKING:
    from collections.abc import Collection, Iterable, Mapping, Sequence
    from pathlib import Path

    from numpy.typing import NDArray

    Fields = Mapping[str, Collection[str] | None]

MESSAGES_AT_ONCE = 4096
"""Messages that come one by one are decoded so many together."""


class Topic(NamedTuple):
    """What was read of one topic.

    Attributes:
        bag_times: In ascending order, ns.
        decoded: The messages' numbers; None where nobody knows their type.
    """

    bag_times: PackedTimes
    decoded: Decoded | None

    @property
    def size(self) -> int:
        """How many messages there are."""
        return len(self.bag_times)


class TopicReader:
    """Takes the messages of one topic as they come out of files.

    Args:
        decoder: For their type; None where nobody knows it.
    """

    def __init__(self, decoder: Decoder | None) -> None:
        self._decoder = decoder
        self._times = PackedTimes()
        self._waiting: tuple[list[int], list[bytes]] = ([], [])

    @property
    def count(self) -> int:
        """How many messages were decoded, or counted."""
        return len(self._times)

    def take(
        self, times: NDArray[np.int64], raw: NDArray[np.uint8], starts: NDArray[np.int64], stops: NDArray[np.int64]
    ) -> None:
        """Take messages that lie in a block of bytes, with their bag times."""
        self._times.extend(times)
        if self._decoder is not None:
            self._decoder.take(raw, starts, stops)

    def take_message(self, time: int, payload: bytes) -> None:
        """Take one message, unpacking it where the recorder packed each message."""
        times, payloads = self._waiting
        times.append(time)
        payloads.append(unpack_zstd(payload) if payload.startswith(ZSTD_MAGIC) else payload)
        if len(times) >= MESSAGES_AT_ONCE:
            self._decode_waiting()

    def absorb(self, later: TopicReader) -> None:
        """Add what another reader has read of the same topic after this one, which then holds nothing."""
        self._decode_waiting()
        later._decode_waiting()
        self._times.absorb(later._times)
        if self._decoder is not None and later._decoder is not None:
            self._decoder.absorb(later._decoder)

    def finished_count(self) -> int:
        """Return how many messages were taken."""
        return self.count + len(self._waiting[0])

    def topic(self) -> Topic:
        """Return all that was taken, in bag-time order."""
        self._decode_waiting()
        decoded = None if self._decoder is None else self._decoder.decoded()
        if self._times.is_ascending:
            return Topic(self._times, decoded)
        times = self._times.array()
        order = np.argsort(times, kind="stable")
        in_order = PackedTimes()
        in_order.extend(times[order])
        if decoded is not None:
            rank = np.empty_like(order)
            rank[order] = np.arange(len(order))
            moved = tuple(batch._replace(where=rank[batch.where]) for batch in decoded.batches)
            decoded = decoded._replace(batches=moved)
        return Topic(in_order, decoded)

    def _decode_waiting(self) -> None:
        times, payloads = self._waiting
        if not times:
            return
        self._waiting = ([], [])
        self._times.extend(np.array(times, dtype=np.int64))
        if self._decoder is not None:
            self._decoder.take_messages(payloads)


class TopicReaders:
    """The readers of one file's topics, made when the first message comes.

    Args:
        path: The recording, which may hold definitions of its types.
        types: Every topic and its message type.
        keep: Topic to the fields to keep of it; None, or a topic that is not there: all.
        most: How many messages of a topic are read at least, and no more of it than it takes to get there; None: all.
    """

    def __init__(
        self, path: Path, types: Mapping[str, str], keep: Fields | None = None, most: int | None = None
    ) -> None:
        self._path, self._types, self._most = path, types, most
        self._keep: Fields = {} if keep is None else keep  # which may be filled later
        self.readers: dict[str, TopicReader] = {}

    def take(
        self,
        topic: str,
        times: NDArray[np.int64],
        raw: NDArray[np.uint8],
        starts: NDArray[np.int64],
        stops: NDArray[np.int64],
    ) -> None:
        """Take messages of a topic that lie in a block of bytes, with their bag times."""
        reader = self.of(topic)
        if self._most is None or reader.count < self._most:
            reader.take(times, raw, starts, stops)

    def of(self, topic: str) -> TopicReader:
        """Return the reader of a topic."""
        if topic not in self.readers:
            definitions = definitions_of(self._path, self._types[topic])
            decoder = None if definitions is None else Decoder(self._types[topic], definitions, self._keep.get(topic))
            self.readers[topic] = TopicReader(decoder)
        return self.readers[topic]

    def take_messages(self, topic: str, times: Sequence[int], payloads: Sequence[bytes]) -> None:
        """Take messages of a topic, each in bytes of its own."""
        reader = self.of(topic)
        for time, payload in zip(times, payloads, strict=True):
            reader.take_message(time, payload)


def joined(files: Iterable[TopicReaders]) -> dict[str, TopicReader]:
    """Return the readers of a recording's files as one for each topic, in the files' order."""
    found: dict[str, TopicReader] = {}
    for file in files:
        for topic, reader in file.readers.items():
            if topic in found:
                found[topic].absorb(reader)
            else:
                found[topic] = reader
    return found
