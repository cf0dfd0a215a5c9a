"""Files are read only where they are files, and no larger than what they should hold can be."""

from __future__ import annotations

from pathlib import Path

from valve_sim.model.errors import ValveError


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
