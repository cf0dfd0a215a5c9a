"""The alarm of a monitor: CUSUM over strokes, with a stated rate of false alarms. Theory, eqs. (66) to (69).

Each stroke gives scores that are standard normal while nothing has changed. A cumulative sum after Page (Biometrika 41,
1954, p. 100) watches each, upwards and downwards:

    S ← max(0, S + min(score, SCORE_LIMIT) − reference)        alarm at S > threshold, after which all sums start again.

The threshold follows from the wanted mean number of strokes between false alarms by Siegmund's approximation
(Sequential Analysis, 1985, section 2.6), shared out evenly among all sums (Bonferroni): scores of related effects rise
together, so that alarms are rarer than stated, not more frequent. A score is clipped at `SCORE_LIMIT`, so that one bad
stroke, such as a command that the network held up, never raises an alarm by itself (Lucas and Crosier, Communications
in Statistics A 11, 1982, p. 2669).
"""

from __future__ import annotations

import math
from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from typing import Final, NamedTuple

CHANGE: Final = 2.0
"""Standard deviations per stroke: the shift that the sums are tuned to."""
SCORE_LIMIT: Final = 4.5
"""Standard deviations at which the score of one stroke is clipped: below every threshold."""
OVERSHOOT: Final = 1.166
"""Siegmund's correction for a random walk observed once a stroke only."""


FELL: Final = " −"
"""Behind the name of a score that fell."""


class Alarm(NamedTuple):
    """An alarm that was raised.

    Attributes:
        cause: name of the score, with " −" behind it where it fell. began: index of the first stroke of its rise.
        raised: index of the stroke that raised it.
    """

    cause: str
    began: int
    raised: int


def mean_run(threshold: float, reference: float) -> float:
    """Mean number of strokes between false alarms of one sum, after Siegmund."""
    reach = 2.0 * reference * (threshold + OVERSHOOT)
    return (math.exp(min(reach, 700.0)) - reach - 1.0) / (2.0 * reference**2)


def threshold_for(run: float, reference: float) -> float:
    """The threshold of one sum that gives this mean number of strokes between false alarms."""
    low, high = 0.0, 1000.0
    for _ in range(60):
        middle = 0.5 * (low + high)
        low, high = (middle, high) if mean_run(middle, reference) < run else (low, middle)
    return high


def likeliest_change(scores: Sequence[float]) -> int:
    """Index of the score from which on the mean most likely is another than 0, all of spread 1.

    The likelihood of a change with stroke k, its size unknown, is largest where (Σ scores from k on)²/count is.
    """
    sums = [math.fsum(scores[first:]) ** 2 / (len(scores) - first) for first in range(len(scores))]
    return max(range(len(sums)), key=sums.__getitem__) if sums else 0


class Sums:
    """Cumulative sums, up and down, for each named score.

    Args:
        run: wanted mean number of strokes between false alarms, of all sums together.
        names: of the scores. one_sided: those of them of which only a rise matters.
        learned: number of strokes from which a score's zero was learned. Its standard error 1/√learned
            is a bias of every later stroke; the reference value is higher by two such standard errors.
    """

    def __init__(self, run: float, names: Sequence[str], learned: int, one_sided: Sequence[str] = ()) -> None:
        self.reference = 0.5 * CHANGE + 2.0 / math.sqrt(learned)
        self._sums = {name: _Sum() for name in names}
        self._sums.update({f"{name}{FELL}": _Sum() for name in names if name not in one_sided})
        self.threshold = max(SCORE_LIMIT, threshold_for(run * len(self._sums), 0.5 * CHANGE))

    def __contains__(self, name: str) -> bool:
        """Whether a score of this name is watched."""
        return name in self._sums

    @property
    def largest(self) -> tuple[str, float]:
        """Name and height of the highest sum; of equal ones, the one that would be highest if no score were clipped."""
        name = max(self._sums, key=lambda name: (self._sums[name].height, self._sums[name].uncut))
        return name, self._sums[name].height

    def add(self, index: int, scores: Mapping[str, float]) -> Alarm | None:
        """Add the scores of one stroke; the alarm, if that raises one."""
        for name, score in scores.items():
            self._sums[name].add(index, score, self.reference)
            if f"{name}{FELL}" in self._sums:
                self._sums[f"{name}{FELL}"].add(index, -score, self.reference)
        cause, height = self.largest
        if height <= self.threshold:
            return None
        alarm = Alarm(cause, self._sums[cause].began, index)
        self._sums = {name: _Sum() for name in self._sums}
        return alarm


@dataclass
class _Sum:
    """One cumulative sum, and the stroke at which it left zero."""

    height: float = 0.0
    uncut: float = 0.0
    began: int = 0

    def add(self, index: int, score: float, reference: float) -> None:
        if self.height == 0.0:
            self.began, self.uncut = index, 0.0
        self.height = max(0.0, self.height + min(score, SCORE_LIMIT) - reference)
        self.uncut += score
