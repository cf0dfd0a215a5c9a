"""A thread that a node can ask to end."""

from __future__ import annotations

import threading


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
