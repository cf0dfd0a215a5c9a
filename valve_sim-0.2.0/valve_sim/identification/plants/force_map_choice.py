"""Force maps as plants offer them: the entry of the catalogue, over one of its variables."""

from __future__ import annotations

import math
from typing import Final

from valve_sim.identification.plants.protocol import ForceMap
from valve_sim.model.effects import FORCE_MAP_COEFFICIENTS, FORCE_MAP_VARIABLES, is_damping, is_periodic

IN_A_PERIOD: Final = 12
"""Coefficients of a curve that repeats itself."""
_END: Final = "force_map.high"


def force_map_over(variable: str, low: float, high: float, unit: str) -> ForceMap:
    """A force map with all B-splines between the smallest and the largest value that the data have.

    Args:
        variable: one of FORCE_MAP_VARIABLES. low, high: in `unit`.
    """
    repeats = is_periodic(variable)
    fixed = {"force_map.variable": float(FORCE_MAP_VARIABLES.index(variable)), "force_map.low": low, _END: high}
    names = FORCE_MAP_COEFFICIENTS[:IN_A_PERIOD] if repeats else FORCE_MAP_COEFFICIENTS
    least = 0.0 if is_damping(variable) else -math.inf
    return ForceMap(
        variable, tuple(f"force_map.{name}" for name in names), fixed, low, high, unit, "force_map.count", least,
        end=_END if repeats else "",
    )  # fmt: skip
