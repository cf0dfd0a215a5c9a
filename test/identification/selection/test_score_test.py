"""What adding an effect would gain, to first order, against what a refit gains."""

from __future__ import annotations

import math
from collections.abc import Mapping

import pytest

from identification.selection.linear_plant import (
    COLUMNS,
    LinearPlant,
    measured,
    problem_of,
)
from valve_sim.identification.fit.result import Fit
from valve_sim.identification.fit.result import fit
from valve_sim.identification.plants.protocol import Array, EffectChoice, Nuisance
from valve_sim.identification.fit.score_test import log_gains
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


def only(switch: Parameter = SWITCH) -> list[EffectChoice]:
    return [EffectChoice("e", (switch,))]


def base_of(plant: LinearPlant) -> Fit:
    return fit(problem_of(plant), ("level",), {})


@pytest.mark.parametrize(
    ("size", "switch"), [(0.0, SWITCH), (0.05, SWITCH), (1.0, UPWARDS), (0.02, UPWARDS), (-0.05, UPWARDS)]
)
def test_the_gain_of_a_switch_is_that_of_its_refit(size: float, switch: Parameter) -> None:
    """From 3 standard errors on the wrong side of a one-sided range to 60 on the right one."""
    plant = LinearPlant(
        measured() + size * COLUMNS[:, 1],
        lambda values: values.get("e.size", 0.0) * COLUMNS[:, 1],
        effects=only(switch),
    )
    base = base_of(plant)
    assert log_gains(base) == {"e": pytest.approx(gain_of_refit(base, "e"), abs=0.05, rel=1e-3)}


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


@pytest.mark.parametrize(("strength", "off"), [(0.05, 8.0), (0.5, 4.0), (8.0, 0.0), (50.0, 4.0)])
def test_a_released_value_gains_what_its_refit_gains(strength: float, off: float) -> None:
    """From data that know it a fifteenth as well as its tolerance to 64 times as well."""
    sigma = 0.02
    plant = Toleranced(measured() + strength * off * sigma * COLUMNS[:, 1], strength, sigma)
    base = fit(problem_of(plant), ("level",), {}, nuisances=plant.nuisances)
    # Where the data hardly know it, a parabola about the middle of a Cauchy density has not all of its mass.
    assert log_gains(base)["valve.slope"] == pytest.approx(
        gain_of_refit(base, "valve.slope"), rel=2e-3, abs=0.1 if strength > 1.0 else 0.6
    )
