"""The ROS side of opcua_node: what monitors and valves publish goes to a `StationServer`, and its methods to services.

Threads: one takes what has been heard ten times a second, which takes a fraction of what an executor needs for each
message; the main one answers ROS; the server has one of its own.
"""

from __future__ import annotations

import asyncio
from collections.abc import Sequence
from functools import partial
from pathlib import Path
from typing import Any, Final

from std_srvs.srv import Trigger

from valve_sim.files.parameter_sections import Section
from valve_sim.model.errors import ValveError
from valve_sim.nodes.diagnostics import Level, Status
from valve_sim.nodes.realtime import NANOSECONDS
from valve_sim.nodes.threads import Repeating
from valve_sim.nodes.wiring import RosNode
from valve_sim.station.alarms import Alarm
from valve_sim.station.figures import Report
from valve_sim.station.hearing import StationEar
from valve_sim.station.loop_thread import LoopThread
from valve_sim.station.opcua_server import ServedValve, StationServer
from valve_sim.station.tables import OPCUA_TOPICS, OpcUaSettings

_PERIOD: Final = 0.1
"""s between looks at what was heard."""
_ANSWER_SECONDS: Final = 10.0
"""s that a service may take to answer."""


class OpcUaNode(RosNode[OpcUaSettings]):
    """The node `opcua`, with the topics `tables.OPCUA_TOPICS` of each of `valves` and `monitors`.

    Services called: <monitor>/recommission, <valve>/self_test. Parameters: `tables.OpcUaSettings`; they are read once,
    at the start.

    Raises:
        ValveError: a parameter cannot be used, or the server cannot start.
    """

    def __init__(self, sections: Sequence[tuple[str, Section]]) -> None:
        super().__init__("opcua", sections, OpcUaSettings, OPCUA_TOPICS)
        settings, valves, monitors = self._settings, self._full_names("valves"), self._full_names("monitors")
        self._services: dict[tuple[str, str], Any] = {}
        for valve, monitor in zip(valves, monitors, strict=True):
            self._services["recommission", valve] = self._node.create_client(Trigger, f"{monitor}/recommission")
            self._services["self_test", valve] = self._node.create_client(Trigger, f"{valve}/self_test")
        served = [ServedValve(*one) for one in zip(valves, settings.serial_numbers, strict=True)]
        server = StationServer(
            settings,
            served,
            recommission=partial(self._call, "recommission"),
            self_test=partial(self._call, "self_test"),
            told=self._tell,
        )
        self._alarms = self._interface.publisher("~/alarms")
        thread = LoopThread("opcua", server, self._fail)
        thread.start()

        def show(report: Report) -> None:
            thread.do(server.put(report))

        ear = StationEar(self._node, self._clock, self._interface, valves, monitors, show, is_live=True)
        hearing = Repeating("hearing", ear.look, lambda: _PERIOD, self._fail)
        hearing.start()
        self._threads += (hearing, thread)
        folder = Path(settings.folder).expanduser()
        self._node.get_logger().info(
            f"ready: {server.endpoint}, {len(served)} valves; clients connect whose certificates are in "
            f"{folder / 'trusted'}"
        )

    # --- in the server's thread ---

    def _tell(self, valve: str, alarm: Alarm) -> None:
        """Publish that a person has acknowledged an alarm, for a node that archives it."""
        values = {"valve": valve, "user": alarm.user, "comment": alarm.comment}
        status = Status(valve.lstrip("/"), Level(alarm.level), f"acknowledged by {alarm.user}", values)
        if self._node.context.ok():
            self._alarms.publish(self._diagnostics([status], round(alarm.time * NANOSECONDS)))

    async def _call(self, name: str, valve: str) -> tuple[bool, str]:
        client = self._services[name, valve]
        if not client.service_is_ready():
            return False, f"{client.srv_name}: no node offers this service; start it"
        loop, done = asyncio.get_running_loop(), asyncio.Event()
        future = client.call_async(Trigger.Request())
        future.add_done_callback(lambda _: loop.call_soon_threadsafe(done.set))
        try:
            await asyncio.wait_for(done.wait(), _ANSWER_SECONDS)
        except asyncio.TimeoutError:
            return False, f"{client.srv_name}: has not answered within {_ANSWER_SECONDS:g} s"
        answer = future.result()
        return bool(answer.success), str(answer.message)

    def _fail(self, error: Exception) -> None:
        if isinstance(error, ValveError):  # a full disk, say: what is shown goes on when there is room again
            self._node.get_logger().error(str(error), throttle_duration_sec=10.0)
        else:
            super()._fail(error)
