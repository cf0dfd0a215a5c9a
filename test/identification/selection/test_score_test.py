"""What adding an effect would gain, to first order, against what a refit gains."""

from __future__ import annotations

import math
from collections.abc import Mapping

import numpy as np
import pytest

from identification.selection.linear_plant import (
    COLUMNS,
    SAMPLES,
    SIGMA,
    LinearPlant,
    least_squares,
    measured,
    problem_of,
)
from valve_sim.identification.estimation.result import Fit
from valve_sim.identification.estimation.solver import fit
from valve_sim.identification.plants.protocol import Array, EffectChoice, Nuisance
from valve_sim.identification.selection.score_test import OrthogonalProjector, log_gains, moves_of, released_spread
from valve_sim.model import Parameter, SimulationError


def gain_of_refit(base: Fit, name: str) -> float:
    """What ln p gains by a fit with an effect, started from where it is first expected."""
    effect = base.problem.plant.effects[name]
    start = {effect.free_name(one): one.prior_scale for one in effect.parameters}
    refitted = fit(base.problem, (*base.free, *effect.free_names()), start, nuisances=base.nuisances)
    return refitted.log_evidence - base.log_evidence


# -- against least squares ---------------------------------------------------------------------------------------------

SWITCH = Parameter("size", "N", "added", -1e6, 1e6, 2.0, 0.0)
UPWARDS = SWITCH._replace(lower=0.0)
FORM = Parameter("form", "1", "of it", 0.5, 4.0, 1.0)


def only(switch: Parameter = SWITCH) -> list[EffectChoice]:
    return [EffectChoice("e", (switch,))]


def base_of(plant: LinearPlant) -> Fit:
    return fit(problem_of(plant), ("level",), {})


def gained(columns: Array, plant: LinearPlant) -> float:
    """By how much χ² falls where columns are fitted beside the level."""
    white, own = plant.channels[0].data / SIGMA, COLUMNS[:, :1]
    return least_squares(own, white) - least_squares(np.column_stack([own, columns]), white)


@pytest.mark.parametrize("size", [0.0, 0.02, 0.05, 0.1, 1.0, -0.02, -0.05])
@pytest.mark.parametrize("switch", [SWITCH, UPWARDS], ids=["two-sided", "one-sided"])
def test_the_gain_of_a_switch_is_that_of_its_refit(size: float, switch: Parameter) -> None:
    """From 3 standard errors on the wrong side of a one-sided range to 60 on the right one."""
    plant = LinearPlant(
        measured() + size * COLUMNS[:, 1],
        lambda values: values.get("e.size", 0.0) * COLUMNS[:, 1],
        effects=only(switch),
    )
    base = base_of(plant)
    assert log_gains(base) == {"e": pytest.approx(gain_of_refit(base, "e"), abs=0.05, rel=1e-3)}


def test_what_is_in_the_fit_is_not_tested_again() -> None:
    plant = LinearPlant(
        measured(), lambda values: values.get("e.size", 0.0) * COLUMNS[:, 1], effects=[*only(), EffectChoice("f", ())]
    )
    plant.effects["g"] = EffectChoice("g", (SWITCH,))
    plant.parameters["g.size"] = SWITCH
    assert set(log_gains(fit(problem_of(plant), ("level", "e.size"), {}))) == {"f", "g"}


def test_the_gain_of_two_switches_is_that_of_their_refit() -> None:
    def shown(values: Mapping[str, float]) -> Array:
        return values.get("e.size", 0.0) * COLUMNS[:, 1] + values.get("e.other", 0.0) * COLUMNS[:, 2]

    effect = EffectChoice("e", (SWITCH, SWITCH._replace(name="other")))
    plant = LinearPlant(measured() + 0.4 * COLUMNS[:, 1] + 0.3 * COLUMNS[:, 2], shown, effects=[effect])
    base = base_of(plant)
    assert log_gains(base) == {"e": pytest.approx(gain_of_refit(base, "e"), abs=0.2)}


@pytest.mark.parametrize("strength", [1.0, 1e-3])
@pytest.mark.parametrize(("share", "counts"), [(1e-5, False), (1e-3, True)])
def test_a_direction_that_is_rounding_gains_nothing(share: float, counts: bool, strength: float) -> None:
    """The difference of two switches that do the same is so small a share of what each does."""
    plant = LinearPlant(measured() + COLUMNS[:, 2])
    outside = OrthogonalProjector(base_of(plant))
    first = strength / SIGMA * COLUMNS[:, 1]
    both = np.column_stack([first, first + share * strength / SIGMA * COLUMNS[:, 2]])
    expected = gained(COLUMNS[:, 1:3] if counts else COLUMNS[:, 1:2], plant)
    assert outside.gain(both) == pytest.approx(expected, rel=0.02)


@pytest.mark.parametrize(("strength", "counts"), [(1e-9, False), (1e-5, True)])
def test_what_changes_nothing_is_no_rival(strength: float, counts: bool) -> None:
    plant = LinearPlant(
        measured() + COLUMNS[:, 1],
        lambda values: strength * values.get("e.size", 0.0) * COLUMNS[:, 1],
        effects=only(),
    )
    base = base_of(plant)
    (move,) = next(moves_of(base, plant.effects["e"], 1.0))
    power, seen = OrthogonalProjector(base).along(move.change)
    if counts:
        assert seen**2 / power == pytest.approx(gained(COLUMNS[:, 1:2], plant), rel=0.01)
    else:
        assert log_gains(base) == {"e": -math.inf}
    # Nor is what the fit can do by itself.
    same = LinearPlant(measured(), lambda values: values.get("e.size", 0.0) * COLUMNS[:, 0], effects=only())
    assert log_gains(base_of(same))["e"] < 0.1


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
    found = log_gains(base_of(plant))["e"]
    assert seen == {1.0, 0.5, 4.0}
    alone = LinearPlant(
        measured() + COLUMNS[:, 3], lambda values: values.get("e.size", 0.0) * COLUMNS[:, 3], effects=only()
    )
    assert found == pytest.approx(log_gains(base_of(alone))["e"], abs=1e-3)


def test_a_switch_is_tried_near_off_and_at_its_scale() -> None:
    """What only a large one does is seen, too: half of it would do nothing."""
    seen: set[float] = set()

    def shown(values: Mapping[str, float]) -> Array:
        size = values.get("e.size", 0.0)
        seen.add(size)
        return max(0.0, size - 1.5) * COLUMNS[:, 1]

    plant = LinearPlant(measured() + COLUMNS[:, 1], shown, effects=only())
    gains = log_gains(base_of(plant))
    assert {abs(size) for size in seen if size} == {0.05 * 2.0, 2.0}
    assert gains["e"] == pytest.approx(0.5 * gained(COLUMNS[:, 1:2], plant), abs=10.0)
    assert gains["e"] > 100.0


def test_a_range_that_ends_where_a_switch_is_off_counts_on_the_side_of_its_range() -> None:
    """A ratio of at most 1, off at 1, that is 0.5: well within its range."""

    def shown(values: Mapping[str, float]) -> Array:
        return (values.get("e.ratio", 1.0) - 1.0) * COLUMNS[:, 1]

    ratio = Parameter("ratio", "1", "of it", 0.0, 1.0, 0.4, 1.0)
    for size, effect in ((-0.5, ratio), (0.05, ratio)):
        plant = LinearPlant(measured() + size * COLUMNS[:, 1], shown, effects=[EffectChoice("e", (effect,))])
        base = base_of(plant)
        assert log_gains(base)["e"] == pytest.approx(gain_of_refit(base, "e"), abs=0.1, rel=1e-3)


def test_a_switch_that_cannot_be_simulated_is_left_out_and_the_other_is_not() -> None:
    def shown(values: Mapping[str, float]) -> Array:
        if values.get("e.size", 0.0) != 0.0:
            raise SimulationError("too large")
        return values.get("e.other", 0.0) * COLUMNS[:, 2]

    both = EffectChoice("e", (SWITCH, SWITCH._replace(name="other")))
    plant = LinearPlant(measured() + COLUMNS[:, 2], shown, effects=[both])
    other = LinearPlant(
        measured() + COLUMNS[:, 2], lambda values: values.get("e.size", 0.0) * COLUMNS[:, 2], effects=only()
    )
    assert log_gains(base_of(plant))["e"] == pytest.approx(log_gains(base_of(other))["e"], abs=1e-6)
    alone = LinearPlant(measured(), shown, effects=only())
    assert log_gains(base_of(alone)) == {"e": -math.inf}


def test_what_a_nuisance_can_do_within_its_prior_is_no_gain() -> None:
    """The fit may move it by its prior: it takes up a part of what looks alike."""
    drift = Nuisance("drift", 0.02, "m")

    def shown(values: Mapping[str, float]) -> Array:
        own = values.get("drift", 0.0) * COLUMNS[:, 1]
        return own + values.get("e.size", 0.0) * (COLUMNS[:, 1] + 0.3 * COLUMNS[:, 2])

    plant = LinearPlant(measured() + 0.1 * COLUMNS[:, 1], shown, effects=only(), nuisances=[drift])
    base = fit(problem_of(plant), ("level",), {}, nuisances=[drift])
    found = log_gains(base)["e"]
    assert found == pytest.approx(gain_of_refit(base, "e"), abs=0.05)
    assert found < log_gains(base_of(plant))["e"] - 5.0


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


@pytest.mark.parametrize("strength", [0.05, 0.5, 8.0, 50.0])
@pytest.mark.parametrize("off", [0.0, 4.0, 8.0])
def test_a_released_value_gains_what_its_refit_gains(strength: float, off: float) -> None:
    """From data that know it a fifteenth as well as its tolerance to 64 times as well."""
    sigma = 0.02
    plant = Toleranced(measured() + strength * off * sigma * COLUMNS[:, 1], strength, sigma)
    base = fit(problem_of(plant), ("level",), {}, nuisances=plant.nuisances)
    # Where the data hardly know it, a parabola about the middle of a Cauchy density has not all of its mass.
    assert log_gains(base)["valve.slope"] == pytest.approx(
        gain_of_refit(base, "valve.slope"), rel=2e-3, abs=0.1 if strength > 1.0 else 0.6
    )


def test_a_declared_value_and_what_comes_after_it_are_both_tested() -> None:
    plant = Toleranced(measured(), 8.0, 0.02)
    plant.effects["e"] = EffectChoice("e", (SWITCH,))
    plant.parameters["e.size"] = SWITCH
    assert list(log_gains(fit(problem_of(plant), ("level",), {}, nuisances=plant.nuisances))) == ["valve.slope", "e"]


def test_a_declared_value_of_which_the_data_say_nothing_gains_nothing() -> None:
    plant = Toleranced(measured(), 0.0, 0.02)
    assert log_gains(fit(problem_of(plant), ("level",), {}, nuisances=plant.nuisances))["valve.slope"] == -math.inf
    # Nor one that the fit does not estimate.
    assert log_gains(fit(problem_of(plant), ("level",), {}))["valve.slope"] == -math.inf


def test_a_released_value_spreads_by_what_the_data_alone_say_of_it_and_by_its_tolerance() -> None:
    """By least squares; infinitely where the data do not show it."""
    shown, hidden = Nuisance("shown", 0.02, "m", is_of_machine=True), Nuisance("hidden", 0.02, "m", is_of_machine=True)
    plant = LinearPlant(
        measured(), lambda values: values.get("shown", 0.0) * COLUMNS[:, 1], nuisances=[shown, hidden]
    )  # fmt: skip
    base = fit(problem_of(plant), ("level",), {}, nuisances=plant.nuisances)
    information = least_squares(COLUMNS[:, :1], COLUMNS[:, 1]) / SIGMA**2
    assert released_spread(base, shown) == pytest.approx(math.hypot(information**-0.5, 0.02), rel=1e-3)
    assert math.isinf(released_spread(base, hidden))
