"""Ctrl-C and SIGTERM, handled between two updates."""

from __future__ import annotations

import signal
from collections.abc import Mapping
from types import FrameType, TracebackType
from typing import Any, Final

SIGNALS: Final = (signal.SIGINT, signal.SIGTERM)


class StoppedError(Exception):
    """A signal asked the demonstration to end."""


class StopSignals:
    """Context in which SIGINT and SIGTERM are noted, and raised by `check`.

    An exception from the handler could be raised anywhere, also inside ROS or the recorder, which might turn it into
    another error, lose it or leave half a bag.
    """

    def __init__(self) -> None:
        self._has_come = False
        self._before: Mapping[signal.Signals, Any] = {}

    def __enter__(self) -> StopSignals:
        self._before = {number: signal.signal(number, self._note) for number in SIGNALS}
        return self

    def __exit__(
        self, kind: type[BaseException] | None, error: BaseException | None, traceback: TracebackType | None
    ) -> None:
        for number, handler in self._before.items():
            signal.signal(number, handler)

    def check(self) -> None:
        """Raise if a signal came.

        Raises:
            StoppedError: one came.
        """
        if self._has_come:
            raise StoppedError

    def _note(self, number: int, frame: FrameType | None) -> None:
        self._has_come = True
