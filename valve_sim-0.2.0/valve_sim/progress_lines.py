"""Progress of long work for logs and pipes: a line now and then, where a terminal would have a bar."""

from __future__ import annotations

import threading
import time
from collections.abc import Callable
from types import TracebackType
from typing import Final, TextIO

EVERY: Final = 10.0
"""s between two lines."""


class ProgressLines:
    """Told what is being done; writes it every few seconds while its block lasts.

    Args:
        stream: where lines go.
        wait: waits for the next line; True when the work has ended. Default: `EVERY` seconds.
        clock: s, never going back.
    """

    def __init__(
        self,
        stream: TextIO,
        wait: Callable[[], bool] | None = None,
        clock: Callable[[], float] = time.monotonic,
    ) -> None:
        self._stream, self._clock = stream, clock
        self._ended = threading.Event()
        self._wait = wait or (lambda: self._ended.wait(EVERY))
        self._begun = clock()
        self._latest = ("starting", 0.0)
        self._thread = threading.Thread(target=self._write, daemon=True)

    def __call__(self, what: str, fraction: float) -> None:
        """Note what is being done, and the fraction done."""
        self._latest = (what, fraction)

    def __enter__(self) -> ProgressLines:
        self._thread.start()
        return self

    def __exit__(
        self, kind: type[BaseException] | None, error: BaseException | None, traceback: TracebackType | None
    ) -> None:
        self._ended.set()
        self._thread.join()

    def _write(self) -> None:
        while not self._wait():
            what, fraction = self._latest
            elapsed = self._clock() - self._begun
            self._stream.write(f"valve-sim: {elapsed:.0f} s, {100.0 * fraction:.0f} % done: {what}\n")
            self._stream.flush()
