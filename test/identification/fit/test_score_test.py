"""What adding an effect would gain, to first order, against what a refit gains."""

from __future__ import annotations

import math
from collections.abc import Mapping

import pytest

from identification.fit.linear_plant import (
    COLUMNS,
    LinearPlant,
    measured,
    problem_of,
)
from valve_sim.identification.fit.fitter import Fitter, Tried
from valve_sim.identification.fit.posterior import rivals_of
from valve_sim.identification.fit.score_test import log_gains
from valve_sim.identification.plants.protocol import Array, EffectChoice, Nuisance
from valve_sim.model import Parameter, SimulationError


def base_of(plant: LinearPlant) -> tuple[Fitter, Tried]:
    """The declared model, fitted."""
    fitter = Fitter(problem_of(plant), rivals_of(plant))  # type: ignore[arg-type]
    return fitter, fitter.fitted_declared()


def gains(plant: LinearPlant) -> dict[str, float]:
    fitter, tried = base_of(plant)
    return log_gains(fitter, (), tried)


def gain_of_refit(plant: LinearPlant, name: str) -> float:
    """What ln p gains by a fit with an effect, started from where it is first expected."""
    (fitter, tried), effect = base_of(plant), plant.effects[name]
    start = {effect.free_name(one): one.prior_scale for one in effect.parameters}
    refitted = fitter.descended(fitter.model((name,)), {**tried.values, **start})
    assert refitted is not None
    return fitter.weighed((name,), refitted).plain - tried.plain


# -- against least squares ---------------------------------------------------------------------------------------------

SWITCH = Parameter("size", "N", "added", -1e6, 1e6, 2.0, 0.0)
UPWARDS = SWITCH._replace(lower=0.0)


def only(switch: Parameter = SWITCH) -> list[EffectChoice]:
    return [EffectChoice("e", (switch,))]


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
    assert gains(plant) == {"e": pytest.approx(gain_of_refit(plant, "e"), abs=0.05, rel=1e-3)}


def test_a_range_that_ends_where_a_switch_is_off_counts_on_the_side_of_its_range() -> None:
    """A ratio of at most 1, off at 1, that is 0.5: well within its range."""

    def shown(values: Mapping[str, float]) -> Array:
        return (values.get("e.ratio", 1.0) - 1.0) * COLUMNS[:, 1]

    ratio = Parameter("ratio", "1", "of it", 0.0, 1.0, 0.4, 1.0)
    for size, effect in ((-0.5, ratio), (0.05, ratio)):
        plant = LinearPlant(measured() + size * COLUMNS[:, 1], shown, effects=[EffectChoice("e", (effect,))])
        assert gains(plant)["e"] == pytest.approx(gain_of_refit(plant, "e"), abs=0.1, rel=1e-3)


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
    assert gains(plant)["e"] == pytest.approx(gains(other)["e"], abs=1e-6)
    alone = LinearPlant(measured(), shown, effects=only())
    assert gains(alone) == {"e": -math.inf}


def test_what_a_nuisance_can_do_within_its_prior_is_no_gain() -> None:
    """The fit may move it by its prior: it takes up a part of what looks alike."""
    drift = Nuisance("drift", 0.02, "m")

    def shown(values: Mapping[str, float]) -> Array:
        own = values.get("drift", 0.0) * COLUMNS[:, 1]
        return own + values.get("e.size", 0.0) * (COLUMNS[:, 1] + 0.3 * COLUMNS[:, 2])

    data = measured() + 0.1 * COLUMNS[:, 1]
    plant, without = (LinearPlant(data, shown, effects=only(), nuisances=own) for own in ([drift], []))
    assert gains(plant)["e"] == pytest.approx(gain_of_refit(plant, "e"), abs=0.05)
    assert gains(plant)["e"] < gains(without)["e"] - 5.0


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
    # Where the data hardly know it, a parabola about the middle of a Cauchy density has not all of its mass.
    assert gains(plant)["valve.slope"] == pytest.approx(
        gain_of_refit(plant, "valve.slope"), rel=2e-3, abs=0.1 if strength > 1.0 else 0.6
    )


def test_a_declared_value_without_a_tolerance_gains_what_its_refit_gains() -> None:
    slope = Parameter("slope", "N", "of it", -1e6, 1e6, 0.2, 1.5)

    class Exact(LinearPlant):
        def parameter(self, name: str) -> Parameter:
            return slope._replace(off=None) if name == "slope" else super().parameter(name)

        def declared(self, name: str) -> float:
            return 1.5 if name == "slope" else super().declared(name)

    wrong = EffectChoice("valve.slope", (slope,), is_declared_value=True)
    for off in (0.0, 0.1):
        plant = Exact(
            measured() + (1.5 + off) * COLUMNS[:, 1],
            lambda values: values.get("slope", 1.5) * COLUMNS[:, 1],
            effects=[wrong],
        )
        assert gains(plant)["valve.slope"] == pytest.approx(gain_of_refit(plant, "valve.slope"), abs=0.6, rel=2e-3)
