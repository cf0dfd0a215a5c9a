"""Topics of the node `valve` whose numbers its machine obeys, and those of the gas around it."""

from __future__ import annotations

import math
from collections.abc import Callable, Iterator, Mapping
from functools import partial
from typing import Any, Final

from rclpy.node import Node

from valve_sim.model.gas import GAS
from valve_sim.nodes import topics
from valve_sim.nodes.diagnostics import RejectionCount, Status, pressure_status
from valve_sim.nodes.live_machine import LiveMachine, Step
from valve_sim.nodes.messages import ReadingMessages
from valve_sim.nodes.node_clock import NodeClock
from valve_sim.nodes.realtime import Arrival, Decimator
from valve_sim.nodes.receiving import Inbox, Source
from valve_sim.nodes.wiring import Interface

BETWEEN_WARNINGS: Final = 5.0
"""s between lines of the log about the same problem, which may occur a thousand times a second."""
_RATE: Final = 100.0
"""Hz of pressure and flow: slower than the plungers, and read by slower programs."""


class ObeyedTopic:
    """A topic each of whose numbers is obeyed from when it came, or else ignored, counted and warned of.

    `receive` subscribes, and is handed what takes each message. `field` of a message holds the number, in `unit`.
    `obey` is called with the time, ns of the clock, and the number; whether it is obeyed.
    """

    def __init__(
        self, node: Node, clock: NodeClock, receive: Callable[[Callable[[Any, Arrival], None]], Source], field: str,
        unit: str, obey: Callable[[int, float], bool], expected: Callable[[], str], what: str,
    ) -> None:  # fmt: skip
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


class GasTopics:
    """The topics of a machine with gas."""

    def __init__(
        self, node: Node, inbox: Inbox, clock: NodeClock, live: LiveMachine[Any], messages: ReadingMessages
    ) -> None:
        self._messages = messages
        interface = Interface(node, topics.GAS)

        def obeyed(name: str) -> ObeyedTopic:
            receive, rule = partial(interface.receive, inbox, f"~/{name}"), GAS[name]
            expected, obey = f"a number from {rule.lower:g} to {rule.upper:g} Pa", partial(live.set_pressure, name)
            return ObeyedTopic(node, clock, receive, "fluid_pressure", "Pa", obey, lambda: expected, "pressure")

        self._heard = {name: obeyed(name) for name in topics.ENDS}
        self._outlet_pressure = interface.publisher("~/outlet_pressure")
        self._mass_flow = interface.publisher("~/mass_flow")
        self._obeyed = {name: interface.publisher(f"~/obeyed/{name}") for name in topics.ENDS}
        self._samples = Decimator(_RATE)

    def words(self) -> str:
        """What is obeyed and published, with full names."""
        obeyed = " and ".join(heard.source.topic for heard in self._heard.values())
        return (
            f"; gas: obeys {obeyed} (Pa), publishes {self._outlet_pressure.topic_name} and "
            f"{self._mass_flow.topic_name} at {_RATE:g} Hz"
        )

    def publish(self, deadline: int, step: Step) -> None:
        """Publish the pressures obeyed since the last step, and this one if it is one of the slower samples.

        In the stepping thread.
        """
        for name, stamp, pressure in step.obeyed:
            self._obeyed[name].publish(self._messages.pressure(stamp, pressure))
        if not self._samples.is_due(deadline) or math.isnan(step.reading.outlet_pressure):
            return
        if self._outlet_pressure.get_subscription_count():
            self._outlet_pressure.publish(self._messages.pressure(step.stamp, step.reading.outlet_pressure))
        if self._mass_flow.get_subscription_count():
            self._mass_flow.publish(self._messages.number(step.reading.mass_flow))

    def statuses(self, pressures: Mapping[str, float]) -> Iterator[Status]:
        """For /diagnostics, with the pressures in force, Pa."""
        for name, pressure in pressures.items():
            heard = self._heard[name]
            task = name.replace("_", " ")
            yield pressure_status(task, pressure, heard.count, heard.source.incompatible_publishers)
