"""The node `valve`: parameters, topics and services wired to a `LiveValve`. No physics, no decisions.

Threads: callbacks run in the main thread, and only store (parameters, resets, and what an `Inbox` receives). One
`Worker` thread loads the model, then empties the inbox, steps the valve and publishes; it consumes what was stored,
each at its own time.
"""

from __future__ import annotations

import contextlib
import math
from collections.abc import Callable, Iterator, Sequence
from functools import partial
from typing import Any, Final

from rcl_interfaces.msg import SetParametersResult
from rclpy.node import Node
from rclpy.parameter import Parameter

from valve_sim.files.parameter_sections import Section
from valve_sim.model import ParameterError, Phase, Valve
from valve_sim.model.gas import GAS
from valve_sim.nodes import topics
from valve_sim.nodes.diagnostics import (
    Level,
    RejectionCount,
    Status,
    command_status,
    pressure_status,
    timing_status,
    valve_status,
)
from valve_sim.nodes.live_valve import LiveValve, Step, self_test
from valve_sim.nodes.messages import IS_OPEN, PHASE, ReadingMessages
from valve_sim.nodes.node_clock import NodeClock
from valve_sim.nodes.parameters import Value, as_declared, changed_words, check_given
from valve_sim.nodes.realtime import NANOSECONDS, Arrival, Decimator, Restart, SubscriberCounts, Worker
from valve_sim.nodes.receiving import Inbox, Source
from valve_sim.nodes.spinning import guarded
from valve_sim.nodes.threads import load_stepper
from valve_sim.nodes.valve_parameters import VALVE_KEYS, ValveSettings, valve_of, without_orphans
from valve_sim.nodes.wiring import Interface, RosNode

BETWEEN_WARNINGS: Final = 5.0
"""s between lines of the log about the same problem, which may occur a thousand times a second."""
BETWEEN_REMINDERS: Final = 60.0
"""s between lines of the log about a machine that is too busy."""


_RATE: Final = 100.0
"""Hz of pressure and flow: slower than the plungers, and read by slower programs."""


class ValveNode(RosNode[ValveSettings]):
    """The node `valve`, with the topics and services `topics.VALVE`, and `topics.GAS` from when gas is declared.

    Parameters: `valve_parameters.ValveSettings`; all can be set at run time.

    Raises:
        ParameterError: a parameter is unknown, of the wrong type or out of range.
    """

    def __init__(self, sections: Sequence[tuple[str, Section]]) -> None:
        super().__init__("valve", sections, ValveSettings, topics.VALVE)
        self._table = ValveSettings.table()
        self._told = self._present_values()
        self._live = LiveValve(
            self._current_valve(),
            scale=self._settings.time_scale,
            command_timeout=self._settings.command_timeout,
            max_voltage=self._settings.max_voltage,
        )
        self._inbox = Inbox(self._node, self._clock)
        self._gas: GasTopics | None = None
        self._failure = ""
        self._is_ready = False
        self._was_waiting = True
        self._said_open: bool | None = None
        self._messages = ReadingMessages(self._settings.frame_id)
        self._wire()
        self._worker = Worker(
            self._clock,
            self._settings.publish_rate,
            prepare=self._load,
            restart=self._restart,
            step=self._step,
            fail=self._fail,
        )
        self._threads.append(self._worker)

    def spin(self) -> None:
        """Run until ROS is shut down."""
        self._worker.start()
        super().spin()

    # --- wiring ---

    def _wire(self) -> None:
        self._node.add_pre_set_parameters_callback(guarded(self._complete))
        self._node.add_on_set_parameters_callback(guarded(self._validate))
        self._node.add_post_set_parameters_callback(guarded(self._apply))
        interface = self._interface
        self._joint_states = interface.publisher("~/joint_states")
        self._coil = interface.publisher("~/coil")
        self._coil_current = interface.publisher("~/coil_current")
        sampled = (self._joint_states, self._coil, self._coil_current)
        self._subscribers = SubscriberCounts(*(publisher.get_subscription_count for publisher in sampled))
        self._phase = interface.publisher("~/phase")
        self._is_open = interface.publisher("~/is_open")
        self._voltage = ObeyedTopic(
            self._node, self._clock, partial(interface.receive, self._inbox, "~/coil_voltage"), "data", "V",
            self._live.command, self._expected_voltage, "command",
        )  # fmt: skip
        if self._live.valve.gas is not None:
            self._gas = self._wire_gas()
        interface.serve("~/reset", self._reset)
        interface.serve("~/self_test", self._self_test)
        self._publish_diagnostics(self._statuses)

    def _wire_gas(self) -> GasTopics:
        return GasTopics(self._node, self._inbox, self._clock, self._live, self._messages)

    # --- the stepping thread ---

    def _load(self) -> None:
        valve = self._live.valve
        load_stepper(valve)
        self._warn_if_it_cannot_open(valve)
        self._is_ready = True
        if self._node.context.ok():
            self._say_ready()

    def _say_ready(self) -> None:
        """Log that the node is ready, with the full names of its topics."""
        waits = "; waits for /clock, as use_sim_time is true" if self._clock.read() is None else ""
        limit, rate = self._settings.max_voltage, self._settings.publish_rate
        gas = "" if self._gas is None else f"; {self._gas.words()}"
        self._node.get_logger().info(
            f"ready: obeys {self._voltage.source.topic} (V, ±{limit:g} at most), publishes "
            f"{self._joint_states.topic_name}, {self._coil.topic_name} and {self._coil_current.topic_name} "
            f"at {rate:g} Hz, "
            f"{self._phase.topic_name} and {self._is_open.topic_name} on change{gas}{waits}"
        )

    def _restart(self, restart: Restart) -> None:
        self._clock.was_set()
        if restart.reason:
            self._inbox.forget()
            self._node.get_logger().warning(f"{restart.reason}: the valve rests closed, and no command holds any more")
        self._live.restart(restart.reading.nanoseconds, self._clock.stamp_at(restart.reading))

    def _follow_system_clock(self) -> None:
        """Have stamps follow the system's clock where that was set; elapsed time, and the valve, go on."""
        shift = 0 if self._clock.is_simulated else self._clock.was_set()
        if shift:
            self._live.shift_stamps(shift)
            self._node.get_logger().warning(
                f"the system's clock was set by {shift / NANOSECONDS:+.6f} s: stamps follow it, the valve goes on"
            )

    def _step(self, deadline: int) -> None:
        live, gas = self._live, self._gas
        self._follow_system_clock()
        self._inbox.deliver()
        step = live.step(deadline)
        self._publish_sample(deadline, step)
        if gas is not None:
            gas.publish(deadline, step)
        if step.phases:
            self._publish_phases(step)
        if step.switched_off:
            self._say_switched_off(step.switched_off)
        if step.failure:
            self._failure = step.failure
            # A valve that fails at every step would fill the disk with a thousand lines a second.
            self._node.get_logger().error(f"the valve was put back to rest: {step.failure}", throttle_duration_sec=1.0)

    def _say_switched_off(self, why: str) -> None:
        words = f"the coil was switched off: {why}"
        if self._live.timed_out:
            # A commander that is always later than command_timeout would fill the disk.
            self._node.get_logger().warning(words, throttle_duration_sec=BETWEEN_WARNINGS)
        else:
            self._node.get_logger().warning(words)

    def _publish_sample(self, deadline: int, step: Step) -> None:
        shown = step.reading
        hears_joint_states, hears_coil, hears_coil_current = self._subscribers.look(deadline)
        if hears_joint_states:
            self._joint_states.publish(self._messages.joint_states(step.stamp, shown))
        if hears_coil:
            for stamp, coil in step.switches:
                self._coil.publish(self._messages.coil(stamp, coil.current, coil.voltage))
            self._coil.publish(self._messages.coil(step.stamp, shown.coil_current, shown.coil_voltage))
        if hears_coil_current:
            self._coil_current.publish(self._messages.number(shown.coil_current))

    def _publish_phases(self, step: Step) -> None:
        for phase in step.phases:
            self._phase.publish(PHASE[phase])
            if (is_open := phase is Phase.OPEN) is not self._said_open:
                self._said_open = is_open
                self._is_open.publish(IS_OPEN[phase])

    def _expected_voltage(self) -> str:
        return f"a number within ±{self._settings.max_voltage:g} V (parameter max_voltage)"

    # --- callbacks, in the main thread ---

    def _reset(self) -> tuple[bool, str]:
        self._inbox.deliver()  # what came before it
        self._live.reset(self._now())
        self._voltage.count.accept()
        self._failure = ""
        self._node.get_logger().info("reset: the valve rests closed, without current")
        return True, "the valve rests closed, without current; the last command no longer holds"

    def _self_test(self) -> tuple[bool, str]:
        if not self._is_ready:
            return False, "the model is still being compiled; ask again in some seconds"
        return self_test(self._live.valve)

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
        if self._gas is not None:
            yield from self._gas.statuses()

    # --- parameters ---

    def _complete(self, parameters: list[Parameter]) -> list[Parameter]:
        """Turn integers into doubles, and drop the tolerances of effects that are switched off."""
        if any(parameter.type_ is Parameter.Type.NOT_SET for parameter in parameters):
            return parameters  # which `_validate` refuses
        own = [parameter for parameter in parameters if parameter.name in self._table]
        given = {parameter.name: as_declared(parameter.name, parameter.value, self._table) for parameter in own}
        with contextlib.suppress(ParameterError):  # which `_validate` reports
            given = without_orphans(given, self._present_values())
        others = [parameter for parameter in parameters if parameter not in own]
        return [*others, *(Parameter(name, value=value) for name, value in given.items())]

    def _validate(self, parameters: list[Parameter]) -> SetParametersResult:
        name = self._node.get_fully_qualified_name()
        given = {parameter.name: parameter.value for parameter in parameters if parameter.name in self._table}
        try:
            places = dict.fromkeys(given, name)
            valve_of(check_given(given, self._table, places, ValveSettings.program, self._present_values()), name)
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
        if any(name.startswith(VALVE_KEYS) and not name.startswith("tolerances.") for name in names):
            valve = self._current_valve()
            self._live.set_valve(now, valve)
            if valve.gas is not None and self._gas is None:
                self._gas = self._wire_gas()
            if self._is_ready:
                self._warn_if_it_cannot_open(valve)

    def _present_values(self) -> dict[str, Value]:
        found = {}
        for name, entry in self._table.items():
            value = self._node.get_parameter(name).value
            found[name] = list(value) if isinstance(entry.default, list) else value
        return found

    def _current_valve(self) -> Valve:
        return valve_of(self._present_values(), self._node.get_fully_qualified_name())

    def _warn_if_it_cannot_open(self, valve: Valve) -> None:
        with contextlib.suppress(Exception):
            if not valve.can_open():
                self._node.get_logger().warning(
                    f"with these parameters the valve cannot open: at {valve.parameters.reference_voltage:g} V nothing "
                    "lifts the pilot plunger off its seat (look at valve.attraction_polynomial[0] and valve.seat_load)"
                )


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


class GasTopics:
    """The topics of a valve with gas."""

    def __init__(self, node: Node, inbox: Inbox, clock: NodeClock, live: LiveValve, messages: ReadingMessages) -> None:
        self._live, self._messages = live, messages
        interface = Interface(node, topics.GAS)

        def obeyed(name: str) -> ObeyedTopic:
            receive, rule = partial(interface.receive, inbox, f"~/{name}"), GAS[name]
            expected, obey = f"a number from {rule.lower:g} to {rule.upper:g} Pa", partial(live.set_pressure, name)
            return ObeyedTopic(node, clock, receive, "fluid_pressure", "Pa", obey, lambda: expected, "pressure")

        self._heard = {name: obeyed(name) for name in topics.ENDS}
        self._outlet_pressure = interface.publisher("~/outlet_pressure")
        self._mass_flow = interface.publisher("~/mass_flow")
        self._obeyed = {name: interface.publisher(f"~/obeyed/{name}") for name in topics.ENDS}
        self._subscribers = SubscriberCounts(
            self._outlet_pressure.get_subscription_count, self._mass_flow.get_subscription_count
        )
        self._samples = Decimator(_RATE)

    def words(self) -> str:
        """What is obeyed and published, with full names."""
        obeyed = " and ".join(heard.source.topic for heard in self._heard.values())
        return (
            f"gas: obeys {obeyed} (Pa), publishes {self._outlet_pressure.topic_name} and "
            f"{self._mass_flow.topic_name} at {_RATE:g} Hz"
        )

    def publish(self, deadline: int, step: Step) -> None:
        """Publish the pressures obeyed since the last step, and this one if it is one of the slower samples.

        In the stepping thread.
        """
        for name, stamp, pressure in step.obeyed:
            self._obeyed[name].publish(self._messages.pressure(stamp, pressure))
        if not self._samples.is_due(deadline) or math.isnan(step.reading.outlet_pressure):
            return
        hears_outlet_pressure, hears_mass_flow = self._subscribers.look(deadline)
        if hears_outlet_pressure:
            self._outlet_pressure.publish(self._messages.pressure(step.stamp, step.reading.outlet_pressure))
        if hears_mass_flow:
            self._mass_flow.publish(self._messages.number(step.reading.mass_flow))

    def statuses(self) -> Iterator[Status]:
        """For /diagnostics; none while the valve has no gas."""
        if self._live.valve.gas is None:
            return
        for name, heard in self._heard.items():
            task, pressure = name.replace("_", " "), self._live.pressure(name)
            yield pressure_status(task, pressure, heard.count, heard.source.incompatible_publishers)
