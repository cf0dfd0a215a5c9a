"""Spinning a node past messages that rclpy itself cannot take."""

from __future__ import annotations

import time
import traceback
from collections.abc import Callable

from rclpy.executors import ExternalShutdownException, SingleThreadedExecutor
from rclpy.node import Node

_OURS = "valve_sim"


def spin(node: Node, pause: Callable[[], float] | None = None) -> None:
    """Answer until ROS is shut down.

    Args:
        node: what is spun.
        pause: s to do nothing after each answer, for a node that then takes all that waits; default none.

    A /clock before 1970, and whatever else rclpy refuses with an exception of its own, would end every node that hears
    it; here it is left out with a line in the log. What fails in a callback of this package is raised: that is a fault
    of ours, and no message's.
    """
    executor = SingleThreadedExecutor()
    executor.add_node(node)
    try:
        while node.context.ok():
            try:
                if pause is None:
                    executor.spin()
                else:
                    executor.spin_once()
                    time.sleep(pause())
            except (KeyboardInterrupt, ExternalShutdownException):
                raise
            except Exception as error:
                if _is_ours(error) or not node.context.ok():
                    raise
                say_left_out(node, error)
    finally:
        executor.remove_node(node)


def say_left_out(node: Node, error: Exception) -> None:
    """A line in the log, one a second at most, for a message that rclpy refuses with this exception."""
    node.get_logger().error(f"a message was left out that ROS cannot take: {error!r}", throttle_duration_sec=1.0)


def _is_ours(error: Exception) -> bool:
    """Whether a callback of this package was at work; the first frame is `spin` itself."""
    frames = list(traceback.walk_tb(error.__traceback__))[1:]
    return any(frame.f_globals.get("__name__", "").startswith(_OURS) for frame, _ in frames)
