"""Commissioning: the baseline of a monitored valve, and of its scores, from its first strokes."""

from __future__ import annotations

import math
from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from typing import Final

import numpy as np
from scipy.special import ndtri, stdtr

from valve_sim.identification.monitoring.command_timing import StrokeTiming, scatter_levels
from valve_sim.identification.monitoring.findings import StrokeRecord
from valve_sim.identification.monitoring.scores import SIZE, Baseline, commission, score_at_levels
from valve_sim.identification.monitoring.stroke_delays import delays_of
from valve_sim.model import Drive, EventKind, Valve, simulate
from valve_sim.recordings import Trace

CONTRADICTS: Final = 4.0
"""Standard errors by which the mean of commissioning scores is not 0."""
TOO_SPREAD: Final = 1.7
"""Standard deviation of twenty standard normal scores, beyond what one set in 10,000 has."""
LONGEST_OPENING: Final = 0.1
"""s: a valve that takes longer is taken to open in this time."""
LEAST_SPREAD: Final = 1.0
"""Standard deviation of a score under noise alone. Where the sensor is less noisy than declared, scores spread less (in
simulation by rounding only), and small differences are no change of the valve."""
LARGEST_SCORE: Final = 8.0
"""Standard deviations at which a score is clipped."""
FEWEST_TO_LEARN: Final = 8
"""Number of commissioning strokes with a score, from which its mean and spread are learned."""


@dataclass(frozen=True)
class ScoreBaseline:
    """The distribution of a score at commissioning; learned where it contradicts the standard normal one."""

    mean: float
    spread: float
    strokes: int
    is_learned: bool

    @classmethod
    def of(cls, name: str, scores: Sequence[float]) -> ScoreBaseline:
        """From the scores of one name in the commissioning strokes."""
        count = len(scores)
        if count < FEWEST_TO_LEARN:
            return cls(0.0, 1.0, count, False)
        mean, spread = float(np.mean(scores)), float(np.std(scores, ddof=1))
        # The size depends on the noise's variance, which is itself an estimate. Where the sensor is less noisy than
        # declared, it says no more than how many samples are in motion: what is within the declared noise is no change.
        is_learned = name == SIZE or abs(mean) * math.sqrt(count) > CONTRADICTS or spread > TOO_SPREAD
        return cls(max(mean, 0.0) if name == SIZE else mean, spread, count, is_learned)

    def standard(self, score: float) -> float:
        """The score, made standard normal."""
        if self.is_learned:
            quotient = (score - self.mean) / (max(self.spread, LEAST_SPREAD) * math.sqrt(1.0 + 1.0 / self.strokes))
            tail = float(stdtr(self.strokes - 1, -abs(quotient)))
            score = math.copysign(float(ndtri(max(tail, 1e-16))), quotient)
        return min(max(score, -LARGEST_SCORE), LARGEST_SCORE)


@dataclass(frozen=True)
class Commissioning:
    """The result of commissioning: the reference for all later strokes.

    Attributes:
        baseline: the valve.
        score_baselines: by the standard deviation of commands' times, s, then by name of the score.
        strokes: the delays of their commands.
    """

    baseline: Baseline
    score_baselines: Mapping[float, Mapping[str, ScoreBaseline]]
    strokes: tuple[StrokeTiming, ...]

    @property
    def levels(self) -> tuple[float, ...]:
        """The standard deviations, s, ascending."""
        return tuple(self.score_baselines)

    @property
    def names(self) -> tuple[str, ...]:
        """The names of all scores."""
        return tuple(
            dict.fromkeys(name for score_baselines in self.score_baselines.values() for name in score_baselines)
        )

    def standard(self, scores: Mapping[str, float], level: float) -> dict[str, float]:
        """Scores computed at a level, made standard normal; those without a baseline are left out."""
        score_baselines = self.score_baselines[level]
        return {
            name: score_baselines[name].standard(score) for name, score in scores.items() if name in score_baselines
        }


def commission_with(records: Sequence[StrokeRecord], declared: Valve, noise: float) -> Commissioning:
    """Estimate the baseline from strokes of a healthy valve.

    Raises:
        SimulationError: the declared valve cannot be simulated.
    """
    traces = [record.trace for record in records]
    baseline = commission(traces, declared, noise)
    levels = scatter_levels(baseline.jitter, _opening_seconds(baseline.valve))
    scored = [score_at_levels(trace, baseline, levels) for trace in traces]
    score_baselines = {level: _score_baselines([one[level].scores for one in scored]) for level in levels}
    return Commissioning(baseline, score_baselines, tuple(stroke_timing(record, baseline) for record in records))


def _score_baselines(table: Sequence[Mapping[str, float]]) -> dict[str, ScoreBaseline]:
    names = dict.fromkeys(name for scores in table for name in scores)
    return {name: ScoreBaseline.of(name, [scores[name] for scores in table if name in scores]) for name in names}


def stroke_timing(record: StrokeRecord, baseline: Baseline) -> StrokeTiming:
    """The delays of a stroke behind its commands."""
    volts = record.trace.drive.volts
    shifts = delays_of(record.trace, baseline.valve, baseline.lateness)
    return StrokeTiming(float(volts[np.argmax(np.abs(volts))]), shifts, record.arrival_spread)


def is_held_too_short(trace: Trace, valve: Valve) -> bool:
    """Whether a stroke was held open for less than half as long as was commanded.

    A valve that is just about to open then may or may not reach its stop: it is too uncertain when the voltage was off.
    """
    hold = float(trace.drive.times[-1] - trace.drive.times[0])
    # An offset of the clock is in both.
    opening, closing = delays_of(trace, valve, 0.0)
    return opening - closing > 0.5 * hold


def _opening_seconds(valve: Valve) -> float:
    """Seconds from a command at the reference voltage until the valve is open."""
    parameters = valve.parameters
    drive = Drive(np.zeros(1), np.array([parameters.reference_voltage]))
    opened = simulate(valve, drive, np.linspace(0.0, LONGEST_OPENING, 2)).first(EventKind.REACHED_STOP)
    return opened if math.isfinite(opened) else LONGEST_OPENING
