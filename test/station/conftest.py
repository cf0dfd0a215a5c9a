"""Fixtures of the tests that run a real node of the station."""

from nodes.conftest import in_own_domain, probe, ros

__all__ = ["in_own_domain", "probe", "ros"]
