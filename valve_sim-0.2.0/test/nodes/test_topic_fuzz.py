"""A slice of `benchmarks.fuzz.topics`: nodes under fire live, write no traceback and do their work again."""

from __future__ import annotations

from collections.abc import Iterator

import pytest

pytestmark = [pytest.mark.ros, pytest.mark.long]
pytest.importorskip("rclpy", reason="there is no ROS 2 here: rclpy cannot be imported")

import rclpy  # noqa: E402

from benchmarks.fuzz.topics import fuzz  # noqa: E402


@pytest.fixture(scope="module", autouse=True)
def ros(in_own_domain: None) -> Iterator[None]:
    rclpy.init()
    yield
    rclpy.try_shutdown()


def test_nodes_under_fire_go_on() -> None:
    assert fuzz(5000, seed=7, rounds=3, names=("valve", "simulated", "identification", "monitor")) == []
