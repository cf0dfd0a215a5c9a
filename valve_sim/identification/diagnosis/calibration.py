"""Probabilities of verdicts, calibrated on the campaign: theory, eq. (58).

Evidence compares the hypotheses that were tried and ignores those that nobody thought of: a share of it is no
probability. How often claims with such shares were right on blind recordings turns it into one (Platt,
Advances in Large Margin Classifiers, 1999): p = 1 / (1 + exp(−(a + b ln(share / (1 − share))))).

`python -m benchmarks.campaign.calibrate results.jsonl` fits a and b to what
`python -m benchmarks.campaign --seeds 10 --json results.jsonl` wrote; docs/how_to/diagnosis.md shows how good they are.
"""

from __future__ import annotations

import math
from collections.abc import Mapping
from typing import Final, NamedTuple


class Platt(NamedTuple):
    """Of one kind of claim: the offset and the slope of its log odds."""

    offset: float
    slope: float


CALIBRATION: Final[Mapping[str, Platt]] = {"none": Platt(2.612, 1.876), "effects": Platt(-0.488, 0.569)}
"""By kind of verdict; from 204 claims that nothing is missing and 167 of effects (2026)."""
MOST_CERTAIN: Final = 1e-4
"""Shares are clipped to this distance from 0 and 1."""


def log_odds(share: float) -> float:
    """Of a share, from 0 to 1, of the evidence."""
    share = min(max(share, MOST_CERTAIN), 1.0 - MOST_CERTAIN)
    return math.log(share / (1.0 - share))


def calibrated(kind: str, share: float) -> float:
    """The probability that a claim of this kind ("none" or "effects") with this share of the evidence is right."""
    offset, slope = CALIBRATION[kind]
    return 1.0 / (1.0 + math.exp(-(offset + slope * log_odds(share))))
