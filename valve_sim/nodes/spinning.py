"""Spinning a node that survives messages which rclpy itself cannot take, in the main thread or beside it.

In a thread beside it are the nodes whose main thread commands valves: there a signal only sets a flag.
"""

from __future__ import annotations

import functools
import signal
import threading
import time
from collections.abc import Callable, Iterable
from types import FrameType
from typing import Final, ParamSpec, TypeVar

from rclpy.duration import Duration
from rclpy.executors import ExternalShutdownException, SingleThreadedExecutor
from rclpy.node import Node
from rclpy.publisher import Publisher
from rclpy.signals import uninstall_signal_handlers

_HEARD_SECONDS: Final = 0.8
"""s that a node waits at its end for its valves to acknowledge 0 V, all together."""

P = ParamSpec("P")
R = TypeVar("R")


class CallbackError(Exception):
    """A callback of this package failed; `__cause__` is its exception."""


def guarded(callback: Callable[P, R]) -> Callable[P, R]:
    """A callback whose exceptions `spin` can tell from those of rclpy."""

    @functools.wraps(callback)
    def call(*args: P.args, **kwargs: P.kwargs) -> R:
        try:
            return callback(*args, **kwargs)
        except Exception as error:
            raise CallbackError(repr(error)) from error

    return call


def spin(node: Node) -> None:
    """Spin until ROS is shut down.

    A /clock before 1970, and whatever else rclpy refuses with an exception of its own, would end every node that
    subscribes to it; here the message is dropped with a line in the log. Exceptions of callbacks of this package, each
    of which is `guarded`, are raised: they are faults of the node, not of a message.
    """
    executor = SingleThreadedExecutor()
    executor.add_node(node)
    try:
        while node.context.ok():
            try:
                executor.spin()
            except (ExternalShutdownException, CallbackError):
                raise
            except Exception as error:
                if not node.context.ok():
                    raise
                log_left_out(node, error)
    finally:
        executor.remove_node(node)


def log_left_out(node: Node, error: Exception) -> None:
    """Log, once a second at most, that rclpy refused a message with this exception."""
    node.get_logger().error(f"a message was left out that ROS cannot take: {error!r}", throttle_duration_sec=1.0)


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
