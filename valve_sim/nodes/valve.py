"""The node `valve` with a valve: what it has beside the shell of `machine`. No physics, no decisions."""

from __future__ import annotations

import contextlib
import math
from collections.abc import Iterator, Mapping, Sequence
from functools import partial
from typing import Any, Final

from rclpy.node import Node
from rclpy.publisher import Publisher

from valve_sim.files.parameter_sections import Section
from valve_sim.model import ParameterError, Phase, Valve
from valve_sim.model.gas import GAS
from valve_sim.nodes import topics
from valve_sim.nodes.diagnostics import Status, pressure_status
from valve_sim.nodes.live_machine import Step
from valve_sim.nodes.live_valve import LiveValve, load_stepper, self_test
from valve_sim.nodes.machine import MachineNode, ObeyedTopic
from valve_sim.nodes.messages import IS_OPEN, JOINT_NAMES, ReadingMessages
from valve_sim.nodes.node_clock import NodeClock
from valve_sim.nodes.parameters import Value
from valve_sim.nodes.realtime import Decimator, SubscriberCounts
from valve_sim.nodes.receiving import Inbox
from valve_sim.nodes.valve_parameters import ValveSettings, valve_of, without_orphans
from valve_sim.nodes.wiring import Interface

_RATE: Final = 100.0
"""Hz of pressure and flow: slower than the plungers, and read by slower programs."""


class ValveNode(MachineNode[Valve, LiveValve]):
    """The node `valve`, with the topics and services `topics.VALVE`, and `topics.GAS` from when gas is declared.

    Parameters: `valve_parameters.ValveSettings`; all but `plant` can be set at run time.

    Raises:
        ParameterError: a parameter is unknown, of the wrong type or out of range.
    """

    rests = "the valve rests closed, without current"
    keys = ("valve.", "effects.", "gas.")

    def __init__(self, node: Node, sections: Sequence[tuple[str, Section]]) -> None:
        self._gas: GasTopics | None = None
        self._said_open: bool | None = None
        super().__init__(node, sections, ValveSettings, JOINT_NAMES, shows_current=True, shows_phase=True)
        self._is_open = self._interface.publisher("~/is_open")
        if self._live.valve.gas is not None:
            self._gas = self._wire_gas()

    def _made(self, machine: Valve, **options: float) -> LiveValve:
        return LiveValve(machine, **options)

    def _machine_of(self, values: Mapping[str, Value]) -> Valve:
        return valve_of(values, self._node.get_fully_qualified_name())

    def _wire_gas(self) -> GasTopics:
        return GasTopics(self._node, self._inbox, self._clock, self._live, self._messages)

    # --- the stepping thread ---

    def _prepare(self) -> None:
        valve = self._live.valve
        load_stepper(valve)
        self._warn_if_it_cannot_open(valve)

    def _more_words(self) -> str:
        return "" if self._gas is None else f"; {self._gas.words()}"

    def _on_change(self) -> list[Publisher]:
        return [*super()._on_change(), self._is_open]

    def _publish_more(self, deadline: int, step: Step) -> None:
        if self._gas is not None:
            self._gas.publish(deadline, step)

    def _publish_phases(self, step: Step) -> None:
        super()._publish_phases(step)
        for phase in step.phases:
            if (is_open := phase == Phase.OPEN) is not self._said_open:
                self._said_open = is_open
                self._is_open.publish(IS_OPEN[Phase(phase)])

    # --- callbacks ---

    def _self_test(self) -> tuple[bool, str]:
        if not self._is_ready:
            return False, "the model is still being compiled; ask again in some seconds"
        return self_test(self._live.valve)

    def _more_statuses(self) -> Iterator[Status]:
        if self._gas is not None:
            yield from self._gas.statuses()

    def _completed(self, given: dict[str, Any]) -> dict[str, Any]:
        """Drop the tolerances of effects that are switched off."""
        with contextlib.suppress(ParameterError):  # which `_validate` reports
            return without_orphans(given, self._present_values())
        return given

    def _go_on_as(self, now: int, machine: Valve) -> None:
        self._live.set_valve(now, machine)
        if machine.gas is not None and self._gas is None:
            self._gas = self._wire_gas()
        if self._is_ready:
            self._warn_if_it_cannot_open(machine)

    def _warn_if_it_cannot_open(self, valve: Valve) -> None:
        with contextlib.suppress(Exception):
            if not valve.can_open():
                self._node.get_logger().warning(
                    f"with these parameters the valve cannot open: at {valve.parameters.reference_voltage:g} V nothing "
                    "lifts the pilot plunger off its seat (look at valve.attraction_polynomial[0] and valve.seat_load)"
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
