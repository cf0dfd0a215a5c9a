"""What a fit makes of held-out data, against the density that a linear model gives them exactly."""

from __future__ import annotations

from collections.abc import Mapping, Sequence

import numpy as np
import pytest

from valve_sim.identification.estimation.noise import Noise
from valve_sim.identification.estimation.problem import Problem
from valve_sim.identification.estimation.result import Fit
from valve_sim.identification.estimation.solver import fit
from valve_sim.identification.plants.protocol import Array, Channel, Nuisance
from valve_sim.identification.selection.predictive_density import FARTHEST, neg2_log_predictive
from valve_sim.model import Parameter

SIGMA = 0.3
DRIFT = Nuisance("drift[0]", 0.5, "m")
NOISES = {"position": Noise(SIGMA, SIGMA, (), 0.0, 1.0, 100)}


class Line:
    """level + slope·t + bend·t², and a drift of the sensor as a nuisance."""

    base = ("level", "slope", "bend")
    nuisances: Sequence[Nuisance] = (DRIFT,)
    timing_errors: Sequence[Nuisance] = ()

    def __init__(self, times: Array, data: Array) -> None:
        count = len(times)
        self.channels = [Channel("", "position", times, data, np.zeros(count, bool), np.zeros(count, np.int64))]

    def parameter(self, name: str) -> Parameter:
        return Parameter(name, "m", "of a line", -1e3, 1e3, 2.0, 0.0)

    def declared(self, name: str) -> float:
        return 0.0

    def predict(self, values: Mapping[str, float]) -> list[Array]:
        times = self.channels[0].times
        powers = [values.get(name, 0.0) * times**power for power, name in enumerate(self.base)]
        return [sum(powers) + values.get(DRIFT.name, 0.0)]


def fits(free: tuple[str, ...], seed: int) -> tuple[Fit, Fit]:
    """To training data, and of the same values to held-out data that show other parts of the line."""
    random = np.random.default_rng(seed)
    problems = []
    for low, high in ((0.0, 1.0), (0.5, 3.0)):
        times = np.linspace(low, high, 40)
        data = 1.0 + 0.7 * times + SIGMA * random.standard_normal(40) + DRIFT.sigma * random.standard_normal()
        problems.append(Problem(Line(times, data), noises=NOISES))  # type: ignore[arg-type]
    training = fit(problems[0], free, {}, nuisances=[DRIFT])
    machine = {name: training.values[name] for name in free}
    return training, fit(problems[1], (), {}, nuisances=[DRIFT], fixed=machine)


@pytest.mark.parametrize("seed", range(5))
@pytest.mark.parametrize("free", [("level",), ("level", "slope"), ("level", "slope", "bend")])
def test_it_is_the_exact_density_of_a_linear_model(free: tuple[str, ...], seed: int) -> None:
    training, held_out = fits(free, seed)
    channel = held_out.problem.plant.channels[0]
    design = np.column_stack([channel.times**power for power in range(len(free))])
    misses = channel.data - design @ [training.values[name] for name in free]
    count = len(free)
    unknown = design @ training.covariance[:count, :count] @ design.T + DRIFT.sigma**2
    covariance = np.eye(len(misses)) + unknown / SIGMA**2
    exact = misses @ np.linalg.solve(covariance, misses) / SIGMA**2 + np.linalg.slogdet(covariance)[1]
    assert neg2_log_predictive(training, held_out) == pytest.approx(exact, rel=1e-6)


def test_what_the_training_data_do_not_hold_is_no_certainty() -> None:
    training, held_out = fits(("level", "slope"), 1)
    training.problem.plant.channels[0].times[:] = 0.0
    blind = fit(training.problem, ("level", "slope"), {}, nuisances=[DRIFT])
    assert blind.stderr("slope") == np.inf
    slope = held_out.problem.plant.parameter("slope").prior_scale * FARTHEST
    assert np.isfinite(neg2_log_predictive(blind, held_out))
    assert neg2_log_predictive(blind, held_out) > neg2_log_predictive(training, held_out)
    assert (
        neg2_log_predictive(blind, held_out)
        < neg2_log_predictive(training, held_out) + 2.0 * np.log(slope / SIGMA) + 40.0
    )


def test_the_truth_surprises_less_than_too_simple_a_model() -> None:
    gains = [
        neg2_log_predictive(*fits(("level",), seed)) - neg2_log_predictive(*fits(("level", "slope"), seed))
        for seed in range(20)
    ]
    assert min(gains) > 10.0
