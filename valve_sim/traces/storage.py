"""Messages out of rosbag2 folders, bare .mcap and .db3 files, whole or damaged."""

from __future__ import annotations

import os
import re
import tempfile
from contextlib import ExitStack, contextmanager, suppress
from pathlib import Path
from typing import TYPE_CHECKING, NamedTuple

from rosbags.interfaces import MessageDefinitionFormat
from rosbags.rosbag2 import Reader
from rosbags.typesys import get_types_from_idl, get_types_from_msg

from valve_sim.model.errors import ValveError
from valve_sim.traces.cdr import full_type, typestore
from valve_sim.traces.errors import TraceError
from valve_sim.traces.indexed_mcap import IndexedMcap
from valve_sim.traces.salvage import MCAP_MAGIC, SQLITE_MAGIC, ZSTD_MAGIC, Salvaged, salvage, unpack_zstd
from valve_sim.traces.topics import Topic

if TYPE_CHECKING:
    from collections.abc import Callable, Collection, Iterator, Mapping, Sequence

    from valve_sim.traces.cdr import Definitions

    Fields = Mapping[str, Collection[str] | None]
    """Topics to read, and the paths of the numbers to keep of each, as `Topic` has them."""
    Select = Callable[[Mapping[str, str]], Fields]

STORAGE_SUFFIXES = (".mcap", ".db3")


class Recording(NamedTuple):
    """What was read.

    Attributes:
        types: Every topic in the recording and its message type ("std_msgs/msg/Float64").
        topics: What the topics that were asked for hold; none of those without a message.
        findings: What was wrong with the files, and what was kept.
        messages: How many the files hold, of topics that were asked for or not, as far as their indexes say it.
    """

    types: Mapping[str, str]
    topics: dict[str, Topic]
    findings: tuple[str, ...] = ()
    messages: int = 0

    def topic(self, path: Path, name: str) -> Topic:
        """Return a topic of which at least one message can be read.

        Raises:
            TraceError: None can; one line that names the file `path` and the topic.
        """
        where, topic = f"{path}: topic {name}", self.topics.get(name)
        if topic is None:
            raise TraceError(f"{where} holds no message; record it while something moves")
        if not topic.is_known:
            raise TraceError(
                f"{where} is {self.types[name]}, whose definition the recording does not hold; record it as MCAP, or "
                "publish a standard type"
            )
        if not topic.batches:
            raise TraceError(
                f"{where}: none of {topic.size} messages can be read as {self.types[name]}; record it again"
            )
        return topic


def read_recording(path: Path, select: Select, most: int | None = None) -> Recording:
    """Read the messages of some topics.

    Args:
        path: A rosbag2 folder, or a bare .mcap or .db3 file.
        select: Called with all topics and their types; returns those to read, each with the fields to keep (None: all).
        most: About how many messages of each topic are enough; None: all.

    Raises:
        TraceError: Nothing can be read from it.
    """
    _refuse_what_is_no_recording(path)
    if path.is_dir() and not (path / "metadata.yaml").exists():
        return _read_damaged(path, select, most, "metadata.yaml is missing (the recorder writes it when it ends)")
    try:
        return _read_whole(path, select, most)
    except ValveError:
        raise
    except Exception as error:  # a damaged bag makes the readers raise whatever they stumble over
        return _read_damaged(path, select, most, _one_line(error))


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


def _read_whole(path: Path, select: Select, most: int | None) -> Recording:
    files = [path]
    if path.is_dir():
        with Reader(path) as reader:  # which refuses metadata that do not fit the files
            if not reader.compression_mode and all(file.suffix == ".mcap" for file in _storage_files(path)):
                files = _storage_files(path)
    if all(file.suffix == ".mcap" and file.is_file() for file in files):
        found = _by_index(files, select, most)
        if found:
            return found
    with ExitStack() as stack:
        readers = [stack.enter_context(Reader(file)) for file in files]
        connections = [connection for reader in readers for connection in reader.connections]
        types = {connection.topic: full_type(connection.msgtype) for connection in connections}
        topics = _topics(files, types, select(types), most)
        for reader in readers:
            wanted = [connection for connection in reader.connections if connection.topic in topics]
            for connection, time, payload in reader.messages(wanted) if wanted else ():
                topics[connection.topic].add(time, payload)
    return _finished(types, topics)


def _by_index(files: Sequence[Path], select: Select, most: int | None) -> Recording | None:
    """Read MCAP files by their indexes; None where one has none, or a damaged one: rosbags says which."""
    try:
        parts = [IndexedMcap(file) for file in files]
        types = {topic: message_type for part in parts for topic, message_type in part.types.items()}
        topics = _topics(files, types, select(types), most)
        for part in parts:
            part.read(topics)
    except ValveError:
        raise
    except Exception:  # the library raises what it stumbles over
        return None
    return _finished(types, topics)._replace(messages=sum(part.count for part in parts))


def _topics(files: Sequence[Path], types: Mapping[str, str], fields: Fields, most: int | None) -> dict[str, Topic]:
    """What takes the messages of each topic that is to be read."""
    return {
        name: Topic(types[name], _definitions_of(files, types[name]), keep, most)
        for name, keep in fields.items()
        if name in types
    }


def _definitions_of(files: Sequence[Path], message_type: str) -> Definitions | None:
    """Definitions of a message type and of those in it: the usual ones, or those that one of the files holds.

    None: nobody knows. The definitions are parsed, never run.
    """
    usual: Definitions = typestore().fielddefs
    if message_type in usual:
        return usual
    parsers = {MessageDefinitionFormat.MSG: get_types_from_msg, MessageDefinitionFormat.IDL: _types_from_idl}
    for file in files:
        # Of a damaged file, or a definition that is none, the library raises what it stumbles over.
        with suppress(Exception), Reader(file) as reader:
            for connection in reader.connections:
                if full_type(connection.msgtype) == message_type and connection.msgdef.format in parsers:
                    found = parsers[connection.msgdef.format](connection.msgdef.data, message_type)
                    if found:
                        return {**usual, **found}
    return None


def _types_from_idl(text: str, _: str) -> Definitions:
    return get_types_from_idl(text)


def _finished(types: Mapping[str, str], topics: Mapping[str, Topic], findings: tuple[str, ...] = ()) -> Recording:
    for topic in topics.values():
        topic.finish()
    return Recording(types, {name: topic for name, topic in topics.items() if topic.size}, findings)


def _storage_files(path: Path) -> list[Path]:
    """Return a folder's storage files in the order they were recorded (bag_2 before bag_10)."""
    names = [*STORAGE_SUFFIXES, *(suffix + ".zstd" for suffix in STORAGE_SUFFIXES)]
    files = [file for file in path.iterdir() if file.name.endswith(tuple(names)) and file.is_file()]
    return sorted(
        files, key=lambda file: [int(part) if part.isdigit() else part for part in re.split(r"(\d+)", file.name)]
    )


def _read_damaged(path: Path, select: Select, most: int | None, reason: str) -> Recording:
    """Read what is left of storage files: first of what they are, then the messages of the topics to read."""
    with _unpacked(_storage_files(path) if path.is_dir() else [path]) as files:
        whole = _by_index(files, select, most) if path.is_dir() else None
        if whole is not None and whole.messages:
            return whole._replace(findings=(_describe_salvage(path, [], whole.messages, reason),))
        found = [salvage(file, {}) for file in files]
        types = {topic: message_type for part in found for topic, message_type in part.types.items()}
        count = sum(part.count for part in found)
        if not count:
            encodings = sorted(encoding for part in found for encoding in part.encodings)
            if encodings:
                raise TraceError(
                    f"{path}: messages are encoded as {', '.join(encodings)}, cdr is needed; record it with ros2 bag"
                )
            raise TraceError(f"{path}: no message could be saved ({reason}); record it again")
        topics = _topics(files, types, select(types), most)
        for file in files:
            salvage(file, topics)
    return _finished(types, topics, (_describe_salvage(path, found, count, reason),))


@contextmanager
def _unpacked(files: Sequence[Path]) -> Iterator[list[Path]]:
    """Storage files, those that are packed whole in an unpacked copy that lasts as long as the context."""
    with tempfile.TemporaryDirectory() as folder:
        found = []
        for file in files:
            place = file
            if file.suffix == ".zstd":
                place = Path(folder) / file.stem
                place.write_bytes(unpack_zstd(file.read_bytes()))
            found.append(place)
        yield found


def _describe_salvage(path: Path, found: Sequence[Salvaged], count: int, reason: str) -> str:
    recorded = _declared_count(path)
    of_all = f" of {recorded}" if recorded and recorded >= count else ""
    complete = all(part.complete for part in found)
    chunks = sum(part.damaged_chunks for part in found)
    lost = "the data reach their end" if complete else "what followed is lost"
    damaged = f", {chunks} damaged {'chunk' if chunks == 1 else 'chunks'}" if chunks else ""
    return f"{path.name}: damaged or unfinished ({reason}); kept {count}{of_all} messages, {lost}{damaged}"


def _declared_count(path: Path) -> int | None:
    """Return how many messages a folder's metadata declare, if the metadata can be read."""
    file = path / "metadata.yaml"
    try:
        declared = re.search(r"^  message_count: (\d+)", file.read_text("utf-8"), re.MULTILINE)
    except (OSError, UnicodeDecodeError):
        return None
    return int(declared[1]) if declared else None
