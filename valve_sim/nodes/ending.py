"""How a program ends: SIGINT and SIGTERM end it at once while its node is not there, and ask the node to end later.

Imported first by what runs programs: a signal that comes while modules load ends them without a traceback.
"""

from __future__ import annotations

import contextlib
import os
import signal
import sys
import threading
from types import FrameType

_PROGRAMS = ("_node", "command_profile", "nodes/__main__.py", "station/__main__.py")
"""What the first word of a program's command line ends in; others that import this keep their signals."""

_NUMBERS = (signal.SIGINT, signal.SIGTERM)


class StopRequest:
    """Whether the main thread shall end its work, and why.

    A signal handler may ask for it. Of `threading.Event` the thread that it interrupts may just hold the inner lock,
    and the handler would wait for that forever.

    Attributes:
        why: the first reason given; empty while there is none.
    """

    def __init__(self) -> None:
        self.why = ""
        self._unasked = threading.Lock()
        self._unasked.acquire()

    def ask(self, why: str) -> None:
        """Ask the main thread to end its work; from any thread, and from a signal handler."""
        self.why = self.why or why
        with contextlib.suppress(RuntimeError):  # of a lock that is free: it was asked for before
            self._unasked.release()

    def wait(self, seconds: float | None = None) -> bool:
        """Return when it is asked for, or after so many seconds; whether it is."""
        if not self.why:
            self._unasked.acquire(timeout=-1.0 if seconds is None else seconds)
        return bool(self.why)


class Signals:
    """SIGINT and SIGTERM from now on; to be made in the main thread.

    Attributes:
        stop: what they ask for; None while nothing has begun: they end the process then, with this exit code.
    """

    def __init__(self, code: int) -> None:
        self.stop: StopRequest | None = None
        self._code = code
        for number in _NUMBERS:
            signal.signal(number, self._take)

    def _take(self, number: int, frame: FrameType | None) -> None:
        if self.stop is None:
            os._exit(self._code)
        self.stop.ask(f"a signal came ({signal.Signals(number).name})")

    @staticmethod
    def pass_over() -> None:
        """Pass over both from now on: Ctrl-C reaches a node of `ros2 launch` twice, and a supervisor may ask again.

        While Python ends, the second one would end the process with code −2 or −15: it takes other handlers out before.
        """
        for number in _NUMBERS:
            signal.signal(number, signal.SIG_IGN)


if sys.argv[0].endswith(_PROGRAMS):
    # The code of command_profile says whether all was sent.
    Signals(int(any(word.endswith("command_profile") for word in sys.argv[:2])))
