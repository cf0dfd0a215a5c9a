"""What monitors and valves say on topics, as reports; for the nodes that pass it on."""

from __future__ import annotations

import time
from collections.abc import Callable, Mapping, Sequence
from datetime import datetime
from functools import partial
from typing import Any, Final

from diagnostic_msgs.msg import DiagnosticArray
from rclpy.node import Node

from valve_sim.model.errors import ValveError
from valve_sim.nodes.node_clock import NodeClock
from valve_sim.nodes.realtime import NANOSECONDS, Arrival
from valve_sim.nodes.receiving import Inbox
from valve_sim.nodes.wiring import Interface
from valve_sim.station.figures import Report, Values, finding_report, stroke_report, utc, worst

_LONGEST: Final = 2000
"""Characters of a text; what is longer is cut."""


class StationEar:
    """Receives the messages about a station's valves when its node looks, a few times a second.

    Args:
        valves, monitors: full names of their nodes, in one order.
        is_live: whether to hear phase, is_open, current and pressure of the valves, too.
        alarms: the topic on which an opcua_node says who has acknowledged an alarm; empty: not heard.
    """

    def __init__(
        self,
        node: Node, clock: NodeClock, interface: Interface, valves: Sequence[str], monitors: Sequence[str],
        tell: Callable[[Report], None], *, is_live: bool, alarms: str = "",
    ) -> None:  # fmt: skip
        self._node, self._tell = node, tell
        self._pairs = list(zip(valves, monitors, strict=True))
        self._inbox = Inbox(node, clock)
        for valve, monitor in self._pairs:
            for name, read in (("stroke_report", stroke_report), ("finding", finding_report)):
                take = partial(self._take, valve, read)
                interface.receive(self._inbox, f"{{monitor}}/{name}", take, monitor=monitor)
            if is_live:
                hear_live(interface, self._inbox, self._inbox, valve, partial(self._show, valve))
        interface.receive(self._inbox, "/diagnostics", self._diagnose)
        if alarms:
            interface.receive(self._inbox, "{alarms}", self._take_answer, alarms=alarms)

    def look(self) -> None:
        """Take all that has come since the last look."""
        self._inbox.deliver()

    def _show(self, valve: str, name: str, value: Any, arrival: Arrival) -> None:
        path = {"phase": "Phase", "is_open": "IsOpen", "coil_current": "CoilCurrent"}.get(name, "OutletPressure")
        received = arrival.received / NANOSECONDS or time.time()
        self._tell(Report(valve, utc(received), {f"Live.{path}": value}))

    def _take(
        self, valve: str, read: Callable[[str, Mapping[str, str]], Report], message: DiagnosticArray, _: Arrival
    ) -> None:
        for status in message.status:
            values = {entry.key: entry.value for entry in status.values}
            try:
                self._tell(read(status.message, values)._replace(valve=valve))
            except ValveError as error:
                self._node.get_logger().warning(f"a report of {valve} is left out: {error}", throttle_duration_sec=10.0)

    def _take_answer(self, message: DiagnosticArray, arrival: Arrival) -> None:
        for status in message.status:
            said = {entry.key: entry.value[:_LONGEST] for entry in status.values}
            if any(said.get("valve") == valve for valve, _ in self._pairs):
                values: Values = {"Answer.Level": status.level[0], "Answer.Message": status.message[:_LONGEST]}
                values |= {"Answer.User": said.get("user", ""), "Answer.Comment": said.get("comment", "")}
                self._tell(Report(said["valve"], _time_of(message), values))

    def _diagnose(self, message: DiagnosticArray, arrival: Arrival) -> None:
        said = [(status.name, status.level[0], status.message[:_LONGEST]) for status in message.status]
        for valve, monitor in self._pairs:
            values: Values = {}
            for name, level, words in said:
                if name == f"{monitor.lstrip('/')}: valve":
                    values |= {"Health.Level": level, "Health.Message": words}
            prefix = f"{valve.lstrip('/')}: "
            if own := [
                (level, name.removeprefix(prefix), words) for name, level, words in said if name.startswith(prefix)
            ]:
                values["Driver.Level"], values["Driver.Message"] = worst(own)
            if values:
                self._tell(Report(valve, _time_of(message), values))


def _time_of(message: DiagnosticArray) -> datetime:
    return utc(message.header.stamp.sec + 1e-9 * message.header.stamp.nanosec)


def hear_live(
    interface: Interface, inbox: Inbox, seldom: Inbox, valve: str, take: Callable[[str, Any, Arrival], None]
) -> None:
    """Receive what a valve says often.

    Args:
        seldom: receives the coil's current, which comes at the rate of the valve and of which only the latest counts.
        take: is handed the topic's name, its value, and when it came.
    """

    def hear(place: Inbox, name: str, field: str) -> None:
        def pass_on(message: Any, arrival: Arrival) -> None:
            take(name, getattr(message, field), arrival)

        interface.receive(place, f"{{valve}}/{name}", pass_on, valve=valve)

    hear(inbox, "phase", "data")
    hear(inbox, "is_open", "data")
    hear(inbox, "outlet_pressure", "fluid_pressure")
    hear(seldom, "coil_current", "data")
