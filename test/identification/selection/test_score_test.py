"""What one step would gain, against what a refit gains."""

from __future__ import annotations

from typing import ClassVar

import numpy as np
import pytest

from benchmarks.campaign.cases import draw_case
from benchmarks.campaign.running import as_trace
from identification.diagnosis.test_sound_verdicts import Decay
from identification.selection.test_held_out import recorded
from valve_sim.identification.estimation.problem import Problem
from valve_sim.identification.estimation.solver import fit
from valve_sim.identification.plants.protocol import Array, EffectChoice, Nuisance
from valve_sim.identification.plants.valve import ValvePlant
from valve_sim.identification.selection.score_test import score_gains
from valve_sim.model import Parameter


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


class Sloping(Decay):
    """A decay on a slope, which is declared to be 0 within 0.02 A/s."""

    SLOPE = Parameter("slope", "A/s", "added", -1e3, 1e3, 10.0 * 0.02, 0.0)
    PARAMETERS: ClassVar = {"gain": Decay.PARAMETERS["gain"], "slope": SLOPE}
    effects: ClassVar = {"valve.slope": EffectChoice("valve.slope", (SLOPE,), is_declared_value=True)}
    nuisances = (Nuisance("slope", 0.02, "A/s", step=1e-4, is_of_machine=True),)

    def predict(self, values: dict[str, float]) -> list[Array]:  # type: ignore[override]
        return [super().predict(values)[0] + values.get("slope", 0.0) * (self.times % 2.0)]


@pytest.mark.parametrize("slope", [0.0, 0.05, 0.1, -0.2])
def test_the_gain_of_a_declared_value_is_that_of_its_refit(slope: float) -> None:
    shown = Sloping("current", "A").predict({"gain": 1.3, "slope": slope})[0]
    shown += np.random.default_rng(7).normal(0.0, 0.05, len(shown))
    problem = Problem(Sloping("current", "A", shown))
    base = fit(problem, ("gain",), {}, nuisances=problem.plant.nuisances)
    refitted = fit(problem, ("gain", "slope"), {}, nuisances=problem.plant.nuisances)
    assert score_gains(base)["valve.slope"] == pytest.approx(base.score - refitted.score, rel=2e-3, abs=0.05)
