"""Fixtures of the tests that run a real valve_node."""

from __future__ import annotations

import importlib.util
from collections.abc import Iterator

import pytest
from own_domain import own_domain


def pytest_collection_modifyitems(items: list[pytest.Item]) -> None:
    if importlib.util.find_spec("rclpy") is None:
        for item in items:
            if item.get_closest_marker("ros"):
                item.add_marker(pytest.mark.skip(reason="there is no ROS 2 here: rclpy cannot be imported"))


@pytest.fixture(scope="session", autouse=True)
def in_own_domain() -> Iterator[None]:
    """No neighbour is heard, and none hears us."""
    with pytest.MonkeyPatch.context() as patch:
        patch.setenv("ROS_DOMAIN_ID", str(own_domain()))
        patch.setenv("ROS_AUTOMATIC_DISCOVERY_RANGE", "LOCALHOST")
        yield
