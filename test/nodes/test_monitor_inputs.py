"""In which order monitor_node takes what waits for it, on queues in place of a middleware's."""

from __future__ import annotations

from collections import deque
from types import SimpleNamespace
from typing import Any

import pytest

from nodes.ros import BatteryState, Float64, FluidPressure, JointState
from valve_sim.nodes.monitor_inputs import MonitorInputs
from valve_sim.nodes.monitor_work import InputCount, StampCheck
from valve_sim.nodes.realtime import Arrival, ClockReading

pytestmark = pytest.mark.ros


ENDS = ("inlet_pressure", "demand_pressure")


class Queue:
    """A subscription; its own handle, too."""

    def __init__(self, message_type: type, topic: str, qos: Any) -> None:
        self.msg_type, self.topic_name, self.qos_profile = message_type, topic, qos
        self.handle, self._waiting = self, deque[tuple[Any, dict[str, int]]]()

    def put(self, message: Any) -> None:
        self._waiting.append((message, {"received_timestamp": 77}))

    def take_message(self, message_type: type, raw: bool) -> Any:
        return self._waiting.popleft() if self._waiting else None


class Node:
    """Of a node what `MonitorInputs` uses."""

    executor = None

    def __init__(self) -> None:
        self.queues: dict[str, Queue] = {}

    def create_subscription(self, message_type: type, topic: str, callback: Any, qos: Any, **groups: Any) -> Queue:
        self.queues[topic] = Queue(message_type, topic, qos)
        return self.queues[topic]

    def create_timer(self, period: float, callback: Any, clock: Any) -> None:
        pass

    def resolve_topic_name(self, topic: str) -> str:
        return topic

    def destroy_subscription(self, queue: Queue) -> None:
        del self.queues[queue.topic_name]


class Clock:
    """Not a simulated one."""

    is_simulated = False

    def read(self) -> ClockReading:
        return ClockReading(0, False)

    def when_exchanged(self, call: Any) -> None:
        pass

    def stamp_of(self, arrival: Arrival) -> int:
        return arrival.received


class Heard:
    """A monitor's inputs, and what came of them, in order."""

    def __init__(self, measured: str) -> None:
        self.node, self.taken = Node(), list[tuple[Any, ...]]()

        def note(kind: str) -> Any:
            return lambda *values: self.taken.append((kind, *values))

        kinds = ("command", "position", "coil", "outlet_pressure", "end_pressure")
        live: Any = SimpleNamespace(**{kind: note(kind) for kind in kinds}, stamps=StampCheck(), input=InputCount())
        node: Any = self.node
        clock: Any = Clock()
        self.inputs = MonitorInputs(node, clock, "/valve", f"/valve/{measured}")
        self.inputs.hear(live, has_gas=True)

    def put(self, topic: str, pressure: float, stamp: int = 0) -> None:
        message = FluidPressure(fluid_pressure=pressure)
        message.header.stamp.nanosec = stamp
        self.node.queues[f"/valve/{topic}"].put(message)

    def put_sample(self, topic: str = "joint_states", stamp: int = 5) -> None:
        joints = JointState(name=["pilot_plunger"], position=[0.0])
        joints.header.stamp.nanosec = stamp
        self.node.queues[f"/valve/{topic}"].put(joints)

    def sample(self, topic: str = "joint_states") -> None:
        self.put_sample(topic)
        assert self.inputs.inbox.deliver()


def test_what_a_simulated_valve_obeys_counts_in_place_of_what_it_is_told() -> None:
    heard = Heard("joint_states")
    heard.put("demand_pressure", 14e6, 1)
    heard.put("obeyed/demand_pressure", 13e6, 4)
    heard.put("inlet_pressure", 26e6, 1)
    heard.sample()
    heard.put("obeyed/demand_pressure", 12e6, 6)
    heard.put("inlet_pressure", 25e6, 2)
    heard.sample()
    ends = {end: [taken[2:] for taken in heard.taken if taken[:2] == ("end_pressure", end)] for end in ENDS}
    assert ends == {"demand_pressure": [(1, 14e6), (4, 13e6), (6, 12e6)], "inlet_pressure": [(1, 26e6), (2, 25e6)]}
    assert "/valve/demand_pressure" not in heard.node.queues and "/valve/inlet_pressure" in heard.node.queues


def test_beside_a_real_valve_its_sensors_count_and_no_simulation() -> None:
    heard = Heard("measured/joint_states")
    assert not any("obeyed" in topic for topic in heard.node.queues)
    heard.put("inlet_pressure", 26e6, 1)
    heard.put("measured/inlet_pressure", 25e6, 2)
    heard.put("measured/outlet_pressure", 3e6, 3)
    heard.sample("measured/joint_states")
    assert set(heard.taken[:-1]) == {
        ("end_pressure", "inlet_pressure", 1, 26e6),
        ("end_pressure", "inlet_pressure", 2, 25e6),
        ("outlet_pressure", 3, 3e6),
    }
    assert "/valve/inlet_pressure" not in heard.node.queues


def test_without_an_executor_all_samples_are_taken_after_what_was_heard_before_them() -> None:
    heard = Heard("joint_states")
    assert not heard.inputs.inbox.deliver()
    heard.put("outlet_pressure", 2e6, 1)
    heard.node.queues["/valve/coil_voltage"].put(Float64(data=9.0))
    for stamp in (5, 6, 7):
        heard.put_sample(stamp=stamp)
    for stamp in (8, 9):
        coil = BatteryState(current=0.5, voltage=9.0)
        coil.header.stamp.nanosec = stamp
        heard.node.queues["/valve/coil"].put(coil)
    heard.node.queues["/valve/coil_current"].put(Float64(data=0.25))
    assert heard.inputs.inbox.deliver()
    unstamped = ("coil", "/valve/coil", 77, 0.25)
    assert [taken[:4] for taken in heard.taken if taken[:4] != unstamped] == [
        ("outlet_pressure", 1, 2e6),
        ("command", "/valve/coil_voltage", 77, 9.0),
        *(("position", "/valve/joint_states", stamp, 0.0) for stamp in (5, 6, 7)),
        *(("coil", "/valve/coil", stamp, 0.5) for stamp in (8, 9)),
    ]
    assert "/valve/coil_current" not in heard.node.queues, "the stamped one is heard in its place"
    heard.put_sample(stamp=10)
    assert heard.inputs.inbox.deliver()
    assert heard.taken[-1][:3] == ("position", "/valve/joint_states", 10)
    assert not heard.inputs.inbox.deliver()
