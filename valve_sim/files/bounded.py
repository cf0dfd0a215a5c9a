"""Files are read only where they are files, and no larger than what they should hold can be."""

from __future__ import annotations

import codecs
from pathlib import Path
from typing import Final

from valve_sim.model.errors import ValveError

LARGEST_TEXT: Final = 2_000_000_000
LONGEST_LINE: Final = 1_000_000
"""Bytes of a table in text and of one of its lines."""
MOST_EXPANDED: Final = 200
SMALL: Final = 1 << 26
"""A packed file unpacks to so many times its size and so many bytes at most: recordings are packed to a tenth."""
_PIECE: Final = 1 << 18


def _as_latin_1(error: UnicodeError) -> tuple[str, int]:
    """What stands for bytes that are no UTF-8."""
    assert isinstance(error, UnicodeDecodeError)
    return error.object[error.start : error.end].decode("latin-1"), error.end


codecs.register_error("as Latin-1", _as_latin_1)


def check_file(path: Path, most: int, refusal: type[ValveError]) -> None:
    """Refuse what would be read for ever: a device, a pipe, or more than so many bytes.

    Raises:
        OSError: It is not there. ValveError: It is refused; of the type `refusal`.
    """
    if not path.is_file() and path.exists() and not path.is_dir():
        raise refusal(f"{path}: is a device or a pipe, expected a file; copy what it gives into a file")
    size = path.stat().st_size
    if size > most:
        raise refusal(f"{path}: is {size / 1e6:.6g} MB large, expected at most {most / 1e6:.6g} MB; cut it")


def check_expanded(path: Path, size: float, refusal: type[ValveError]) -> None:
    """Refuse a packed file that says that it holds so many bytes, if that is more than any measurement packs to."""
    most = MOST_EXPANDED * path.stat().st_size + SMALL
    if size > most:
        raise refusal(
            f"{path}: unpacks to {size / 1e6:.6g} MB, expected at most {most / 1e6:.6g} MB; export the measured columns"
        )


def table_text(path: Path, refusal: type[ValveError]) -> str:
    """The text of a table: UTF-16 by its mark or its zeros, else UTF-8; what is none is Latin-1, as loggers write µ.

    Raises:
        OSError: It cannot be read. ValveError: It, or one of its lines, is too long.
    """
    check_file(path, LARGEST_TEXT, refusal)
    longest = 0
    with path.open("rb") as stream:
        while piece := stream.read(_PIECE):
            end = piece.rfind(b"\n")
            longest = longest + len(piece) if end < 0 else len(piece) - end
            if longest > LONGEST_LINE:
                raise refusal(
                    f"{path}: has a line of more than {LONGEST_LINE} bytes, expected the rows of a table; export it as "
                    "text, one row a line"
                )
    data = path.read_bytes()
    if data.startswith((b"\xff\xfe", b"\xfe\xff")):
        return data.decode("utf-16", "replace")
    zeros = data[1:400:2].count(0), data[:400:2].count(0)
    for own, other, encoding in ((*zeros, "utf-16-le"), (*zeros[::-1], "utf-16-be")):
        if 2 * own > len(data[1:400:2]) and 2 * other < own:
            return data.decode(encoding, "replace")
    return data.decode("utf-8-sig", "as Latin-1")
