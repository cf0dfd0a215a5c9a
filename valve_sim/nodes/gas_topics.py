"""What valve_node hears and publishes of gas: the pressures at both ends of the valve, the outlet, and the flow."""

from __future__ import annotations

import math
from collections.abc import Callable, Iterator
from functools import partial
from typing import Final

from rclpy.node import Node

from valve_sim.model.gas import GAS
from valve_sim.nodes import topics
from valve_sim.nodes.diagnostics import Status, pressure_status
from valve_sim.nodes.live_valve import LiveValve, Step
from valve_sim.nodes.messages import ReadingMessages
from valve_sim.nodes.node_clock import NodeClock
from valve_sim.nodes.obeyed_topic import ObeyedTopic
from valve_sim.nodes.realtime import Decimator, SubscriberCounts
from valve_sim.nodes.receiving import Inbox
from valve_sim.nodes.wiring import Interface

_RATE: Final = 100.0
"""Hz of pressure and flow: slower than the plungers, and read by slower programs."""


class GasTopics:
    """The topics of a valve with gas.

    Args:
        node: publishes. inbox: receives. clock: of the node. live: obeys. messages: encodes.
    """

    def __init__(self, node: Node, inbox: Inbox, clock: NodeClock, live: LiveValve, messages: ReadingMessages) -> None:
        self._live, self._messages = live, messages
        interface = Interface(node, topics.GAS)

        def obeyed(name: str, obey: Callable[[int, float], bool]) -> ObeyedTopic:
            receive, rule = partial(interface.receive, inbox, f"~/{name}"), GAS[name]
            expected = f"a number from {rule.lower:g} to {rule.upper:g} Pa"
            return ObeyedTopic(node, clock, receive, "fluid_pressure", "Pa", obey, lambda: expected, "pressure")

        self._inlet = obeyed("inlet_pressure", live.supply)
        self._demand = obeyed("demand_pressure", live.set_demand_pressure)
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
        for task, heard, pressure in (
            ("inlet pressure", self._inlet, live.inlet_pressure),
            ("demand pressure", self._demand, live.demand_pressure),
        ):
            yield pressure_status(task, pressure, heard.count.rejections(), heard.source.incompatible_publishers)
