"""With which period a force acts that repeats itself over the stroke or over time: a periodogram of the residual.

For each period, small waves of force with phases all around are simulated. What the residual of a fit has in common
with the effects of two neighbouring phases, none of them taken negative, once what is fitted anyway is taken out of
these, is by how much such a force would lower χ²: theory, eq. (53). A plunger that rests on its seat is lifted by half
of each wave and by nothing of the other: there a wave and the same wave upside down have other effects, but twice the
wave has twice the effect.
"""

from __future__ import annotations

import math
from collections.abc import Callable, Sequence
from itertools import zip_longest
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
"""N, of the small waves."""
PHASES: Final = 8
"""So many of them for each period. With four, and eight about the highest peaks alone, a vibration that throws the
plunger off its seat is missed: held out 1.84 in place of 0.99 µm in `uncatalogued:7` of the campaign."""
TRIED: Final = 7
"""So many of the largest peaks are fitted, of all samples and of those in motion."""


class Period(NamedTuple):
    """A period, how far off it may be (one standard deviation), and the wave of it that would lower χ² most.

    Attributes:
        length, sigma: in the variable's unit. gain: of χ². wave: coefficients of the force map, N.
    """

    length: float
    sigma: float
    gain: float
    wave: dict[str, float]


class _Wave(NamedTuple):
    """By how much a wave would lower χ², and its parts of each phase, N."""

    gain: float
    parts: Array


NO_WAVE: Final = _Wave(0.0, np.zeros(PHASES))


def likely_periods(choice: ForceMap, *bases: Fit) -> list[list[Period]]:
    """For each fit the periods of a force beside it that would lower its χ² most.

    They are taken by turns from all samples and from those in motion. Each of both leads astray at times: what a
    resting plunger does is not linear, and of a weak force of a high frequency only what lifts a resting plunger is to
    be seen.

    Args:
        choice: a force map that repeats itself.
        bases: fits to the same data that differ in nothing that matters to what a wave does: waves are simulated once,
            beside the first.
    """
    span = choice.high - choice.low
    most = MOST_OVER_STROKE if choice.unit == "m" else MOST_CYCLES
    cycles = np.arange(FEWEST_CYCLES, most, STEP)
    shapes = _shapes(len(choice.coefficients))
    best_waves = _best_waves_of(choice, bases, shapes)
    waves = run_parallel(lambda count: best_waves(span / count), cycles.tolist())
    return [_periods(choice, cycles, shapes, of_base) for of_base in zip(*waves, strict=True)]


def _periods(choice: ForceMap, cycles: Array, shapes: Array, waves: Sequence[tuple[_Wave, ...]]) -> list[Period]:
    """The highest peaks of the waves of each period, by turns of those by all samples and by those in motion."""
    span = choice.high - choice.low
    peaks = [_peaks(np.array([wave.gain for wave in of_samples])) for of_samples in zip(*waves, strict=True)]
    by_turns = [(peak, samples) for same_rank in zip_longest(*peaks) for samples, peak in enumerate(same_rank)]
    found = {peak: waves[peak][samples] for peak, samples in reversed(by_turns) if peak is not None}
    return [
        Period(
            span / float(cycles[peak]), span * STEP / float(cycles[peak]) ** 2, found[peak].gain,
            dict(zip(choice.coefficients, (shapes @ found[peak].parts).tolist(), strict=True)),
        )
        for peak in reversed(found)
    ]  # fmt: skip


def _peaks(gains: Array) -> list[int]:
    """Indices of the largest peaks, the highest first."""
    padded = np.concatenate([[-math.inf], gains, [-math.inf]])
    peaks: list[int] = np.flatnonzero((gains >= padded[:-2]) & (gains >= padded[2:])).tolist()
    return sorted(peaks, key=lambda peak: -float(gains[peak]))[:TRIED]


def _shapes(count: int) -> Array:
    """(count, PHASES) coefficients of a wave of each phase."""
    along = np.arange(count) / count
    return np.asarray(np.cos(2.0 * np.pi * (along[:, None] - np.arange(PHASES) / PHASES)))


def _best_waves_of(
    choice: ForceMap, bases: Sequence[Fit], shapes: Array
) -> Callable[[float], tuple[tuple[_Wave, ...], ...]]:
    """The waves of a period that would lower χ² most, beside each fit: by all samples, and by those in motion."""
    (first, *_), problem = bases, bases[0].problem
    small = [dict(zip(choice.coefficients, AMPLITUDE * shape, strict=True)) for shape in shapes.T]
    moves = ~np.concatenate([channel.quiet for channel in problem.plant.channels])
    pulls = [gram(base.jacobian, base.residuals) for base in bases]
    left: list[Array] = [
        np.asarray(np.linalg.lstsq(base.information, pull, rcond=1e-13)[0], dtype=np.float64)
        for base, pull in zip(bases, pulls, strict=True)
    ]

    def column(period: float, shape: dict[str, float]) -> Array:
        there = problem.residuals({**first.values, **choice.with_period(period).held, **shape})
        return np.asarray((there - first.residuals) / AMPLITUDE)

    def best(base: Fit, taken: Array, columns: Array) -> _Wave:
        shared = gram(base.jacobian, columns)
        own = gram(columns, columns) - shared.T @ np.linalg.lstsq(base.information, shared, rcond=1e-13)[0]
        return best_wave(own, gram(columns, base.residuals) - shared.T @ taken)

    def waves(period: float) -> tuple[tuple[_Wave, ...], ...]:
        try:
            columns = np.column_stack([column(period, shape) for shape in small])
        except SimulationError:
            return ((NO_WAVE, NO_WAVE),) * len(bases)
        moving = np.where(moves[:, None], columns, 0.0)
        return tuple(
            (best(base, taken, columns), best(base, taken, moving)) for base, taken in zip(bases, left, strict=True)
        )

    return waves


def best_wave(own: Array, slope: Array) -> _Wave:
    """The parts a ≥ 0 of two neighbouring phases that minimise aᵀ own a + 2 slopeᵀ a.

    Args:
        own: (PHASES, PHASES) information on the parts, all else at its best. slope: (PHASES,) half of that of χ².
    """
    best = NO_WAVE
    for first in range(PHASES):
        two = [first, (first + 1) % PHASES]
        for chosen in (two, two[:1]):
            size = np.linalg.lstsq(own[np.ix_(chosen, chosen)], -slope[chosen], rcond=1e-10)[0]
            gain = -float(slope[chosen] @ size)
            if gain > best.gain and np.all(size >= 0.0):
                parts = np.zeros(PHASES)
                parts[chosen] = size
                best = _Wave(gain, parts)
    return best
