"""What a fit is worth for choosing a name, each part of it worked out once."""

from __future__ import annotations

from types import SimpleNamespace
from typing import Any

import numpy as np
import pytest
from valve_sim.identification.selection.criteria import Criteria
from valve_sim.identification.selection.cross_validation import CrossValidation

from valve_sim.identification.selection import criteria
from valve_sim.identification.selection.residual_tests import SIGNIFICANT, Adequacy


class Made:
    """A fit of S = 100, of noise that discounts evidence by 2."""

    def __init__(self, p_value: float, rise: float | None) -> None:
        self.p_value, self.rise = p_value, rise
        self.score, self.problem = 100.0, SimpleNamespace(variance_inflation=2.0)
        self.asked = 0

    @property
    def evidence(self) -> float:
        self.asked += 1
        return 55.0


@pytest.fixture
def tested(monkeypatch: pytest.MonkeyPatch) -> list[str]:
    """What was worked out, in order."""
    done: list[str] = []

    def adequacy(result: Any) -> Adequacy:
        done.append("residual")
        return Adequacy(result.p_value, "made up", 0.0)

    def cross_validate(result: Any) -> CrossValidation | None:
        done.append("strokes left out")
        return None if result.rise is None else CrossValidation(np.zeros(3), result.rise, 3)

    monkeypatch.setattr(criteria, "adequacy", adequacy)
    monkeypatch.setattr(criteria, "cross_validate", cross_validate)
    return done


@pytest.mark.parametrize(
    ("p_value", "rise", "score"),
    [(1.01 * SIGNIFICANT, 60.0, 100.0), (SIGNIFICANT, 60.0, 130.0), (SIGNIFICANT, None, 100.0)],
)
def test_strokes_left_out_count_where_the_residual_is_not_white(
    tested: list[str], p_value: float, rise: float | None, score: float
) -> None:
    found, result = Criteria(), Made(p_value, rise)
    assert found.score(result) == score  # type: ignore[arg-type]
    assert tested == ["residual"] + ["strokes left out"] * (p_value == SIGNIFICANT)


def test_each_is_worked_out_once(tested: list[str]) -> None:
    found, result, other = Criteria(), Made(0.0, 60.0), Made(0.0, None)
    for _ in range(2):
        assert found.score(result) == 130.0  # type: ignore[arg-type]
        assert found.cross_validation(other) is None  # type: ignore[arg-type]
        assert found.evidence(result) == 55.0  # type: ignore[arg-type]
        assert not found.is_white(result)  # type: ignore[arg-type]
    assert tested == ["residual", "strokes left out", "strokes left out"]
    assert result.asked == 1
