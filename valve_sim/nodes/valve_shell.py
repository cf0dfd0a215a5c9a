"""The ROS side of valve_node: parameters, topics and services wired to a `LiveValve`. No physics, no decisions.

Threads: callbacks run in the main thread, in a `SingleThreadedExecutor`, and only store (parameters, resets, and what
an `Inbox` receives). One `Worker` thread empties the inbox, steps the valve and publishes; it consumes what was stored,
each at its own time.
Until a `ModelLoader` thread has the model ready, it publishes that the valve rests, and from a request on it waits.
"""

from __future__ import annotations

import contextlib
import math
from collections.abc import Sequence

from diagnostic_msgs.msg import DiagnosticArray
from rcl_interfaces.msg import SetParametersResult
from rclpy.clock import Clock
from rclpy.clock_type import ClockType
from rclpy.parameter import Parameter
from sensor_msgs.msg import BatteryState, JointState
from std_msgs.msg import Bool, Float64, UInt8
from std_srvs.srv import Trigger

from valve_sim.files.parameter_files import default_valve
from valve_sim.files.parameter_sections import Section
from valve_sim.model import ParameterError, Phase, Valve
from valve_sim.nodes.diagnostics import (
    CommandCount,
    Level,
    Reminder,
    ValveFacts,
    command_status,
    timing_status,
    valve_status,
)
from valve_sim.nodes.duplicate_nodes import DuplicateNodes
from valve_sim.nodes.gas_topics import BETWEEN_WARNINGS, GasTopics
from valve_sim.nodes.live_valve import LiveValve, Step, self_test
from valve_sim.nodes.loading import ModelLoader, load_stepper
from valve_sim.nodes.messages import (
    IS_OPEN,
    PHASE,
    ReadingMessages,
    SampleImage,
    descriptor,
    diagnostic_array,
)
from valve_sim.nodes.node_clock import NodeClock
from valve_sim.nodes.parameters import (
    Settings,
    Value,
    as_declared,
    changed_words,
    check_overrides,
    left_without_effect,
    settings_of,
    sources_of,
    table,
    valve_of,
)
from valve_sim.nodes.realtime import NANOSECONDS, Arrival, Audience, Restart, Worker
from valve_sim.nodes.receiving import Inbox
from valve_sim.nodes.shell_parts import (
    LATCHED,
    RELIABLE,
    declare,
    given_parameters,
    make_node,
)
from valve_sim.nodes.spinning import guarded, spin


class ValveShell:
    """The node `valve`.

    Topics (docs/reference/topics.md): in ~/coil_voltage; out ~/joint_states, ~/coil and ~/coil_current at publish_rate,
    ~/phase and ~/is_open on change (latched), /diagnostics at 1 Hz; from when gas is declared also those of
    `GasTopics`. Services: ~/reset (rests closed, no current, no command), ~/self_test (one stroke of a copy of the
    valve, off line). Parameters: the table of `valve_sim.nodes.parameters`; all can be set at run time.

    Args:
        sections: (file, section) of the parameter files on the command line.

    Raises:
        ParameterError: an override is unknown, of the wrong type or out of range.
    """

    def __init__(self, sections: Sequence[tuple[str, Section]]) -> None:
        self._node = make_node("valve")
        try:
            self._entries = table(default_valve())
            self._settings = self._declare(sections)
            self._clock = NodeClock(self._node)
            self._live = LiveValve(
                self._current_valve(),
                scale=self._settings.time_scale,
                command_timeout=self._settings.command_timeout,
                max_voltage=self._settings.max_voltage,
            )
            self._inbox = Inbox(self._node, self._clock)
            self._commands = CommandCount()
            self._gas: GasTopics | None = None
            self._duplicates = DuplicateNodes(self._node)
            self._failure = ""
            self._exit_code = 0
            self._is_ready = False
            self._was_waiting = True
            self._said_open: bool | None = None
            self._messages = ReadingMessages(self._settings.frame_id)
            self._image = self._messages.image()
            self._wire()
        except BaseException:
            self._node.destroy_node()
            raise
        self._worker = Worker(
            self._clock,
            self._settings.publish_rate,
            prepare=self._wait_unless_at_rest,
            restart=self._restart,
            step=self._step,
            fail=self._fail,
            may_step=self._may_step,
        )
        self._loader = ModelLoader(self._load, self._fail)

    @property
    def exit_code(self) -> int:
        """0, or 1 if the stepper failed."""
        return self._exit_code

    def spin(self) -> None:
        """Run until ROS is shut down."""
        for thread in (self._loader, self._worker):
            thread.start()
        spin(self._node)

    def close(self, timeout: float) -> bool:
        """Stop and release everything; whether all threads have ended. The loader cannot while it compiles."""
        # Whoever publishes must have ended before the node is destroyed; the loader does not.
        are_silent = self._worker.stop(timeout)
        is_loaded = self._loader.stop(timeout)
        if are_silent:
            self._node.destroy_node()
        return are_silent and is_loaded

    # --- wiring ---

    def _declare(self, sections: Sequence[tuple[str, Section]]) -> Settings:
        node, name = self._node, self._node.get_fully_qualified_name()
        given = given_parameters(node, sections)
        values = check_overrides(given, self._entries, sources_of(sections, name))
        for key, entry in self._entries.items():
            declare(node, key, values[key], descriptor(entry))
        self._told = self._values()
        node.add_pre_set_parameters_callback(guarded(self._complete))
        node.add_on_set_parameters_callback(guarded(self._validate))
        node.add_post_set_parameters_callback(guarded(self._apply))
        return settings_of(values)

    def _wire(self) -> None:
        node = self._node
        self._joint_states = node.create_publisher(JointState, "~/joint_states", RELIABLE)
        self._coil = node.create_publisher(BatteryState, "~/coil", RELIABLE)
        self._coil_current = node.create_publisher(Float64, "~/coil_current", RELIABLE)
        sampled = (self._joint_states, self._coil, self._coil_current)
        self._audience = Audience(*(publisher.get_subscription_count for publisher in sampled))
        self._phase = node.create_publisher(UInt8, "~/phase", LATCHED)
        self._is_open = node.create_publisher(Bool, "~/is_open", LATCHED)
        self._diagnostics = node.create_publisher(DiagnosticArray, "/diagnostics", RELIABLE)
        self._voltage = self._inbox.subscribe(Float64, "~/coil_voltage", self._take_command, RELIABLE)
        if self._live.valve.gas is not None:
            self._gas = self._wire_gas()
        node.create_service(Trigger, "~/reset", guarded(self._reset))
        node.create_service(Trigger, "~/self_test", guarded(self._self_test))
        # Wall time: diagnostics must also report that /clock is silent.
        self._steady = Clock(clock_type=ClockType.STEADY_TIME)
        self._too_busy = Reminder()
        node.create_timer(1.0, guarded(self._diagnose), clock=self._steady)

    def _wire_gas(self) -> GasTopics:
        return GasTopics(self._node, self._inbox, self._clock, self._live, self._messages)

    # --- the loading thread ---

    def _load(self) -> None:
        valve = self._live.valve
        load_stepper(valve)
        self._warn_if_it_cannot_open(valve)
        self._is_ready = True
        self._worker.may_always_step()
        self._say_ready()

    def _say_ready(self) -> None:
        """Log that the node is ready, with the full names of its topics."""
        waits = "; waits for /clock, as use_sim_time is true" if self._clock.read() is None else ""
        limit, rate = self._settings.max_voltage, self._settings.publish_rate
        gas = "" if self._gas is None else f"; {self._gas.words()}"
        self._node.get_logger().info(
            f"ready: obeys {self._voltage.topic} (V, ±{limit:g} at most), publishes "
            f"{self._joint_states.topic_name}, {self._coil.topic_name} and {self._coil_current.topic_name} "
            f"at {rate:g} Hz, "
            f"{self._phase.topic_name} and {self._is_open.topic_name} on change{gas}{waits}"
        )

    # --- the stepping thread ---

    def _wait_unless_at_rest(self) -> None:
        if not self._live.can_rest:
            self._loader.join()

    def _may_step(self, until: int) -> bool:
        self._inbox.deliver()
        return self._live.rests_until(until)

    def _restart(self, restart: Restart) -> None:
        self._clock.was_set()
        if restart.reason:
            self._inbox.forget()
        if restart.reason:
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
        live, shown, gas = self._live, self._image, self._gas
        self._follow_system_clock()
        self._inbox.deliver()
        is_of_gas = gas is not None and gas.is_due(deadline)
        if self._is_ready and not is_of_gas and live.passes(shown.image, deadline):
            self._publish_image(deadline, shown)
            return
        step = live.step(deadline) if self._is_ready else live.step_at_rest(deadline)
        self._publish_sample(deadline, step)
        if gas is not None:
            gas.publish(deadline, step, is_due=is_of_gas)
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

    def _publish_image(self, deadline: int, shown: SampleImage) -> None:
        hears_joint_states, hears_coil, hears_coil_current = self._audience.look(deadline)
        if hears_joint_states:
            self._joint_states.publish(shown.joint_states.tobytes())
        if hears_coil:
            self._coil.publish(shown.coil.tobytes())
        if hears_coil_current:
            self._coil_current.publish(shown.coil_current.tobytes())

    def _publish_sample(self, deadline: int, step: Step) -> None:
        shown = step.reading
        hears_joint_states, hears_coil, hears_coil_current = self._audience.look(deadline)
        if hears_joint_states:
            self._joint_states.publish(self._messages.joint_states(step.stamp, shown))
        if hears_coil:
            for stamp, coil in step.switches:
                self._coil.publish(self._messages.coil(stamp, coil.current, coil.voltage))
            self._coil.publish(self._messages.coil(step.stamp, shown.coil_current, shown.coil_voltage))
        if hears_coil_current:
            self._coil_current.publish(self._messages.coil_current(shown))

    def _publish_phases(self, step: Step) -> None:
        for phase in step.phases:
            self._phase.publish(PHASE[phase])
            if (is_open := phase is Phase.OPEN) is not self._said_open:
                self._said_open = is_open
                self._is_open.publish(IS_OPEN[phase])

    def _fail(self, error: Exception) -> None:
        if self._node.context.ok():
            self._exit_code = 1
            self._node.get_logger().fatal(f"the node cannot go on: {error!r}")
            self._node.context.try_shutdown()

    def _take_command(self, message: Float64, arrival: Arrival) -> None:
        if self._live.command(self._clock.time_of(arrival), message.data):
            self._commands.accept()
            return
        self._commands.reject(message.data)
        limit = self._settings.max_voltage
        self._node.get_logger().warning(
            f"{self._voltage.topic}: {message.data:g} V is ignored, expected a number within ±{limit:g} V "
            "(parameter max_voltage); the last good command stays",
            throttle_duration_sec=BETWEEN_WARNINGS,
        )

    # --- callbacks, in the main thread ---

    def _now(self) -> int:
        reading = self._clock.read()
        return 0 if reading is None else reading.nanoseconds

    def _reset(self, request: Trigger.Request, response: Trigger.Response) -> Trigger.Response:
        self._inbox.deliver()  # what came before it
        self._live.reset(self._now())
        self._commands.accept()
        self._failure = ""
        self._node.get_logger().info("reset: the valve rests closed, without current")
        response.success = True
        response.message = "the valve rests closed, without current; the last command no longer holds"
        return response

    def _self_test(self, request: Trigger.Request, response: Trigger.Response) -> Trigger.Response:
        if not self._is_ready:
            response.success, response.message = False, "the model is still being compiled; ask again in some seconds"
            return response
        response.success, response.message = self_test(self._live.valve)
        return response

    def _diagnose(self) -> None:
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
            line = self._too_busy.line(self._steady.now().nanoseconds / NANOSECONDS, timing.message)
            if line:
                self._node.get_logger().warning(line)
        statuses = [
            timing,
            command_status(
                self._commands.look(
                    now,
                    live.last_command,
                    live.volts,
                    live.timed_out,
                    live.withdrawn,
                    self._voltage.incompatible_publishers(),
                )
            ),
            valve_status(ValveFacts(live.phase, live.strokes, live.failures, self._failure, self._duplicates.look())),
        ]
        if self._gas is not None:
            statuses += self._gas.statuses()
        name = self._node.get_fully_qualified_name()
        self._diagnostics.publish(diagnostic_array(statuses, name, self._clock.stamp()))

    # --- parameters ---

    def _complete(self, parameters: list[Parameter]) -> list[Parameter]:
        """Turn integers into doubles; switch off the tolerances of an effect that is switched off."""
        given = [
            Parameter(parameter.name, value=as_declared(parameter.name, parameter.value, self._entries))
            if parameter.name in self._entries and parameter.type_ is not Parameter.Type.NOT_SET
            else parameter
            for parameter in parameters
        ]
        with contextlib.suppress(ParameterError):  # which `_validate` reports
            changes = self._checked(given, "")
            given += [Parameter(name, value=0.0) for name in left_without_effect(changes, self._values())]
        return given

    def _validate(self, parameters: list[Parameter]) -> SetParametersResult:
        name = self._node.get_fully_qualified_name()
        try:
            changes = self._checked(parameters, name)
            valve_of({**self._values(), **changes}, name)
        except ParameterError as error:
            return SetParametersResult(successful=False, reason=str(error))
        return SetParametersResult(successful=True)

    def _apply(self, parameters: list[Parameter]) -> None:
        """Apply parameters that ROS has checked and stored."""
        names = {parameter.name for parameter in parameters} & self._entries.keys()
        if not names:
            return
        values = self._values()
        if changes := changed_words(self._told, values):
            self._node.get_logger().info(f"set: {changes}")
        self._inbox.deliver()  # what came before they were set
        now, settings, self._told = self._now(), settings_of(values), values
        if settings.time_scale != self._settings.time_scale:
            self._live.set_scale(now, settings.time_scale)
        if settings.max_voltage != self._settings.max_voltage:
            self._live.limit(now, settings.max_voltage)
        self._live.command_timeout = settings.command_timeout
        if settings.frame_id != self._settings.frame_id:
            self._messages.set_frame_id(settings.frame_id)
            self._image = self._messages.image()
        if settings.publish_rate != self._settings.publish_rate:
            self._worker.set_rate(settings.publish_rate)
        self._settings = settings
        if any(name.startswith(("valve.", "effects.", "gas.")) for name in names):
            valve = self._current_valve()
            self._live.set_valve(now, valve)
            if valve.gas is not None and self._gas is None:
                self._gas = self._wire_gas()
            if self._is_ready:
                self._warn_if_it_cannot_open(valve)

    def _checked(self, parameters: list[Parameter], source: str) -> dict[str, Value]:
        checked = {}
        for parameter in parameters:
            if parameter.name in self._entries:
                if parameter.type_ is Parameter.Type.NOT_SET:
                    raise ParameterError(f"{source}: {parameter.name}: cannot be undeclared")
                checked[parameter.name] = self._entries[parameter.name].check(parameter.value, source)
        return checked

    def _values(self) -> dict[str, Value]:
        found = {}
        for name, entry in self._entries.items():
            value = self._node.get_parameter(name).value
            found[name] = list(value) if isinstance(entry.default, list) else value
        return found

    def _current_valve(self) -> Valve:
        return valve_of(self._values(), self._node.get_fully_qualified_name())

    def _warn_if_it_cannot_open(self, valve: Valve) -> None:
        with contextlib.suppress(Exception):
            if not valve.can_open():
                self._node.get_logger().warning(
                    f"with these parameters the valve cannot open: at {valve.parameters.reference_voltage:g} V nothing "
                    "lifts the pilot plunger off its seat (look at valve.attraction_polynomial[0] and valve.seat_load)"
                )
