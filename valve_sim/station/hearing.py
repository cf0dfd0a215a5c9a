"""What monitors and valves say on topics, as reports; for the nodes that pass it on."""

from __future__ import annotations

import time
from collections.abc import Callable, Sequence
from functools import partial
from typing import Any, Final

from diagnostic_msgs.msg import DiagnosticArray
from rclpy.node import Node
from rclpy.qos import DurabilityPolicy, QoSProfile, ReliabilityPolicy
from rclpy.subscription import Subscription
from sensor_msgs.msg import FluidPressure
from std_msgs.msg import Bool, Float64, String, UInt8

from valve_sim.model.errors import ValveError
from valve_sim.nodes.receiving import ReceiverGroup
from valve_sim.nodes.shell_parts import LATCHED, RELIABLE
from valve_sim.nodes.spinning import guarded, log_left_out, received_time, waiting_messages
from valve_sim.station.figures import Report, Values, finding_report, stroke_report, utc, worst

LATEST: Final = QoSProfile(depth=1, reliability=ReliabilityPolicy.BEST_EFFORT, durability=DurabilityPolicy.VOLATILE)
"""Of what comes often, the last one is enough."""
_MANY: Final = QoSProfile(depth=100, reliability=ReliabilityPolicy.RELIABLE)


class Ear:
    """Subscriptions that are taken when their node looks, a few times a second.

    That takes a fraction of what an executor needs for each message.

    Args:
        node: subscribes.
    """

    def __init__(self, node: Node) -> None:
        self._node = node
        self._subscriptions: list[tuple[Subscription, Callable[[Any, float], None]]] = []

    def hear(self, kind: type, topic: str, qos: QoSProfile, take: Callable[[Any, float], None]) -> None:
        """Subscribe; `take` is handed each message and when it was received, s since 1970."""
        nothing = guarded(lambda message: None)  # the executor leaves these to `look`
        subscription = self._node.create_subscription(kind, topic, nothing, qos, callback_group=ReceiverGroup())
        self._subscriptions.append((subscription, take))

    def look(self) -> None:
        """Take all that has come since the last look."""
        for subscription, take in self._subscriptions:
            try:
                heard = list(waiting_messages(subscription))
            except Exception as error:  # of rclpy
                log_left_out(self._node, error)
                continue
            for message, info in heard:
                take(message, received_time(info) * 1e-9 or time.time())


class StationEar(Ear):
    """What is said of the valves of a station.

    Args:
        node: subscribes.
        valves, monitors: full names of their nodes, in one order.
        tell: is handed each report.
        is_live: whether to hear phase, is_open, current and pressure of the valves, too.
    """

    def __init__(
        self, node: Node, valves: Sequence[str], monitors: Sequence[str], tell: Callable[[Report], None], *,
        is_live: bool,
    ) -> None:  # fmt: skip
        super().__init__(node)
        self._tell, self._pairs = tell, list(zip(valves, monitors, strict=True))
        for valve, monitor in self._pairs:
            self.hear(String, f"{monitor}/stroke_report", RELIABLE, partial(self._report, valve, stroke_report))
            self.hear(String, f"{monitor}/finding", LATCHED, partial(self._report, valve, finding_report))
            if is_live:
                self._hear_live(valve)
        self.hear(DiagnosticArray, "/diagnostics", _MANY, self._diagnose)

    def _hear_live(self, valve: str) -> None:
        show = partial(self._show, valve)
        self.hear(UInt8, f"{valve}/phase", LATCHED, partial(show, "Live.Phase", "data"))
        self.hear(Bool, f"{valve}/is_open", LATCHED, partial(show, "Live.IsOpen", "data"))
        self.hear(Float64, f"{valve}/coil_current", LATEST, partial(show, "Live.CoilCurrent", "data"))
        pressure = partial(show, "Live.OutletPressure", "fluid_pressure")
        self.hear(FluidPressure, f"{valve}/outlet_pressure", LATEST, pressure)

    def _show(self, valve: str, path: str, field: str, message: Any, received: float) -> None:
        self._tell(Report(valve, utc(received), {path: getattr(message, field)}))

    def _report(self, valve: str, read: Callable[[str], Report], message: String, received: float) -> None:
        try:
            self._tell(read(message.data)._replace(valve=valve))
        except ValveError as error:
            self._node.get_logger().warning(f"a report of {valve} is left out: {error}", throttle_duration_sec=10.0)

    def _diagnose(self, message: DiagnosticArray, received: float) -> None:
        stamp = message.header.stamp.sec + 1e-9 * message.header.stamp.nanosec
        for valve, monitor in self._pairs:
            values: Values = {}
            for status in message.status:
                if status.name == f"{monitor.lstrip('/')}: valve":
                    values |= {"Health.Level": status.level[0], "Health.Message": status.message}
            prefix = f"{valve.lstrip('/')}: "
            own = [
                (status.level[0], status.name.removeprefix(prefix), status.message)
                for status in message.status
                if status.name.startswith(prefix)
            ]
            if own:
                level, words = worst(own)
                values |= {"Driver.Level": level, "Driver.Message": words}
            if values:
                self._tell(Report(valve, utc(stamp), values))
