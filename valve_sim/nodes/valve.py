"""The shell of the node `valve`: parameters, topics and services wired to a live machine. No physics, no decisions.

Threads: callbacks only store (parameters, resets, and what an `Inbox` receives). One `Worker` thread loads the model,
then empties the inbox, steps the machine and publishes; it consumes what was stored, each at its own time.
"""

from __future__ import annotations

import contextlib
import math
from collections.abc import Callable, Iterator, Mapping, Sequence
from functools import partial
from typing import Any, Final

from rcl_interfaces.msg import SetParametersResult
from rclpy.node import Node
from rclpy.parameter import Parameter
from rclpy.publisher import Publisher

from valve_sim.files.parameter_sections import Section
from valve_sim.model import ParameterError, Phase
from valve_sim.nodes import topics
from valve_sim.nodes.diagnostics import Level, Status, command_status, timing_status, valve_status
from valve_sim.nodes.live_machine import LiveMachine, Step
from valve_sim.nodes.live_valve import LiveValve
from valve_sim.nodes.messages import IS_OPEN, JOINTS_OF, PHASE, ReadingMessages
from valve_sim.nodes.obeying import BETWEEN_WARNINGS, GasTopics, ObeyedTopic
from valve_sim.nodes.parameters import Declares, Value, as_declared, changed_words, check_given, sources_of
from valve_sim.nodes.realtime import NANOSECONDS, Decimator, Restart, Worker
from valve_sim.nodes.receiving import Inbox
from valve_sim.nodes.spinning import guarded
from valve_sim.nodes.valve_parameters import ValveSettings, valve_of
from valve_sim.nodes.wiring import RosNode, make_node

BETWEEN_REMINDERS: Final = 60.0
"""s between lines of the log about a machine that is too busy."""
_LOOKS_FOR_LISTENERS: Final = 20.0
"""Hz: a look at each of three topics at 1 kHz takes 1 % of a core, and a listener is discovered in 80 to 240 ms."""


def valve_node(sections: Sequence[tuple[str, Section]]) -> ValveNode:
    """The node with the valve, or, where the parameter `plant` is given, with the machine of that file.

    Raises:
        ParameterError, PlantFileError: it cannot be made.
    """
    node = make_node("valve")
    name = node.get_fully_qualified_name()
    if node.has_parameter("plant"):
        place = sources_of(sections, name).get("plant", "command line")
        path = ValveSettings.rows()["plant"].check(node.get_parameter("plant").value, f"{place}: plant")
        if path:
            from valve_sim.nodes.live_plant import LivePlant, NodePlant

            plant = NodePlant(path)
            return ValveNode(node, sections, plant, plant.numbers, partial(LivePlant, plant))
    return ValveNode(node, sections, ValveSettings, partial(valve_of, source=name), LiveValve)


class ValveNode(RosNode[ValveSettings]):
    """The node `valve`, with those topics and services of `topics.VALVE` that its machine has.

    With gas also those of `topics.GAS`, from when it is declared. All parameters but `plant` can be set at run time.

    Args:
        node: the ROS node. sections: of the parameter files. table: of the parameters.
        machine_of: what is simulated, by the values of the table. made: the live machine of that.

    Raises:
        ParameterError: a parameter is unknown, of the wrong type or out of range.
    """

    def __init__(
        self, node: Node, sections: Sequence[tuple[str, Section]], table: Declares[ValveSettings],
        machine_of: Callable[[Mapping[str, Value]], Any], made: Callable[..., LiveMachine[Any]],
    ) -> None:  # fmt: skip
        super().__init__(node, sections, table, topics.VALVE)
        self._table, self._machine_of = table.table(), machine_of
        self._told, own = self._present_values(), self._settings
        self._live = live = made(
            machine_of(self._told), scale=own.time_scale, command_timeout=own.command_timeout,
            max_voltage=own.max_voltage,
        )  # fmt: skip
        self._inbox = Inbox(self._node, self._clock)
        self._failure, self._was_waiting = "", True
        self._said_open: bool | None = None
        joints = [joint for name, joint in JOINTS_OF.items() if name in live.shows]
        self._messages = ReadingMessages(own.frame_id, joints)
        interface = self._interface
        wanted = [
            ("~/joint_states", self._publish_joint_states, bool(joints)),
            ("~/coil", self._publish_coil, True),
            ("~/coil_current", self._publish_current, "current" in live.shows),
        ]
        self._samples = [(interface.publisher(name), publish) for name, publish, is_shown in wanted if is_shown]
        self._heard, self._looks = self._samples, Decimator(_LOOKS_FOR_LISTENERS)
        self._phase, self._is_open = (
            interface.publisher(f"~/{name}") if name in live.shows else None for name in ("phase", "is_open")
        )
        self._voltage = ObeyedTopic(
            self._node, self._clock, partial(interface.receive, self._inbox, "~/coil_voltage"), "data", "V",
            live.command, lambda: f"a number within ±{self._settings.max_voltage:g} V (parameter max_voltage)",
            "command",
        )  # fmt: skip
        self._gas: GasTopics | None = None
        self._wire_gas()
        self._node.add_pre_set_parameters_callback(guarded(self._complete))
        self._node.add_on_set_parameters_callback(guarded(self._validate))
        self._node.add_post_set_parameters_callback(guarded(self._apply))
        interface.serve("~/reset", self._reset)
        interface.serve("~/self_test", self._self_test)
        self._publish_diagnostics(self._statuses)
        self._worker = Worker(
            self._clock, own.publish_rate, prepare=self._load, restart=self._restart, step=self._step, fail=self._fail
        )
        self._threads.append(self._worker)

    def _work(self) -> None:
        self._worker.start()
        super()._work()

    def _wire_gas(self) -> None:
        if self._gas is None and self._live.pressures():
            self._gas = GasTopics(self._node, self._inbox, self._clock, self._live, self._messages)

    # --- the stepping thread ---

    def _load(self) -> None:
        """Load the model, and log that the node is ready, with the full names of its topics."""
        self._live.prepare()
        self._warn()
        self._is_ready = True
        waits = "; waits for /clock, as use_sim_time is true" if self._clock.read() is None else ""
        limit, rate = self._settings.max_voltage, self._settings.publish_rate
        changing = [publisher for publisher in (self._phase, self._is_open) if publisher is not None]
        self._node.get_logger().info(
            f"ready: obeys {self._voltage.source.topic} (V, ±{limit:g} at most), publishes "
            f"{_listed([publisher for publisher, _ in self._samples])} at {rate:g} Hz"
            f"{f', {_listed(changing)} on change' if changing else ''}{self._gas.words() if self._gas else ''}{waits}"
        )

    def _warn(self) -> None:
        if words := self._live.warning():
            self._node.get_logger().warning(words)

    def _restart(self, restart: Restart) -> None:
        self._clock.was_set()
        if restart.reason:
            self._inbox.forget()
            self._node.get_logger().warning(f"{restart.reason}: {self._live.rests}, and no command holds any more")
        self._live.restart(restart.reading.nanoseconds, self._clock.stamp_at(restart.reading))

    def _follow_system_clock(self) -> None:
        """Have stamps follow the system's clock where that was set; elapsed time, and the machine, go on."""
        shift = 0 if self._clock.is_simulated else self._clock.was_set()
        if shift:
            self._live.shift_stamps(shift)
            self._node.get_logger().warning(
                f"the system's clock was set by {shift / NANOSECONDS:+.6f} s: stamps follow it, the machine goes on"
            )

    def _step(self, deadline: int) -> None:
        self._follow_system_clock()
        self._inbox.deliver()
        step = self._live.step(deadline)
        if self._looks.is_due(deadline):
            self._heard = [
                (publisher, publish) for publisher, publish in self._samples if publisher.get_subscription_count()
            ]
        for publisher, publish in self._heard:
            publish(publisher, step)
        if self._gas is not None:
            self._gas.publish(deadline, step)
        if step.phases:
            self._publish_phases(step.phases)
        if step.switched_off:
            self._say_switched_off(f"the coil was switched off: {step.switched_off}")
        if step.failure:
            self._failure = step.failure
            # A machine that fails at every step would fill the disk with a thousand lines a second.
            self._node.get_logger().error(f"it was put back to rest: {step.failure}", throttle_duration_sec=1.0)

    def _say_switched_off(self, words: str) -> None:
        if self._live.timed_out:  # by a commander, perhaps, that is always later than command_timeout
            self._node.get_logger().warning(words, throttle_duration_sec=BETWEEN_WARNINGS)
        else:
            self._node.get_logger().warning(words)

    def _publish_joint_states(self, publisher: Publisher, step: Step) -> None:
        publisher.publish(self._messages.joint_states(step.stamp, step.reading))

    def _publish_coil(self, publisher: Publisher, step: Step) -> None:
        for stamp, coil in step.switches:
            publisher.publish(self._messages.coil(stamp, coil.current, coil.voltage))
        publisher.publish(self._messages.coil(step.stamp, step.reading.coil_current, step.reading.coil_voltage))

    def _publish_current(self, publisher: Publisher, step: Step) -> None:
        publisher.publish(self._messages.number(step.reading.coil_current))

    def _publish_phases(self, phases: Sequence[int]) -> None:
        for phase in phases:
            if self._phase is not None:
                self._phase.publish(PHASE[phase])
            if self._is_open is not None and (is_open := phase == Phase.OPEN) is not self._said_open:
                self._said_open = is_open
                self._is_open.publish(IS_OPEN[is_open])

    # --- callbacks ---

    def _reset(self) -> tuple[bool, str]:
        self._inbox.deliver()  # what came before it
        self._live.reset(self._now())
        self._voltage.count.accept()
        self._failure = ""
        self._node.get_logger().info(f"reset: {self._live.rests}")
        return True, f"{self._live.rests}; the last command no longer holds"

    def _self_test(self) -> tuple[bool, str]:
        if not self._is_ready:
            return False, "the model is still being compiled; ask again in some seconds"
        return self._live.self_test()

    def _statuses(self) -> Iterator[Status]:
        now = self._now()
        waiting_for = self._waiting_for()
        kept = self._worker.timing.look(now)
        if self._was_waiting:
            kept = kept._replace(rate=math.nan)  # of a second during part of which it did not step
        self._was_waiting = bool(waiting_for)
        timing = timing_status(kept, self._settings.publish_rate, waiting_for)
        if self._is_ready and timing.level is Level.WARN:
            self._node.get_logger().warning(timing.message, throttle_duration_sec=BETWEEN_REMINDERS)
        yield timing
        yield command_status(self._live, now, self._voltage.count, self._voltage.source.incompatible_publishers)
        yield valve_status(self._live, self._failure)
        if self._gas is not None:
            yield from self._gas.statuses(self._live.pressures())

    # --- parameters ---

    def _complete(self, parameters: list[Parameter]) -> list[Parameter]:
        """Turn integers into doubles, and add what follows."""
        if any(parameter.type_ is Parameter.Type.NOT_SET for parameter in parameters):
            return parameters  # which `_validate` refuses
        own = [parameter for parameter in parameters if parameter.name in self._table]
        given = {parameter.name: as_declared(parameter.name, parameter.value, self._table) for parameter in own}
        with contextlib.suppress(ParameterError):  # which `_validate` reports
            given = self._live.completed(given, self._present_values())
        others = [parameter for parameter in parameters if parameter not in own]
        return [*others, *(Parameter(name, value=value) for name, value in given.items())]

    def _validate(self, parameters: list[Parameter]) -> SetParametersResult:
        name = self._node.get_fully_qualified_name()
        given = {parameter.name: parameter.value for parameter in parameters if parameter.name in self._table}
        try:
            places = dict.fromkeys(given, name)
            values = check_given(given, self._table, places, ValveSettings.program, self._present_values())
            self._machine_of(values)
        except ParameterError as error:
            return SetParametersResult(successful=False, reason=str(error))
        return SetParametersResult(successful=True)

    def _apply(self, parameters: list[Parameter]) -> None:
        """Apply parameters that ROS has checked and stored."""
        names = {parameter.name for parameter in parameters} & self._table.keys()
        if not names:
            return
        values = self._present_values()
        if changes := changed_words(self._told, values):
            self._node.get_logger().info(f"set: {changes}")
        self._inbox.deliver()  # what came before they were set
        now, settings, self._told = self._now(), ValveSettings.of(values), values
        if settings.time_scale != self._settings.time_scale:
            self._live.set_scale(now, settings.time_scale)
        if settings.max_voltage != self._settings.max_voltage:
            self._live.limit(now, settings.max_voltage)
        self._live.command_timeout = settings.command_timeout
        self._messages.set_frame_id(settings.frame_id)
        self._worker.set_rate(settings.publish_rate)
        self._settings = settings
        if not names <= ValveSettings.rows().keys():
            self._live.go_on_as(now, self._machine_of(values))
            self._wire_gas()
            if self._is_ready:
                self._warn()

    def _present_values(self) -> dict[str, Value]:
        found = {}
        for name, entry in self._table.items():
            value = self._node.get_parameter(name).value
            found[name] = list(value) if isinstance(entry.default, list) else value
        return found


def _listed(publishers: Sequence[Publisher]) -> str:
    """The names of their topics, in words."""
    *others, last = (publisher.topic_name for publisher in publishers)
    return f"{', '.join(others)} and {last}" if others else str(last)
