"""A topic of numbers that valve_node obeys: the coil's voltage, and the pressures of a valve with gas."""

from __future__ import annotations

import math
from collections.abc import Callable
from typing import Any, Final

from rclpy.node import Node

from valve_sim.nodes.diagnostics import RejectionCount
from valve_sim.nodes.node_clock import NodeClock
from valve_sim.nodes.realtime import Arrival
from valve_sim.nodes.receiving import Source

BETWEEN_WARNINGS: Final = 5.0
"""s between lines of the log about the same problem, which may occur a thousand times a second."""


class ObeyedTopic:
    """A topic each of whose numbers is obeyed from when it came, or else ignored, counted and warned of.

    Args:
        node: hears. clock: of it. receive: subscribes, and is handed what takes each message.
        field: of a message, which holds the number. unit: of it.
        obey: called with the time, ns of the clock, and the number; whether it is obeyed.
        expected: what would have been obeyed, in words. what: it is, in a word.

    Attributes:
        count: of what was ignored. source: what is subscribed to.
    """

    def __init__(
        self,
        node: Node,
        clock: NodeClock,
        receive: Callable[[Callable[[Any, Arrival], None]], Source],
        field: str,
        unit: str,
        obey: Callable[[int, float], bool],
        expected: Callable[[], str],
        what: str,
    ) -> None:
        self.count = RejectionCount()
        self.source = receive(self._take)
        self._node, self._clock, self._obey = node, clock, obey
        self._field, self._unit, self._expected, self._what = field, unit, expected, what
        self._warned_at = -math.inf

    def _take(self, message: Any, arrival: Arrival) -> None:
        value = getattr(message, self._field)
        if self._obey(self._clock.time_of(arrival), value):
            self.count.accept()
            return
        self.count.reject(value)
        # ROS's own throttle counts by the place in the source, which several topics share.
        now = self._clock.elapsed()
        if now - self._warned_at >= BETWEEN_WARNINGS:
            self._warned_at = now
            self._node.get_logger().warning(
                f"{self.source.topic}: {value:g} {self._unit} is ignored, expected {self._expected()}; the last good "
                f"{self._what} stays"
            )
