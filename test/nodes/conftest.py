"""Fixtures of the tests that run a real valve_node."""

from __future__ import annotations

import importlib.util
from collections.abc import Iterator
from pathlib import Path

import pytest
from own_domain import own_domain

from valve_sim.nodes.starting import installed_rclpy, offer_profile

from .ros_process import Probe


def pytest_collection_modifyitems(items: list[pytest.Item]) -> None:
    if importlib.util.find_spec("rclpy") is None:
        for item in items:
            if item.get_closest_marker("ros"):
                item.add_marker(pytest.mark.skip(reason="there is no ROS 2 here: rclpy cannot be imported"))


@pytest.fixture(scope="session", autouse=True)
def in_own_domain() -> Iterator[None]:
    """No neighbour is heard, and none hears us; nodes that begin are found at once, with the profile of the nodes."""
    with pytest.MonkeyPatch.context() as patch:
        wanted: dict[str, str] = {}
        offer_profile(wanted, Path.cwd(), installed_rclpy())
        own = {"ROS_DOMAIN_ID": str(own_domain()), "ROS_AUTOMATIC_DISCOVERY_RANGE": "LOCALHOST"}
        for name, value in {**wanted, **own}.items():
            patch.setenv(name, value)
        yield


@pytest.fixture(scope="module")
def ros(in_own_domain: None) -> Iterator[None]:
    """ROS in this process; the test is skipped where there is none."""
    rclpy = pytest.importorskip("rclpy", reason="there is no ROS 2 here: rclpy cannot be imported")
    rclpy.init()
    yield
    rclpy.try_shutdown()


@pytest.fixture
def probe(ros: None, request: pytest.FixtureRequest) -> Iterator[Probe]:
    """A node that talks to the one that is tested: the module's TARGET, or /valve."""
    probe = Probe(getattr(request.module, "TARGET", "/valve"))
    yield probe
    probe.close()
