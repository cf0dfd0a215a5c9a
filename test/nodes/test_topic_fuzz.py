"""A slice of `benchmarks.fuzz.topics`: nodes under fire live, write no traceback and do their work again."""

from __future__ import annotations

import pytest

import nodes.ros  # noqa: F401
from benchmarks.fuzz.topics import NAMES_OF_NODES, fuzz

pytestmark = [pytest.mark.ros, pytest.mark.long, pytest.mark.usefixtures("ros")]


def test_nodes_under_fire_go_on() -> None:
    assert fuzz(5000, seed=7, rounds=3, names=NAMES_OF_NODES) == []
