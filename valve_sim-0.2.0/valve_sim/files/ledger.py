"""Which files a run is to write and has written, so that one that is stopped can say so. Imports nothing slow."""

from __future__ import annotations

import os
from collections.abc import Iterator
from contextlib import contextmanager
from contextvars import ContextVar
from dataclasses import dataclass, field
from pathlib import Path
from typing import Final

MOST_NAMED: Final = 8
"""Files that are named one by one; a run of a day writes thousands."""


@dataclass
class Ledger:
    """Which files a run is to write, and which it has written, each whole."""

    planned: list[Path] = field(default_factory=list)
    written: list[Path] = field(default_factory=list)

    def words(self) -> str:
        """What to say of the files when the run is stopped."""
        missing = [path for path in self.planned if path not in self.written]
        done = f"wrote {self._listed()}" if self.written else "nothing was written"
        return f"{done}; not written: {', '.join(map(str, missing))}" if self.written and missing else done

    def _listed(self) -> str:
        if len(self.written) <= MOST_NAMED:
            return ", ".join(map(str, self.written))
        return f"{len(self.written)} files in {os.path.commonpath([path.absolute() for path in self.written])}"


_LEDGER: ContextVar[Ledger | None] = ContextVar("ledger", default=None)


@contextmanager
def keeping_ledger() -> Iterator[Ledger]:
    """Context that notes the files planned and written inside."""
    ledger = Ledger()
    token = _LEDGER.set(ledger)
    try:
        yield ledger
    finally:
        _LEDGER.reset(token)


def plan_files(*paths: Path) -> None:
    """Tell the ledger which files are going to be written."""
    ledger = _LEDGER.get()
    if ledger is not None:
        ledger.planned += paths


def note_written(path: Path) -> None:
    """Tell the ledger that a file was written whole; `atomic_write` does."""
    ledger = _LEDGER.get()
    if ledger is not None and path not in ledger.written:
        ledger.written.append(path)
