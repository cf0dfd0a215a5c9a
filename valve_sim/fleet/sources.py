"""Bags of files, folders that are searched, globs, and URLs of any file system that fsspec knows; fetched to be read.

What is a bag: a folder with metadata.yaml; a folder whose storage files the recorder numbered after it, without that
file; a .mcap or .db3 file by itself; and any file that is named. All else in a folder is passed over.
"""

from __future__ import annotations

import hashlib
import posixpath
import re
import shutil
import tempfile
from collections import defaultdict
from collections.abc import Iterator, Mapping, Sequence
from contextlib import contextmanager
from pathlib import Path
from typing import Any, Final, NamedTuple

import fsspec

from valve_sim.model.errors import ValveError

STORAGE: Final = re.compile(r".+\.(mcap|db3)(\.zstd)?")
"""Names of files that rosbag2 stores messages in."""
OLD_BAG: Final = re.compile(r".+\.bag")
"""Bags of ROS 1, which are found so that a row says what to do with them."""
METADATA: Final = "metadata.yaml"
BLOCK: Final = 1 << 20
"""Bytes that are read at once."""
_PATTERN: Final = re.compile(r"[*?\[]")
_CREDENTIALS: Final = re.compile(r"://[^/]*:[^/@]*@|\?.*=")
"""A user with a password, or a signed query."""
_LONGEST: Final = 600
"""Characters of a message that are kept."""


class SourceError(ValveError):
    """A source cannot be listed, or a bag cannot be fetched."""


class BagFile(NamedTuple):
    """One file of a bag: its path on its file system, its bytes, and what changes when it is written again."""

    path: str
    size: int
    stamp: str


class Bag(NamedTuple):
    """A bag as it was listed, not yet opened: an absolute path or a URL, and its files in the order of their names."""

    source: str
    files: tuple[BagFile, ...]
    is_folder: bool

    @property
    def size(self) -> int:
        """Bytes of all its files."""
        return sum(file.size for file in self.files)

    @property
    def stamp(self) -> str:
        """Changes when one of its files is written again, as far as its file system tells."""
        listed = "\n".join(f"{file.path} {file.size} {file.stamp}" for file in self.files)
        return hashlib.sha256(listed.encode("utf-8", "surrogateescape")).hexdigest()[:16]

    @property
    def is_local(self) -> bool:
        """Whether it can be read where it lies."""
        return "://" not in self.source


def one_line(error: BaseException) -> str:
    """What went wrong, without line breaks."""
    return (" ".join(str(error).split()) or type(error).__name__)[:_LONGEST]


# --- listing --------------------------------------------------------------------------------------------------------


def find_bags(sources: Sequence[str]) -> list[Bag]:
    """The bags of all sources, each once, in the order of their names.

    Raises:
        SourceError: a source does not exist, holds no bag, or cannot be listed, or its URL holds credentials.
    """
    found: dict[str, Bag] = {}
    for source in sources:
        if "://" in source and _CREDENTIALS.search(source):
            raise SourceError(
                f"{source.partition('://')[0]}://...: the URL holds credentials, which the table would show; set them "
                "in the environment of the command and of its workers"
            )
        try:
            bags = list(_bags_of(source))
        except SourceError:
            raise
        except Exception as error:  # every file system has errors of its own
            raise SourceError(f"{source}: cannot be listed ({one_line(error)})") from error
        if not bags:
            raise SourceError(
                f"{source}: no bag in it; give a rosbag2 folder, a .mcap file, a folder with such, a glob in quotes or "
                "a URL"
            )
        found.update((bag.source, bag) for bag in bags)
    return [found[name] for name in sorted(found)]


def _bags_of(source: str) -> Iterator[Bag]:
    if "://" not in source and Path(source).exists():
        yield from _bags_below(fsspec.filesystem("file"), "", str(Path(source).absolute()))
        return
    system, path = fsspec.core.url_to_fs(source)
    # What stands before the path on its file system: a protocol, perhaps with a host.
    prefix = source.rstrip("/").removesuffix(path) if "://" in source else ""
    if prefix == source.rstrip("/"):
        prefix = source[: source.index("://") + 3]
    if "://" in source and not _PATTERN.search(path):
        yield from _bags_below(system, prefix, path)
        return
    places = system.glob(path)
    if not places and not _PATTERN.search(path):
        raise SourceError(f"{source}: does not exist; give a bag, a folder with bags, a glob in quotes or a URL")
    for place in places:
        yield from _bags_below(system, prefix, place)


def _bags_below(system: Any, prefix: str, place: str) -> Iterator[Bag]:
    """The bags in one file or folder of a file system."""
    files = {path: _as_file(path, information) for path, information in system.find(place, detail=True).items()}
    if list(files) == [place]:
        yield Bag(prefix + place, (files[place],), is_folder=False)
        return
    for path, inside, is_folder in bags_among(list(files)):
        yield Bag(prefix + path, tuple(files[name] for name in inside), is_folder)


def _as_file(path: str, information: Mapping[str, Any]) -> BagFile:
    stamps = (information.get(key) for key in ("ETag", "etag", "mtime", "LastModified", "md5Hash", "updated"))
    return BagFile(path, int(information.get("size") or 0), str(next((stamp for stamp in stamps if stamp), "")))


def bags_among(paths: Sequence[str]) -> list[tuple[str, list[str], bool]]:
    """Which of these files are bags: the path of each, its files in order, and whether it is a folder."""
    folders: dict[str, list[str]] = defaultdict(list)
    for path in paths:
        folder, _, name = path.rpartition("/")
        is_part = name == METADATA or STORAGE.fullmatch(name) or OLD_BAG.fullmatch(name)
        if is_part and not name.startswith("."):
            folders[folder].append(path)
    found: list[tuple[str, list[str], bool]] = []
    for folder, inside in folders.items():
        ordered = sorted(inside, key=_numbered)
        if _is_bag(folder, [posixpath.basename(path) for path in ordered]):
            found.append((folder, ordered, True))
        else:
            found += [(path, [path], False) for path in ordered]
    return found


def _is_bag(folder: str, names: Sequence[str]) -> bool:
    start = re.escape(posixpath.basename(folder))
    are_parts = all(re.fullmatch(start + r"_\d+\.(mcap|db3)(\.zstd)?", name) for name in names)
    return METADATA in names or (are_parts and len(names) > 1)


def _numbered(path: str) -> list[int | str]:
    """Sorts bag_2 before bag_10."""
    return [int(part) if part.isdigit() else part for part in re.split(r"(\d+)", path)]


# --- reading --------------------------------------------------------------------------------------------------------


@contextmanager
def at_hand(bag: Bag) -> Iterator[Path]:
    """The bag as a local path: in its place, or fetched into a folder that is deleted afterwards.

    Raises:
        SourceError: one of its files has a name that cannot be a file's.
        OSError: it cannot be fetched.
    """
    if bag.is_local:
        yield Path(bag.source)
        return
    with tempfile.TemporaryDirectory(prefix="valve-sim-fleet-") as folder:
        place = Path(folder) / _safe_name(bag, bag.source)
        if bag.is_folder:
            place.mkdir()
        system, _ = fsspec.core.url_to_fs(bag.source)
        for file in bag.files:
            target = _place_of(bag, file, place)
            with system.open(file.path, "rb") as stream, target.open("wb") as copy:
                shutil.copyfileobj(stream, copy, BLOCK)
        yield place


def content_hash(bag: Bag, place: Path) -> str:
    """SHA-256 of all its bytes, 64 digits; names do not count, so that a copy under another name is the same.

    Raises:
        OSError: a file cannot be read.
    """
    whole = hashlib.sha256()
    for file in bag.files:
        with _place_of(bag, file, place).open("rb") as stream:
            part = hashlib.sha256()
            while block := stream.read(BLOCK):
                part.update(block)
        whole.update(part.digest())
    return whole.hexdigest()


def _place_of(bag: Bag, file: BagFile, place: Path) -> Path:
    return place / _safe_name(bag, file.path) if bag.is_folder else place


def _safe_name(bag: Bag, path: str) -> str:
    """The last part of a path of an object storage, which may hold anything, as the name of a file."""
    name = posixpath.basename(path.rstrip("/"))
    if name in ("", ".", "..") or "\\" in name or "\0" in name:
        raise SourceError(f"{bag.source}: {name!r} cannot be the name of a file; name it otherwise")
    return name
