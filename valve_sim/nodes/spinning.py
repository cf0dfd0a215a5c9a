"""Spinning a node that survives messages which rclpy itself cannot take."""

from __future__ import annotations

import functools
from collections.abc import Callable
from typing import ParamSpec, TypeVar

from rclpy.executors import ExternalShutdownException, SingleThreadedExecutor
from rclpy.node import Node

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
