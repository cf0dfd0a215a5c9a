"""What follows the strokes, and what is drawn for each: by NumPy's draws."""

from __future__ import annotations

import numpy as np

from valve_sim.identification.fit.changes import change_over

STROKES, ERRORS = np.arange(8.0), np.full(8, 0.03)


def test_a_line_and_a_step_are_told_apart() -> None:
    noise = 0.03 * np.random.default_rng(1).standard_normal(8)
    line, step = (change_over(STROKES, shape + noise, ERRORS) for shape in (0.2 * STROKES - 0.7, (STROKES > 4) - 0.4))
    assert line is not None and line.kind == "line"
    assert abs(line.last - line.first - 1.4) < 0.1
    assert step is not None and (step.kind, step.strokes) == ("step", (5,))
    assert abs(step.last - step.first - 1.0) < 0.1


def test_draws_follow_the_strokes_once_in_five_hundred() -> None:
    """A chance of 1e-3 each for a line, for any of the steps, and for being in some alone."""
    random = np.random.default_rng(2)
    for errors in (0.01, 0.1, 0.3):
        found = [change_over(STROKES, own, np.full(8, errors)) for own in random.standard_normal((2000, 8))]
        assert sum(own is not None for own in found) <= 12


def test_what_is_in_some_strokes_alone_is_told() -> None:
    noise = 0.03 * np.random.default_rng(3).standard_normal(8)
    there = np.isin(STROKES, (1, 4, 5, 7))
    found = change_over(STROKES, np.where(there, 1.0, -1.0) + noise, ERRORS)
    assert found is not None and (found.kind, found.strokes) == ("some", (1, 4, 5, 7))
    assert found.others == (0, 2, 3, 6)
    assert change_over(STROKES, np.where(there, 0.4, -0.4) + noise, ERRORS) is None


def test_few_strokes_and_equal_ones_say_nothing() -> None:
    assert change_over(STROKES[:4], STROKES[:4], ERRORS[:4]) is None
    assert change_over(STROKES, np.zeros(8), ERRORS) is None
