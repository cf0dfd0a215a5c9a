"""The thread that takes a node's commands, while nothing spins the node."""

from __future__ import annotations

import threading
from collections.abc import Callable, Iterator
from typing import Any

import pytest

from .ros_process import ENDS_WITHIN, Probe

pytestmark = pytest.mark.ros
pytest.importorskip("rclpy", reason="there is no ROS 2 here: rclpy cannot be imported")

import rclpy  # noqa: E402
from rclpy.event_handler import SubscriptionEventCallbacks  # noqa: E402
from rclpy.qos import QoSProfile, ReliabilityPolicy  # noqa: E402
from std_msgs.msg import Float64  # noqa: E402

from valve_sim.nodes.receiving import LeftToReceiver, Receiver  # noqa: E402
from valve_sim.nodes.spinning import guarded  # noqa: E402


@pytest.fixture
def probe(in_own_domain: None) -> Iterator[Probe]:
    rclpy.init()
    probe = Probe("/heard")
    yield probe
    probe.close()
    rclpy.try_shutdown()


@pytest.fixture
def start(probe: Probe) -> Iterator[Callable[..., list[Exception]]]:
    """Starts a receiver of a node that nobody spins, with this callback; what it fails with."""
    node = rclpy.create_node("heard")
    started: list[Receiver] = []

    def start(take: Callable[[Any], None], on_event: Callable[[Any], None]) -> list[Exception]:
        failures: list[Exception] = []
        events = SubscriptionEventCallbacks(incompatible_qos=on_event)
        subscription = node.create_subscription(
            Float64, "~/volts", guarded(take), 10, callback_group=LeftToReceiver(), event_callbacks=events
        )
        started.append(Receiver(node, subscription, failures.append))
        started[0].start()
        return failures

    yield start
    assert started[0].stop(ENDS_WITHIN), "it waits although it was to end"
    node.destroy_node()


def test_messages_and_events_come_though_nobody_spins_the_node(
    probe: Probe, start: Callable[..., list[Exception]]
) -> None:
    heard: list[float] = []
    threads, events = set(), []

    def take(message: Any) -> None:
        heard.append(message.data)
        threads.add(threading.current_thread())

    failures = start(take, events.append)
    volts = probe.talker("volts", Float64)
    assert probe.until(lambda: volts.publish(Float64(data=4.5)) or heard)
    assert heard[0] == 4.5
    assert threading.main_thread() not in threads
    probe.talker("volts", Float64, QoSProfile(depth=1, reliability=ReliabilityPolicy.BEST_EFFORT))
    assert probe.until(lambda: events)
    assert not failures


def test_a_callback_that_fails_is_told_and_ends_it(probe: Probe, start: Callable[..., list[Exception]]) -> None:
    def take(message: Any) -> None:
        raise ValueError(message.data)

    failures = start(take, lambda event: None)
    volts = probe.talker("volts", Float64)
    assert probe.until(lambda: volts.publish(Float64(data=7.0)) or failures)
    assert repr(failures[0].__cause__) == "ValueError(7.0)"
