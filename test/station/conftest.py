"""Fixtures of the tests that run a real node of the station."""

from __future__ import annotations

from nodes.conftest import in_own_domain

__all__ = ["in_own_domain"]
