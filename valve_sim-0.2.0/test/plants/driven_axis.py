"""An axis under position control, integrated by small steps of its own: nothing of it is from the package."""

import math
from collections.abc import Callable
from typing import NamedTuple

import numpy as np

from .common import FloatArray

RATE = 1000.0
MASS, VISCOUS = 50.0, 100.0
"""kg, N s/m."""


class Moves(NamedTuple):
    """Five out-and-back moves: (n,) s, m and N."""

    times: FloatArray
    position: FloatArray
    force: FloatArray


def moves(friction: Callable[[float], float], load: float, seed: int = 0) -> Moves:
    """The axis as it moves.

    Args:
        friction: v → dry friction in N, a size. load: N, constant. seed: of the noise on the force, 0.5 N.
    """
    random = np.random.default_rng(seed)
    interval, substeps = 1.0 / RATE, 10
    times = np.arange(0.0, 20.0, interval)
    wanted = 0.1 * (1.0 - np.cos(0.5 * math.pi * times))
    position, force = np.empty(len(times)), np.empty(len(times))
    x, v, before = 0.0, 0.0, 0.0
    for i, target in enumerate(wanted):
        position[i] = x
        force[i] = 4e4 * (target - x) + 3e3 * ((target - before) / interval - v)
        before = target
        for _ in range(substeps):
            step = interval / substeps
            pushed = v + step * (force[i] + load - VISCOUS * v) / MASS
            held = step * friction(pushed) / MASS
            v = math.copysign(max(abs(pushed) - held, 0.0), pushed)
            x += step * v
    return Moves(times, position, force + random.normal(0.0, 0.5, len(times)))
