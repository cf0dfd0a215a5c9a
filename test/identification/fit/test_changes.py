"""What follows the strokes, and what is drawn for each: by NumPy's draws."""

from __future__ import annotations

import numpy as np

from valve_sim.identification.fit.changes import change_over

STROKES = np.arange(8.0)


def test_a_line_and_a_step_are_told_apart() -> None:
    noise = 0.03 * np.random.default_rng(1).standard_normal(8)
    line, step = change_over(STROKES, 0.2 * STROKES - 0.7 + noise), change_over(STROKES, (STROKES > 4) - 0.4 + noise)
    assert line is not None and line.kind == "line"
    assert abs(line.last - line.first - 1.4) < 0.1
    assert step is not None and (step.kind, step.stroke) == ("step", 5)
    assert abs(step.last - step.first - 1.0) < 0.1


def test_draws_follow_the_strokes_once_in_five_hundred() -> None:
    """A chance of 1e-3 each for a line and for any of the steps."""
    random = np.random.default_rng(2)
    found = sum(change_over(STROKES, random.standard_normal(8)) is not None for _ in range(5000))
    assert found <= 20


def test_few_strokes_and_equal_ones_say_nothing() -> None:
    assert change_over(STROKES[:4], STROKES[:4]) is None
    assert change_over(STROKES, np.zeros(8)) is None
