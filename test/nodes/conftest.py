"""Fixtures of the tests that run a real valve_node."""

from __future__ import annotations

import importlib.util
from collections.abc import Iterator
from importlib.metadata import PackageNotFoundError, version
from pathlib import Path

import pytest
from own_domain import own_domain

from .ros_process import Probe

PROFILE = Path(__file__).with_name("fast_dds.xml")


def profile_variable() -> str:
    """Where Fast DDS looks for its profiles: version 3 of it came with Kilted, whose rclpy is 9."""
    try:
        return "FASTRTPS" if int(version("rclpy").partition(".")[0]) < 9 else "FASTDDS"
    except PackageNotFoundError:
        return "FASTDDS"


def pytest_collection_modifyitems(items: list[pytest.Item]) -> None:
    if importlib.util.find_spec("rclpy") is None:
        for item in items:
            if item.get_closest_marker("ros"):
                item.add_marker(pytest.mark.skip(reason="there is no ROS 2 here: rclpy cannot be imported"))


@pytest.fixture(scope="session", autouse=True)
def in_own_domain() -> Iterator[None]:
    """No neighbour is heard, and none hears us; nodes that begin are found at once."""
    with pytest.MonkeyPatch.context() as patch:
        patch.setenv("ROS_DOMAIN_ID", str(own_domain()))
        patch.setenv("ROS_AUTOMATIC_DISCOVERY_RANGE", "LOCALHOST")
        patch.setenv(f"{profile_variable()}_DEFAULT_PROFILES_FILE", str(PROFILE))
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
