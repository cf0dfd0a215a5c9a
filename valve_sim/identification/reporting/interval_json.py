"""Intervals as every report in JSON has them."""

from __future__ import annotations

from collections.abc import Mapping
from typing import Any

from valve_sim.files.json_text import plain
from valve_sim.identification.estimation.intervals import Interval
from valve_sim.identification.reporting.findings import remark_on


def interval_json(found: Interval) -> dict[str, Any]:
    """Value, standard error and 95 % interval; null where one is infinite."""
    entry: dict[str, Any] = {
        "value": plain(found.value),
        "stderr": plain(found.stderr),
        "ci95": plain([found.low, found.high]),
    }
    if remark := remark_on(found):
        entry["remark"] = remark
    return entry


def intervals_json(intervals: Mapping[str, Interval]) -> dict[str, dict[str, Any]]:
    """Intervals by name, each as `interval_json` has it."""
    return {name: interval_json(found) for name, found in intervals.items()}
