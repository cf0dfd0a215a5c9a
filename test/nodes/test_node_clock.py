"""The clock of a real node, with the system's clocks moved by hand."""

from __future__ import annotations

from collections.abc import Iterator
from typing import Any

import numpy as np
import pytest

from nodes.ros import rclpy
from valve_sim.nodes.node_clock import NodeClock
from valve_sim.nodes.realtime import NANOSECONDS, ClockReading

pytestmark = pytest.mark.ros


EPOCH = 1_700_000_000 * NANOSECONDS


class SystemClocks:
    """Elapsed time and the system's clock, which go on at each look; `hold_up` is spent between two of them."""

    def __init__(self) -> None:
        self.elapsed = 5 * NANOSECONDS
        self.ahead = EPOCH
        self.hold_up = 0

    def monotonic(self) -> int:
        self.elapsed += 60
        return self.elapsed

    def system(self) -> int:
        self.elapsed += 40 + self.hold_up
        now = self.elapsed + self.ahead
        self.elapsed += self.hold_up
        return now


@pytest.fixture
def node(in_own_domain: None) -> Iterator[Any]:
    rclpy.init()
    node = rclpy.create_node("clocked")
    yield node
    node.destroy_node()
    rclpy.try_shutdown()


@pytest.mark.parametrize("step", [3600 * NANOSECONDS, -3600 * NANOSECONDS, 1_000_000, -1_000_000, 2_000])
def test_stamps_follow_each_step_of_the_systems_clock_and_elapsed_time_does_not(node: Any, step: int) -> None:
    clocks = SystemClocks()
    clock = NodeClock(node, clocks.monotonic, clocks.system)
    before = clock.read()
    assert before is not None
    assert clock.stamp_at(before) - before.nanoseconds == pytest.approx(EPOCH, abs=100)
    assert clock.was_set() == 0
    clocks.ahead += step
    after = clock.read()
    assert after is not None
    assert after.nanoseconds - before.nanoseconds < 10_000
    assert clock.was_set() == pytest.approx(step, abs=100)
    assert clock.stamp_at(after) - after.nanoseconds == pytest.approx(EPOCH + step, abs=100)
    assert clock.was_set() == 0


def test_a_process_that_is_held_up_between_two_looks_takes_that_for_no_step(node: Any) -> None:
    clocks, generator = SystemClocks(), np.random.default_rng(20)
    clocks.hold_up = 3_000_000
    held_up_at_first = NodeClock(node, clocks.monotonic, clocks.system)
    clocks.hold_up = 0
    assert [held_up_at_first.was_set() for _ in range(100)] == [0] * 100
    clock = NodeClock(node, clocks.monotonic, clocks.system)
    for _ in range(1000):
        clocks.hold_up = int(generator.exponential(5e6))
        assert clock.was_set() == 0
    clocks.hold_up = 0
    clocks.ahead -= 7_000_000
    assert clock.was_set() == pytest.approx(-7_000_000, abs=2_000)


def test_simulated_time_is_its_own_stamp(node: Any) -> None:
    assert NodeClock(node).stamp_at(ClockReading(17, True)) == 17
