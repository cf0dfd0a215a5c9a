"""Drift: the zero of a position sensor changes with its temperature, slowly, as a random walk.

The columns are a constant, and between each two knots (the commands) a ramp that stays up afterwards. A ramp that lasts
longer drifts farther: its size grows as the root of its duration. Two ramps of the mean duration make one stroke.
"""

from __future__ import annotations

import math
from typing import Final

import numpy as np

from valve_sim.identification.estimation.errors.error import RecordingError, Seen
from valve_sim.identification.plants.protocol import Array


def columns(seen: Seen) -> Array:
    """(n, q) a constant, and a ramp between each two knots."""
    inside = seen.knots[(seen.knots > seen.times[0]) & (seen.knots < seen.times[-1])]
    knots = np.unique(np.concatenate([seen.times[:1], inside, seen.times[-1:]]))
    gaps = np.diff(knots)
    usual = float(np.mean(gaps)) if len(gaps) else 1.0
    ramps = np.clip((seen.times[:, None] - knots[:-1]) / gaps, 0.0, 1.0) * np.sqrt(gaps / usual) / math.sqrt(2.0)
    return np.column_stack([np.ones(len(seen.times)), ramps])


DRIFT: Final = RecordingError(
    "drift", "drift of the zero",
    "let the sensor warm up, shield it from draughts, and record short", columns=columns,
    share=8e-4,
)  # fmt: skip
"""Prior: 1 µm a stroke, of 1.23 mm, as a laser sensor's 0.01 to 0.03 % of its range for each kelvin."""
