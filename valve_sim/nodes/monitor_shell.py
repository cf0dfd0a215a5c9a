"""The ROS side of monitor_node: segmenter, monitor and fault isolation wired to topics. No physics, no decisions.

Threads: callbacks run in the main thread; each sample is a step of the model there, some tens of microseconds. One
thread scores strokes, another isolates the fault after an alarm; the live path waits for neither.
"""

from __future__ import annotations

import contextlib
import gc
import itertools
import json
import math
from collections import deque
from collections.abc import Callable, Iterator, Sequence
from pathlib import Path
from typing import Any, Final

from diagnostic_msgs.msg import DiagnosticArray
from rclpy.clock import Clock
from rclpy.clock_type import ClockType
from rclpy.event_handler import QoSRequestedIncompatibleQoSInfo, SubscriptionEventCallbacks
from rclpy.qos import QoSProfile, ReliabilityPolicy, qos_policy_name_from_kind
from rclpy.subscription import Subscription
from sensor_msgs.msg import JointState
from std_msgs.msg import Float64, String
from std_srvs.srv import Trigger

from valve_sim.files.parameter_files import Section
from valve_sim.identification.monitoring.fault_isolation import FaultFinding
from valve_sim.identification.monitoring.memory import load_commissioning, save_commissioning
from valve_sim.identification.monitoring.scores import Baseline
from valve_sim.identification.monitoring.segmenter import Prediction, StrokeSegmenter
from valve_sim.identification.monitoring.stroke_monitor import StrokeMonitor, StrokeReport
from valve_sim.identification.reporting.monitoring import finding_json, stroke_json
from valve_sim.identification.reporting.monitoring_words import finding_words
from valve_sim.model import ParameterError, Stepper
from valve_sim.nodes.diagnostics import Level
from valve_sim.nodes.live_map import LiveInput, live_inputs
from valve_sim.nodes.messages import JOINT_NAMES, ReadingMessages, diagnostic_array
from valve_sim.nodes.monitor_parameters import FORMER_NAMES, Given, check_given, descriptions
from valve_sim.nodes.monitor_status import (
    HealthLog,
    InputCount,
    health_status,
    input_status,
    isolation_status,
    model_status,
    stroke_status,
)
from valve_sim.nodes.monitor_tasks import FaultIsolation, MonitorThread
from valve_sim.nodes.node_clock import NodeClock
from valve_sim.nodes.parameters import sources_of
from valve_sim.nodes.realtime import LONGEST_LEAP_SECONDS, NANOSECONDS
from valve_sim.nodes.shell_parts import LATCHED, RELIABLE, declare_read_only, full_name, given_parameters, make_node
from valve_sim.nodes.spinning import guarded, log_left_out, spin, waiting_messages
from valve_sim.traces import Trace
from valve_sim.traces.trouble import MOST_STROKES

_MEASURED: Final = QoSProfile(depth=2000, reliability=ReliabilityPolicy.BEST_EFFORT)
"""Best effort accepts sensors of either reliability; deep, because samples may come while the model compiles."""
_COMMANDS: Final = QoSProfile(depth=1000, reliability=ReliabilityPolicy.RELIABLE)
_PAUSE: Final = 10e-3
"""s between polls: waking up for each sample would cost rclpy more than the model's step."""
_JUMP_SECONDS: Final = 1.0
"""A stamp that goes back by more means a clock that was set or a bag that restarted, not a sample out of order."""
_MOST_WAITING: Final = 100_000


class MonitorShell:
    """The node `monitor`.

    Topics of the valve <valve>, in: <valve>/coil_voltage, <valve>/<measured>, and coil_current beside the latter, where
    there is one: with it fault isolation tells a change of the coil from one of the magnetic circuit. Out:
    ~/predicted/joint_states and ~/residual (m, measured less predicted position of the pilot plunger) with each sample;
    ~/stroke_report (JSON) and ~/stroke_diagnostics (its numbers, to be plotted) with each stroke; ~/finding (JSON,
    latched), what has changed, after an alarm; /diagnostics at 1 Hz. Service: ~/recommission (the next strokes are
    the new baseline). Parameters: those of `valve_sim.nodes.monitor_parameters`; they are read once, at the start.

    Args:
        sections: (file, section) of the parameter files on the command line.

    Raises:
        ParameterError: a parameter is unknown, of the wrong type or out of range, or the state file cannot be used.
    """

    def __init__(self, sections: Sequence[tuple[str, Section]]) -> None:
        self._node = make_node("monitor")
        try:
            given = self._declare(sections)
            self._settings = given.settings
            self._valve = full_name(self._node, given.settings.valve_node, "valve_node")
            self._measured = full_name(self._node, f"{self._valve}/{given.settings.measured}", "measured")
            self._sensors = self._measured.rpartition("/")[0]
            self._voltage = f"{self._valve}/coil_voltage"
            self._inputs = live_inputs(given.settings.map, self._valve) if given.settings.map else {}
            self._entries: dict[Subscription, LiveInput] = {}
            self._clock = NodeClock(self._node)
            self._state = Path(given.settings.state).expanduser() if given.settings.state else None
            self._kept = None if self._state is None else load_commissioning(self._state, given.valve)
            self._wire()
        except BaseException:
            self._node.destroy_node()
            raise
        self._exit_code = 0
        self._epoch: int | None = None
        self._last_stamp: int | None = None
        self._next_message = 0
        self._input = InputCount()
        self._declared = given.valve
        self._segmenter = StrokeSegmenter(given.valve, given.settings.monitor)
        self._stroke_monitor = StrokeMonitor(given.valve, given.settings.monitor)
        if self._kept is not None:
            self._stroke_monitor.use(self._kept)
        self._isolation = FaultIsolation(self._tell)
        self._health = HealthLog()
        self._told: tuple[str, ...] | None = None
        self._last_report: StrokeReport | None = None
        self._baseline: Baseline | None = None
        self._is_ready = False
        self._waiting: deque[Callable[[], None]] = deque(maxlen=_MOST_WAITING)
        self._monitor_thread = MonitorThread(
            self._stroke_monitor, prepare=self._prepare, report=self._report, isolate=self._isolate,
            forget=self._forget, fail=self._fail,
        )  # fmt: skip

    @property
    def exit_code(self) -> int:
        """0, or 1 if the monitor's thread failed."""
        return self._exit_code

    def spin(self) -> None:
        """Monitor until ROS is shut down."""
        self._monitor_thread.start()
        spin(self._node, lambda: 0.0 if self._is_simulated() else _PAUSE)

    def close(self, timeout: float | None) -> bool:
        """Stop and release everything; whether both threads have ended."""
        has_ended = self._monitor_thread.stop(timeout) and self._isolation.stop(timeout)
        if has_ended:
            self._node.destroy_node()
        return has_ended

    # --- wiring ---

    def _declare(self, sections: Sequence[tuple[str, Section]]) -> Given:
        node, name = self._node, self._node.get_fully_qualified_name()
        given = check_given(given_parameters(node, sections, FORMER_NAMES), sources_of(sections, name), name)
        declare_read_only(node, given.values, descriptions())
        return given

    def _wire(self) -> None:
        node = self._node
        self._predicted = node.create_publisher(JointState, "~/predicted/joint_states", RELIABLE)
        self._residual = node.create_publisher(Float64, "~/residual", RELIABLE)
        self._stroke_diagnostics = node.create_publisher(DiagnosticArray, "~/stroke_diagnostics", RELIABLE)
        self._stroke_report = node.create_publisher(String, "~/stroke_report", RELIABLE)
        self._finding = node.create_publisher(String, "~/finding", LATCHED)
        self._diagnostics = node.create_publisher(DiagnosticArray, "/diagnostics", RELIABLE)
        self._messages = ReadingMessages(self._settings.frame_id)
        events = SubscriptionEventCallbacks(incompatible_qos=guarded(self._on_incompatible_qos))
        if self._inputs:
            self._subscribe_by_map(events)
        else:
            self._subscribe_to_own_topics(events)
        node.create_service(Trigger, "~/recommission", guarded(self._recommission))
        # Wall time: diagnostics must also report that /clock is silent.
        node.create_timer(1.0, guarded(self._diagnose), clock=Clock(clock_type=ClockType.STEADY_TIME))

    def _subscribe_to_own_topics(self, events: SubscriptionEventCallbacks) -> None:
        node = self._node
        on_command: Any = guarded(self._on_command)  # its second argument, message info, is missing in rclpy's types
        self._commands = node.create_subscription(
            Float64, f"{self._valve}/coil_voltage", on_command, _COMMANDS, event_callbacks=events
        )
        on_samples: Any = guarded(self._on_samples)
        self._samples = node.create_subscription(JointState, self._measured, on_samples, _MEASURED)
        on_currents: Any = guarded(self._on_currents)
        self._currents = node.create_subscription(Float64, f"{self._sensors}/coil_current", on_currents, _MEASURED)

    def _subscribe_by_map(self, events: SubscriptionEventCallbacks) -> None:
        """Subscribe to the topics that the map names; each message is converted to the type of this package."""

        def subscription_to(quantity: str, callback: Callable[..., None], qos: QoSProfile, **settings: Any) -> Any:
            entry = self._inputs[quantity]
            subscription = subscribe(
                entry.message_class,
                entry.source.topic,
                guarded(lambda message, info: callback(*self._as_own_message(entry, message, info))),
                qos,
                **settings,
            )
            self._entries[subscription] = entry
            return subscription

        subscribe: Any = self._node.create_subscription
        self._measured, self._voltage = (self._inputs[key].source.topic for key in ("position", "command"))
        self._commands = subscription_to("command", self._on_command, _COMMANDS, event_callbacks=events)
        self._samples = subscription_to("position", self._on_samples, _MEASURED)
        if "current" in self._inputs:
            self._currents = subscription_to("current", self._on_currents, _MEASURED)

    def _as_own_message(self, entry: LiveInput | None, message: Any, info: Any) -> tuple[Any, Any]:
        """A message and its times in the types of this package; `entry` is None where they are already."""
        if entry is None:
            return message, info
        value, stamp = entry.value(message), entry.stamp(message)
        if entry.quantity != "position":
            return Float64(data=value), {"stamp": stamp} if stamp else info
        seconds, nanoseconds = divmod(stamp or self._arrival(info), NANOSECONDS)
        joints = JointState(name=[JOINT_NAMES[0]], position=[value])
        joints.header.stamp.sec, joints.header.stamp.nanosec = seconds, nanoseconds
        return joints, info

    # --- callbacks, in the main thread ---

    def _on_command(self, message: Float64, info: Any) -> None:
        stamp = self._arrival(info)
        self._when_ready(lambda: self._command(stamp, message.data))

    def _on_currents(self, message: Float64, info: Any) -> None:
        self._take_current(message, info)
        for waiting in self._waiting_on(self._currents):
            self._take_current(*waiting)

    def _take_current(self, message: Float64, info: Any) -> None:
        stamp = self._arrival(info)
        self._when_ready(lambda: self._segmenter.measure_current(self._seconds(stamp), message.data))

    def _on_samples(self, message: JointState, info: Any) -> None:
        """Take all queued samples, each after the commands received before it."""
        for sample in itertools.chain([(message, info)], self._waiting_on(self._samples)):
            for command in self._waiting_on(self._commands):
                self._on_command(*command)
            self._take_sample(*sample)

    def _waiting_on(self, subscription: Subscription) -> Iterator[tuple[Any, Any]]:
        """Queued messages with their times; none in simulated time, where the order with /clock must be kept."""
        if self._is_simulated():
            return
        try:
            for waiting in waiting_messages(subscription):
                yield self._as_own_message(self._entries.get(subscription), *waiting)
        except Exception as error:  # of rclpy; callbacks of this package are not called in here
            log_left_out(self._node, error)

    def _is_simulated(self) -> bool:
        reading = self._clock.read()
        return reading is None or reading.is_simulated

    def _arrival(self, info: Any) -> int:
        """Receive time of a message without a stamp, ns; in simulated time, when this thread processes it.

        A message that a map names may have one.
        """
        if isinstance(info, dict) and "stamp" in info:
            return int(info["stamp"])
        received = _received(info)
        return self._clock.stamp() if self._is_simulated() or not received else received

    def _take_sample(self, message: JointState, info: Any) -> None:
        received = 0 if self._is_simulated() else _received(info)
        self._when_ready(lambda: self._sample(message, received))

    def _when_ready(self, action: Callable[[], None]) -> None:
        if not self._is_ready:
            self._waiting.append(action)
            return
        while self._waiting:
            self._waiting.popleft()()
        action()

    def _command(self, stamp: int, volts: float) -> None:
        rejected = self._segmenter.rejected
        self._segmenter.command(self._seconds(stamp), volts)
        if self._segmenter.rejected > rejected:
            self._input.reject(f"{self._voltage}: {volts:g} V")
        else:
            self._input.commands += 1
        self._hand_over()

    def _sample(self, message: JointState, received: int) -> None:
        position = self._position_of(message)
        if position is None:
            return
        largest = MOST_STROKES * self._declared.parameters.stroke
        if abs(position) > largest:
            words = f"{self._measured}: {position:g} m, expected metres, at most {largest:g} m; the map's unit:"
            self._input.reject(words)
            return
        header = message.header.stamp
        stamp = header.sec * NANOSECONDS + header.nanosec
        moved = (stamp - self._last_stamp) / NANOSECONDS if self._last_stamp is not None else 0.0
        if moved < -_JUMP_SECONDS or moved > LONGEST_LEAP_SECONDS:
            words = f"the stamps jumped by {moved:g} s: the valve is taken to be at rest"
            self._node.get_logger().warning(words, throttle_duration_sec=1.0)
            self._segmenter.reset()
            self._epoch, self._last_stamp, self._next_message = stamp, stamp - 1, 0
        time_of = self._seconds
        prediction = self._segmenter.measure(time_of(stamp), position, time_of(received) if received else math.nan)
        if prediction is None:
            self._input.reject(f"{self._measured}: {position:g} m at {stamp} ns, the last at {self._last_stamp} ns")
            return
        self._last_stamp = stamp
        self._input.samples += 1
        self._publish(stamp, prediction)
        self._hand_over()

    def _position_of(self, message: JointState) -> float | None:
        """The pilot plunger's position, m; None, and counted, where the message has none."""
        names, positions = message.name, message.position
        if JOINT_NAMES[0] not in names:
            self._input.reject(f"{self._measured}: joints {list(names)}, expected {JOINT_NAMES[0]} among them")
            return None
        index = names.index(JOINT_NAMES[0])
        if len(positions) <= index:
            self._input.reject(f"{self._measured}: {len(positions)} positions for {len(names)} joints")
            return None
        return float(positions[index])

    def _publish(self, stamp: int, prediction: Prediction) -> None:
        """Publish prediction and residual, at most at max_rate and only if there are subscribers."""
        if stamp < self._next_message:
            return
        self._next_message = max(self._next_message, stamp) + round(0.9 * NANOSECONDS / self._settings.max_rate)
        if self._predicted.get_subscription_count():
            self._predicted.publish(self._messages.joint_states(stamp, prediction.reading))
        if self._residual.get_subscription_count():
            self._residual.publish(Float64(data=prediction.residual))

    def _hand_over(self) -> None:
        for record in self._segmenter.take_finished():
            self._monitor_thread.post(record)
        scatter = self._stroke_monitor.command_scatter
        self._segmenter.scatter = scatter if math.isfinite(scatter) else 0.0
        baseline = self._stroke_monitor.baseline
        if baseline is not self._baseline and baseline is not None:
            self._segmenter.use(baseline.valve, baseline.lateness)
            self._baseline = baseline

    def _seconds(self, stamp: int) -> float:
        """Seconds since the first stamp, so that a double resolves nanoseconds."""
        if self._epoch is None:
            self._epoch = stamp
        return (stamp - self._epoch) / NANOSECONDS

    def _on_incompatible_qos(self, event: QoSRequestedIncompatibleQoSInfo) -> None:
        policy = qos_policy_name_from_kind(event.last_policy_kind)
        self._node.get_logger().warning(
            f"{self._voltage}: a publisher offers an incompatible QoS ({policy}) and cannot be heard; publish reliable"
        )

    def _recommission(self, request: Trigger.Request, response: Trigger.Response) -> Trigger.Response:
        self._monitor_thread.recommission()
        response.success = True
        response.message = f"the next {self._settings.commissioning_strokes} strokes are taken as the new baseline"
        return response

    def _diagnose(self) -> None:
        waiting_for = "" if self._is_ready else "the model to be compiled"
        if self._is_ready and self._clock.read() is None:
            waiting_for = "/clock (use_sim_time is true)"
        elif self._is_ready and not self._input.samples:
            waiting_for = f"samples on {self._measured}"
        elif self._is_ready and not self._input.commands:
            waiting_for = f"a command on {self._voltage}"
        facts = self._input.look(self._clock.elapsed(), self._monitor_thread.lost, waiting_for)
        wanted = self._settings.commissioning_strokes
        statuses = (
            health_status(self._segmenter.fault, self._stroke_monitor, self._last_report, wanted, self._isolation),
            model_status(self._stroke_monitor),
            input_status(facts),
            isolation_status(self._isolation),
        )
        name = self._node.get_fully_qualified_name()
        self._diagnostics.publish(diagnostic_array(statuses, name, self._clock.stamp()))

    # --- the monitor's thread, and that of fault isolation ---

    def _prepare(self) -> None:
        """Load or compile the model before the first sample is processed."""
        stepper = Stepper(self._segmenter.valve)
        stepper.command(1e-3, self._segmenter.valve.parameters.reference_voltage)
        stepper.advance(20e-3)
        gc.freeze()
        self._is_ready = True
        self._node.get_logger().info(
            f"ready: hears {self._commands.topic_name} and {self._measured}, reports each stroke on "
            f"{self._stroke_report.topic_name} and what has changed on {self._finding.topic_name}"
        )

    def _report(self, report: StrokeReport) -> None:
        self._last_report = report
        self._stroke_report.publish(String(data=json.dumps(stroke_json(report), ensure_ascii=False)))
        stamp = (self._epoch or 0) + round(report.record.time * NANOSECONDS)
        name = self._node.get_fully_qualified_name()
        self._stroke_diagnostics.publish(diagnostic_array([stroke_status(report)], name, stamp))
        self._keep()
        if change := self._health.look(report, self._stroke_monitor):
            self._log(*change)

    def _keep(self) -> None:
        """Write the state file once commissioning is complete."""
        commissioning = self._stroke_monitor.commissioning
        if commissioning is None or commissioning is self._kept or self._state is None:
            return
        self._kept = commissioning
        try:
            save_commissioning(self._state, commissioning, self._declared)
        except ParameterError as error:
            self._node.get_logger().error(f"commissioned, but not kept: {error}")
        else:
            self._node.get_logger().info(f"commissioned; kept in {self._state}")

    def _forget(self) -> None:
        self._isolation.forget()
        self._told = self._kept = None
        if self._state is not None:
            with contextlib.suppress(OSError):
                self._state.unlink(missing_ok=True)

    def _log(self, level: Level, words: str) -> None:
        # rclpy allows only one severity for each line of code that logs.
        if level is Level.ERROR:
            self._node.get_logger().error(words)
        elif level is Level.WARN:
            self._node.get_logger().warning(words)
        else:
            self._node.get_logger().info(words)

    def _isolate(self, strokes: list[Trace], baseline: Baseline) -> None:
        self._isolation.begin(strokes, baseline)

    def _tell(self, finding: FaultFinding) -> None:
        self._finding.publish(String(data=json.dumps(finding_json(finding), ensure_ascii=False)))
        if finding.verdict.effects != self._told:
            self._told = finding.verdict.effects
            self._node.get_logger().warning(finding_words(finding))

    def _fail(self, error: Exception) -> None:
        if self._node.context.ok():
            self._exit_code = 1
            self._node.get_logger().fatal(f"monitoring ended: {error!r}")
            self._node.context.try_shutdown()


def _received(info: Any) -> int:
    """Receive time by the middleware, ns; 0 where it gives none."""
    return int(info.get("received_timestamp", 0)) if isinstance(info, dict) else 0
