"""The ROS side of opcua_node: what monitors and valves publish goes to a `StationServer`, and its methods to services.

Threads: the main one takes what has been heard ten times a second, which takes a fraction of what an executor needs for
each message, and answers ROS; the server has one of its own.
"""

from __future__ import annotations

import asyncio
import time
from collections.abc import Callable, Sequence
from functools import partial
from pathlib import Path
from typing import Any, Final

from diagnostic_msgs.msg import DiagnosticArray
from rclpy.clock import Clock
from rclpy.clock_type import ClockType
from rclpy.node import Node
from rclpy.qos import DurabilityPolicy, QoSProfile, ReliabilityPolicy
from rclpy.subscription import Subscription
from sensor_msgs.msg import FluidPressure
from std_msgs.msg import Bool, Float64, String, UInt8
from std_srvs.srv import Trigger

from valve_sim.files.parameter_sections import Section
from valve_sim.model.errors import ValveError
from valve_sim.nodes.receiving import ReceiverGroup
from valve_sim.nodes.shell_parts import LATCHED, RELIABLE, declare_settings, full_name, make_node
from valve_sim.nodes.spinning import guarded, log_left_out, received_time, spin, waiting_messages
from valve_sim.station.figures import Report, Values, finding_report, stroke_report, utc, worst
from valve_sim.station.opcua_parameters import DESCRIPTIONS, NodeSettings, check_settings
from valve_sim.station.opcua_server import ServedValve, ServerThread, Settings, StationServer

_PERIOD: Final = 0.1
"""s between looks at what was heard."""
_ANSWER_SECONDS: Final = 10.0
"""s that a service may take to answer."""
_LATEST: Final = QoSProfile(depth=1, reliability=ReliabilityPolicy.BEST_EFFORT, durability=DurabilityPolicy.VOLATILE)
"""Of what comes often, the last one is enough."""
_MANY: Final = QoSProfile(depth=100, reliability=ReliabilityPolicy.RELIABLE)


class OpcUaShell:
    """The node `opcua`.

    Topics in, for each of `valves`: <valve>/phase, <valve>/is_open, <valve>/coil_current, <valve>/outlet_pressure; for
    each of `monitors`: <monitor>/stroke_report, <monitor>/finding; and /diagnostics. Services called:
    <monitor>/recommission, <valve>/self_test. Parameters: `NodeSettings`; they are read once, at the start.

    Args:
        sections: (file, section) of the parameter files on the command line.

    Raises:
        ValveError: a parameter cannot be used, or the server cannot start.
    """

    def __init__(self, sections: Sequence[tuple[str, Section]]) -> None:
        self._node: Node = make_node("opcua")
        try:
            settings: NodeSettings = declare_settings(self._node, sections, check_settings, DESCRIPTIONS)
            self._valves = [full_name(self._node, name, "valves") for name in settings.valves]
            self._monitors = [full_name(self._node, name, "monitors") for name in settings.monitors]
            self._subscriptions: list[tuple[Subscription, Callable[[Any, float], None]]] = []
            self._services: dict[tuple[str, str], Any] = {}
            self._is_failed = False
            self._wire()
            folder = Path(settings.folder).expanduser()
            served = [
                ServedValve(name, serial) for name, serial in zip(self._valves, settings.serial_numbers, strict=True)
            ]
            server = StationServer(
                Settings(folder, settings.address, settings.port, settings.anonymous_read, settings.history_days),
                served,
                recommission=partial(self._call, "recommission"),
                self_test=partial(self._call, "self_test"),
            )
            self._thread = ServerThread(server, self._fail)
            self._thread.start()
        except BaseException:
            self._node.destroy_node()
            raise
        self._node.get_logger().info(
            f"ready: {server.endpoint}, {len(served)} valves; clients connect whose certificates are in "
            f"{folder / 'trusted'}; those of others are kept in {folder / 'rejected'}"
        )

    @property
    def exit_code(self) -> int:
        """0, or 1 if the server failed."""
        return int(self._is_failed)

    def spin(self) -> None:
        """Serve until ROS is shut down."""
        spin(self._node)

    def close(self, timeout: float) -> bool:
        """End the server and release everything; whether it has ended."""
        has_ended = self._thread.stop(timeout)
        self._node.destroy_node()
        return has_ended

    # --- wiring ---

    def _wire(self) -> None:
        node = self._node
        for valve, monitor in zip(self._valves, self._monitors, strict=True):
            self._hear(UInt8, f"{valve}/phase", LATCHED, partial(self._show, valve, "Live.Phase", "data"))
            self._hear(Bool, f"{valve}/is_open", LATCHED, partial(self._show, valve, "Live.IsOpen", "data"))
            self._hear(
                Float64, f"{valve}/coil_current", _LATEST, partial(self._show, valve, "Live.CoilCurrent", "data")
            )
            show = partial(self._show, valve, "Live.OutletPressure", "fluid_pressure")
            self._hear(FluidPressure, f"{valve}/outlet_pressure", _LATEST, show)
            self._hear(String, f"{monitor}/stroke_report", RELIABLE, partial(self._report, valve, stroke_report))
            self._hear(String, f"{monitor}/finding", LATCHED, partial(self._report, valve, finding_report))
            self._services["recommission", valve] = node.create_client(Trigger, f"{monitor}/recommission")
            self._services["self_test", valve] = node.create_client(Trigger, f"{valve}/self_test")
        self._hear(DiagnosticArray, "/diagnostics", _MANY, self._diagnose)
        node.create_timer(_PERIOD, guarded(self._look), clock=Clock(clock_type=ClockType.STEADY_TIME))

    def _hear(self, kind: type, topic: str, qos: QoSProfile, take: Callable[[Any, float], None]) -> None:
        nothing = guarded(lambda message: None)  # the executor leaves these to `_look`
        subscription = self._node.create_subscription(kind, topic, nothing, qos, callback_group=ReceiverGroup())
        self._subscriptions.append((subscription, take))

    # --- what is heard ---

    def _look(self) -> None:
        for subscription, take in self._subscriptions:
            try:
                heard = list(waiting_messages(subscription))
            except Exception as error:  # of rclpy
                log_left_out(self._node, error)
                continue
            for message, info in heard:
                take(message, received_time(info) * 1e-9 or time.time())

    def _show(self, valve: str, path: str, field: str, message: Any, received: float) -> None:
        self._thread.put(Report(valve, utc(received), {path: getattr(message, field)}))

    def _report(self, valve: str, read: Callable[[str], Report], message: String, received: float) -> None:
        try:
            self._thread.put(read(message.data)._replace(valve=valve))
        except ValveError as error:
            self._node.get_logger().warning(f"a report of {valve} is left out: {error}", throttle_duration_sec=10.0)

    def _diagnose(self, message: DiagnosticArray, received: float) -> None:
        stamp = message.header.stamp.sec + 1e-9 * message.header.stamp.nanosec
        for valve, monitor in zip(self._valves, self._monitors, strict=True):
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
                self._thread.put(Report(valve, utc(stamp), values))

    # --- methods, in the server's thread ---

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
        elif self._node.context.ok():
            self._is_failed = True
            self._node.get_logger().fatal(f"the server ended: {error!r}")
            self._node.context.try_shutdown()
