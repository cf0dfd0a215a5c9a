"""Messages out of rosbag2 folders, bare .mcap and .db3 files, whole or damaged."""

from __future__ import annotations

import os
import re
import tempfile
from contextlib import contextmanager
from pathlib import Path
from typing import TYPE_CHECKING, Final, NamedTuple

import numpy as np
import zstandard
from rosbags.typesys import get_types_from_idl, get_types_from_msg

from valve_sim.files.bounded import MOST_EXPANDED, SMALL
from valve_sim.model.errors import ValveError
from valve_sim.recordings.cdr import typestore
from valve_sim.recordings.clocks import SECOND
from valve_sim.recordings.mcap_files import MCAP_MAGIC, ZSTD_MAGIC, Contents, IndexedMcap, TooLargeError, read_records
from valve_sim.recordings.sqlite_files import SQLITE_MAGIC, read_database
from valve_sim.recordings.topics import Topic
from valve_sim.recordings.trace import TraceError

if TYPE_CHECKING:
    from collections.abc import Callable, Collection, Iterable, Iterator, Mapping, Sequence

    from valve_sim.recordings.cdr import Definitions

    Fields = Mapping[str, Collection[str] | None]
    """Topics to read, and the paths of the numbers to keep of each, as `Topic` has them."""
    Select = Callable[[Mapping[str, str]], Fields]

STORAGE_SUFFIXES: Final = (".mcap", ".db3")
MAGIC: Final = {".mcap": MCAP_MAGIC, ".db3": SQLITE_MAGIC, ".zstd": ZSTD_MAGIC}
LARGEST_METADATA: Final = 1 << 22
"""Bytes of a metadata.yaml that are looked at."""
LARGEST_DEFINITION: Final = 100_000
"""Characters of a message type's definition that are parsed."""
LATE: Final = 1_000_000
"""ns from publication to the log: some message takes less, or these are of two clocks. A longer way is said."""
MOST_STANDING: Final = 0.5
"""A log at whose times most messages share one says when they were written, or nothing."""
EARLY: Final = 100_000
"""ns by which no message of one clock is logged before it is published."""


class Recording(NamedTuple):
    """What was read.

    Attributes:
        types: Every topic in the recording and its message type ("std_msgs/msg/Float64").
        topics: What the topics that were asked for hold; none of those without a message.
        findings: What was wrong with the files, and what was kept.
    """

    types: Mapping[str, str]
    topics: dict[str, Topic]
    findings: tuple[str, ...] = ()

    def topic(self, path: Path, name: str) -> Topic:
        """Return a topic of which at least one message can be read.

        Raises:
            TraceError: None can; one line that names the file `path` and the topic.
        """
        if trouble := self.trouble(name):
            raise TraceError(f"{path}: topic {name}{trouble}")
        return self.topics[name]

    def trouble(self, name: str) -> str:
        """Why no message of a topic can be read, and the mend, to follow its name; empty where one can."""
        topic = self.topics.get(name)
        if topic is None:
            return " holds no message; record it while something moves"
        if not topic.is_known:
            return (
                f" is {self.types[name]}, whose definition the recording does not hold; record it as MCAP, or publish "
                "a standard type"
            )
        if topic.batches:
            return ""
        none = f": none of {topic.size} messages can be read as {self.types[name]}"
        if topic.unreadable:
            return f"{none}, they are written as {', '.join(sorted(topic.unreadable))}; set the middleware to write CDR"
        return f"{none}; record it again"


class _Metadata(NamedTuple):
    """What a folder says of its files: their names, how many messages they hold, and what is wrong with it."""

    names: tuple[str, ...] = ()
    messages: int = 0
    trouble: str = ""


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
    metadata = _metadata_of(path) if path.is_dir() else _Metadata()
    files, findings = _listed_files(path, metadata)
    with _unpacked(path, files) as places:
        try:
            contents, types, topics = _read(places, select, most)
        except TooLargeError as error:
            raise TraceError(f"{path}: {error}") from None
        except _NothingError as error:
            why = metadata.trouble or "nothing of it is valid"
            raise TraceError(
                f"{path}: {error.words or f'no message could be saved ({why}); record it again'}"
            ) from None
    findings += _damage(path, metadata, contents, [file.name for file in files])
    by_publication, words = _recorded_by(topics.values())
    for topic in topics.values():
        topic.finish(by_publication=by_publication)
    findings += [f"{path.name}: {own}" for own in words]
    return Recording(types, {name: topic for name, topic in topics.items() if topic.size}, tuple(findings))


def _recorded_by(topics: Iterable[Topic]) -> tuple[bool, list[str]]:
    """Whether messages count as recorded when they were published, and what is said of it."""
    found = list(topics)
    ways = [(topic.size, way) for topic in found if (way := topic.ways) is not None]
    if not ways:
        return False, []
    shortest, longest = min(way.shortest for _, way in ways), max(way.longest for _, way in ways)
    if sum(way.standing for _, way in ways) > MOST_STANDING * sum(size for size, _ in ways) and _is_coarse(found):
        if sum(way.apart for _, way in ways) > MOST_STANDING * sum(way.standing for _, way in ways):
            words = "several messages were logged at one time; those without a stamp are timed by their publication"
            return True, [words]
        return False, ["most messages were logged at the time of another; those without a stamp are timed as coarsely"]
    if not (-EARLY <= shortest <= LATE and longest < SECOND):
        return False, []
    late = f"messages were logged up to {longest / 1e6:.2f} ms after they were published"
    return True, [f"{late}; those without a stamp are timed by their publication"] if longest > LATE else []


def _is_coarse(topics: Sequence[Topic]) -> bool:
    """Whether most messages without a stamp were logged at the time of another, of whichever topic.

    Else the log is fine, and a driver sends the messages of another topic in bursts.
    """
    logged = [topic.logged for topic in topics]
    times, counts = np.unique(np.concatenate(logged), return_counts=True)
    loose = [own for topic, own in zip(topics, logged, strict=True) if not topic.is_stamped]
    shared = [counts[np.searchsorted(times, own)] > 1 for own in loose]
    return sum(map(np.count_nonzero, shared)) > MOST_STANDING * sum(map(len, loose))


class _NothingError(Exception):
    """Files hold nothing that can be read: why, and the mend; empty: nobody knows."""

    def __init__(self, words: str = "") -> None:
        super().__init__(words)
        self.words = words


_Found = tuple[list[Contents], dict[str, str], dict[str, Topic]]


def _read(files: Sequence[Path], select: Select, most: int | None) -> _Found:
    """Read MCAP files by their indexes; others, and where one has none or a damaged one, message by message."""
    indexed = _indexed(files)
    if indexed:
        found = _topics([part.contents for part in indexed], select, most)
        try:
            for part in indexed:
                part.read(found[2])
        except (TooLargeError, ValveError):
            raise
        except Exception:  # the index does not fit the data
            pass
        else:
            return found
    readers = [read_records if file.suffix.lower() == ".mcap" else read_database for file in files]
    found = _topics([read(file, {}) for read, file in zip(readers, files, strict=True)], select, most)
    for read, file in zip(readers, files, strict=True):
        if found[2]:
            read(file, found[2])
    return found


def _indexed(files: Sequence[Path]) -> list[IndexedMcap]:
    try:
        return [IndexedMcap(file) for file in files] if all(file.suffix.lower() == ".mcap" for file in files) else []
    except Exception:  # the library raises what it stumbles over
        return []


def _topics(contents: list[Contents], select: Select, most: int | None) -> _Found:
    """Every topic's type, and what takes the messages of those that are to be read."""
    types = {topic: message_type for part in contents for topic, message_type in part.types.items()}
    encodings = sorted({encoding for part in contents for encoding in part.encodings})
    if encodings and not types:
        raise _NothingError(f"messages are encoded as {', '.join(encodings)}, cdr is needed; record it with ros2 bag")
    if not any(part.count for part in contents) and not all(part.complete for part in contents):
        raise _NothingError
    topics = {
        name: Topic(types[name], _definitions_of(contents, types[name]), keep, most)
        for name, keep in select(types).items()
        if name in types
    }
    return contents, types, topics


def _definitions_of(contents: Sequence[Contents], message_type: str) -> Definitions | None:
    """Definitions of a message type and of those in it: the usual ones, or those that one of the files holds.

    None: nobody knows. The definitions are parsed, never run.
    """
    usual: Definitions = typestore().fielddefs
    if message_type in usual:
        return usual
    for part in contents:
        form, text = part.definitions.get(message_type, ("", ""))
        if len(text) > LARGEST_DEFINITION:
            continue
        try:
            found = _types_from_idl(text) if form in ("ros2idl", "omgidl") else get_types_from_msg(text, message_type)
        except Exception:  # of a definition that is none, the library raises what it stumbles over
            continue
        if text and found:
            return {**usual, **found}
    return None


def _types_from_idl(text: str) -> Definitions:
    """Several files behind each other, as rosbag2 stores them; what they include is among them."""
    found: Definitions = {}
    for own in re.split(r"^=+\nIDL: .*\n", text, flags=re.MULTILINE):
        plain = re.sub(r"^\s*#include.*$", "", own, flags=re.MULTILINE)
        if plain.strip():
            found = {**found, **get_types_from_idl(plain)}
    return found


def _damage(path: Path, metadata: _Metadata, contents: Sequence[Contents], names: Sequence[str]) -> list[str]:
    """What is wrong with the files, and what was kept, in a line; none where nothing is."""
    count, chunks = sum(part.count for part in contents), sum(part.damaged_chunks for part in contents)
    cut = [(name, part.count) for name, part in zip(names, contents, strict=True) if not part.complete]
    declared = max(metadata.messages, count)
    if not cut and not metadata.trouble and not chunks and declared == count:
        return []
    lost = "what followed is lost" if cut else "the data reach their end"
    why = metadata.trouble or ("a chunk is" if chunks else "its end is" if cut else "messages are") + " missing"
    if cut and len(names) > 1:  # the files after it may be whole
        lost = "the rest is lost"
        ends = [f"the end of {name} is missing" if kept else f"nothing of {name} is valid" for name, kept in cut]
        why = ", ".join(filter(None, (metadata.trouble, *ends)))
    of_all = f" of {declared}" if declared > count else ""
    damaged = f", {chunks} damaged {'chunk' if chunks == 1 else 'chunks'}" if chunks else ""
    return [f"{path.name}: damaged or unfinished ({why}); kept {count}{of_all} messages, {lost}{damaged}"]


# --- files ---


def _refuse_what_is_no_recording(path: Path) -> None:
    # os.path says False of names that cannot be, where Path raises.
    if not os.path.exists(path):  # noqa: PTH110
        raise TraceError(f"{path}: does not exist; give a rosbag2 folder or a .mcap file")
    if path.suffix == ".bag" or (path.is_dir() and not _storage_files(path) and any(path.glob("*.bag"))):
        raise TraceError(f"{path}: is a ROS 1 bag, a rosbag2 folder or .mcap file is needed; rosbags-convert makes one")
    if path.is_dir():
        inside = _recordings_in(path)
        if inside:
            number, names = f"{len(inside)} recording{'s' if len(inside) > 1 else ''}", ", ".join(inside)
            raise TraceError(f"{path}: is a folder that holds {number}: {names}; name one, such as {path / inside[0]}")
        if not _storage_files(path):
            raise TraceError(f"{path}: the folder holds no .mcap or .db3 file; give a rosbag2 folder or a .mcap file")
        return
    suffix = path.suffix.lower()
    if suffix not in MAGIC:
        raise TraceError(
            f"{path}: is not a recording; give a rosbag2 folder, a .mcap file, or a table (.csv, .parquet, .mat)"
        )
    if not path.is_file():
        raise TraceError(f"{path}: is a device or a pipe, not a file; give a rosbag2 folder or a .mcap file")
    try:
        with path.open("rb") as stream:
            head = stream.read(16)
    except OSError as error:
        raise TraceError(f"{path}: cannot be read ({error.strerror}); check the permissions") from error
    if not head:
        raise TraceError(f"{path}: is empty (0 bytes), nothing was recorded; record it again")
    if not head.startswith((MAGIC[suffix], ZSTD_MAGIC)):
        raise TraceError(
            f"{path}: is not a {suffix} file, it starts with {head[:8]!r}; give a rosbag2 folder or a .mcap file"
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


def _storage_files(path: Path) -> list[Path]:
    """Return a folder's storage files in the order they were recorded (bag_2 before bag_10), none twice."""
    names = [*STORAGE_SUFFIXES, *(suffix + ".zstd" for suffix in STORAGE_SUFFIXES)]
    files = [file for file in path.iterdir() if file.name.endswith(tuple(names)) and file.is_file()]
    # Beside what is packed may lie what `ros2 bag play` unpacked of it, or began to.
    packed = {file.stem for file in files if file.suffix == ".zstd"}
    files = [file for file in files if file.name not in packed]
    return sorted(
        files, key=lambda file: [int(part) if part.isdigit() else part for part in re.split(r"(\d+)", file.name)]
    )


def _metadata_of(path: Path) -> _Metadata:
    """What metadata.yaml says, of whichever version."""
    file = path / "metadata.yaml"
    if not file.is_file():
        return _Metadata(trouble="metadata.yaml is missing (the recorder writes it when it ends)")
    with file.open("rb") as stream:
        text = stream.read(LARGEST_METADATA).decode("utf-8", "replace").replace("\r\n", "\n")
    # Its lines on quality of service are YAML within YAML, of every version in another form.
    listed = re.search(r"^  relative_file_paths:(?P<one> *\[.*)?\n(?P<each>(?: +- .*\n?)*)", text, re.MULTILINE)
    count = re.search(r"^  message_count: (\d{1,18})\s*$", text, re.MULTILINE)
    if listed is None or count is None:
        return _Metadata(trouble="metadata.yaml cannot be read")
    names = re.findall(r"[^\s\[\],]+", listed["one"] or "") or re.findall(
        r"^ +- (.*?)\s*$", listed["each"], re.MULTILINE
    )
    return _Metadata(tuple(Path(name.strip("'\"")).name for name in names), int(count[1]))


def _listed_files(path: Path, metadata: _Metadata) -> tuple[list[Path], list[str]]:
    """The files of a recording, and what is said of those that are missing or belong to another one."""
    if not path.is_dir():
        return [path], []
    there = _storage_files(path)
    # What was unpacked in place has lost the suffix of its packing.
    listed = {name.removesuffix(".zstd") for name in metadata.names}
    own = [file for file in there if file.name.removesuffix(".zstd") in listed]
    if not own:
        return there, []
    findings = []
    missing = sorted(listed - {file.name.removesuffix(".zstd") for file in own})
    if missing:
        findings.append(f"{path.name}: {', '.join(missing)} is missing, which metadata.yaml lists")
    if len(own) < len(there):
        others = ", ".join(file.name for file in there if file not in own)
        findings.append(f"{path.name}: {others} was not read: metadata.yaml does not list it")
    return own, findings


@contextmanager
def _unpacked(path: Path, files: Sequence[Path]) -> Iterator[list[Path]]:
    """Storage files, those that are packed whole in an unpacked copy that lasts as long as the context."""
    with tempfile.TemporaryDirectory() as folder:
        found = []
        for file in files:
            place = file
            with file.open("rb") as stream:
                if stream.read(len(ZSTD_MAGIC)) == ZSTD_MAGIC:
                    place = Path(folder) / file.name.removesuffix(".zstd")
                    _unpack(path, file, place)
            found.append(place)
        yield found


def _unpack(path: Path, file: Path, place: Path) -> None:
    """Unpack as much as there is of a file that is packed whole, and may be cut.

    Raises:
        TraceError: it unpacks to more than any recording.
    """
    most = SMALL + MOST_EXPANDED * file.stat().st_size
    size, unpack = 0, zstandard.ZstdDecompressor().decompressobj()
    with file.open("rb") as source, place.open("wb") as target:
        try:
            while piece := source.read(1 << 10):
                size += target.write(unpack.decompress(piece))
                if size > most:
                    raise TraceError(
                        f"{path}: {file.name} unpacks to more than {most / 1e6:.0f} MB, expected at most "
                        f"{MOST_EXPANDED} times its size; unpack it yourself (zstd -d)"
                    )
        except zstandard.ZstdError:
            return
