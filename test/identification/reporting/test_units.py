"""Numbers as people read them, and what is said where two of them seem to disagree."""

from __future__ import annotations

import pytest

from valve_sim.identification.fit.intervals import Interval, Unbounded
from valve_sim.identification.reporting.units import signed
from valve_sim.identification.reporting.values import remark_on


@pytest.mark.parametrize(("value", "words"), [(1.25, "+1.250"), (-0.428, "−0.428"), (-0.0004, "0.000"), (0.0, "0.000")])
def test_a_minus_is_always_the_same_sign_and_nothing_has_none(value: float, words: str) -> None:
    assert signed(value, 3) == words


@pytest.mark.parametrize("found", [Interval(0.77919, 0.00081, 0.7626, 0.7872), Interval(4.147, 0.089, 3.678, 4.6)])
def test_an_interval_that_its_standard_error_does_not_explain_is_explained(found: Interval) -> None:
    assert "one standard error" in remark_on(found)
    assert "use the interval" in remark_on(found)


def test_an_interval_as_its_standard_error_says_needs_no_words() -> None:
    assert remark_on(Interval(1.0, 0.1, 0.81, 1.2)) == ""
    assert "flat" in remark_on(Interval(1.0, 0.1, 0.0, 9.0, Unbounded.FLAT_PROFILE))
