"""The clock that a node follows, by means of rclpy."""

from __future__ import annotations

import threading
import time
from collections.abc import Callable
from typing import Any, Final

from rclpy.clock import JumpThreshold
from rclpy.duration import Duration
from rclpy.node import Node

from valve_sim.nodes.realtime import NANOSECONDS, Arrival, ClockReading

_LONGEST_SLEEP: Final = 0.05
_LONGEST_WAY: Final = NANOSECONDS
"""ns from the middleware to this process; a message that took longer counts from when it arrived here."""
_ROUNDING: Final = 1_000
"""ns by which two clocks of the system may differ without one of them having been set."""
_LOOKS: Final = 20
"""Looks at both clocks of which the one with the least between is believed."""
_NEW: Final = tuple.__new__
"""A named tuple's own call is one of Python, and takes three times as long."""


class NodeClock:
    """The clock that the node follows: elapsed time, or /clock with use_sim_time.

    Elapsed time is Python's own, and ROS tells when the clock is exchanged: a look at a ROS clock by a thread that has
    just slept a millisecond takes 30 µs, and a step takes three of them. The stamps of what is sampled by elapsed time
    are those of the system's clock, which may be set while the node runs: `was_set` says by how much.

    Args:
        node: whose clock it is.
        monotonic, system: read elapsed time and the system's clock, which is ROS time without use_sim_time, ns.
    """

    def __init__(
        self,
        node: Node,
        monotonic: Callable[[], int] = time.monotonic_ns,
        system: Callable[[], int] = time.time_ns,
    ) -> None:
        self._clock: Any = node.get_clock()
        self._monotonic, self._system = monotonic, system
        self._measure()
        self._woken = threading.Event()
        self._on_exchange: list[Callable[[], None]] = []
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
        self._on_exchange.append(call)

    def read(self) -> ClockReading | None:
        """Elapsed time, or simulated time once there is any."""
        if not self._is_simulated:
            return _NEW(ClockReading, (self._monotonic(), False))
        now = self._clock.now().nanoseconds
        return ClockReading(now, True) if now else None

    def elapsed(self) -> float:
        """Monotonic wall time, s, from any origin."""
        return self._monotonic() / NANOSECONDS

    def sleep_until(self, deadline: int) -> None:
        """Return at the deadline, at the next /clock message, or after 50 ms."""
        if self._is_simulated:
            self._woken.wait(_LONGEST_SLEEP)
            self._woken.clear()
        else:
            remaining = (deadline - self._monotonic()) / NANOSECONDS
            if remaining > 0.0:
                time.sleep(min(remaining, _LONGEST_SLEEP))

    def wake(self) -> None:
        """Make `sleep_until` return soon."""
        self._woken.set()

    def stamp(self) -> int:
        """ROS time, ns, for the stamp of a message that is sent now."""
        return int(self._clock.now().nanoseconds)

    def stamp_at(self, reading: ClockReading) -> int:
        """ROS time, ns, at a reading of this clock."""
        return reading.nanoseconds + (0 if reading.is_simulated else self._ahead)

    def time_of(self, arrival: Arrival) -> int:
        """When a message came, ns of this clock: when it was received, or where that is not known, taken; 0: never yet.

        The middleware stamps by the system's clock, of which the present distance from elapsed time is known.
        """
        reading = arrival.reading
        if reading is None:
            return 0
        if reading.is_simulated or not arrival.received:
            return reading.nanoseconds
        received = arrival.received - self._ahead
        return received if 0 <= reading.nanoseconds - received <= _LONGEST_WAY else reading.nanoseconds

    def stamp_of(self, arrival: Arrival) -> int:
        """When a message came, ns of ROS time; 0 before the first /clock."""
        reading = arrival.reading
        if reading is None:
            return 0
        return self.stamp_at(reading) if reading.is_simulated or not arrival.received else arrival.received

    def was_set(self) -> int:
        """By how much, ns, the system's clock was set since this was last asked; negative where it was set back.

        Its distance from elapsed time is known to the time that passes between two looks at the latter, so that no
        interruption in between is taken for a step. Both clocks are slewed alike.
        """
        least, most = self._look()
        if least <= self._most + _ROUNDING and most >= self._least - _ROUNDING:
            return 0
        known = self._ahead
        self._measure()
        return self._ahead - known

    def _measure(self) -> None:
        """Find by how much the system's clock is ahead of elapsed time, ns, and within which bounds that is known."""
        looks = [self._look() for _ in range(_LOOKS)]
        self._least, self._most = min(looks, key=lambda bounds: bounds[1] - bounds[0])
        self._ahead = (self._least + self._most) // 2

    def _look(self) -> tuple[int, int]:
        before, system, after = self._monotonic(), self._system(), self._monotonic()
        return system - after, system - before

    def _note_jump(self, jump: object) -> None:
        """/clock has moved, or another clock is followed from now on; or this is the first look."""
        before, self._is_simulated = self._is_simulated, bool(self._clock.ros_time_is_active)
        self._woken.set()
        if self._is_simulated != before:
            for call in self._on_exchange:
                call()
