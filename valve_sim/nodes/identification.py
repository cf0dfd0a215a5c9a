"""The node `identification`: a recording, a replay and a task wired to topics. No physics, no fitting.

Threads: a `Replay` thread publishes what is due, a `Task` thread refits, publishes
the result and hands it on.
"""

from __future__ import annotations

import contextlib
import queue
from collections.abc import Callable, Mapping, Sequence
from pathlib import Path
from typing import Any, Final

from rclpy.duration import Duration
from rclpy.node import Node
from rclpy.parameter import Parameter, parameter_value_to_python
from rclpy.parameter_client import AsyncParameterClient
from std_msgs.msg import Float64, String

from valve_sim.files.parameter_files import default_valve, load_recorded_valve
from valve_sim.files.parameter_sections import Section, write_sections
from valve_sim.identification.fit.intervals import Interval
from valve_sim.model import ParameterError, Valve
from valve_sim.nodes import topics
from valve_sim.nodes.diagnostics import Status
from valve_sim.nodes.identification_work import (
    BEFORE_FILE,
    Applied,
    Outcome,
    Prediction,
    Progress,
    Replay,
    Task,
    fit_or_diagnose,
    freed,
    measured_reading,
    measured_voltages,
    predict,
    read_recording,
    replay_status,
    report_text,
)
from valve_sim.nodes.messages import ReadingMessages
from valve_sim.nodes.settings import IdentificationSettings
from valve_sim.nodes.valve_parameters import unit_of, valve_table
from valve_sim.nodes.wiring import RosNode, full_name

_DELIVERY: Final = Duration(seconds=2)
"""s that the node waits at its end until subscribers have the result."""
FIND_SECONDS: Final = 10.0
"""Time in which a node must be found: announcements that DDS loses are repeated every 3 s."""
ANSWER_SECONDS: Final = 10.0
"""Time in which it must answer, all requests together."""
_REQUESTS: Final = 4
"""Requests to a node that does not answer: a reply that is sent before DDS has matched its reader is lost."""
_MOST_SHOWN: Final = 4
"""Numbers of a list in a line of the log."""
_DIGITS: Final = (6, 9, 17)
"""Of numbers in such a line: as few as show the change."""
Values = dict[str, Any]
"""Flat parameter name to value."""


class IdentificationNode(RosNode[IdentificationSettings]):
    """The node `identification`, with the topics and services `topics.IDENTIFICATION`.

    The prediction is by the declared valve until the refitted one is known. Parameters:
    `settings.IdentificationSettings`; they are read once, at the start. It ends when the recording has been played and
    the result is known, but for `loop` and `linger`.

    Raises:
        ValveError: a parameter, the recording or the parameter file cannot be used.
    """

    def __init__(self, sections: Sequence[tuple[str, Section]]) -> None:
        super().__init__("identification", sections, IdentificationSettings, topics.IDENTIFICATION)
        self._folder = _output_folder(self._settings)
        given = self._settings.apply_to
        target = full_name(self._node, given, "apply_to") if given else ""
        name, params = self._settings.valve_name or None, self._settings.params
        self._declared = load_recorded_valve(params, name) if params else default_valve()
        self._trace = read_recording(self._settings, self._declared)
        self._voltages = measured_voltages(self._trace)
        self._remote = RemoteParameters(self._node, target) if target else None
        self._prediction: Prediction | None = None
        self._refusal = ""
        self._task = Task(self._fit, self._report)
        self._replay = Replay(
            self._clock, self._trace, rate=self._settings.rate, loop=self._settings.loop, prepare=self._prepare,
            play=self._play, end=self._end, fail=self._fail,
        )  # fmt: skip
        self._threads += (self._replay, self._task)
        self._wire()

    def _work(self) -> None:
        for finding in self._trace.findings:
            self._node.get_logger().warning(finding)
        self._replay.start()
        super()._work()

    # --- wiring ---

    def _wire(self) -> None:
        interface = self._interface
        self._voltage = interface.publisher("~/coil_voltage")
        self._measured = interface.publisher("~/measured/joint_states")
        self._measured_coil = interface.publisher("~/measured/coil")
        self._predicted_coil = interface.publisher("~/predicted/coil")
        self._predicted = interface.publisher("~/predicted/joint_states")
        self._residual = interface.publisher("~/residual")
        self._result = interface.publisher("~/result")
        self._messages = ReadingMessages("")
        self._publish_diagnostics(self._statuses)

    # --- the replay's thread ---

    def _prepare(self) -> None:
        """Simulate the declared valve, and log what is about to be played."""
        self._prediction = predict(self._trace, self._declared, 0.0, "declared")
        own = self._settings
        what = f"refits {', '.join(freed(own, self._declared))}" if own.mode == "identify" else "diagnoses it"
        topic = (self._measured if self._trace.has_positions else self._measured_coil).topic_name
        self._node.get_logger().info(
            f"ready: replays {own.bag} on {topic} beside the model, {what}; the result comes on "
            f"{self._result.topic_name} and in {self._folder.resolve()}"
        )
        self._task.start()

    def _play(self, place: int) -> None:
        """Publish one command of the recording, or one sample, the prediction, and the residual."""
        if place < 0:
            self._voltage.publish(Float64(data=float(self._trace.drive.volts[-1 - place])))
            return
        assert self._prediction is not None
        measured, predicted = measured_reading(self._trace, place), self._prediction.reading(place)
        stamp = self._trace.epoch_ns + round(measured.time * 1e9)
        self._predicted.publish(self._messages.joint_states(stamp, predicted))
        if self._trace.has_positions:
            self._measured.publish(self._messages.joint_states(stamp, measured))
            self._residual.publish(Float64(data=measured.pilot_position - predicted.pilot_position))
            return
        volts = float(self._voltages[place])
        self._measured_coil.publish(self._messages.coil(stamp, measured.coil_current, volts))
        self._predicted_coil.publish(self._messages.coil(stamp, predicted.coil_current, volts))
        self._residual.publish(Float64(data=measured.coil_current - predicted.coil_current))

    # --- the task's thread ---

    def _fit(self, progress: Progress) -> str:
        outcome = fit_or_diagnose(self._trace, self._declared, self._settings, self._folder, progress)
        self._prediction = predict(self._trace, outcome.valve, outcome.clock_offset, self._settings.mode)
        applied = None if self._remote is None else self._apply(outcome, self._remote)
        text = report_text(outcome, applied)
        if applied is not None and not applied.is_set:
            # Before the result is published, upon which somebody may end this node.
            self.exit_code = 1
            self._refusal = f"{outcome.summary}; but apply_to: {applied.node} is as it was: {applied.reason}"
            self._node.get_logger().error(self._refusal)
        self._result.publish(String(data=text))
        if self._refusal:
            raise ParameterError(self._refusal)
        return f"{outcome.summary}; see {outcome.files}"

    def _report(self, words: str, is_good: bool) -> None:
        if not is_good:
            self.exit_code = 1
        if self._node.context.ok():
            logger = self._node.get_logger()
            if words != self._refusal:
                (logger.info if is_good else logger.error)(words)
            self._end()

    def _end(self) -> None:
        """At the end of the replay and of the task; the second call ends the node."""
        is_done = self._replay.is_done and self._task.is_done
        if is_done and not self._settings.linger and self._node.context.ok():
            self._result.wait_for_all_acked(_DELIVERY)
            self.stop.ask("all is done")

    def _apply(self, outcome: Outcome, remote: RemoteParameters) -> Applied:
        """Set what the recording determines, all of it at once or nothing; keep what the valve had."""
        logger = self._node.get_logger()
        if outcome.objection and not self._settings.apply_always:
            return Applied(remote.name, False, f"{outcome.objection}; apply_always:=true sets it all the same")
        new = valve_parameters(outcome.to_set)
        try:
            old = remote.values(list(new))
            write_sections(self._folder / BEFORE_FILE, [Section(remote.name, old)])
            remote.set(new)
        except ParameterError as error:
            return Applied(remote.name, False, str(error))
        if outcome.objection:
            logger.warning(f"{remote.name} is given the result although {outcome.objection} (apply_always)")
        lines = change_lines(old, new, outcome.intervals)
        for line in lines:
            logger.info(f"{remote.name}: {line}")
        if outcome.held:
            logger.info(
                f"{remote.name}: as declared, because the recording does not determine it: {', '.join(outcome.held)}"
            )
        logger.info(f"undo: `ros2 param load {remote.name} {(self._folder / BEFORE_FILE).resolve()}`")
        return Applied(remote.name, True, changes=lines)

    # --- callbacks ---

    def _statuses(self) -> Sequence[Status]:
        model = "none yet" if self._prediction is None else self._prediction.model
        return replay_status(self._replay, self._now(), model), self._task.status


def valve_parameters(valve: Valve) -> Values:
    """Every parameter of valve_node that describes its valve, with the values of this one."""
    return {name: entry.default for name, entry in valve_table(valve).items()}


def _output_folder(settings: IdentificationSettings) -> Path:
    """The folder of the results; it is made if missing. ParameterError: it cannot be made."""
    folder = Path(settings.output).expanduser()
    try:
        folder.mkdir(parents=True, exist_ok=True)
    except OSError as error:
        raise ParameterError(f"output: {folder}: cannot be made ({error.strerror}); expected a folder") from error
    return folder


class RemoteParameters:
    """Parameters of a running valve node. The methods block, so they must not be called by the spinning thread."""

    def __init__(self, node: Node, name: str) -> None:
        self.name = name
        self._client = AsyncParameterClient(node, name)

    def values(self, names: Sequence[str]) -> Values:
        """The present values; ParameterError: no such node, no answer, or it lacks one of them."""
        answer = self._ask(lambda callback: self._client.get_parameters(list(names), callback))
        found = dict(zip(names, map(parameter_value_to_python, answer.values), strict=False))
        missing = [name for name in names if found.get(name) is None]
        if missing:
            raise ParameterError(f"{self.name} has no parameter {missing[0]}; expected a valve_node of this release")
        return {name: value if isinstance(value, float | str) else list(value) for name, value in found.items()}

    def set(self, values: Mapping[str, Any]) -> None:
        """Set all of these, or none; ParameterError: no such node, no answer, or its reason to refuse them."""
        parameters = [Parameter(name, value=value) for name, value in values.items()]
        # Setting the same values again changes nothing, so the first reply counts.
        answer = self._ask(lambda callback: self._client.set_parameters_atomically(parameters, callback))
        if not answer.result.successful:
            raise ParameterError(f"{self.name} refuses them: {answer.result.reason}")

    def _ask(self, question: Callable[[Callable[[Any], None]], object]) -> Any:
        if not self._client.wait_for_services(timeout_sec=FIND_SECONDS):
            raise ParameterError(f"{self.name}: no such node was found within {FIND_SECONDS:g} s")
        answers: queue.SimpleQueue[Any] = queue.SimpleQueue()
        for _ in range(_REQUESTS):
            question(answers.put)
            with contextlib.suppress(queue.Empty):
                return answers.get(timeout=ANSWER_SECONDS / _REQUESTS).result()
        raise ParameterError(f"{self.name}: did not answer within {ANSWER_SECONDS:g} s")


def change_lines(old: Values, new: Values, intervals: Mapping[str, Interval]) -> tuple[str, ...]:
    """One line for each value that changes; `intervals` by the names of a fit, such as stiction.force."""
    lines = []
    for name, value in new.items():
        if old[name] != value:
            root, _, rest = name.partition(".")
            found = None if root == "tolerances" else intervals.get(name if root == "gas" else rest)
            interval = "" if found is None else f", 95 % interval {found.low:.6g} to {found.high:.6g}"
            digits = next((few for few in _DIGITS if _short(old[name], few) != _short(value, few)), _DIGITS[-1])
            change = f"{_short(old[name], digits)} → {_short(value, digits)}"
            lines.append(f"{name}: {change} {unit_of(name)}".rstrip() + interval)
    return tuple(lines)


def _short(value: object, digits: int) -> str:
    if isinstance(value, list):
        shown = ", ".join(_short(one, digits) for one in value)
        return f"[{shown}]" if len(value) <= _MOST_SHOWN else f"{len(value)} numbers"
    return f"{value:.{digits}g}" if isinstance(value, float) else str(value)
