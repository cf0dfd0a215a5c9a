"""For nodes whose main thread commands valves: ROS is answered by another thread, and a signal only sets a flag."""

from __future__ import annotations

import signal
import threading
import time
from collections.abc import Callable, Iterable
from types import FrameType
from typing import Final

from rclpy.duration import Duration
from rclpy.executors import ExternalShutdownException
from rclpy.node import Node
from rclpy.publisher import Publisher
from rclpy.signals import uninstall_signal_handlers

from valve_sim.nodes.spinning import spin

_HEARD_SECONDS: Final = 0.8
"""s that a node waits at its end for its valves to acknowledge 0 V, all together."""


class AnsweringThread:
    """Answers ROS (parameters, topics, /clock) from `start` to `close`.

    SIGINT and SIGTERM only call `stop`: a ROS context that they had shut down could not send 0 V any more.

    Args:
        node: is spun.
        stop: called with the reason why the main thread shall end its work.
        fail: called with what went wrong in the thread.
    """

    def __init__(self, node: Node, *, stop: Callable[[str], None], fail: Callable[[Exception], None]) -> None:
        self._node = node
        self._stop = stop
        self._fail = fail
        self._thread = threading.Thread(target=self._answer, name="answering", daemon=True)

    def start(self) -> None:
        """Take signals from now on, and answer; to be called in the main thread."""
        uninstall_signal_handlers()
        for number in (signal.SIGINT, signal.SIGTERM):
            signal.signal(number, self._take_signal)
        self._thread.start()

    def close(self, timeout: float) -> bool:
        """Shut ROS down; whether the thread has ended within so many seconds."""
        self._node.context.try_shutdown()
        if self._thread.ident is not None:
            self._thread.join(timeout)
        return not self._thread.is_alive()

    def _take_signal(self, number: int, frame: FrameType | None) -> None:
        self._stop(f"a signal came ({signal.Signals(number).name})")

    def _answer(self) -> None:
        try:
            spin(self._node)
        except ExternalShutdownException:
            self._stop("ROS was shut down")
        except Exception as error:
            self._fail(error)


def wait_until_heard(publishers: Iterable[Publisher]) -> None:
    """Wait until all is acknowledged, but not for long: a process that ends at once loses unsent messages."""
    end = time.monotonic() + _HEARD_SECONDS
    for publisher in publishers:
        publisher.wait_for_all_acked(Duration(seconds=max(0.0, end - time.monotonic())))
