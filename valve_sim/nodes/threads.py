"""The threads of a node: each can be asked to end, and each tells the node what went wrong in it."""

from __future__ import annotations

import contextlib
import threading
from collections.abc import Callable

Fail = Callable[[Exception], None]
"""Told what went wrong in a thread, which ends then. What goes wrong in one that is to end anyway is not told."""


class Cancelled(Exception):  # noqa: N818 -- not an error: the node ends
    """What is being calculated is no longer wanted; raised in a report of its progress."""


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


class StoppableThread(threading.Thread):
    """A daemon thread whose work returns soon after `stop` was called: it looks at `is_stopping`.

    Attributes:
        is_stopping: whether `stop` was called.
    """

    def __init__(self, name: str, work: Callable[[], None], fail: Fail) -> None:
        super().__init__(name=name, daemon=True)
        self.is_stopping = False
        self._stopping = threading.Event()
        self._work, self._fail = work, fail

    def run(self) -> None:
        """The thread."""
        try:
            self._work()
        except Exception as error:
            if not self.is_stopping:
                self._fail(error)

    def wake(self) -> None:
        """Interrupt what the thread waits for, if anything, so that it sees that it is to end."""

    def stop(self, timeout: float) -> bool:
        """Ask the thread to end; whether it has ended within `timeout`, s."""
        self.is_stopping = True
        self._stopping.set()
        self.wake()
        if self.is_alive():
            self.join(timeout)
        return not self.is_alive()


class Repeating(StoppableThread):
    """A thread that does something again and again, with pauses."""

    def __init__(self, name: str, act: Callable[[], object], pause: Callable[[], float], fail: Fail) -> None:
        super().__init__(name, self._repeat, fail)
        self._act, self._pause = act, pause

    def _repeat(self) -> None:
        while not self._stopping.wait(self._pause()):
            self._act()
