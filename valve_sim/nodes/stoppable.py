"""Threads that a node can ask to end."""

from __future__ import annotations

import threading
from collections.abc import Callable


class StoppableThread(threading.Thread):
    """A daemon thread whose `run` returns soon after `stop` was called: it looks at `is_stopping`.

    Attributes:
        is_stopping: whether `stop` was called.

    Args:
        name: of the thread.
    """

    def __init__(self, name: str) -> None:
        super().__init__(name=name, daemon=True)
        self.is_stopping = False
        self._stopping = threading.Event()

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
    """A thread that does something again and again, with pauses.

    Args:
        name: of the thread.
        act: is done. pause: s until it is done next.
        fail: called with what went wrong, if anything did; the thread then ends.
    """

    def __init__(
        self, name: str, act: Callable[[], object], pause: Callable[[], float], fail: Callable[[Exception], None]
    ) -> None:
        super().__init__(name)
        self._act, self._pause, self._fail = act, pause, fail

    def run(self) -> None:
        """The thread."""
        try:
            while not self._stopping.wait(self._pause()):
                self._act()
        except Exception as error:
            if not self.is_stopping:
                self._fail(error)
