"""What valve_node hears and publishes of gas: the pressures at both ends of the valve, the outlet, and the flow."""

from __future__ import annotations

import math
from collections.abc import Callable, Iterator
from typing import Final

from rclpy.node import Node
from sensor_msgs.msg import FluidPressure
from std_msgs.msg import Float64

from valve_sim.model.gas import GAS
from valve_sim.nodes.diagnostics import CommandCount, Status, pressure_status
from valve_sim.nodes.live_valve import LiveValve, Step
from valve_sim.nodes.messages import ReadingMessages
from valve_sim.nodes.realtime import NANOSECONDS, Audience, Thinning
from valve_sim.nodes.shell_parts import RELIABLE, EncodedPublisher, IncompatiblePublishers
from valve_sim.nodes.spinning import guarded

BETWEEN_WARNINGS: Final = 5.0
"""s between lines of the log about the same problem, which may occur a thousand times a second."""
_RATE: Final = 100.0
"""Hz of pressure and flow: slower than the plungers, and read by slower programs."""


class _Heard:
    """One pressure that is obeyed.

    Args:
        node: hears. live: obeys. name: of the pressure, as declared. obey: by what it does. now: clock time, ns.
    """

    def __init__(
        self, node: Node, live: LiveValve, name: str, obey: Callable[[int, float], bool], now: Callable[[], int]
    ) -> None:
        self.name = name
        self.count = CommandCount()
        self.take = guarded(self._take)
        self._node, self._live, self._obey, self._now = node, live, obey, now
        self.incompatible = IncompatiblePublishers(node, self.topic)
        self._warned_at = -math.inf

    @property
    def topic(self) -> str:
        """Full name."""
        return str(self._node.resolve_topic_name(f"~/{self.name}"))

    def _take(self, message: FluidPressure) -> None:
        pressure = message.fluid_pressure
        if self._live.valve.gas is None:
            return
        if self._obey(self._now(), pressure):
            self.count.accept()
            return
        self.count.reject(pressure)
        self._warn(pressure)

    def _warn(self, pressure: float) -> None:
        # ROS's own throttle counts by the place in the source, which several topics share.
        now = self._now()
        if 0 <= now - self._warned_at < BETWEEN_WARNINGS * NANOSECONDS:
            return
        self._warned_at = now
        rule = GAS[self.name]
        self._node.get_logger().warning(
            f"{self.topic}: {pressure:g} Pa is ignored, expected a number from {rule.lower:g} to {rule.upper:g} Pa; "
            "the last good pressure stays"
        )


class GasTopics:
    """The topics of a valve with gas.

    Args:
        node: hears and publishes. live: obeys. messages: encodes. now: the clock's time, ns.
    """

    def __init__(self, node: Node, live: LiveValve, messages: ReadingMessages, now: Callable[[], int]) -> None:
        self._live, self._messages = live, messages
        self._inlet = inlet = _Heard(node, live, "inlet_pressure", live.supply, now)
        self._demand = demand = _Heard(node, live, "demand_pressure", live.set_demand_pressure, now)
        of_inlet, of_demand = inlet.incompatible.events, demand.incompatible.events
        node.create_subscription(FluidPressure, "~/inlet_pressure", inlet.take, RELIABLE, event_callbacks=of_inlet)
        node.create_subscription(FluidPressure, "~/demand_pressure", demand.take, RELIABLE, event_callbacks=of_demand)
        self._outlet_pressure = EncodedPublisher(node, FluidPressure, "~/outlet_pressure")
        self._mass_flow = EncodedPublisher(node, Float64, "~/mass_flow")
        self._obeyed = {
            "inlet_pressure": EncodedPublisher(node, FluidPressure, "~/obeyed/inlet_pressure"),
            "demand_pressure": EncodedPublisher(node, FluidPressure, "~/obeyed/demand_pressure"),
        }
        self._audience = Audience(self._outlet_pressure.get_subscription_count, self._mass_flow.get_subscription_count)
        self._samples = Thinning(_RATE)

    def words(self) -> str:
        """What is obeyed and published, with full names."""
        return (
            f"gas: obeys {self._inlet.topic} and {self._demand.topic} (Pa), publishes "
            f"{self._outlet_pressure.topic_name} and {self._mass_flow.topic_name} at {_RATE:g} Hz"
        )

    def is_due(self, deadline: int) -> bool:
        """Whether a step is one of the slower samples; to be asked once for each, in the stepping thread."""
        return self._samples.is_due(deadline)

    def publish(self, deadline: int, step: Step, *, is_due: bool) -> None:
        """Publish the pressures obeyed since the last step, and this one if it is one of the slower samples.

        In the stepping thread.
        """
        for name, stamp, pressure in step.obeyed:
            self._obeyed[name].publish(self._messages.pressure(stamp, pressure))
        if not is_due or math.isnan(step.reading.outlet_pressure):
            return
        hears_outlet_pressure, hears_mass_flow = self._audience.look(deadline)
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
            yield pressure_status(task, pressure, heard.count.rejections(), heard.incompatible.count())
