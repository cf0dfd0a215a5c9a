"""Predictions of held-out data: the machine is kept, and the bands hold what they promise, on a linear plant."""

from __future__ import annotations

from collections.abc import Mapping

import numpy as np
import pytest

from identification.fit.linear_plant import COLUMNS, SAMPLES, SIGMA, LinearPlant, problem_of
from identification.freed import fit
from valve_sim.identification.fit.held_out import HeldOut, machine_values
from valve_sim.identification.fit.result import Fit, rmse
from valve_sim.identification.plants.protocol import Array, Nuisance

STRONGER = 40.0
"""Times the training data: what training leaves open of the machine is then as large as the noise."""
TOLERANCE = Nuisance("known", 0.02, "m", is_of_machine=True)
ERROR = Nuisance("clock", 1.0, "s")


class Stretched(LinearPlant):
    """A level, a declared value with a tolerance, and an error of the recording."""

    def __init__(self, data: Array, strength: float) -> None:
        super().__init__(data, nuisances=[TOLERANCE, ERROR])
        self.strength = strength

    def predict(self, values: Mapping[str, float]) -> list[Array]:
        of_machine = values.get("level", 0.0) * COLUMNS[:, 0] + values.get("known", 0.0) * COLUMNS[:, 1]
        return [self.strength * of_machine + values.get("clock", 0.0) * COLUMNS[:, 2]]


def drawn(seed: int) -> tuple[Stretched, Stretched, Array]:
    """Training data, held-out data, and what the latter would be without noise."""
    random = np.random.default_rng(seed)
    machine = {"level": float(random.normal(2.0, 0.5)), "known": float(random.normal(0.0, TOLERANCE.sigma))}
    made = []
    for strength in (1.0, STRONGER):
        shown = Stretched(np.zeros(SAMPLES), strength).predict({**machine, "clock": float(random.normal())})[0]
        made.append((Stretched(shown + SIGMA * random.standard_normal(SAMPLES), strength), shown))
    return made[0][0], made[1][0], made[1][1]


def trained(plant: LinearPlant) -> Fit:
    return fit(problem_of(plant), ("level",), {}, nuisances=plant.nuisances)


def test_bands_hold_95_percent_of_held_out_samples_and_of_what_they_would_be_without_noise() -> None:
    with_noise, without, wider = [], [], []
    for seed in range(200):
        plant, other, truth = drawn(seed)
        found = HeldOut(problem_of(other)).predicted(trained(plant))
        assert found is not None
        shown, band = other.predict(found.fit.values)[0], found.bands[0]
        with_noise.append(np.mean(np.abs(other.channels[0].data - shown) < 1.96 * band))
        of_machine = np.sqrt(np.square(band) - SIGMA**2)
        without.append(np.mean(np.abs(truth - shown) < 1.96 * of_machine))
        wider.append(np.mean(np.square(band)) / SIGMA**2)
    assert np.mean(wider) > 1.5
    assert 0.93 < np.mean(with_noise) < 0.97
    assert 0.93 < np.mean(without) < 0.97


def test_the_error_that_is_predicted_is_the_one_that_comes() -> None:
    ratios = []
    for seed in range(200, 700):
        plant, other, _ = drawn(seed)
        found = HeldOut(problem_of(other)).predicted(trained(plant))
        assert found is not None
        ratios.append((found.rmse / found.deviation) ** 2)
    assert np.mean(ratios) == pytest.approx(1.0, abs=0.1)


def test_all_that_training_says_of_the_machine_is_kept_and_the_errors_of_the_recording_are_not() -> None:
    """Held-out data of another machine show all of the difference: nothing of it is refitted."""
    plant, other, _ = drawn(1)
    result = trained(plant)
    changed = Stretched(other.channels[0].data + 3.0 * COLUMNS[:, 0] + 3.0 * COLUMNS[:, 1], STRONGER)
    held_out = HeldOut(problem_of(changed))
    found = held_out.fit(result)
    assert found is not None
    assert machine_values(result) == {name: result.values[name] for name in ("level", "known")}
    assert {name: found.values[name] for name in ("level", "known")} == machine_values(result)
    assert found.values["clock"] != pytest.approx(result.values["clock"], abs=0.05)
    assert rmse(found) > 4.0
    assert held_out.fit(result) is found


def test_held_out_data_raise_the_odds_of_something_unnamed_where_they_show_it_and_never_lower_them() -> None:
    plant, other, _ = drawn(3)
    result = trained(plant)
    assert HeldOut(problem_of(other)).log_odds_of_unnamed(result) == 0.0
    slow = 2.0 * np.sin(2.0 * np.pi * np.arange(SAMPLES) / 60.0)
    wrong = Stretched(other.channels[0].data + slow, STRONGER)
    assert HeldOut(problem_of(wrong)).log_odds_of_unnamed(result) > 10.0


def test_what_training_leaves_open_of_the_machine_is_nothing_unnamed() -> None:
    """An error of two standard errors of the machine is 100 σ of held-out data that are so much stronger."""
    plant, other, _ = drawn(4)
    result = trained(plant)
    off = 2.0 * STRONGER * result.stderr("level") * COLUMNS[:, 0]
    moved = Stretched(other.channels[0].data + off, STRONGER)
    assert HeldOut(problem_of(moved)).log_odds_of_unnamed(result) < 3.0


def test_without_held_out_data_nothing_is_predicted() -> None:
    result, nothing = trained(drawn(5)[0]), HeldOut(None)
    assert nothing.fit(result) is None
    assert nothing.predicted(result) is None
    assert nothing.log_odds_of_unnamed(result) == 0.0
    assert nothing.log_density(result) is None
