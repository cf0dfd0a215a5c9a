"""Diagnoses within a budget, which is counted in simulated strokes: what was left untried, and what is said of it."""

from __future__ import annotations

import math

import pytest
from plants.recording import Recorder, train_profile

from valve_sim.identification.diagnosis.run import Diagnosis, diagnose_plant
from valve_sim.identification.fit.budget import DERIVATIVES, STROKES_A_SECOND, Budget
from valve_sim.identification.reporting.claims import summarise
from valve_sim.identification.reporting.diagnosis_document import diagnosis_document
from valve_sim.model import ValveError

from ..recordings import Short
from .test_run import DECLARED, measured

FRICTION = {"coulomb_friction": {"force": 0.05}}
FEW = ["coulomb_friction", "squeeze_film", "stiction", "quadratic_drag", "drive_gain", "coil_lag"]


def test_work_is_counted_by_strokes_and_derivatives() -> None:
    budget = Budget(10.0)
    budget.count(5)
    assert (budget.spent, budget.is_used_up) == (5.0, False)
    budget.count(1, derivatives=4 * DERIVATIVES)
    assert (budget.spent, budget.is_used_up) == (10.0, True)
    assert Budget.of_seconds(120.0).strokes == 120.0 * STROKES_A_SECOND
    endless = Budget.unlimited()
    endless.count(10**12)
    assert not endless.is_used_up


@pytest.mark.parametrize("work", [0.0, -1.0, math.nan])
def test_no_work_at_all_is_refused(work: float) -> None:
    for made in (Budget, Budget.of_seconds):
        with pytest.raises(ValveError, match="above 0"):
            made(work)


@pytest.fixture(scope="module")
def plant() -> Short:
    return Short([measured(FRICTION, train_profile(), Recorder(sample_rate=5e3), 10)], DECLARED, FEW)


@pytest.fixture(scope="module")
def whole(plant: Short) -> Diagnosis:
    """A diagnosis without a budget."""
    return diagnose_plant(plant, None)


@pytest.mark.long
@pytest.mark.parametrize("strokes", [1.0, 6000.0])
def test_a_diagnosis_keeps_to_its_budget_and_says_what_it_left(strokes: float, plant: Short, whole: Diagnosis) -> None:
    """What is begun is ended, and the declared model is always fitted; what is left claims nothing more surely."""
    found = diagnose_plant(plant, None, budget=Budget(strokes))
    assert found.untried
    assert found.work < whole.work
    assert found.allowed == strokes
    assert diagnosis_document(found).to_json()["untried"] == list(found.untried)
    due = len(found.untried) - len(found.impossible)
    assert f"{due} sets were not tried, because the budget ended: " in summarise(found)
    assert found.verdict.probability <= whole.verdict.probability + 1e-3
    assert found.after.train_rmse <= found.before.train_rmse


@pytest.mark.long
def test_with_work_enough_nothing_is_left_and_the_outcome_is_the_same(plant: Short, whole: Diagnosis) -> None:
    within = diagnose_plant(plant, None, budget=Budget(1e6))
    assert within.untried == ()
    assert within.work == whole.work
    first, second = diagnosis_document(whole).to_json(), diagnosis_document(within).to_json()
    assert first.keys() == second.keys()
    assert {name for name in first if first[name] != second[name]} <= {"budget", "work", "allowed"}
