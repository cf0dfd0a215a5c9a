"""A bag where a worker can read it: in its place, or fetched into a folder that goes when it has been read."""

from __future__ import annotations

import hashlib
import posixpath
import shutil
import tempfile
from collections.abc import Iterator
from contextlib import contextmanager
from pathlib import Path
from typing import Final

import fsspec

from valve_sim.fleet.sources import Bag
from valve_sim.traces import TraceError

BLOCK: Final = 1 << 20
"""Bytes that are read at once."""


@contextmanager
def at_hand(bag: Bag) -> Iterator[Path]:
    """The bag as a local path.

    Raises:
        TraceError: one of its files has a name that cannot be a file's.
        OSError: it cannot be fetched.
    """
    if bag.is_local:
        yield Path(bag.url)
        return
    with tempfile.TemporaryDirectory(prefix="valve-sim-fleet-") as folder:
        place = Path(folder) / _safe_name(bag, bag.url)
        if bag.is_folder:
            place.mkdir()
        system, _ = fsspec.core.url_to_fs(bag.url)
        for file in bag.files:
            target = place / _safe_name(bag, file.path) if bag.is_folder else place
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
        whole.update(_hash_of(place / _safe_name(bag, file.path) if bag.is_folder else place))
    return whole.hexdigest()


def _hash_of(path: Path) -> bytes:
    found = hashlib.sha256()
    with path.open("rb") as stream:
        while block := stream.read(BLOCK):
            found.update(block)
    return found.digest()


def _safe_name(bag: Bag, path: str) -> str:
    """The last part of a path of an object storage, which may hold anything, as the name of a file."""
    name = posixpath.basename(path.rstrip("/"))
    if name in ("", ".", "..") or "\\" in name or "\0" in name:
        raise TraceError(f"{bag.source}: {name!r} cannot be the name of a file; name it otherwise")
    return name
