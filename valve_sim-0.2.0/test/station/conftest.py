"""Fixtures of the tests that run a real node of the station."""

from __future__ import annotations

from collections.abc import Iterator

import pytest
from nodes.conftest import in_own_domain
from nodes.ros_process import Probe

__all__ = ["in_own_domain", "probe"]


@pytest.fixture
def probe(in_own_domain: None) -> Iterator[Probe]:
    """A node that plays the valve; skipped without ROS."""
    rclpy = pytest.importorskip("rclpy", reason="there is no ROS 2 here: rclpy cannot be imported")
    rclpy.init()
    probe = Probe("/valve")
    yield probe
    probe.close()
    rclpy.try_shutdown()
