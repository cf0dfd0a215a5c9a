"""Drift: the zero of a position sensor changes with its temperature, slowly, as a random walk.

The columns are a constant, and ramps that stay up afterwards: `RAMPS` between each two knots, which are the commands.
A ramp that lasts longer drifts farther: its size grows as the root of its duration. Between commands a walk is no
straight line, which shows where a sensor of low noise drifts by micrometres.
"""

from __future__ import annotations

from typing import Final

import numpy as np

from valve_sim.identification.fit.errors.error import RecordingError, Seen
from valve_sim.identification.plants.protocol import Array

RAMPS: Final = 4
"""Between two commands."""


def columns(seen: Seen) -> Array:
    """(n, q) a constant, and ramps between each two knots."""
    inside = seen.knots[(seen.knots > seen.times[0]) & (seen.knots < seen.times[-1])]
    commands = np.unique(np.concatenate([seen.times[:1], inside, seen.times[-1:]]))
    places = np.arange(RAMPS * (len(commands) - 1) + 1) / RAMPS
    knots = np.interp(places, np.arange(len(commands)), commands)
    gaps = np.diff(knots)
    # A stroke has two intervals between commands.
    stroke = 2.0 * RAMPS * float(np.mean(gaps)) if len(gaps) else 1.0
    ramps = np.clip((seen.times[:, None] - knots[:-1]) / gaps, 0.0, 1.0) * np.sqrt(gaps / stroke)
    return np.column_stack([np.ones(len(seen.times)), ramps])


def change_by_stroke(coefficients: Array, samples: Array) -> float:
    """Root mean square of the zero's change over a stroke, of (q,) coefficients and their (n, q) columns.

    Not the size that they share: a zero that changes smoothly has ramps that follow each other, and goes farther in a
    stroke than a walk of as large steps.
    """
    steps = coefficients[1:] * samples[-1, 1:]
    # What follows the last whole stroke is less than one.
    whole = max(1, len(steps) // (2 * RAMPS))
    strokes = [float(np.sum(part)) for part in np.split(steps[: 2 * RAMPS * whole], whole)]
    return float(np.sqrt(np.mean(np.square(strokes))))


DRIFT: Final = RecordingError(
    "drift", "drift of the zero",
    "let the sensor warm up, shield it from draughts, and record short", columns=columns,
    share=8e-4, at_rest=True, amount=change_by_stroke,
)  # fmt: skip
"""Prior: 1 µm a stroke, of 1.23 mm, as a laser sensor's 0.01 to 0.03 % of its range for each kelvin."""
