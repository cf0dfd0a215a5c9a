"""What valve_node hears and publishes of gas: the pressures at both ends of the valve, the outlet, and the flow."""

from __future__ import annotations

import math
from collections.abc import Callable, Iterator
from typing import Final

from rclpy.node import Node
from sensor_msgs.msg import FluidPressure

from valve_sim.model.gas import GAS
from valve_sim.nodes import topics
from valve_sim.nodes.diagnostics import RejectionCount, Status, pressure_status
from valve_sim.nodes.live_valve import LiveValve, Step
from valve_sim.nodes.messages import ReadingMessages
from valve_sim.nodes.node_clock import NodeClock
from valve_sim.nodes.realtime import Arrival, Decimator, SubscriberCounts
from valve_sim.nodes.receiving import Inbox
from valve_sim.nodes.wiring import Interface

BETWEEN_WARNINGS: Final = 5.0
"""s between lines of the log about the same problem, which may occur a thousand times a second."""
_RATE: Final = 100.0
"""Hz of pressure and flow: slower than the plungers, and read by slower programs."""


class _Obeyed:
    """One pressure that is obeyed.

    Args:
        node: hears. interface: of it. inbox: receives. clock: of the node.
        live: obeys. name: of the pressure, as declared. obey: by what it does.
    """

    def __init__(
        self,
        node: Node,
        interface: Interface,
        inbox: Inbox,
        clock: NodeClock,
        live: LiveValve,
        name: str,
        obey: Callable[[int, float], bool],
    ) -> None:
        self.name = name
        self.count = RejectionCount()
        self.source = interface.receive(inbox, f"~/{name}", self._take)
        self._node, self._clock, self._live, self._obey = node, clock, live, obey
        self._warned_at = -math.inf

    def _take(self, message: FluidPressure, arrival: Arrival) -> None:
        pressure = message.fluid_pressure
        if self._live.valve.gas is None:
            return
        if self._obey(self._clock.time_of(arrival), pressure):
            self.count.accept()
            return
        self.count.reject(pressure)
        self._warn(pressure)

    def _warn(self, pressure: float) -> None:
        # ROS's own throttle counts by the place in the source, which several topics share.
        now = self._clock.elapsed()
        if now - self._warned_at < BETWEEN_WARNINGS:
            return
        self._warned_at = now
        rule = GAS[self.name]
        self._node.get_logger().warning(
            f"{self.source.topic}: {pressure:g} Pa is ignored, expected a number from {rule.lower:g} to "
            f"{rule.upper:g} Pa; the last good pressure stays"
        )


class GasTopics:
    """The topics of a valve with gas.

    Args:
        node: publishes. inbox: receives. clock: of the node. live: obeys. messages: encodes.
    """

    def __init__(self, node: Node, inbox: Inbox, clock: NodeClock, live: LiveValve, messages: ReadingMessages) -> None:
        self._live, self._messages = live, messages
        interface = Interface(node, topics.GAS)
        self._inlet = _Obeyed(node, interface, inbox, clock, live, "inlet_pressure", live.supply)
        self._demand = _Obeyed(node, interface, inbox, clock, live, "demand_pressure", live.set_demand_pressure)
        self._outlet_pressure = interface.publisher("~/outlet_pressure")
        self._mass_flow = interface.publisher("~/mass_flow")
        self._obeyed = {
            "inlet_pressure": interface.publisher("~/obeyed/inlet_pressure"),
            "demand_pressure": interface.publisher("~/obeyed/demand_pressure"),
        }
        self._subscribers = SubscriberCounts(
            self._outlet_pressure.get_subscription_count, self._mass_flow.get_subscription_count
        )
        self._samples = Decimator(_RATE)

    def words(self) -> str:
        """What is obeyed and published, with full names."""
        return (
            f"gas: obeys {self._inlet.source.topic} and {self._demand.source.topic} (Pa), publishes "
            f"{self._outlet_pressure.topic_name} and {self._mass_flow.topic_name} at {_RATE:g} Hz"
        )

    def publish(self, deadline: int, step: Step) -> None:
        """Publish the pressures obeyed since the last step, and this one if it is one of the slower samples.

        In the stepping thread.
        """
        for name, stamp, pressure in step.obeyed:
            self._obeyed[name].publish(self._messages.pressure(stamp, pressure))
        if not self._samples.is_due(deadline) or math.isnan(step.reading.outlet_pressure):
            return
        hears_outlet_pressure, hears_mass_flow = self._subscribers.look(deadline)
        if hears_outlet_pressure:
            self._outlet_pressure.publish(self._messages.pressure(step.stamp, step.reading.outlet_pressure))
        if hears_mass_flow:
            self._mass_flow.publish(self._messages.mass_flow(step.reading))

    def statuses(self) -> Iterator[Status]:
        """For /diagnostics; none while the valve has no gas."""
        live = self._live
        if live.valve.gas is None:
            return
        for heard, pressure in ((self._inlet, live.inlet_pressure), (self._demand, live.demand_pressure)):
            task = heard.name.replace("_", " ")
            yield pressure_status(task, pressure, heard.count.rejections(), heard.source.incompatible_publishers)
