"""Spinning a node that survives messages which rclpy itself cannot take, and what is called back by."""

from __future__ import annotations

import functools
import time
from collections.abc import Callable, Iterable
from typing import Final, ParamSpec, TypeVar

from rclpy.clock import Clock
from rclpy.clock_type import ClockType
from rclpy.duration import Duration
from rclpy.executors import ExternalShutdownException, SingleThreadedExecutor
from rclpy.node import Node
from rclpy.publisher import Publisher

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


def every(node: Node, seconds: float, call: Callable[[], None]) -> None:
    """Call back by elapsed time, also while /clock stands still."""
    node.create_timer(seconds, guarded(call), clock=Clock(clock_type=ClockType.STEADY_TIME))


def wait_until_heard(publishers: Iterable[Publisher]) -> None:
    """Wait until all is acknowledged, but not for long: a process that ends at once loses unsent messages."""
    end = time.monotonic() + _HEARD_SECONDS
    for publisher in publishers:
        publisher.wait_for_all_acked(Duration(seconds=max(0.0, end - time.monotonic())))
