"""With which period a force acts that repeats itself over the stroke or over time: a periodogram of the residual.

For each period, a small cosine and a small sine of force are simulated; what the residual of a fit has in common with
their effects, once what is fitted anyway is taken out of these, is by how much such a force would lower χ²: theory,
eq. (53).
"""

from __future__ import annotations

import math
from collections.abc import Callable
from typing import Final, NamedTuple

import numpy as np

from valve_sim.identification.estimation.gram import gram
from valve_sim.identification.estimation.parallel import run_parallel
from valve_sim.identification.estimation.result import Fit
from valve_sim.identification.plants.protocol import Array, ForceMap
from valve_sim.model import SimulationError

FEWEST_CYCLES, MOST_CYCLES = 2.0, 250.0
"""Over the range of the variable."""
MOST_OVER_STROKE: Final = 15.0
"""Cycles over a stroke: of shorter ones a fast plunger feels nothing."""
STEP: Final = 1.0 / 3.0
"""Cycles between two periods that are tried."""
AMPLITUDE: Final = 1e-3
"""N, of the small forces."""
TRIED: Final = 3
"""So many of the largest peaks are fitted."""


class Period(NamedTuple):
    """A period, how far off it may be (one standard deviation), in the variable's unit, and what it gains of χ²."""

    length: float
    sigma: float
    gain: float


def likely_periods(choice: ForceMap, base: Fit) -> list[Period]:
    """The periods of a force beside a fit that would lower its χ² most, best first.

    Raises:
        OutOfTimeError: the time is used up.
    """
    span = choice.high - choice.low
    most = MOST_OVER_STROKE if choice.unit == "m" else MOST_CYCLES
    cycles = np.arange(FEWEST_CYCLES, most, STEP)
    gain = _gain_of(choice, base)
    gains = np.array(run_parallel(lambda count: gain(span / count), cycles.tolist()))
    padded = np.concatenate([[-math.inf], gains, [-math.inf]])
    peaks = np.flatnonzero((gains >= padded[:-2]) & (gains >= padded[2:]))
    best = sorted(peaks, key=lambda peak: -gains[peak])[:TRIED]
    return [
        Period(span / float(cycles[peak]), span * STEP / float(cycles[peak]) ** 2, float(gains[peak])) for peak in best
    ]


def _gain_of(choice: ForceMap, base: Fit) -> Callable[[float], float]:
    """The decrease of χ² by a small force of a period."""
    problem, values = base.problem, base.values
    anyway = base.information
    # A plunger that rests is lifted by the smallest force, or not at all: nothing of that is linear.
    moves = ~np.concatenate([channel.quiet for channel in problem.plant.channels])
    angles = 2.0 * np.pi * np.arange(len(choice.coefficients)) / len(choice.coefficients)
    shapes = [
        dict(zip(choice.coefficients, AMPLITUDE * wave, strict=True)) for wave in (np.cos(angles), np.sin(angles))
    ]

    def column(period: float, shape: dict[str, float]) -> Array:
        there = problem.residuals({**values, **choice.with_period(period).held, **shape})
        return np.where(moves, there - base.residuals, 0.0) / AMPLITUDE

    def gain(period: float) -> float:
        try:
            columns = np.column_stack([column(period, shape) for shape in shapes])
        except SimulationError:
            return 0.0
        shared = gram(base.jacobian, columns)
        own = gram(columns, columns) - shared.T @ np.linalg.lstsq(anyway, shared, rcond=1e-13)[0]
        slope = gram(columns, base.residuals)
        return float(slope @ np.linalg.lstsq(own, slope, rcond=1e-10)[0])

    return gain
