"""Parameters of a node as `ros2 param dump` writes them, and a file with tolerances to begin with."""

from __future__ import annotations

import array
from pathlib import Path
from typing import Any

import yaml

TOLERATED = """
/**:
  ros__parameters:
    valve: {main_damping: 3.5, attraction_polynomial: [3.0, 17.0e+3, -30.0e+6, 24.0e+9]}
    effects: {coulomb_friction: {force: 0.3}}
    tolerances:
      spring_rate: 12.8
      stroke: 4.0e-6
      attraction_covariance: [0.01, 2.0, 0.0, 0.0, 2.0, 1.0e+4, 0.0, 0.0, 0.0, 0.0, 1.0e+9, 0.0, 0.0, 0.0, 0.0, 0.0]
      effects: {coulomb_friction: {force: 0.05}}
"""


def plain(value: Any) -> Any:
    return list(value) if isinstance(value, array.array) else value


def plain_values(values: dict[str, Any]) -> dict[str, Any]:
    return {name: plain(value) for name, value in values.items()}


def dump(values: dict[str, Any], path: Path, node: str) -> Path:
    """Sorted and nested, as ros2cli does it: a name that is both a value and a prefix of others ends it."""
    nested: dict[str, Any] = {}
    for name, value in sorted(values.items()):
        *folders, last = name.split(".")
        place = nested
        for folder in folders:
            place = place.setdefault(folder, {})
        place[last] = plain(value)
    path.write_text(yaml.dump({node: {"ros__parameters": nested}}))
    return path
