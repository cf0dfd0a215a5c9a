"""What holds of any posterior: on a sum of known columns exactly, on a valve nearly."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import replace

import numpy as np
import pytest
from plants.recording import Recorder

from identification.diagnosis.test_run import DECLARED
from identification.fit.linear_plant import COLUMNS, SAMPLES, SIGMA, LinearPlant, measured
from identification.freed import fit
from identification.recordings import Short, recorded
from valve_sim.identification.diagnosis.run import diagnose_plant
from valve_sim.identification.fit.noise import Noise
from valve_sim.identification.fit.posterior import decide
from valve_sim.identification.fit.problem import Problem
from valve_sim.identification.fit.result import Fit
from valve_sim.identification.fit.search import Search
from valve_sim.identification.plants.protocol import Array, EffectChoice, Nuisance
from valve_sim.model import Parameter, Tolerances

KNOWN = [Nuisance(f"known {number}", sigma, "m", is_of_machine=True) for number, sigma in enumerate((1e-4, 0.01, 1.0))]


class Watched(LinearPlant):
    """Some sensors show a level and three declared values in columns of their own; noise is known."""

    def __init__(self, sensors: int, seed: int = 1, *, slow: float = 0.0) -> None:
        random = np.random.default_rng(seed)
        super().__init__(measured(), nuisances=KNOWN)
        (one,) = self.channels
        shown = self.of_sensors(sensors, {"level": 2.0})
        slowly = slow * np.sin(np.arange(SAMPLES) / 40.0)
        self.channels = [
            replace(one, name=f"sensor {number}", data=own + slowly + SIGMA * random.standard_normal(SAMPLES))
            for number, own in enumerate(shown)
        ]

    @staticmethod
    def of_sensors(sensors: int, values: Mapping[str, float]) -> list[Array]:
        parts = [values.get("level", 0.0), *(values.get(own.name, 0.0) for own in KNOWN)]
        return [COLUMNS[:, 2 * number : 2 * number + 4] @ np.array(parts) for number in range(sensors)]

    def predict(self, values: Mapping[str, float]) -> list[Array]:
        return self.of_sensors(len(self.channels), values)


def fitted(plant: LinearPlant) -> Fit:
    noises = {"position": Noise(SIGMA, SIGMA, (), 0.0, 10_000)}
    return fit(Problem(plant, noises=noises), ("level",), {}, nuisances=plant.nuisances)  # type: ignore[arg-type]


@pytest.mark.parametrize("slow", [0.0, 3.0])
def test_no_posterior_is_wider_than_its_prior(slow: float) -> None:
    """However badly the model fits."""
    found = fitted(Watched(1, slow=slow))
    errors = np.sqrt(np.diag(found.covariance))[1:]
    assert np.all(errors <= [own.sigma for own in KNOWN])
    assert errors[2] < 0.1 * KNOWN[2].sigma


def test_a_further_sensor_widens_nothing() -> None:
    one, two, three = (fitted(Watched(sensors)).covariance for sensors in (1, 2, 3))
    for before, after in ((one, two), (two, three)):
        scale = np.sqrt(np.diag(before))
        assert np.min(np.linalg.eigvalsh((before - after) / np.outer(scale, scale))) >= -1e-9
        assert after[0, 0] < before[0, 0]


# -- names and their order ---------------------------------------------------------------------------------------------

EFFECTS = {"alpha": 1, "beta": 2, "gamma": 3, "delta": 4}


def searched(names: Mapping[str, str], order: list[str]) -> Search:
    """The search of a plant whose effects have these names and this order; two of them act."""

    def shown(values: Mapping[str, float]) -> Array:
        sizes = [values.get(f"{names[name]}.size", 0.0) for name in EFFECTS]
        return np.asarray(COLUMNS[:, 1:5] @ np.array(sizes))

    data = measured() + 0.04 * COLUMNS[:, 1] + 0.3 * COLUMNS[:, 3]
    switch = Parameter("size", "m", "added", -1e6, 1e6, 0.2, 0.0)
    plant = LinearPlant(data, shown, effects=[EffectChoice(names[name], (switch,)) for name in order])
    noises = {"position": Noise(SIGMA, SIGMA, (), 0.0, 10_000)}
    found = Search(Problem(plant, noises=noises))  # type: ignore[arg-type]
    found.run()
    return found


def test_other_names_in_another_order_change_no_probability() -> None:
    same = {name: name for name in EFFECTS}
    new = dict(zip(EFFECTS, ("zeta", "eta", "epsilon", "aleph"), strict=True))
    first = searched(same, list(EFFECTS)).posterior()
    for names, order in (
        (same, [*reversed(EFFECTS)]),
        (new, list(EFFECTS)),
        (new, ["gamma", "alpha", "delta", "beta"]),
    ):
        second = searched(names, order).posterior()
        for name, probability in first.inclusion().items():
            assert second.inclusion()[names[name]] == pytest.approx(probability, abs=1e-4)
        assert second.unnamed == pytest.approx(first.unnamed, abs=1e-4)
        assert set(decide(second).names) == {names[name] for name in decide(first).names}
        assert decide(second).probability == pytest.approx(decide(first).probability, abs=1e-4)
    assert decide(first).names == ("alpha", "gamma")
    assert 0.5 < first.inclusion()["alpha"] < 0.9999


# -- a valve -----------------------------------------------------------------------------------------------------------


def test_of_a_valve_no_posterior_is_wider_than_its_prior() -> None:
    tolerances = Tolerances({"spring_preload": 0.08, "coil_time_constant": 2e-5, "stroke": 4e-6}, None, {})
    plant = Short([recorded(Recorder(sample_rate=5e3))], replace(DECLARED, tolerances=tolerances), [])
    found = fit(Problem(plant), plant.base, {}, nuisances=plant.nuisances)
    for index, own in enumerate(found.nuisances, start=len(found.free)):
        assert np.sqrt(found.covariance[index, index]) <= own.sigma * (1.0 + 1e-6)


@pytest.mark.long
def test_a_declared_effect_of_no_size_changes_nothing() -> None:
    few = ["quadratic_drag", "drive_gain", "coulomb_friction"]
    trace = recorded(Recorder(sample_rate=5e3), effects={"quadratic_drag": {"coefficient": 1.0}})
    without = Short([trace], DECLARED, few)
    with_it = Short([trace], replace(DECLARED, effects={"coulomb_friction": {"force": 0.0}}), few)
    first, second = (fit(Problem(plant), plant.base, {}, nuisances=plant.nuisances) for plant in (without, with_it))
    assert second.chi2 == pytest.approx(first.chi2, rel=1e-9)
    assert second.log_evidence == pytest.approx(first.log_evidence, abs=1e-6)
    found, again = (diagnose_plant(plant, None).verdict for plant in (without, with_it))
    assert (again.kind, again.effects) == (found.kind, found.effects)
    # It is a declared thing that may be wrong in place of an effect that may act: that is all that moves.
    assert again.probability == pytest.approx(found.probability, abs=0.02)
