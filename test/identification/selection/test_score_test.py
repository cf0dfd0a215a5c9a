"""What one step would gain, against what a refit gains."""

from __future__ import annotations

import pytest

from benchmarks.campaign.cases import draw_case
from benchmarks.campaign.running import as_trace
from identification.selection.test_held_out import recorded
from valve_sim.identification.estimation.problem import Problem
from valve_sim.identification.estimation.solver import fit
from valve_sim.identification.plants.valve import ValvePlant
from valve_sim.identification.selection.score_test import score_gains


@pytest.mark.parametrize(
    "values", [{}, {"ramp_slope": 0.05}, {"sag_depth": 0.3}, {"ramp_slope": 1.0, "sag_depth": 6.0}]
)
def test_the_gain_of_a_linear_effect_is_that_of_its_refit(values: dict[str, float]) -> None:
    problem = Problem(recorded(7, **values))
    base = fit(problem, ("gain",), {})
    for name, gain in score_gains(base).items():
        refitted = fit(problem, ("gain", *problem.plant.effects[name].free_names()), {})
        assert gain == pytest.approx(base.score - refitted.score, rel=1e-3, abs=0.05)


def test_what_is_in_the_fit_is_not_tested_again() -> None:
    problem = Problem(recorded(7, ramp_slope=1.0))
    assert set(score_gains(fit(problem, ("gain", "ramp.slope"), {}))) == {"sag"}


def test_an_effect_gains_by_taking_the_place_of_a_declared_value_that_is_far_out_of_its_tolerance() -> None:
    """A coil time constant 5 tolerances above the declared one: coil_lag is the same thing without the tolerance."""
    case = draw_case("wrong_value", 12)
    train, _ = case.recordings()
    problem = Problem(ValvePlant([as_trace(train, "train")], case.declared))
    plant = problem.plant
    base = fit(problem, plant.base, {}, nuisances=plant.nuisances)
    refitted = fit(
        problem,
        (*plant.base, "coil_lag.time_constant"),
        {"coil_lag.time_constant": 2e-4},
        nuisances=plant.nuisances,
    )
    gains = score_gains(base)
    assert 0.0 < gains["coil_lag"] <= base.score - refitted.score + 1.0
    assert gains["coil_lag"] == max(gains.values())
