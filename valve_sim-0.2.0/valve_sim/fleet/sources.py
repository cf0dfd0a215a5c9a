"""Where bags are: files, folders that are searched, globs, and URLs of any file system that fsspec knows.

What is a bag: a folder with metadata.yaml; a folder whose storage files the recorder numbered after it, without that
file; a .mcap or .db3 file by itself; and any file that is named. All else in a folder is passed over.
"""

from __future__ import annotations

import hashlib
import posixpath
import re
from collections import defaultdict
from collections.abc import Iterator, Mapping, Sequence
from pathlib import Path
from typing import Any, Final, NamedTuple

import fsspec

from valve_sim.fleet.secrets import one_line, without_credentials
from valve_sim.model.errors import ValveError

STORAGE: Final = re.compile(r".+\.(mcap|db3)(\.zstd)?")
"""Names of files that rosbag2 stores messages in."""
OLD_BAG: Final = re.compile(r".+\.bag")
"""Bags of ROS 1, which are found so that a row says what to do with them."""
METADATA: Final = "metadata.yaml"
_PATTERN: Final = re.compile(r"[*?\[]")


class SourceError(ValveError):
    """A source cannot be listed."""


class BagFile(NamedTuple):
    """One file of a bag: its path on its file system, its bytes, and what changes when it is written again."""

    path: str
    size: int
    stamp: str


class Bag(NamedTuple):
    """A bag as it was listed, not yet opened.

    Attributes:
        source: how people and rows call it: absolute where it is local; without credentials.
        url: how it is opened.
        files: in the order of their names. is_folder: whether it is a rosbag2 folder.
    """

    source: str
    url: str
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
        return "://" not in self.url


def find_bags(sources: Sequence[str]) -> list[Bag]:
    """The bags of all sources, each once, in the order of their names.

    Raises:
        SourceError: a source does not exist, holds no bag, or cannot be listed; one line without credentials.
    """
    found: dict[str, Bag] = {}
    for source in sources:
        try:
            bags = list(_bags_of(source))
        except SourceError:
            raise
        except Exception as error:  # every file system has errors of its own
            raise SourceError(f"{without_credentials(source)}: cannot be listed ({one_line(error)})") from error
        if not bags:
            raise SourceError(
                f"{without_credentials(source)}: no bag in it; give a rosbag2 folder, a .mcap file, a folder with "
                "such, a glob in quotes or a URL"
            )
        found.update((bag.source, bag) for bag in bags)
    return [found[name] for name in sorted(found)]


def _bags_of(source: str) -> Iterator[Bag]:
    is_remote = "://" in source
    if not is_remote and Path(source).exists():
        yield from _bags_below(fsspec.filesystem("file"), "", str(Path(source).absolute()))
        return
    system, path = fsspec.core.url_to_fs(source)
    prefix = source[: source.index("://") + 3] if is_remote else ""
    if is_remote and not _PATTERN.search(path):
        yield from _bags_below(system, prefix + _user_of(source, path), path)
        return
    places = system.glob(path)
    if not places and not _PATTERN.search(path):
        raise SourceError(f"{source}: does not exist; give a bag, a folder with bags, a glob in quotes or a URL")
    for place in places:
        yield from _bags_below(system, prefix + (_user_of(source, path) if is_remote else ""), place)


def _user_of(source: str, path: str) -> str:
    """What stands in a URL between :// and the path on its file system: a host, perhaps with a user."""
    rest = source.partition("://")[2]
    return rest[: -len(path)] if path and rest.endswith(path) else ""


def _bags_below(system: Any, prefix: str, place: str) -> Iterator[Bag]:
    """The bags in one file or folder of a file system."""
    listed: Mapping[str, Mapping[str, Any]] = system.find(place, detail=True)
    files = {path: _as_file(path, information) for path, information in listed.items()}
    if list(files) == [place]:
        yield _named(prefix, place, [files[place]], is_folder=False)
        return
    for path, inside, is_folder in bags_among(list(files)):
        yield _named(prefix, path, [files[name] for name in inside], is_folder=is_folder)


def _named(prefix: str, path: str, files: Sequence[BagFile], *, is_folder: bool) -> Bag:
    url = prefix + path
    return Bag(without_credentials(url), url, tuple(files), is_folder)


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
    own = re.escape(posixpath.basename(folder))
    are_parts = all(re.fullmatch(own + r"_\d+\.(mcap|db3)(\.zstd)?", name) for name in names)
    return METADATA in names or (are_parts and len(names) > 1)


def _numbered(path: str) -> list[int | str]:
    """Sorts bag_2 before bag_10."""
    return [int(part) if part.isdigit() else part for part in re.split(r"(\d+)", path)]
