"""Valves and drives that the tests of the core share."""

from __future__ import annotations

from collections.abc import Callable, Mapping
from dataclasses import replace
from typing import Any

import numpy as np

from model.flux_cases import TIMES as FLUX_TIMES
from model.flux_cases import random_case, random_release
from model.random_valves import TIMES, random_valve
from valve_sim.model import Valve
from valve_sim.model.drives import Drive

CALIBRATED = Valve().with_values(a0=3.0336, coil_time_constant=0.9934e-3)
STROKE = Drive.of([1e-3, 16e-3], [9.0, 0.0])

DRAWN: Mapping[str, tuple[Callable[[int], tuple[Any, Drive]], Any]] = {
    "random": (random_valve, TIMES),
    "flux": (random_case, FLUX_TIMES),
    "release": (random_release, FLUX_TIMES),
}
"""By kind: what draws a valve and its drive from a seed, and the times of its samples."""


def drawn(kind: str, seed: int) -> tuple[Valve, Drive, np.ndarray]:
    """A random valve, its drive, and times."""
    draw, times = DRAWN[kind]
    valve, drive = draw(seed)
    return Valve(valve.parameters, valve.effects), drive, times


def with_value(valve: Valve, name: str, value: float) -> Valve:
    """The same valve with one parameter replaced, "pilot_damping" or "effect.parameter"."""
    if "." not in name:
        return valve.with_values(**{name: value})
    effect, parameter = name.split(".")
    return replace(valve, effects={**valve.effects, effect: {**valve.effects[effect], parameter: value}})
