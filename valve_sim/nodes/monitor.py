"""The node `monitor`: segmenter, monitor and fault isolation wired to topics. No physics, no decisions.

Threads: callbacks only store. One thread empties the inbox, where each sample is a step of
the model, some tens of microseconds; one scores strokes, another isolates the fault after an alarm; the live path waits
for neither.
"""

from __future__ import annotations

import contextlib
from collections.abc import Sequence
from pathlib import Path
from typing import Final

from rclpy.publisher import Publisher
from std_msgs.msg import Float64

from valve_sim.files.parameter_sections import Section
from valve_sim.identification.monitoring.findings import Occasion, Prediction, StrokeRecord
from valve_sim.identification.monitoring.memory import load_commissioning, save_commissioning
from valve_sim.identification.monitoring.scores import Baseline
from valve_sim.identification.monitoring.stroke_monitor import StrokeMonitor, StrokeReport
from valve_sim.identification.reporting.monitor_messages import not_judged_words, occasion_words, told_finding
from valve_sim.model import ParameterError
from valve_sim.nodes import topics
from valve_sim.nodes.diagnostics import Level, Status
from valve_sim.nodes.live_monitor import LiveMonitor
from valve_sim.nodes.live_valve import load_stepper
from valve_sim.nodes.messages import ReadingMessages
from valve_sim.nodes.monitor_inputs import MonitorInputs
from valve_sim.nodes.monitor_work import (
    FaultIsolation,
    Found,
    MonitorThread,
    finding_status,
    health_of,
    health_status,
    isolation_status,
    model_status,
    stroke_status,
)
from valve_sim.nodes.realtime import NANOSECONDS
from valve_sim.nodes.settings import MonitorNodeSettings
from valve_sim.nodes.threads import Repeating
from valve_sim.nodes.valve_parameters import valve_of
from valve_sim.nodes.wiring import RosNode, full_name
from valve_sim.recordings import Trace

_PAUSE: Final = 40e-3
"""s between deliveries: to wake up for a sample costs more than the model's step, and what is done once for each of
them costs as much as ten samples. What a stroke shows is known when it has ended."""
_PAUSE_IF_HEARD: Final = 10e-3
"""s, where each sample's prediction is heard: at 1 kHz no more at a time than the ten that a subscriber queues."""
BETWEEN_REMINDERS: Final = 60.0
"""s between lines of the log about stamps of another clock."""


class MonitorNode(RosNode[MonitorNodeSettings]):
    """The node `monitor`, with the topics and services `topics.MONITOR`.

    It hears the commands of a valve and the measured positions beside them; a current, where one comes, tells a change
    of the coil from one of the magnetic circuit. Where no position comes, or `measured` is that of the coil, the valve
    is watched by its current alone. Of a valve with gas it also hears the pressures around it; without them, the
    model's own and the declared ones count. Parameters: `settings.MonitorNodeSettings`; they are read once, at the
    start.

    Raises:
        ValveError: a parameter is unknown, of the wrong type or out of range, or the state file cannot be used.
    """

    def __init__(self, sections: Sequence[tuple[str, Section]]) -> None:
        super().__init__("monitor", sections, MonitorNodeSettings, topics.MONITOR)
        self._declared = valve_of(self._initial_values, self._node.get_fully_qualified_name())
        settings, valve = self._settings.monitor, self._declared
        self._valve = full_name(self._node, self._settings.valve_node, "valve_node")
        measured = full_name(self._node, f"{self._valve}/{self._settings.measured}", "measured")
        self._state = Path(self._settings.state).expanduser() if self._settings.state else None
        self._kept = None if self._state is None else load_commissioning(self._state, valve)
        self._strokes = StrokeMonitor(valve, settings)
        if self._kept is not None:
            self._strokes.use(self._kept)
        self._isolation = FaultIsolation(self._tell)
        self._state_told = ""
        self._last_report: StrokeReport | None = None
        self._heard: list[Publisher] = []
        """Those of the topics of each sample that have subscribers, as of the last delivery."""
        self._monitor_thread = MonitorThread(
            self._strokes, prepare=self._prepare, report=self._report, isolate=self._isolate, forget=self._forget,
            fail=self._fail,
        )  # fmt: skip
        self._inputs = MonitorInputs(self._node, self._clock, self._valve, measured)
        self._live = LiveMonitor(
            valve, settings, self._strokes, by_current=self._inputs.by_current, follow=self._publish,
            finished=self._monitor_thread.post, warn=self._warn,
        )  # fmt: skip
        self._inputs.hear(self._live, has_gas=valve.gas is not None)
        self._next_message = 0
        self._delivery = Repeating(
            "delivery", self._deliver, lambda: _PAUSE_IF_HEARD if self._heard else _PAUSE, self._fail
        )
        # Neither the comparison of a stroke nor a search for a fault can end at once.
        self._threads += (self._delivery, self._monitor_thread, self._isolation)
        self._wire()

    def _work(self) -> None:
        self._monitor_thread.start()
        self._delivery.start()
        super()._work()

    # --- wiring ---

    def _wire(self) -> None:
        interface = self._interface
        self._predicted = interface.publisher("~/predicted/joint_states")
        self._residual = interface.publisher("~/residual")
        self._stroke_report = interface.publisher("~/stroke_report")
        self._finding = interface.publisher("~/finding")
        self._messages = ReadingMessages(self._settings.frame_id)
        interface.serve("~/recommission", self._recommission)
        self._publish_diagnostics(self._statuses)

    # --- what is heard, in the thread that empties the inbox ---

    def _deliver(self) -> None:
        inbox = self._inputs.inbox
        if self._is_ready:
            self._heard = [topic for topic in (self._predicted, self._residual) if topic.get_subscription_count()]
            inbox.deliver()
        else:
            inbox.store_waiting()

    def _warn(self, words: str, is_frequent: bool) -> None:
        if is_frequent:
            self._node.get_logger().warning(words, throttle_duration_sec=1.0)
        else:
            self._node.get_logger().warning(words)

    def _publish(self, stamp: int, prediction: Prediction) -> None:
        """Publish prediction and residual, at most at max_rate and only if there are subscribers."""
        pause = round(0.9 * NANOSECONDS / self._settings.max_rate)
        if not self._heard or self._next_message - pause <= stamp < self._next_message:
            return
        self._next_message = stamp + pause
        if self._predicted in self._heard:
            self._predicted.publish(self._messages.joint_states(stamp, prediction.reading))
        if self._residual in self._heard:
            self._residual.publish(Float64(data=prediction.residual))

    def _recommission(self) -> tuple[bool, str]:
        self._monitor_thread.recommission()
        return True, f"the next {self._settings.commissioning_strokes} strokes are taken as the new baseline"

    def _statuses(self) -> Sequence[Status]:
        waiting_for = self._waiting_for()
        if not waiting_for and not self._live.input.samples:
            waiting_for = f"samples on {self._inputs.wanted}"
        elif not waiting_for and not self._live.input.commands:
            waiting_for = f"a command on {self._inputs.voltage}"
        unheard = self._inputs.incompatible_publishers()
        if stamps := self._live.stamps.look(is_simulated=self._clock.is_simulated):
            self._node.get_logger().warning(stamps, throttle_duration_sec=BETWEEN_REMINDERS)
        wanted, last = self._settings.commissioning_strokes, self._last_report
        lost = self._monitor_thread.lost
        not_judged = not_judged_words(last) if last is not None and last.is_incomplete else ""
        return (
            health_status(self._live.segmenter.fault, self._strokes, last, wanted, self._isolation.found),
            model_status(self._strokes),
            self._live.input.status(self._clock.elapsed(), lost, waiting_for, unheard, stamps, not_judged),
            isolation_status(self._isolation),
        )

    # --- the monitor's thread, and that of fault isolation ---

    def _prepare(self) -> None:
        """Load or compile the model before the first sample is processed."""
        load_stepper(self._live.segmenter.valve)
        self._is_ready = True
        self._node.get_logger().info(
            f"ready: hears {self._inputs.voltage} and {self._inputs.measured}, reports each stroke on "
            f"{self._stroke_report.topic_name} and what has changed on {self._finding.topic_name}"
        )

    def _report(self, report: StrokeReport) -> None:
        self._last_report = report
        self._live.input.incomplete += report.is_incomplete
        self._stroke_report.publish(self._diagnostics([stroke_status(report, self._valve)], report.record.stamp))
        self._keep()
        wanted = self._settings.commissioning_strokes
        level, state, words = health_of(self._strokes, report.record.fault, self._isolation.found, wanted)
        if state != self._state_told:
            self._state_told = state
            occasion = Occasion(self._valve, report.record.number, report.record.stamp)
            self._log(level, f"{occasion_words(occasion)}, {report.volts:.1f} V: {words}")

    def _keep(self) -> None:
        """Write the state file once commissioning is complete."""
        commissioning = self._strokes.commissioning
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
        self._kept = None
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

    def _isolate(self, strokes: list[Trace], baseline: Baseline, last: StrokeRecord) -> None:
        self._isolation.begin(strokes, baseline, Occasion(self._valve, last.number, last.stamp))

    def _tell(self, found: Found, is_new: bool) -> None:
        """Say a finding on the topic and in the log, as /diagnostics has it; what was said is not logged again."""
        self._finding.publish(self._diagnostics([finding_status(found)], found.occasion.stamp))
        if is_new:
            self._node.get_logger().warning(told_finding(*found))
