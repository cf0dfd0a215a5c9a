"""Files that are on the disk when the call returns, whole or not at all, also after a power cut."""

from __future__ import annotations

import os
from collections.abc import Callable
from pathlib import Path

from valve_sim.files.whole_files import atomic_write
from valve_sim.model.errors import ValveError


def write_durably(path: Path, write: Callable[[Path], None]) -> None:
    """Write a file by another name, flush it, put it in its place, and flush the folder.

    Args:
        path: the file, replaced if it exists. write: writes the content to the path that it is given.

    Raises:
        ValveError: it cannot be written, as where the disk is full; the file that was there stays.
    """
    with atomic_write(path) as partial:
        write(partial)
        _flush(partial)
    try:
        _flush(path.parent)
    except OSError as error:
        raise ValveError(f"{path}: is written, but its folder cannot be flushed ({error.strerror})") from error


def write_text_durably(path: Path, text: str) -> None:
    """Write a text in UTF-8; see `write_durably`."""

    def write(partial: Path) -> None:
        partial.write_text(text, encoding="utf-8")

    write_durably(path, write)


def _flush(path: Path) -> None:
    number = os.open(path, os.O_RDONLY)
    try:
        os.fsync(number)
    finally:
        os.close(number)
