"""The clock that a node follows, by means of rclpy."""

from __future__ import annotations

import threading
import time
from collections.abc import Callable
from typing import Any, Final

from rclpy.clock import JumpThreshold
from rclpy.duration import Duration
from rclpy.node import Node

from valve_sim.nodes.realtime import NANOSECONDS, ClockReading

_LONGEST_SLEEP: Final = 0.05
_NEW: Final = tuple.__new__
"""A named tuple's own call is one of Python, and takes three times as long."""


class NodeClock:
    """The clock that the node follows: elapsed time, or /clock with use_sim_time.

    Elapsed time is Python's own, and ROS tells when the clock is exchanged: a look at a ROS clock by a thread that has
    just slept a millisecond takes 30 µs, and a step takes three of them.
    """

    def __init__(self, node: Node) -> None:
        self._clock: Any = node.get_clock()
        self._woken = threading.Event()
        self._on_exchange: Callable[[], None] = _nothing
        # The handle is kept, because ROS drops a callback without it. Every /clock message is a jump of some size.
        threshold = JumpThreshold(
            min_forward=Duration(nanoseconds=1), min_backward=Duration(nanoseconds=-1), on_clock_change=True
        )
        self._handle = self._clock.create_jump_callback(threshold, post_callback=self._note_jump)
        self._is_simulated = False
        self._note_jump(None)

    @property
    def is_simulated(self) -> bool:
        """Whether /clock is followed."""
        return self._is_simulated

    def when_exchanged(self, call: Callable[[], None]) -> None:
        """Have this called whenever /clock is followed from now on, or no longer; it must return soon."""
        self._on_exchange = call

    def read(self) -> ClockReading | None:
        """Elapsed time, or simulated time once there is any."""
        if not self._is_simulated:
            return _NEW(ClockReading, (time.monotonic_ns(), False))
        now = self._clock.now().nanoseconds
        return ClockReading(now, True) if now else None

    def elapsed(self) -> float:
        """Monotonic wall time, s, from any origin."""
        return time.monotonic_ns() / NANOSECONDS

    def sleep_until(self, deadline: int) -> None:
        """Return at the deadline, at the next /clock message, or after 50 ms."""
        if self._is_simulated:
            self._woken.wait(_LONGEST_SLEEP)
            self._woken.clear()
        else:
            remaining = (deadline - time.monotonic_ns()) / NANOSECONDS
            if remaining > 0.0:
                time.sleep(min(remaining, _LONGEST_SLEEP))

    def wake(self) -> None:
        """Make `sleep_until` return soon."""
        self._woken.set()

    def stamp(self) -> int:
        """ROS time, ns, for the stamp of a message that is sent now."""
        return int(self._clock.now().nanoseconds)

    def _note_jump(self, jump: object) -> None:
        """/clock has moved, or another clock is followed from now on; or this is the first look."""
        before, self._is_simulated = self._is_simulated, bool(self._clock.ros_time_is_active)
        self._woken.set()
        if self._is_simulated != before:
            self._on_exchange()


def _nothing() -> None:
    """Nobody wants to know."""
