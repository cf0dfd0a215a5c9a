"""The shell of the node `valve`: parameters, topics and services wired to a live machine. No physics, no decisions.

Threads: callbacks only store (parameters, resets, and what an `Inbox` receives). One
`Worker` thread loads the model, then empties the inbox, steps the machine and publishes; it consumes what was stored,
each at its own time.
"""

from __future__ import annotations

import math
from abc import ABC, abstractmethod
from collections.abc import Callable, Iterator, Mapping, Sequence
from functools import partial
from typing import Any, ClassVar, Final, Generic, TypeVar

from rcl_interfaces.msg import SetParametersResult
from rclpy.node import Node
from rclpy.parameter import Parameter
from rclpy.publisher import Publisher

from valve_sim.files.parameter_sections import Section
from valve_sim.model import ParameterError
from valve_sim.nodes import topics
from valve_sim.nodes.diagnostics import Level, RejectionCount, Status, command_status, timing_status, valve_status
from valve_sim.nodes.live_machine import LiveMachine, Step
from valve_sim.nodes.messages import PHASE, ReadingMessages
from valve_sim.nodes.node_clock import NodeClock
from valve_sim.nodes.parameters import Declares, Value, as_declared, changed_words, check_given
from valve_sim.nodes.realtime import NANOSECONDS, Arrival, Restart, SubscriberCounts, Worker
from valve_sim.nodes.receiving import Inbox, Source
from valve_sim.nodes.spinning import guarded
from valve_sim.nodes.valve_parameters import ValveSettings
from valve_sim.nodes.wiring import RosNode

BETWEEN_WARNINGS: Final = 5.0
"""s between lines of the log about the same problem, which may occur a thousand times a second."""
BETWEEN_REMINDERS: Final = 60.0
"""s between lines of the log about a machine that is too busy."""
L = TypeVar("L", bound=LiveMachine[Any, Any])
M = TypeVar("M")
"""What is simulated: a valve, or the numbers of a machine of a file."""


class MachineNode(RosNode[ValveSettings], ABC, Generic[M, L]):
    """The node `valve`, with some of the topics and services `topics.VALVE`: what its machine shows.

    Args:
        node: the ROS node. sections: of the parameter files. table: of the parameters.
        joints: whose positions the machine shows, by their names in messages.
        shows_current, shows_phase: whether it shows these.

    Attributes:
        rests: what it does after a reset, in words.
        keys: what the names of those parameters begin with by which the machine moves.

    Raises:
        ParameterError: a parameter is unknown, of the wrong type or out of range.
    """

    rests: ClassVar[str]
    keys: ClassVar[tuple[str, ...]]

    def __init__(
        self, node: Node, sections: Sequence[tuple[str, Section]], table: Declares[ValveSettings],
        joints: Sequence[str], *, shows_current: bool, shows_phase: bool,
    ) -> None:  # fmt: skip
        super().__init__(node, sections, table, topics.VALVE)
        self._table = table.table()
        self._told = self._present_values()
        self._live = self._made(
            self._machine_of(self._told),
            scale=self._settings.time_scale,
            command_timeout=self._settings.command_timeout,
            max_voltage=self._settings.max_voltage,
        )
        self._inbox = Inbox(self._node, self._clock)
        self._failure = ""
        self._is_ready = False
        self._was_waiting = True
        self._messages = ReadingMessages(self._settings.frame_id, joints)
        self._samples: list[tuple[Publisher, Callable[[Publisher, Step], None]]] = []
        self._wire(has_positions=bool(joints), shows_current=shows_current)
        self._phase = self._interface.publisher("~/phase") if shows_phase else None
        self._worker = Worker(
            self._clock,
            self._settings.publish_rate,
            prepare=self._load,
            restart=self._restart,
            step=self._step,
            fail=self._fail,
        )
        self._threads.append(self._worker)

    def _work(self) -> None:
        self._worker.start()
        super()._work()

    # --- what is of one machine ---

    @abstractmethod
    def _made(self, machine: M, **options: float) -> L:
        """The live machine; `options` as of a `LiveMachine`."""

    @abstractmethod
    def _machine_of(self, values: Mapping[str, Value]) -> M:
        """What the values of the table describe.

        Raises:
            ParameterError: they describe nothing that can be.
        """

    @abstractmethod
    def _go_on_as(self, now: int, machine: M) -> None:
        """Have the live machine be another from a time on, ns."""

    @abstractmethod
    def _prepare(self) -> None:
        """Have every function at hand by which the machine is stepped; in the stepping thread."""

    @abstractmethod
    def _self_test(self) -> tuple[bool, str]:
        """The answer of ~/self_test."""

    def _completed(self, given: dict[str, Any]) -> dict[str, Any]:
        """Parameters that are about to be set, and others that follow from them."""
        return given

    def _on_change(self) -> list[Publisher]:
        """What is published whenever it changes."""
        return [] if self._phase is None else [self._phase]

    def _publish_more(self, deadline: int, step: Step) -> None:
        """Publish what only this machine shows of a step."""

    def _publish_phases(self, step: Step) -> None:
        if self._phase is not None:
            for phase in step.phases:
                self._phase.publish(PHASE[phase])

    def _more_words(self) -> str:
        """What else is obeyed and published, for the log."""
        return ""

    def _more_statuses(self) -> Iterator[Status]:
        yield from ()

    # --- wiring ---

    def _wire(self, *, has_positions: bool, shows_current: bool) -> None:
        self._node.add_pre_set_parameters_callback(guarded(self._complete))
        self._node.add_on_set_parameters_callback(guarded(self._validate))
        self._node.add_post_set_parameters_callback(guarded(self._apply))
        interface = self._interface
        if has_positions:
            self._samples.append((interface.publisher("~/joint_states"), self._publish_joint_states))
        self._samples.append((interface.publisher("~/coil"), self._publish_coil))
        if shows_current:
            self._samples.append((interface.publisher("~/coil_current"), self._publish_current))
        self._subscribers = SubscriberCounts(*(publisher.get_subscription_count for publisher, _ in self._samples))
        self._voltage = ObeyedTopic(
            self._node, self._clock, partial(interface.receive, self._inbox, "~/coil_voltage"), "data", "V",
            self._live.command, self._expected_voltage, "command",
        )  # fmt: skip
        interface.serve("~/reset", self._reset)
        interface.serve("~/self_test", self._self_test)
        self._publish_diagnostics(self._statuses)

    # --- the stepping thread ---

    def _load(self) -> None:
        self._prepare()
        self._is_ready = True
        if self._node.context.ok():
            self._say_ready()

    def _say_ready(self) -> None:
        """Log that the node is ready, with the full names of its topics."""
        waits = "; waits for /clock, as use_sim_time is true" if self._clock.read() is None else ""
        limit, rate = self._settings.max_voltage, self._settings.publish_rate
        sampled = _listed([publisher for publisher, _ in self._samples])
        changing = f", {_listed(found)} on change" if (found := self._on_change()) else ""
        self._node.get_logger().info(
            f"ready: obeys {self._voltage.source.topic} (V, ±{limit:g} at most), publishes {sampled} at {rate:g} Hz"
            f"{changing}{self._more_words()}{waits}"
        )

    def _restart(self, restart: Restart) -> None:
        self._clock.was_set()
        if restart.reason:
            self._inbox.forget()
            self._node.get_logger().warning(f"{restart.reason}: {self.rests}, and no command holds any more")
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
        for is_heard, (publisher, publish) in zip(self._subscribers.look(deadline), self._samples, strict=True):
            if is_heard:
                publish(publisher, step)
        self._publish_more(deadline, step)
        if step.phases:
            self._publish_phases(step)
        if step.switched_off:
            self._say_switched_off(step.switched_off)
        if step.failure:
            self._failure = step.failure
            # A machine that fails at every step would fill the disk with a thousand lines a second.
            self._node.get_logger().error(f"it was put back to rest: {step.failure}", throttle_duration_sec=1.0)

    def _say_switched_off(self, why: str) -> None:
        words = f"the coil was switched off: {why}"
        if self._live.timed_out:
            # A commander that is always later than command_timeout would fill the disk.
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

    def _expected_voltage(self) -> str:
        return f"a number within ±{self._settings.max_voltage:g} V (parameter max_voltage)"

    # --- callbacks ---

    def _reset(self) -> tuple[bool, str]:
        self._inbox.deliver()  # what came before it
        self._live.reset(self._now())
        self._voltage.count.accept()
        self._failure = ""
        self._node.get_logger().info(f"reset: {self.rests}")
        return True, f"{self.rests}; the last command no longer holds"

    def _statuses(self) -> Iterator[Status]:
        now = self._now()
        waiting_for = "" if self._is_ready else "the model to be compiled"
        if self._is_ready and self._clock.read() is None:
            waiting_for = "/clock (use_sim_time is true)"
        live = self._live
        kept = self._worker.timing.look(now)
        if self._was_waiting:
            kept = kept._replace(rate=math.nan)  # of a second during part of which it did not step
        self._was_waiting = bool(waiting_for)
        timing = timing_status(kept, self._settings.publish_rate, waiting_for)
        if self._is_ready and timing.level is Level.WARN:
            self._node.get_logger().warning(timing.message, throttle_duration_sec=BETWEEN_REMINDERS)
        yield timing
        heard = self._voltage
        yield command_status(live, now, heard.count, heard.source.incompatible_publishers)
        yield valve_status(live, self._failure)
        yield from self._more_statuses()

    # --- parameters ---

    def _complete(self, parameters: list[Parameter]) -> list[Parameter]:
        """Turn integers into doubles, and add what follows."""
        if any(parameter.type_ is Parameter.Type.NOT_SET for parameter in parameters):
            return parameters  # which `_validate` refuses
        own = [parameter for parameter in parameters if parameter.name in self._table]
        given = {parameter.name: as_declared(parameter.name, parameter.value, self._table) for parameter in own}
        others = [parameter for parameter in parameters if parameter not in own]
        return [*others, *(Parameter(name, value=value) for name, value in self._completed(given).items())]

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
        if settings.frame_id != self._settings.frame_id:
            self._messages.set_frame_id(settings.frame_id)
        if settings.publish_rate != self._settings.publish_rate:
            self._worker.set_rate(settings.publish_rate)
        self._settings = settings
        if any(name.startswith(self.keys) for name in names):
            self._go_on_as(now, self._machine_of(values))

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


class ObeyedTopic:
    """A topic each of whose numbers is obeyed from when it came, or else ignored, counted and warned of.

    `receive` subscribes, and is handed what takes each message. `field` of a message holds the number, in `unit`.
    `obey` is called with the time, ns of the clock, and the number; whether it is obeyed.
    """

    def __init__(
        self,
        node: Node,
        clock: NodeClock,
        receive: Callable[[Callable[[Any, Arrival], None]], Source],
        field: str,
        unit: str,
        obey: Callable[[int, float], bool],
        expected: Callable[[], str],
        what: str,
    ) -> None:
        self.count = RejectionCount()
        self.source = receive(self._take)
        self._node, self._clock, self._obey = node, clock, obey
        self._field, self._unit, self._expected, self._what = field, unit, expected, what
        self._warned_at = -math.inf

    def _take(self, message: Any, arrival: Arrival) -> None:
        value = getattr(message, self._field)
        if self._obey(self._clock.time_of(arrival), value):
            self.count.accept()
            return
        self.count.reject(value)
        # ROS's own throttle counts by the place in the source, which several topics share.
        now = self._clock.elapsed()
        if now - self._warned_at >= BETWEEN_WARNINGS:
            self._warned_at = now
            self._node.get_logger().warning(
                f"{self.source.topic}: {value:g} {self._unit} is ignored, expected {self._expected()}; the last good "
                f"{self._what} stays"
            )
