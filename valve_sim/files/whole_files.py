"""Files are written whole or not at all: under a hidden name first, which then takes the place of the old file."""

from __future__ import annotations

import errno
import os
import tempfile
from collections.abc import Iterator
from contextlib import contextmanager, suppress
from pathlib import Path

from valve_sim.model.errors import ValveError


@contextmanager
def atomic_write(path: Path, refusal: type[ValveError] = ValveError, *, durable: bool = False) -> Iterator[Path]:
    """Yield a temporary name to write to; on success, move the file to its own name. Creates its folder.

    Args:
        path: the file, replaced if it exists.
        refusal: the error that is raised.
        durable: whether it is on the disk in the end, so that it is there after a power cut, too.

    Raises:
        ValveError: it cannot be written; of the type `refusal`.
    """
    if not path.absolute().name:
        raise refusal(f"{path}: cannot be written (is a folder); choose the name of a file")
    # A path such as "." has a name only when it is absolute; that a folder cannot be replaced is found out at the end.
    partial = path.absolute().with_name(f".{path.name}.{os.getpid()}.partial")
    try:
        path.parent.mkdir(parents=True, exist_ok=True)
        yield partial
        if durable:
            _flush(partial)
        partial.replace(path)
    except OSError as error:
        raise refusal(f"{path}: cannot be written ({error.strerror}); choose another place") from error
    finally:
        # Without the folder there is nothing to remove, and the error above says why.
        with suppress(OSError):
            partial.unlink(missing_ok=True)
    if durable:
        try:
            _flush(path.absolute().parent)
        except OSError as error:
            raise refusal(f"{path}: is written, but its folder cannot be flushed ({error.strerror})") from error


def _flush(path: Path) -> None:
    number = os.open(path, os.O_RDONLY)
    try:
        os.fsync(number)
    finally:
        os.close(number)


def write_whole(path: Path, text: str, refusal: type[ValveError] = ValveError, *, durable: bool = False) -> None:
    """Write a text file in UTF-8; see `atomic_write`."""
    with atomic_write(path, refusal, durable=durable) as partial:
        partial.write_text(text, encoding="utf-8")


def refuse_unwritable(*paths: Path) -> None:
    """Say before long work, not after it, that files cannot be written. Leaves nothing behind.

    Raises:
        ValveError: one is a folder, or its own folder is a file or takes no file.
    """
    for path in paths:
        try:
            if path.is_dir():
                raise IsADirectoryError(errno.EISDIR, os.strerror(errno.EISDIR))
            # A folder that is not there is made when the file is written.
            place = next(above for above in path.absolute().parents if above.exists())
            with tempfile.TemporaryFile(dir=place):
                pass
        except OSError as error:
            raise ValveError(f"{path}: cannot be written ({error.strerror}); choose another place") from error
