"""Every finding of a fit has a sentence with its numbers, in the units that people read."""

from __future__ import annotations

import math

import pytest

from valve_sim.identification.fit.findings import (
    Correlated,
    ExplainedByErrors,
    Finding,
    LacksSomething,
    LooselyDetermined,
    NotConverged,
    NotIdentifiable,
    OnBound,
    StampErrors,
)
from valve_sim.identification.fit.intervals import Interval, Unbounded
from valve_sim.identification.fit.static_force import (
    BeginsLate,
    EndsEarly,
    Opening,
    StartOfMotion,
    StaticFinding,
)
from valve_sim.identification.reporting.finding_sentences import remarks
from valve_sim.identification.reporting.values import interval_json, remark_on

NEVER = Opening(9.0, math.nan, math.nan)
HALF_WAY = Opening(9.0, 5.3e-3, math.nan)
OPENS = Opening(9.0, 5.3e-3, 9.9e-3)
SENTENCES: list[tuple[Finding | StaticFinding, list[str]]] = [
    (NotIdentifiable("main_damping", Unbounded.FLAT_PROFILE), ["main_damping is not identifiable", "profile is flat"]),
    (NotIdentifiable("tau", Unbounded.MAY_BE_INFINITE), ["tau is not identifiable", "too long to be seen"]),
    (OnBound("pilot_damping", "lower"), ["pilot_damping is on its lower bound"]),
    (LooselyDetermined("pilot_damping", 0.5, 1.5, "N·s/m"), ["is determined only loosely", "0.5 to 1.5 N·s/m"]),
    (Correlated("seat_load", "pilot_damping", 0.99512), ["seat_load and pilot_damping", "correlation 0.9951"]),
    (StampErrors(51.2e-6), ["up to 51.2 µs"]),
    (LacksSomething(0.987), ["lacks something", "99 %", "`diagnose`"]),
    (ExplainedByErrors(), ["with these errors of the recording", "`diagnose`"]),
    (NotConverged(), ["did not converge"]),
    (BeginsLate(2e-4), ["begins at 200 µm"]),
    (EndsEarly(1e-3, 1.23e-3), ["ends at 1000 µm of 1230 µm"]),
    (StartOfMotion(None, NEVER, None), ["without a constant term", "never opens at 9 V"]),
    (StartOfMotion(Interval(0.1, 0.1, -0.1, 0.3), OPENS, NEVER), ["cannot be told from 0", "-0.1 to 0.3 N", "9.90 ms"]),
    (StartOfMotion(Interval(3.0, 0.1, 2.8, 3.2), HALF_WAY, NEVER), ["a0 = 3 N starts", "5.30 ms and never reaches"]),
    (StartOfMotion(None, OPENS._replace(has_one_plunger=True), None), ["the plunger leaves its seat at 5.30 ms"]),
]


@pytest.mark.parametrize(("finding", "parts"), SENTENCES, ids=lambda value: type(value).__name__)
def test_a_finding_has_a_sentence_with_its_numbers(finding: Finding | StaticFinding, parts: list[str]) -> None:
    (sentence,) = remarks([finding])
    assert sentence.endswith(".")
    assert [part for part in parts if part not in sentence] == []


def test_an_interval_that_the_data_do_not_bound_says_why() -> None:
    assert remark_on(Interval(1.0, 0.1, 0.8, 1.2)) == ""
    assert "remark" not in interval_json(Interval(1.0, 0.1, 0.8, 1.2))
    for reason in Unbounded:
        entry = interval_json(Interval(1.0, math.inf, 0.0, math.inf, reason))
        assert entry["remark"]
        assert entry["ci95"] == [0.0, None]
