"""What one step would gain, against what a refit gains."""

from __future__ import annotations

import math
from collections.abc import Mapping
from typing import ClassVar

import numpy as np
import pytest

from benchmarks.campaign.cases import draw_case
from benchmarks.campaign.running import as_trace
from identification.diagnosis.test_sound_verdicts import Decay
from identification.selection.linear_plant import (
    COLUMNS,
    SAMPLES,
    SIGMA,
    LinearPlant,
    least_squares,
    measured,
    problem_of,
)
from identification.selection.test_held_out import recorded
from valve_sim.identification.estimation.problem import Problem
from valve_sim.identification.estimation.solver import fit
from valve_sim.identification.plants.protocol import Array, EffectChoice, Nuisance
from valve_sim.identification.plants.valve import ValvePlant
from valve_sim.identification.selection.score_test import Outside, score_gains
from valve_sim.model import Parameter, SimulationError


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
    problem = Problem(Sloping("current", "A", [shown]))
    base = fit(problem, ("gain",), {}, nuisances=problem.plant.nuisances)
    refitted = fit(problem, ("gain", "slope"), {}, nuisances=problem.plant.nuisances)
    assert score_gains(base)["valve.slope"] == pytest.approx(base.score - refitted.score, rel=2e-3, abs=0.05)


# -- against least squares ---------------------------------------------------------------------------------------------

SWITCH = Parameter("size", "N", "added", -1e6, 1e6, 2.0, 0.0)
FORM = Parameter("form", "1", "of it", 0.5, 4.0, 1.0)
PRICE = math.log(SAMPLES)


def gained(columns: Array, plant: LinearPlant) -> float:
    """By how much χ² falls where columns are fitted beside the level."""
    white, own = plant.channels[0].data / SIGMA, COLUMNS[:, :1]
    return least_squares(own, white) - least_squares(np.column_stack([own, columns]), white)


def test_the_gain_of_two_switches_is_that_of_least_squares() -> None:
    def shown(values: Mapping[str, float]) -> Array:
        return values.get("e.size", 0.0) * COLUMNS[:, 1] + values.get("e.other", 0.0) * COLUMNS[:, 2]

    effect = EffectChoice("e", (SWITCH, SWITCH._replace(name="other")))
    plant = LinearPlant(measured() + 0.1 * COLUMNS[:, 1], shown, effects=[effect])
    for inflation in (1.0, 2.5):
        base = fit(problem_of(plant, inflation), ("level",), {})
        expected = gained(COLUMNS[:, 1:3], plant) / inflation - 2.0 * PRICE
        assert score_gains(base) == {"e": pytest.approx(expected, abs=1e-3)}


@pytest.mark.parametrize("strength", [1.0, 1e-3])
@pytest.mark.parametrize(("share", "counts"), [(1e-5, False), (1e-3, True)])
def test_a_switch_that_does_what_another_does_gains_nothing_more(share: float, counts: bool, strength: float) -> None:
    """Their difference is so small a share of what each does that it is rounding."""

    def shown(values: Mapping[str, float]) -> Array:
        other = COLUMNS[:, 1] + share * COLUMNS[:, 2]
        return strength * (values.get("e.size", 0.0) * COLUMNS[:, 1] + values.get("e.other", 0.0) * other)

    effect = EffectChoice("e", (SWITCH, SWITCH._replace(name="other")))
    plant = LinearPlant(measured() + COLUMNS[:, 2], shown, effects=[effect])
    expected = gained(COLUMNS[:, 1:3] if counts else COLUMNS[:, 1:2], plant)
    assert score_gains(fit(problem_of(plant), ("level",), {}))["e"] + 2.0 * PRICE == pytest.approx(expected, rel=0.02)


@pytest.mark.parametrize(("strength", "counts"), [(1e-9, False), (1e-6, True)])
def test_what_changes_nothing_gains_nothing(strength: float, counts: bool) -> None:
    """Of one prior scale 2·32/0.5 times `strength` is seen over all samples."""
    plant = LinearPlant(
        measured() + COLUMNS[:, 1],
        lambda values: strength * values.get("e.size", 0.0) * COLUMNS[:, 1],
        effects=[EffectChoice("e", (SWITCH,))],
    )
    gain = score_gains(fit(problem_of(plant), ("level",), {}))["e"] + PRICE
    assert gain == pytest.approx(gained(COLUMNS[:, 1:2], plant) if counts else 0.0, rel=0.01)
    # Nor does what the fit can do by itself.
    same = LinearPlant(
        measured(), lambda values: values.get("e.size", 0.0) * COLUMNS[:, 0], effects=[EffectChoice("e", (SWITCH,))]
    )
    assert score_gains(fit(problem_of(same), ("level",), {}))["e"] == pytest.approx(-PRICE)


def test_a_form_is_tried_at_its_scale_a_fifth_and_five_times_that() -> None:
    seen: set[float] = set()

    def shown(values: Mapping[str, float]) -> Array:
        if values.get("e.size", 0.0) == 0.0:
            return np.zeros(SAMPLES)
        seen.add(values["e.form"])
        number = {1.0: 1, 0.5: 2, 4.0: 3}[values["e.form"]]
        return values["e.size"] * COLUMNS[:, number]

    # Bounds keep it at 0.5 and 4; there is a third column in the data.
    plant = LinearPlant(measured() + COLUMNS[:, 3], shown, effects=[EffectChoice("e", (SWITCH, FORM))])
    gains = score_gains(fit(problem_of(plant), ("level",), {}))
    assert seen == {1.0, 0.5, 4.0}
    assert gains["e"] == pytest.approx(gained(COLUMNS[:, 3:4], plant) - 2.0 * PRICE, abs=1e-3)


def test_a_switch_is_tried_near_off_and_at_its_scale() -> None:
    """What only a large one does is seen, too: half of it would do nothing."""
    seen: set[float] = set()

    def shown(values: Mapping[str, float]) -> Array:
        size = values.get("e.size", 0.0)
        seen.add(size)
        return max(0.0, size - 1.5) * COLUMNS[:, 1]

    plant = LinearPlant(measured() + COLUMNS[:, 1], shown, effects=[EffectChoice("e", (SWITCH,))])
    gains = score_gains(fit(problem_of(plant), ("level",), {}))
    assert {size for size in seen if size} == {0.05 * 2.0, 2.0}
    assert gains["e"] == pytest.approx(gained(COLUMNS[:, 1:2], plant) - PRICE, abs=1e-3)


def test_a_switch_whose_off_is_not_0_is_moved_from_there_while_others_stay_off() -> None:
    seen: list[tuple[float, float]] = []

    def shown(values: Mapping[str, float]) -> Array:
        ratio, size = values.get("e.ratio", 1.0), values.get("e.size", 0.0)
        seen.append((round(ratio, 6), size))
        return (ratio - 1.0) * COLUMNS[:, 1] + size * COLUMNS[:, 2]

    ratio = Parameter("ratio", "1", "of it", 0.0, 1.0, 0.4, 1.0)
    plant = LinearPlant(measured() + COLUMNS[:, 1], shown, effects=[EffectChoice("e", (ratio, SWITCH))])
    gains = score_gains(fit(problem_of(plant), ("level",), {}))
    assert set(seen) == {(1.0, 0.0), (0.98, 0.0), (1.0, 0.1), (0.6, 0.0), (1.0, 2.0)}
    assert gains["e"] == pytest.approx(gained(COLUMNS[:, 1:3], plant) - 2.0 * PRICE, abs=1e-3)


def test_a_switch_that_cannot_be_simulated_is_left_out_and_the_other_is_not() -> None:
    def shown(values: Mapping[str, float]) -> Array:
        if values.get("e.size", 0.0) != 0.0:
            raise SimulationError("too large")
        return values.get("e.other", 0.0) * COLUMNS[:, 2] + values.get("f.size", 0.0) * COLUMNS[:, 3]

    both = EffectChoice("e", (SWITCH, SWITCH._replace(name="other")))
    plant = LinearPlant(measured() + COLUMNS[:, 2], shown, effects=[both])
    gains = score_gains(fit(problem_of(plant), ("level",), {}))
    assert gains["e"] == pytest.approx(gained(COLUMNS[:, 2:3], plant) - 2.0 * PRICE, abs=1e-3)
    alone = LinearPlant(measured(), shown, effects=[EffectChoice("e", (SWITCH,))])
    assert score_gains(fit(problem_of(alone), ("level",), {})) == {"e": -PRICE}


def test_what_a_nuisance_can_do_within_its_prior_is_no_gain() -> None:
    """The fit may move it by its prior: it takes up a part of what looks alike, which least squares with a row for the
    prior tells."""
    drift = Nuisance("drift", 0.02, "m")

    def shown(values: Mapping[str, float]) -> Array:
        own = values.get("drift", 0.0) * COLUMNS[:, 1]
        return own + values.get("e.size", 0.0) * (COLUMNS[:, 1] + 0.3 * COLUMNS[:, 2])

    data = measured() + 0.1 * COLUMNS[:, 1]
    plant = LinearPlant(data, shown, effects=[EffectChoice("e", (SWITCH,))], nuisances=[drift])
    base = fit(problem_of(plant), ("level",), {}, nuisances=[drift])
    rows = np.zeros((1, 2))
    rows[0, 1] = 1.0 / drift.sigma
    own = np.vstack([COLUMNS[:, :2] / SIGMA, rows])
    effect = np.concatenate([(COLUMNS[:, 1] + 0.3 * COLUMNS[:, 2]) / SIGMA, [0.0]])
    white = np.concatenate([data / SIGMA, [0.0]])
    expected = least_squares(own, white) - least_squares(np.column_stack([own, effect]), white) - PRICE
    assert score_gains(base)["e"] == pytest.approx(expected, abs=1e-3)
    assert Outside(base).basis(effect[:-1, None]).shape == (SAMPLES, 1)


# -- declared values ---------------------------------------------------------------------------------------------------


class Toleranced(LinearPlant):
    """Its `slope` is declared to be 0 within a tolerance, which every fit may use."""

    def __init__(self, data: Array, strength: float, sigma: float) -> None:
        tolerance = Nuisance("slope", sigma, "N", is_of_machine=True)
        slope = Parameter("slope", "N", "of it", -1e6, 1e6, 10.0 * sigma, 0.0)
        released = EffectChoice("valve.slope", (slope,), is_declared_value=True)
        super().__init__(
            data,
            lambda values: strength * values.get("slope", 0.0) * COLUMNS[:, 1],
            effects=[released],
            nuisances=[tolerance],
        )


@pytest.mark.parametrize("inflation", [1.0, 2.0])
@pytest.mark.parametrize("strength", [0.05, 0.5, 8.0, 50.0])
@pytest.mark.parametrize("off", [0.0, 4.0, 8.0])
def test_a_released_value_gains_what_its_refit_gains_where_the_data_know_it_and_no_more_elsewhere(
    strength: float, off: float, inflation: float
) -> None:
    """From data that know it a fifteenth as well as its tolerance to 64 times as well."""
    sigma = 0.02
    plant = Toleranced(measured() + strength * off * sigma * COLUMNS[:, 1], strength, sigma)
    problem = problem_of(plant, inflation)
    base = fit(problem, ("level",), {}, nuisances=plant.nuisances)
    refitted = fit(problem, ("level", "slope"), {}, nuisances=plant.nuisances)
    gain, found = base.score - refitted.score, score_gains(base)["valve.slope"]
    if strength > 1.0:
        assert found == pytest.approx(gain, rel=2e-3, abs=0.02)
    else:
        # Its price is then that of a value which the data know as well as its tolerance, ln 100 at most.
        assert gain - math.log(100.0) - 0.1 < found < gain


def test_a_declared_value_and_what_comes_after_it_are_both_tested() -> None:
    plant = Toleranced(measured(), 8.0, 0.02)
    plant.effects["e"] = EffectChoice("e", (SWITCH,))
    plant.parameters["e.size"] = SWITCH
    assert list(score_gains(fit(problem_of(plant), ("level",), {}, nuisances=plant.nuisances))) == ["valve.slope", "e"]


def test_a_declared_value_of_which_the_data_say_nothing_gains_nothing() -> None:
    plant = Toleranced(measured(), 0.0, 0.02)
    assert score_gains(fit(problem_of(plant), ("level",), {}, nuisances=plant.nuisances))["valve.slope"] == -math.inf
    # Nor one that the fit does not estimate.
    assert score_gains(fit(problem_of(plant), ("level",), {}))["valve.slope"] == -math.inf
