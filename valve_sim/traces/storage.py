"""Raw messages out of rosbag2 folders, bare .mcap and .db3 files, whole or damaged."""

from __future__ import annotations

import os
import re
import tempfile
from contextlib import ExitStack
from pathlib import Path
from typing import TYPE_CHECKING, NamedTuple

from rosbags.rosbag2 import Reader

from valve_sim.traces.errors import TraceError
from valve_sim.traces.indexed_mcap import read_indexed_mcap
from valve_sim.traces.salvage import (
    KEPT_TYPES,
    MCAP_MAGIC,
    SQLITE_MAGIC,
    ZSTD_MAGIC,
    full_type,
    salvage_mcap,
    salvage_sqlite,
    unpack_zstd,
)
from valve_sim.traces.topics import Topic, TopicReader, TopicReaders, joined

if TYPE_CHECKING:
    from collections.abc import Callable, Collection, Mapping, Sequence

    from valve_sim.traces.cdr import Decoded
    from valve_sim.traces.packed_times import PackedTimes
    from valve_sim.traces.topics import Fields

    Select = Callable[[Mapping[str, str]], Fields]

STORAGE_SUFFIXES = (".mcap", ".db3")


class Recording(NamedTuple):
    """What was read.

    Attributes:
        types: Every topic in the recording and its message type ("std_msgs/msg/Float64").
        topics: What the topics that were asked for hold, decoded; none of those without a message.
        findings: What was wrong with the files, and what was kept.
    """

    types: Mapping[str, str]
    topics: dict[str, Topic]
    findings: tuple[str, ...]

    def decoded(self, path: Path, name: str) -> tuple[PackedTimes, Decoded]:
        """Return bag times and numbers of a topic's messages, of which at least one must be readable.

        Raises:
            TraceError: None is; one line that names the file `path` and the topic.
        """
        where, topic = f"{path}: topic {name}", self.topics.get(name)
        if topic is None:
            raise TraceError(f"{where} holds no message; record it while something moves")
        if topic.decoded is None:
            raise TraceError(
                f"{where} is {self.types[name]}, whose definition the recording does not hold; record it as MCAP, or "
                "publish a standard type"
            )
        if not topic.decoded.batches:
            raise TraceError(
                f"{where}: none of {topic.size} messages can be read as {self.types[name]}; record it again"
            )
        return topic.bag_times, topic.decoded


class _Part(NamedTuple):
    """What one or more files hold: types by topic, readers of topics, and how much was damaged."""

    types: dict[str, str]
    topics: TopicReaders
    messages: int = 0
    complete: bool = True
    damaged_chunks: int = 0
    encodings: frozenset[str] = frozenset()


def read_recording(
    path: Path, select: Select, wanted: frozenset[str] = frozenset(), most: int | None = None
) -> Recording:
    """Read the messages of some topics.

    Args:
        path: A rosbag2 folder, or a bare .mcap or .db3 file.
        select: Called with all topics and their types; returns those to read, each with the fields to keep (None: all).
        wanted: Topics that a damaged file is searched for beside those of `KEPT_TYPES`.
        most: About how many messages of each topic are enough; None: all.

    Raises:
        TraceError: Nothing can be read from it.
    """
    _refuse_what_is_no_recording(path)
    if path.is_dir() and not (path / "metadata.yaml").exists():
        reason = "metadata.yaml is missing (the recorder writes it when it ends)"
        return _read_storages(path, select, reason, wanted)
    try:
        whole = _read_whole(path, select, most)
        return Recording(whole.types, _finished(joined([whole.topics])), ())
    except TraceError:
        raise
    except Exception as error:  # a damaged bag makes the readers raise whatever they stumble over
        return _read_storages(path, select, _one_line(error), wanted)


def _refuse_what_is_no_recording(path: Path) -> None:
    # os.path says False of names that cannot be, where Path raises.
    if not os.path.exists(path):  # noqa: PTH110
        raise TraceError(f"{path}: does not exist; give a rosbag2 folder or a .mcap file")
    if path.suffix == ".bag":
        raise TraceError(f"{path}: is a ROS 1 bag, a rosbag2 folder or .mcap file is needed; rosbags-convert makes one")
    if path.is_dir():
        inside = _recordings_in(path)
        if inside:
            number, names = f"{len(inside)} recording{'s' if len(inside) > 1 else ''}", ", ".join(inside)
            raise TraceError(f"{path}: is a folder that holds {number}: {names}; name one, such as {path / inside[0]}")
        if not _storage_files(path):
            raise TraceError(f"{path}: the folder holds no .mcap or .db3 file; give a rosbag2 folder or a .mcap file")
        return
    try:
        with path.open("rb") as stream:
            head = stream.read(16)
    except OSError as error:
        raise TraceError(f"{path}: cannot be read ({error.strerror}); check the permissions") from error
    if not head:
        raise TraceError(f"{path}: is empty (0 bytes), nothing was recorded; record it again")
    if _magic_of(path) is None:
        raise TraceError(
            f"{path}: is not a recording; give a rosbag2 folder, a .mcap file, or a table (.csv, .parquet, .mat)"
        )
    if not head.startswith((_magic_of(path) or b"", ZSTD_MAGIC)):
        raise TraceError(
            f"{path}: is not a {path.suffix} file, it starts with {head[:8]!r}; give a rosbag2 folder or a .mcap file"
        )


def _recordings_in(path: Path) -> list[str]:
    """Return the recordings in a folder that is none itself; none where its files are the parts of one."""
    if (path / "metadata.yaml").exists():
        return []
    files = [file.name for file in _storage_files(path)]
    folders = [entry.name for entry in path.iterdir() if entry.is_dir() and _holds_storage(entry)]
    # The recorder numbers the parts of one recording: bag_0.mcap, bag_1.mcap.
    stems = {re.sub(r"(_\d+)?(\.(mcap|db3|zstd))+$", "", name) for name in files}
    return sorted([*files, *folders]) if folders or len(stems) > 1 else []


def _holds_storage(folder: Path) -> bool:
    try:
        return bool(_storage_files(folder))
    except OSError:  # not ours to look into
        return False


def _magic_of(path: Path) -> bytes | None:
    return {".mcap": MCAP_MAGIC, ".db3": SQLITE_MAGIC, ".zstd": ZSTD_MAGIC}.get(path.suffix)


def _one_line(error: BaseException) -> str:
    text = " ".join(str(error).split()) or type(error).__name__
    return text.rstrip(".")[:200]


def _read_whole(path: Path, select: Select, most: int | None = None) -> _Part:
    if path.suffix == ".mcap" and path.is_file():
        try:
            return _read_indexed(path, select, most)
        except TraceError:
            raise
        except Exception:  # no index, or a damaged one: rosbags reports which
            return _read_by_rosbags(path, select, most)
    return _read_by_rosbags(path, select, most)


def _read_indexed(path: Path, select: Select, most: int | None) -> _Part:
    types: dict[str, str] = {}
    keep: dict[str, Collection[str] | None] = {}
    readers = TopicReaders(path, types, keep, most)

    def chosen(found: Mapping[str, str]) -> Collection[str]:
        types.update(found)
        keep.update(select(found))
        return keep

    read_indexed_mcap(path, chosen, readers.take)
    return _Part(types, readers)


def _read_by_rosbags(path: Path, select: Select, most: int | None) -> _Part:
    with Reader(path) as reader:
        types = {connection.topic: full_type(connection.msgtype) for connection in reader.connections}
        wanted = select(types)
        readers = TopicReaders(path, types, wanted)
        files = _storage_files(path) if path.is_dir() else []
        if files and not reader.compression_mode and all(file.suffix == ".mcap" for file in files):
            parts = [_read_whole(file, lambda _: wanted, most) for file in files]
            readers.readers = joined(part.topics for part in parts)
            return _Part(types, readers)
        connections = [connection for connection in reader.connections if connection.topic in wanted]
        sinks = {connection.id: readers.of(connection.topic).take_message for connection in connections}
        for connection, time, payload in reader.messages(connections) if connections else ():
            sinks[connection.id](time, payload)
    return _Part(types, readers)


def _finished(readers: Mapping[str, TopicReader]) -> dict[str, Topic]:
    topics = {name: reader.topic() for name, reader in readers.items()}
    return {name: topic for name, topic in topics.items() if topic.size}


def _storage_files(path: Path) -> list[Path]:
    """Return a folder's storage files in the order they were recorded (bag_2 before bag_10)."""
    names = [*STORAGE_SUFFIXES, *(suffix + ".zstd" for suffix in STORAGE_SUFFIXES)]
    files = [file for file in path.iterdir() if file.name.endswith(tuple(names)) and file.is_file()]
    return sorted(
        files, key=lambda file: [int(part) if part.isdigit() else part for part in re.split(r"(\d+)", file.name)]
    )


def _read_storages(path: Path, select: Select, reason: str, also: frozenset[str]) -> Recording:
    """Read storage files one by one, each whole or what is left of it."""
    files = _storage_files(path) if path.is_dir() else [path]
    kept = [_read_storage(file, also, alone=not path.is_dir()) for file in files]
    types = {topic: message_type for part in kept for topic, message_type in part.types.items()}
    count = sum(part.messages for part in kept)
    if not count:
        encodings = sorted(encoding for part in kept for encoding in part.encodings)
        if encodings:
            raise TraceError(
                f"{path}: messages are encoded as {', '.join(encodings)}, cdr is needed; record it with ros2 bag"
            )
        raise TraceError(f"{path}: no message could be saved ({reason}); record it again")
    wanted = set(select(types))
    readers = {topic: reader for topic, reader in joined(part.topics for part in kept).items() if topic in wanted}
    return Recording(types, _finished(readers), (_describe_salvage(path, kept, count, reason),))


def _describe_salvage(path: Path, kept: Sequence[_Part], count: int, reason: str) -> str:
    recorded = _declared_count(path)
    of_all = f" of {recorded}" if recorded and recorded >= count else ""
    complete = all(part.complete for part in kept)
    chunks = sum(part.damaged_chunks for part in kept)
    lost = "the data reach their end" if complete else "what followed is lost"
    damaged = f", {chunks} damaged {'chunk' if chunks == 1 else 'chunks'}" if chunks else ""
    return f"{path.name}: damaged or unfinished ({reason}); kept {count}{of_all} messages, {lost}{damaged}"


def _declared_count(path: Path) -> int | None:
    """Return how many messages a folder's metadata declare, if the metadata can be read."""
    file = path / "metadata.yaml"
    try:
        found = re.search(r"^  message_count: (\d+)", file.read_text("utf-8"), re.MULTILINE)
    except (OSError, UnicodeDecodeError):
        return None
    return int(found[1]) if found else None


def _read_storage(file: Path, also: frozenset[str], *, alone: bool) -> _Part:
    """Read one file: by rosbags where it is whole and has not been tried, otherwise by salvage."""
    with ExitStack() as stack:
        if file.suffix == ".zstd":
            folder = stack.enter_context(tempfile.TemporaryDirectory())
            unpacked = Path(folder) / file.stem
            unpacked.write_bytes(unpack_zstd(file.read_bytes()))
            file = unpacked
        elif alone:
            return _salvage(file, also)
        try:
            whole = _read_whole(file, lambda types: _kept(types, also))
        except Exception:  # damaged: see read_recording
            return _salvage(file, also)
    return whole._replace(messages=sum(reader.finished_count() for reader in whole.topics.readers.values()))


def _kept(types: Mapping[str, str], also: frozenset[str]) -> dict[str, None]:
    return {topic: None for topic, message_type in types.items() if message_type in KEPT_TYPES or topic in also}


def _salvage(file: Path, also: frozenset[str]) -> _Part:
    found = salvage_mcap(file, also) if file.suffix == ".mcap" else salvage_sqlite(file, also)
    readers = TopicReaders(file, found.types)
    for topic, times in found.times.items():
        readers.take_messages(topic, times, found.payloads[topic])
    return _Part(found.types, readers, found.count, found.complete, found.damaged_chunks, frozenset(found.encodings))
