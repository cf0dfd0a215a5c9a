"""Intervals as every report has them, in JSON and as a table for the terminal."""

from __future__ import annotations

from collections.abc import Mapping
from typing import Any

from valve_sim.files.json_text import plain
from valve_sim.identification.estimation.intervals import Interval
from valve_sim.identification.plants.protocol import Plant
from valve_sim.identification.reporting.findings import remark_on
from valve_sim.identification.reporting.units import limits, measured, quantity


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


def interval_lines(plant: Plant, intervals: Mapping[str, Interval], width: int) -> list[str]:
    """A table of refitted parameters beside their declared values, with a remark below an unusual interval.

    Args:
        plant: whose parameters they are. intervals: by name. width: of the column of 95 % intervals, characters.
    """
    column = max([28, *(len(name) + 2 for name in intervals)])
    lines = [f"{'parameter':<{column}}{'value ± standard error':<30}{'95 % interval':<{width}}declared"]
    for name, found in intervals.items():
        unit, declared = plant.parameter(name).unit, plant.declared(name)
        known = f"{measured(found, unit):<29} {limits(found, unit):<{width - 1}} "
        row = f"{name:<{column}}{known}{quantity(declared, unit)}"
        lines += [row, *([f"  {remark}."] if (remark := remark_on(found)) else [])]
    return lines
