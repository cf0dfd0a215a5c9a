"""The first strokes of a monitored valve: what it is while healthy, and what its scores are then."""

from __future__ import annotations

import math
from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from typing import Final

import numpy as np
from scipy.special import ndtri, stdtr

from valve_sim.identification.monitoring.command_timing import TimedStroke, allowed_scatters
from valve_sim.identification.monitoring.scores import SIZE, Baseline, commission, late_by, score_stroke
from valve_sim.identification.monitoring.segmenter import StrokeRecord
from valve_sim.model import Drive, EventKind, Valve, simulate
from valve_sim.traces import Trace

CONTRADICTS: Final = 4.0
"""Standard errors by which the mean of commissioning scores is not 0."""
TOO_SPREAD: Final = 1.7
"""Standard deviation of twenty standard normal scores, beyond what one set in 10,000 has."""
LONGEST_OPENING: Final = 0.1
"""s: a valve that takes longer is taken to open in this time."""
LEAST_SPREAD: Final = 1.0
"""Standard deviation of a score under noise alone. Where the sensor is less noisy than declared, scores spread by less,
and by nothing but rounding where it is simulated; what they then differ by is no change of the valve."""
SCORED_MOST: Final = 8.0
"""Standard deviations: the most that a score says."""
FEWEST_TO_LEARN: Final = 8
"""Commissioning strokes that show a direction, from which its mean and spread are learned."""


@dataclass(frozen=True)
class ScoreBaseline:
    """What a score was while the valve was commissioned; learned where that contradicts a standard normal one."""

    mean: float
    spread: float
    strokes: int
    is_learned: bool

    @classmethod
    def of(cls, name: str, scores: Sequence[float]) -> ScoreBaseline:
        """From the scores of one name, of strokes that are taken for healthy."""
        count = len(scores)
        if count < FEWEST_TO_LEARN:
            return cls(0.0, 1.0, count, False)
        mean, spread = float(np.mean(scores)), float(np.std(scores, ddof=1))
        # The size depends on the noise's variance, which is itself an estimate.
        is_learned = name == SIZE or abs(mean) * math.sqrt(count) > CONTRADICTS or spread > TOO_SPREAD
        return cls(mean, spread, count, is_learned)

    def standard(self, score: float) -> float:
        """The score as a standard normal one."""
        if self.is_learned:
            quotient = (score - self.mean) / (max(self.spread, LEAST_SPREAD) * math.sqrt(1.0 + 1.0 / self.strokes))
            tail = float(stdtr(self.strokes - 1, -abs(quotient)))
            score = math.copysign(float(ndtri(max(tail, 1e-16))), quotient)
        return min(max(score, -SCORED_MOST), SCORED_MOST)


@dataclass(frozen=True)
class Commissioning:
    """What the first strokes have shown.

    Attributes:
        healthy: the valve.
        baselines: by the standard deviation that commands' times are allowed, s, then by name: scores while healthy.
        strokes: when they obeyed their commands.
    """

    healthy: Baseline
    baselines: Mapping[float, Mapping[str, ScoreBaseline]]
    strokes: tuple[TimedStroke, ...]

    @property
    def levels(self) -> tuple[float, ...]:
        """The standard deviations, s, ascending."""
        return tuple(self.baselines)

    @property
    def names(self) -> tuple[str, ...]:
        """Of all scores."""
        return tuple(dict.fromkeys(name for baselines in self.baselines.values() for name in baselines))

    def standard(self, scores: Mapping[str, float], level: float) -> dict[str, float]:
        """Scores made with a level, as standard normal ones; those that commissioning has not seen are left out."""
        baselines = self.baselines[level]
        return {name: baselines[name].standard(score) for name, score in scores.items() if name in baselines}


def commission_with(records: Sequence[StrokeRecord], declared: Valve, noise: float) -> Commissioning:
    """Take strokes for healthy.

    Args:
        records: the strokes.
        declared: the valve as declared.
        noise: standard deviation of the position sensor, m; 0 to estimate it.

    Raises:
        SimulationError: the declared valve cannot be simulated.
    """
    traces = [record.trace for record in records]
    healthy = commission(traces, declared, noise)
    levels = allowed_scatters(healthy.jitter, _opening_seconds(healthy.valve))
    tables = {level: [score_stroke(trace, healthy, level).scores for trace in traces] for level in levels}
    baselines = {level: _baselines(table) for level, table in tables.items()}
    return Commissioning(healthy, baselines, tuple(timed_stroke(record, healthy) for record in records))


def _baselines(table: Sequence[Mapping[str, float]]) -> dict[str, ScoreBaseline]:
    names = dict.fromkeys(name for scores in table for name in scores)
    return {name: ScoreBaseline.of(name, [scores[name] for scores in table if name in scores]) for name in names}


def timed_stroke(record: StrokeRecord, healthy: Baseline) -> TimedStroke:
    """When a stroke obeyed its commands."""
    volts = record.trace.drive.volts
    shifts = late_by(record.trace, healthy.valve, healthy.lateness)
    return TimedStroke(float(volts[np.argmax(np.abs(volts))]), shifts, record.arrival_spread)


def came_together(trace: Trace, valve: Valve) -> bool:
    """Whether a stroke was held open for less than half as long as it was commanded.

    A valve that is just about to open then may or may not reach its stop: too little is known of when the voltage went.
    """
    hold = float(trace.drive.times[-1] - trace.drive.times[0])
    # What a clock is off by is in both.
    opening, closing = late_by(trace, valve, 0.0)
    return opening - closing > 0.5 * hold


def _opening_seconds(valve: Valve) -> float:
    """Seconds from a command at the reference voltage until the valve is open."""
    parameters = valve.parameters
    drive = Drive(np.zeros(1), np.array([parameters.reference_voltage]))
    opened = simulate(valve, drive, np.linspace(0.0, LONGEST_OPENING, 2)).first(EventKind.REACHED_STOP)
    return opened if math.isfinite(opened) else LONGEST_OPENING
