"""What an inbox receives, whether it takes messages itself or an executor calls back, from a real middleware."""

from __future__ import annotations

import threading
from collections.abc import Callable, Iterator
from types import SimpleNamespace
from typing import Any

import pytest

from nodes.ros import (
    LATCHED,
    Float64,
    Parameter,
    QoSProfile,
    ReliabilityPolicy,
    SingleThreadedExecutor,
    Subscription,
    UInt8,
    rclpy,
)
from valve_sim.nodes import receiving
from valve_sim.nodes.node_clock import NodeClock
from valve_sim.nodes.realtime import Arrival
from valve_sim.nodes.receiving import Inbox

from .ros_process import ENDS_WITHIN, Probe

pytestmark = pytest.mark.ros
TARGET = "/heard"


RELIABLE = QoSProfile(depth=1000)


class Hearing:
    """A node with an inbox; `spin` has an executor serve it."""

    def __init__(self, simulated: bool) -> None:
        overrides = [Parameter("use_sim_time", value=simulated)]
        self.node = rclpy.create_node("heard", parameter_overrides=overrides)
        self.clock = NodeClock(self.node)
        self.inbox = Inbox(self.node, self.clock)
        self.heard: list[Any] = []
        self.arrivals: list[Arrival] = []
        self.threads: set[threading.Thread] = set()
        self._executor = SingleThreadedExecutor()
        self._executor.add_node(self.node)
        self._spinning: threading.Thread | None = None

    def spin(self) -> None:
        self._spinning = threading.Thread(target=self._executor.spin, daemon=True)
        self._spinning.start()

    def take(self, message: Any, arrival: Arrival) -> None:
        self.heard.append(message.data)
        self.arrivals.append(arrival)
        self.threads.add(threading.current_thread())

    def close(self) -> None:
        self._executor.shutdown()
        if self._spinning is not None:
            self._spinning.join(ENDS_WITHIN)
        self.node.destroy_node()


@pytest.fixture
def hearing(probe: Probe) -> Iterator[Callable[..., Hearing]]:
    """Starts a node."""
    started: list[Hearing] = []

    def start(*, simulated: bool = False, spinning: bool = True) -> Hearing:
        started.append(Hearing(simulated))
        if spinning:
            started[0].spin()
        return started[0]

    yield start
    started[0].close()


def without_take_message(monkeypatch: pytest.MonkeyPatch) -> None:
    """An rclpy whose subscriptions cannot be asked by anyone but its executor."""

    class Handle:
        """Of a subscription's handle nothing that is known."""

    monkeypatch.setattr(Subscription, "handle", property(lambda subscription: Handle()))


def send_until_heard(probe: Probe, node: Hearing, publisher: Any, number: float) -> None:
    def sent() -> bool:
        publisher.publish(Float64(data=number))
        node.inbox.deliver()
        return number in node.heard

    assert probe.until(sent)


@pytest.mark.parametrize("way", ["polled", "by the executor", "in simulated time"])
def test_every_message_is_taken_once_and_in_order_however_it_comes(
    probe: Probe, hearing: Callable[..., Hearing], way: str, monkeypatch: pytest.MonkeyPatch
) -> None:
    node = hearing(simulated=way == "in simulated time", spinning=False)
    node.inbox.subscribe(Float64, "~/volts", node.take, RELIABLE)
    if way == "by the executor":
        with monkeypatch.context() as patch:
            without_take_message(patch)
            assert not node.inbox.deliver()
    assert node.inbox.is_polled == (way == "polled")
    node.spin()
    volts = probe.talker("volts", Float64)
    send_until_heard(probe, node, volts, -1.0)
    for number in range(300):
        volts.publish(Float64(data=float(number)))
    assert probe.until(lambda: node.inbox.deliver() is not None and 299.0 in node.heard)
    assert [number for number in node.heard if number >= 0.0] == [float(number) for number in range(300)]
    assert node.threads == {threading.current_thread()}


def test_an_executor_that_waits_already_takes_over_when_time_is_simulated_and_hands_back(
    probe: Probe, hearing: Callable[..., Hearing]
) -> None:
    node = hearing()
    node.inbox.subscribe(Float64, "~/volts", node.take, RELIABLE)
    volts = probe.talker("volts", Float64)
    for number, simulated in enumerate((False, True, False)):
        assert probe.set_parameters(use_sim_time=simulated)[0].successful
        assert node.inbox.is_polled is not simulated
        send_until_heard(probe, node, volts, float(number))
        if simulated:
            assert node.arrivals[-1].reading is None, "there is no /clock"
        else:
            assert node.arrivals[-1].reading is not None
            assert not node.arrivals[-1].reading.is_simulated


def test_a_message_counts_from_when_it_was_received(probe: Probe, hearing: Callable[..., Hearing]) -> None:
    node = hearing()
    node.inbox.subscribe(Float64, "~/volts", node.take, RELIABLE)
    before = node.clock.read()
    send_until_heard(probe, node, probe.talker("volts", Float64), 4.5)
    arrival, after = node.arrivals[0], node.clock.read()
    assert before is not None and after is not None and arrival.reading is not None
    assert before.nanoseconds < node.clock.time_of(arrival) <= arrival.reading.nanoseconds <= after.nanoseconds
    unstamped, simulated = arrival._replace(received=0), Arrival(7, None)
    assert node.clock.time_of(unstamped) == arrival.reading.nanoseconds
    assert node.clock.stamp_of(unstamped) == node.clock.stamp_at(arrival.reading)
    assert (node.clock.time_of(simulated), node.clock.stamp_of(simulated)) == (0, 0)
    for wrong in (3600 * 10**9, -3600 * 10**9):
        stepped = arrival._replace(received=arrival.received + wrong)
        assert node.clock.time_of(stepped) == arrival.reading.nanoseconds, "the system's clock was set between"


def test_messages_that_come_as_fast_as_they_are_taken_are_delivered_all_the_same(
    hearing: Callable[..., Hearing], monkeypatch: pytest.MonkeyPatch
) -> None:
    class Endless:
        """The handle of a subscription on which another message waits whenever one was taken."""

        def take_message(self, kind: type, is_raw: bool) -> tuple[Any, dict[str, int]]:
            return Float64(data=1.5), {"received_timestamp": 1}

    node = hearing(spinning=False)
    node.inbox.subscribe(Float64, "~/volts", node.take, RELIABLE)
    with monkeypatch.context() as patch:
        patch.setattr(Subscription, "handle", property(lambda subscription: Endless()))
        assert node.inbox.deliver()
    assert len(node.heard) == RELIABLE.depth


@pytest.mark.parametrize("simulated", [False, True])
def test_earlier_topics_are_taken_before_later_ones_and_messages_can_be_forgotten(
    probe: Probe, hearing: Callable[..., Hearing], simulated: bool
) -> None:
    node = hearing(simulated=simulated)
    node.inbox.subscribe(UInt8, "~/first", node.take, RELIABLE)
    later = node.inbox.subscribe(Float64, "~/second", node.take, RELIABLE)
    first, second = probe.talker("first", UInt8), probe.talker("second", Float64)

    def all_match() -> bool:
        first.publish(UInt8(data=1))
        second.publish(Float64(data=0.5))
        node.inbox.deliver()
        return {1, 0.5} <= set(node.heard)

    assert probe.until(all_match)
    node.inbox.forget()
    node.heard.clear()
    if not simulated:
        second.publish(Float64(data=2.5))
        first.publish(UInt8(data=2))
        assert probe.until(lambda: not node.inbox.deliver() and len(node.heard) >= 2)
        assert node.heard[-2:] == [2, 2.5] or node.heard[-2:] == [2.5, 2], "one delivery or two"
    node.inbox.unsubscribe(later)
    second.publish(Float64(data=3.5))
    first.publish(UInt8(data=3))
    assert probe.until(lambda: node.inbox.deliver() is not None and 3 in node.heard)
    assert 3.5 not in node.heard


def test_what_nobody_takes_is_bounded(
    probe: Probe, hearing: Callable[..., Hearing], monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.setattr(receiving, "MOST_STORED", 100)
    node = hearing(simulated=True, spinning=False)
    source = node.inbox.subscribe(Float64, "~/volts", node.take, RELIABLE)
    for number in range(105):
        source.subscription.callback(Float64(data=float(number)), {"received_timestamp": 1})
    assert node.inbox.deliver()
    assert (node.heard[0], node.heard[-1], len(node.heard)) == (5.0, 104.0, 100)


@pytest.mark.parametrize(
    ("asked", "offered", "mend"),
    [
        (RELIABLE, QoSProfile(depth=1, reliability=ReliabilityPolicy.BEST_EFFORT), "(RELIABILITY)"),
        (LATCHED, RELIABLE, "(DURABILITY) and cannot be heard; publish transient local"),
    ],
)
def test_a_publisher_that_cannot_be_heard_is_counted(
    probe: Probe, hearing: Callable[..., Hearing], monkeypatch: pytest.MonkeyPatch, asked: QoSProfile,
    offered: QoSProfile, mend: str,
) -> None:  # fmt: skip
    node, said = hearing(), list[str]()
    monkeypatch.setattr(node.node, "get_logger", lambda: SimpleNamespace(warning=said.append))
    source = node.inbox.subscribe(Float64, "~/volts", node.take, asked)
    assert source.topic == "/heard/volts"
    assert source.incompatible_publishers == 0
    probe.talker("volts", Float64, offered)
    assert probe.until(lambda: source.incompatible_publishers == 1)
    assert probe.until(lambda: said) and mend in said[0]


@pytest.mark.long
def test_a_publisher_of_another_type_is_warned_of_once(
    probe: Probe, hearing: Callable[..., Hearing], monkeypatch: pytest.MonkeyPatch
) -> None:
    node, said = hearing(), list[str]()
    monkeypatch.setattr(node.node, "get_logger", lambda: SimpleNamespace(warning=said.append))
    node.inbox.subscribe(Float64, "~/volts", node.take, RELIABLE)
    elsewhere = rclpy.Context()  # the middleware lets a process have a topic of one type only
    rclpy.init(context=elsewhere)
    another = rclpy.create_node("another", context=elsewhere)
    another.create_publisher(UInt8, "/heard/volts", 10)
    assert probe.until(lambda: said)
    looks = node.clock.elapsed() + 2.5
    assert probe.until(lambda: node.clock.elapsed() > looks), "two more looks"
    words = "/heard/volts: a publisher sends std_msgs/msg/UInt8 and cannot be heard; publish std_msgs/msg/Float64"
    assert said == [words]
    another.destroy_node()
    rclpy.shutdown(context=elsewhere)
