"""The ROS side of identification_node: a recording, a replay and a task wired to topics. No physics, no fitting.

Threads: callbacks run in the main thread. A `Replay` thread publishes what is due, a `Task` thread refits, publishes
the result and hands it on.
"""

from __future__ import annotations

import threading
from collections.abc import Sequence
from typing import Final

from diagnostic_msgs.msg import DiagnosticArray
from rclpy.callback_groups import MutuallyExclusiveCallbackGroup
from rclpy.clock import Clock
from rclpy.clock_type import ClockType
from rclpy.duration import Duration
from rclpy.qos import QoSProfile, ReliabilityPolicy
from rclpy.task import Future
from sensor_msgs.msg import BatteryState, JointState
from std_msgs.msg import Float64, String
from std_srvs.srv import Trigger

from valve_sim.files.parameter_files import default_valve, load_valve
from valve_sim.files.parameter_sections import Section, write_sections
from valve_sim.model import ParameterError, Valve
from valve_sim.nodes.identification_parameters import DESCRIPTIONS, Settings, check_settings, output_folder
from valve_sim.nodes.identification_task import (
    BEFORE_FILE,
    Applied,
    Outcome,
    Progress,
    Task,
    fit_or_diagnose,
    freed,
    read_recording,
    report_text,
)
from valve_sim.nodes.messages import ReadingMessages, diagnostic_array
from valve_sim.nodes.node_clock import NodeClock
from valve_sim.nodes.parameters import VALVE_KEYS, table
from valve_sim.nodes.remote_parameters import RemoteParameters, Values, changes_between
from valve_sim.nodes.replay import Prediction, Replay, measured_reading, measured_voltages, predict, replay_status
from valve_sim.nodes.shell_parts import LATCHED, declare_settings, full_name, make_node
from valve_sim.nodes.spinning import guarded, spin

_DEEP: Final = QoSProfile(depth=1000, reliability=ReliabilityPolicy.RELIABLE)
"""A recording has more samples a second than a live valve."""
_DELIVERY: Final = Duration(seconds=2)
"""s that the node waits at its end until subscribers have the result."""


class IdentificationShell:
    """The node `identification`.

    Topics: ~/coil_voltage and ~/measured/joint_states as recorded, header stamps too; ~/predicted/joint_states with the
    same stamps, by the declared valve until the refitted one is known; ~/residual, m, measured less predicted position
    of the pilot plunger. Of a recording without positions ~/measured/coil in their place, ~/predicted/coil, and
    ~/residual, A, of the current. ~/result (JSON, latched) when it is known; /diagnostics at 1 Hz. Service: ~/undo,
    which gives the valve of `apply_to` its own values back. Parameters: `Settings`; they are read once, at the start.

    It ends when the recording has been played and the result is known, but for `loop` and `linger`.

    Args:
        sections: (file, section) of the parameter files on the command line.

    Raises:
        ValveError: a parameter, the recording or the parameter file cannot be used.
    """

    def __init__(self, sections: Sequence[tuple[str, Section]]) -> None:
        self._node = make_node("identification")
        try:
            self._settings: Settings = declare_settings(self._node, sections, check_settings, DESCRIPTIONS)
            self._folder = output_folder(self._settings)
            self._target = self._resolved_target()
            self._declared = load_valve(self._settings.params) if self._settings.params else default_valve()
            self._trace = read_recording(self._settings, self._declared)
            self._voltages = measured_voltages(self._trace)
            self._clock = NodeClock(self._node)
            self._remote = RemoteParameters(self._node, self._target) if self._target else None
            self._before: Values = {}
            self._wire()
        except BaseException:
            self._node.destroy_node()
            raise
        self._prediction: Prediction | None = None
        self._exit_code = 0
        self._refusal = ""
        self._task = Task(self._work, self._report)
        rate, loop = self._settings.rate, self._settings.loop
        self._replay = Replay(self._clock, self._trace, rate=rate, loop=loop, player=self)

    @property
    def exit_code(self) -> int:
        """0; 1 if the replay or the task failed, or the result could not be set on the valve of `apply_to`."""
        return self._exit_code

    def spin(self) -> None:
        """Replay, refit and answer until ROS is shut down."""
        for finding in self._trace.findings:
            self._node.get_logger().warning(finding)
        self._replay.start()
        spin(self._node)

    def close(self, timeout: float) -> bool:
        """Stop and release everything; whether both threads have ended. A fit cannot at once."""
        have_ended = [self._replay.stop(timeout), self._task.stop(timeout)]
        self._node.destroy_node()
        return all(have_ended)

    # --- wiring ---

    def _resolved_target(self) -> str:
        """The full name of the node on which the result is set; empty for none."""
        given = self._settings.apply_to
        return full_name(self._node, given, "apply_to") if given else ""

    def _wire(self) -> None:
        node = self._node
        self._voltage = node.create_publisher(Float64, "~/coil_voltage", _DEEP)
        self._measured = node.create_publisher(JointState, "~/measured/joint_states", _DEEP)
        self._measured_coil = node.create_publisher(BatteryState, "~/measured/coil", _DEEP)
        self._predicted_coil = node.create_publisher(BatteryState, "~/predicted/coil", _DEEP)
        self._predicted = node.create_publisher(JointState, "~/predicted/joint_states", _DEEP)
        self._residual = node.create_publisher(Float64, "~/residual", _DEEP)
        self._result = node.create_publisher(String, "~/result", LATCHED)
        self._diagnostics = node.create_publisher(DiagnosticArray, "/diagnostics", _DEEP)
        self._messages = ReadingMessages("")
        # Wall time: diagnostics must also report that /clock is silent.
        node.create_timer(1.0, guarded(self._diagnose), clock=Clock(clock_type=ClockType.STEADY_TIME))
        # A callback group of its own: while it waits for the valve, the reply needs the other group.
        node.create_service(Trigger, "~/undo", self._undo, callback_group=MutuallyExclusiveCallbackGroup())

    # --- the replay's thread ---

    def prepare(self) -> None:
        """Simulate the declared valve, and log what is about to be played."""
        self._prediction = predict(self._trace, self._declared, 0.0, "declared")
        self._say_ready()
        self._task.start()

    def _say_ready(self) -> None:
        settings = self._settings
        what = f"refits {', '.join(freed(settings, self._declared))}" if settings.mode == "identify" else "diagnoses it"
        topic = (self._measured if self._trace.has_positions else self._measured_coil).topic_name
        self._node.get_logger().info(
            f"ready: replays {settings.bag} on {topic} beside the model, {what}; the result comes on "
            f"{self._result.topic_name} and in {self._folder.resolve()}"
        )

    def command(self, index: int) -> None:
        """Publish one command of the recording."""
        self._voltage.publish(Float64(data=float(self._trace.drive.volts[index])))

    def sample(self, index: int) -> None:
        """Publish one sample of the recording, the prediction, and the residual."""
        assert self._prediction is not None
        measured, predicted = measured_reading(self._trace, index), self._prediction.reading(index)
        stamp = self._trace.epoch_ns + round(measured.time * 1e9)
        self._predicted.publish(self._messages.joint_states(stamp, predicted))
        if self._trace.has_positions:
            self._measured.publish(self._messages.joint_states(stamp, measured))
            self._residual.publish(Float64(data=measured.pilot_position - predicted.pilot_position))
            return
        volts = float(self._voltages[index])
        self._measured_coil.publish(self._messages.coil(stamp, measured.coil_current, volts))
        self._predicted_coil.publish(self._messages.coil(stamp, predicted.coil_current, volts))
        self._residual.publish(Float64(data=measured.coil_current - predicted.coil_current))

    def fail(self, error: Exception) -> None:
        """End the node because the replay failed."""
        if self._node.context.ok():
            self._exit_code = 1
            self._node.get_logger().fatal(f"the replay ended: {error!r}")
            self._node.context.try_shutdown()

    # --- the task's thread ---

    def _work(self, progress: Progress) -> str:
        outcome = fit_or_diagnose(self._trace, self._declared, self._settings, self._folder, progress)
        self._prediction = predict(self._trace, outcome.valve, outcome.clock_offset, self._settings.mode)
        applied = None if self._remote is None else self._apply(outcome, self._remote)
        text = report_text(outcome, applied)
        if applied is not None and not applied.is_set:
            # Before the result is published, upon which somebody may end this node.
            self._exit_code = 1
            self._refusal = f"{outcome.summary}; but apply_to: {applied.node} is as it was: {applied.reason}"
            self._node.get_logger().error(self._refusal)
            self._result.publish(String(data=text))
            raise ParameterError(self._refusal)
        self._result.publish(String(data=text))
        return f"{outcome.summary}; see {outcome.files}"

    def _report(self, words: str, is_good: bool) -> None:
        if not is_good:
            self._exit_code = 1
        if self._node.context.ok():
            logger = self._node.get_logger()
            if words != self._refusal:
                (logger.info if is_good else logger.error)(words)
            self.end()

    def end(self) -> None:
        """Called at the end of the replay and of the task; the second call ends the node."""
        is_done = self._replay.is_done and self._task.is_done
        if is_done and not self._settings.linger and self._node.context.ok():
            self._result.wait_for_all_acked(_DELIVERY)
            self._node.context.try_shutdown()

    def _apply(self, outcome: Outcome, remote: RemoteParameters) -> Applied:
        """Set the whole valve, effects that are off and tolerances too, at once or not at all; keep what it had."""
        logger = self._node.get_logger()
        if outcome.objection and not self._settings.apply_always:
            return Applied(remote.name, False, f"{outcome.objection}; apply_always:=true sets it all the same")
        new = valve_parameters(outcome.valve)
        try:
            old = remote.values(list(new))
            write_sections(self._folder / BEFORE_FILE, [Section(remote.name, old)])
            remote.set(new)
        except ParameterError as error:
            return Applied(remote.name, False, str(error))
        changes = changes_between(old, new, outcome.intervals)
        self._before = {change.name: change.old for change in changes}
        if outcome.objection:
            logger.warning(f"{remote.name} is given the result although {outcome.objection} (apply_always)")
        lines = tuple(change.text() for change in changes)
        for line in lines:
            logger.info(f"{remote.name}: {line}")
        logger.info(
            f"undo: `ros2 param load {remote.name} {(self._folder / BEFORE_FILE).resolve()}`, or, while this node "
            f"runs (linger:=true), its service ~/undo"
        )
        return Applied(remote.name, True, changes=lines)

    # --- callbacks, in the main thread ---

    async def _undo(self, request: Trigger.Request, response: Trigger.Response) -> Trigger.Response:
        """Set the valve's former values; a thread waits for the reply, which this one must be free to receive."""
        taken_back: Future = Future()

        def take_back() -> None:
            taken_back.set_result(self._take_back())
            if self._node.executor is not None:
                self._node.executor.wake()

        threading.Thread(target=take_back, name="undo", daemon=True).start()
        response.success, response.message = await taken_back
        return response

    def _take_back(self) -> tuple[bool, str]:
        if self._remote is None or not self._before:
            return False, "nothing was set that could be taken back"
        try:
            self._remote.set(self._before)
        except ParameterError as error:
            return False, str(error)
        words = f"{self._remote.name} has its own values again: {', '.join(self._before)}"
        self._node.get_logger().info(words)
        self._before = {}
        return True, words

    def _diagnose(self) -> None:
        reading = self._clock.read()
        model = "none yet" if self._prediction is None else self._prediction.model
        statuses = (replay_status(self._replay, reading.nanoseconds if reading else 0, model), self._task.status)
        name = self._node.get_fully_qualified_name()
        self._diagnostics.publish(diagnostic_array(statuses, name, self._clock.stamp()))


def valve_parameters(valve: Valve) -> Values:
    """Every parameter of valve_node that describes its valve, with the values of this one."""
    return {entry.name: entry.default for entry in table(valve).values() if entry.name.startswith(VALVE_KEYS)}
