"""Tables of scores that no simulator made."""

from __future__ import annotations

import numpy as np
from valve_sim.identification.selection.cross_validation import CrossValidation
from valve_sim.identification.selection.table import Hypothesis, Score, ScoreTable

BASE = Hypothesis(())
LOOK_ALIKES = {"a": ("b",), "b": ("a",), "c": ()}


def of(*effects: str, timing: bool = False) -> Hypothesis:
    return Hypothesis(tuple(sorted(effects)), timing)


def scored(
    hypothesis: Hypothesis,
    score: float,
    *,
    white: bool = True,
    claimable: bool = True,
    evidence: float | None = None,
    parameters: int | None = None,
    left_out: float | None = None,
    chi2: float | None = None,
    of_declared: float = 0.0,
    inflation: float = 1.0,
    of_recordings: float = 0.0,
    stamp_variance: float = 1.0,
) -> Score:
    """A score; `left_out`: the size of ten residuals of strokes that are left out in turn."""
    held = None if left_out is None else CrossValidation(np.full(10, left_out), 10.0 * left_out**2, 2)
    return Score(
        hypothesis, score, score if evidence is None else evidence,
        2 + len(hypothesis.effects) if parameters is None else parameters, white, claimable,
        inflation, score if chi2 is None else chi2, of_declared, cross_validation=lambda: held,
        of_recordings=of_recordings, stamp_variance=stamp_variance,
    )  # fmt: skip


def table(*scores: Score, screened: dict[str, float] | None = None) -> ScoreTable:
    return ScoreTable({one.hypothesis: one for one in scores}, LOOK_ALIKES, screened or {})
