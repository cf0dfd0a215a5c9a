"""The thread that takes a node's commands, and how it leaves them to the executor."""

from __future__ import annotations

import itertools
import threading
from collections.abc import Callable, Iterator
from typing import Any

import pytest

from .ros_process import ENDS_WITHIN, Probe

pytestmark = pytest.mark.ros
pytest.importorskip("rclpy", reason="there is no ROS 2 here: rclpy cannot be imported")

import rclpy  # noqa: E402
from rclpy.event_handler import SubscriptionEventCallbacks  # noqa: E402
from rclpy.executors import SingleThreadedExecutor  # noqa: E402
from rclpy.qos import QoSProfile, ReliabilityPolicy  # noqa: E402
from std_msgs.msg import Float64  # noqa: E402

from valve_sim.nodes.receiving import Receiver, ReceiverGroup  # noqa: E402
from valve_sim.nodes.spinning import guarded  # noqa: E402


@pytest.fixture
def probe(in_own_domain: None) -> Iterator[Probe]:
    rclpy.init()
    probe = Probe("/heard")
    yield probe
    probe.close()
    rclpy.try_shutdown()


class Hearing:
    """A node with a receiver, which nobody spins.

    Args:
        take: called with each message. on_event: with each publisher that cannot be heard.
    """

    def __init__(self, take: Callable[[Any], None], on_event: Callable[[Any], None] = lambda event: None) -> None:
        self.node = rclpy.create_node("heard")
        self.may_serve = True
        self.failures: list[Exception] = []
        subscription = self.node.create_subscription(
            Float64, "~/volts", guarded(take), 10, callback_group=ReceiverGroup(),
            event_callbacks=SubscriptionEventCallbacks(incompatible_qos=on_event),
        )  # fmt: skip
        self.receiver = Receiver(self.node, subscription, lambda: self.may_serve, self.failures.append)
        self.receiver.start()

    def close(self) -> None:
        assert self.receiver.stop(ENDS_WITHIN), "it waits although it was to end"
        self.node.destroy_node()


@pytest.fixture
def hearing(probe: Probe) -> Iterator[Callable[..., Hearing]]:
    """Starts a receiver."""
    started: list[Hearing] = []

    def start(*callbacks: Callable[[Any], None]) -> Hearing:
        started.append(Hearing(*callbacks))
        return started[0]

    yield start
    started[0].close()


def test_messages_and_events_come_though_nobody_spins_the_node(probe: Probe, hearing: Callable[..., Hearing]) -> None:
    heard: list[float] = []
    threads, events = set(), []

    def take(message: Any) -> None:
        heard.append(message.data)
        threads.add(threading.current_thread())

    started = hearing(take, events.append)
    volts = probe.talker("volts", Float64)
    assert probe.until(lambda: volts.publish(Float64(data=4.5)) or heard)
    assert heard[0] == 4.5
    assert threads == {started.receiver}
    probe.talker("volts", Float64, QoSProfile(depth=1, reliability=ReliabilityPolicy.BEST_EFFORT))
    assert probe.until(lambda: events)
    assert not started.failures


def test_an_executor_that_waits_already_takes_over_when_it_may_no_longer_serve(
    probe: Probe, hearing: Callable[..., Hearing]
) -> None:
    threads: list[threading.Thread] = []
    started = hearing(lambda message: threads.append(threading.current_thread()))
    executor = SingleThreadedExecutor()
    executor.add_node(started.node)
    # No time limit: only the receiver's end can have it look again at what it waits for.
    spinning = threading.Thread(target=executor.spin, daemon=True)
    spinning.start()
    try:
        volts = probe.talker("volts", Float64)
        assert probe.until(lambda: volts.publish(Float64(data=4.5)) or threads)
        assert threads[0] is started.receiver
        started.may_serve = False
        started.receiver.wake()
        assert probe.until(lambda: volts.publish(Float64(data=9.0)) or threads[-1] is spinning)
        assert [thread for thread, _ in itertools.groupby(threads)] == [started.receiver, spinning]
    finally:
        executor.shutdown()
        spinning.join(ENDS_WITHIN)


def test_a_callback_that_fails_is_told_and_ends_it(probe: Probe, hearing: Callable[..., Hearing]) -> None:
    def take(message: Any) -> None:
        raise ValueError(message.data)

    started = hearing(take)
    volts = probe.talker("volts", Float64)
    assert probe.until(lambda: volts.publish(Float64(data=7.0)) or started.failures)
    assert repr(started.failures[0].__cause__) == "ValueError(7.0)"
