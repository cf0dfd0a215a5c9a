"""Diagnoses within a budget: what time is left for, and what is said of the rest."""

from __future__ import annotations

import io
import itertools
from collections.abc import Callable

import pytest
from plants.recording import Recorder, train_profile
from valve_sim.identification.selection.table import Hypothesis

from valve_sim.identification.diagnosis.run import diagnose
from valve_sim.identification.estimation.budget import Budget, OutOfTimeError, kept_for_writing
from valve_sim.identification.reporting.diagnosis_json import to_json
from valve_sim.identification.reporting.summary import summarise
from valve_sim.model import ValveError
from valve_sim.progress_lines import ProgressLines

from .test_run import DECLARED, measured

FRICTION = {"coulomb_friction": {"force": 0.05}}


def ticking() -> Callable[[], float]:
    """A clock on which every look takes a second, so that a budget counts simulations."""
    ticks = itertools.count()
    return lambda: float(next(ticks))


def test_a_part_has_its_share_and_no_more_than_what_surrounds_it() -> None:
    now = 0.0
    budget = Budget(10.0, lambda: now)
    with budget.until(0.5):
        now = 5.0
        budget.check()
        now = 5.1
        with pytest.raises(OutOfTimeError):
            budget.check()
        with budget.until(0.9), pytest.raises(OutOfTimeError):
            budget.check()
    budget.check()
    now = 10.1
    with pytest.raises(OutOfTimeError, match="budget of 10 s"):
        budget.check()


@pytest.mark.parametrize("seconds", [0.0, -1.0, float("nan")])
def test_no_time_at_all_is_refused(seconds: float) -> None:
    with pytest.raises(ValveError, match="above 0"):
        Budget(seconds, lambda: 0.0)


@pytest.mark.parametrize("seconds", [200.0, 600.0, 900.0])
def test_a_diagnosis_keeps_to_its_budget_and_says_what_it_left(seconds: float) -> None:
    trace = measured(FRICTION, train_profile(), Recorder(), 10)
    clock = ticking()
    found = diagnose([trace], [], DECLARED, budget=Budget(seconds, clock))
    assert clock() < 1.1 * seconds
    assert found.untried
    assert to_json(found)["untried"] == list(found.untried)
    assert not {str(Hypothesis(one.effects, one.timing)) for one in found.candidates} & set(found.untried)
    assert f"{len(found.untried)} left untried" in summarise(found)
    assert found.verdict.probability <= 0.5
    assert (found.verdict.kind, found.verdict.effects) == (
        ("insufficient", ()) if seconds < 300.0 else ("effects", ("coulomb_friction",))
    )
    assert found.after.train_rmse <= found.before.train_rmse


def test_with_time_enough_nothing_is_left_and_the_outcome_is_the_same() -> None:
    trace = measured(FRICTION, train_profile(), Recorder(), 10)
    unlimited = diagnose([trace], [], DECLARED)
    within = diagnose([trace], [], DECLARED, budget=Budget(1e6, ticking()))
    assert within.untried == ()
    assert to_json(within) == to_json(unlimited)


def test_a_budget_too_short_for_the_declared_model_is_an_error() -> None:
    trace = measured({}, train_profile(), Recorder(), 1)
    with pytest.raises(OutOfTimeError, match="give it more time"):
        diagnose([trace], [], DECLARED, budget=Budget(4.0, ticking()))


def test_more_is_kept_for_writing_on_a_busy_machine_and_never_all() -> None:
    assert kept_for_writing(120.0, 1.0) == pytest.approx(5.0)
    assert kept_for_writing(10.0, 1.0) == pytest.approx(4.0)
    assert kept_for_writing(120.0, 9.0) == pytest.approx(9.0)
    assert kept_for_writing(10.0, 1000.0) == pytest.approx(7.0)


def test_progress_is_a_line_for_each_wait() -> None:
    stream, times = io.StringIO(), iter([100.0, 110.0, 120.4])
    told = iter([("coulomb_friction", 0.1), ("coil_heating", 0.25)])

    def wait() -> bool:
        latest = next(told, None)
        if latest is not None:
            lines(*latest)
        return latest is None

    lines = ProgressLines(stream, wait, lambda: next(times), lambda what: what.replace("coil_heating", "compiling"))
    with lines:
        pass
    assert stream.getvalue().splitlines() == [
        "valve-sim: 10 s, 10 % done: coulomb_friction",
        "valve-sim: 20 s, 25 % done: compiling",
    ]
