"""What a fit makes of held-out data, against the density that a linear model gives them exactly."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from typing import cast

import numpy as np
import pytest
from valve_sim.identification.selection.predictive_density import FARTHEST, knowledge_for, neg2_log_predictive

from valve_sim.identification.estimation.noise import Noise
from valve_sim.identification.estimation.problem import Problem
from valve_sim.identification.estimation.result import Fit
from valve_sim.identification.estimation.solver import fit
from valve_sim.identification.plants.protocol import Array, Channel, Nuisance
from valve_sim.model import Parameter, SimulationError

SIGMA = 0.3
DRIFT = Nuisance("drift[0]", 0.4, "m")
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


# -- at the edges of what is known -------------------------------------------------------------------------------------


class Limited(Line):
    """A line whose `level` is at most 1, and whose `slope` can be simulated at one value alone."""

    slope: float | None = None

    def parameter(self, name: str) -> Parameter:
        parameter = super().parameter(name)
        return parameter._replace(upper=1.0) if name == "level" else parameter

    def predict(self, values: Mapping[str, float]) -> list[Array]:
        if values.get("level", 0.0) > 1.0 or values.get("slope", 0.0) != (self.slope or values.get("slope", 0.0)):
            raise SimulationError("out of range")
        return super().predict(values)


def both(free: tuple[str, ...], times: tuple[Array, Array], level: float, made: type[Line] = Line) -> tuple[Fit, Fit]:
    """A fit to training data at some times, and the same values on held-out data at others."""
    random = np.random.default_rng(3)
    problems = []
    for at in times:
        data = level + 0.7 * at + SIGMA * random.standard_normal(len(at))
        problems.append(Problem(made(at, data), noises=NOISES))  # type: ignore[arg-type]
    training = fit(problems[0], free, {}, nuisances=[DRIFT])
    machine = {name: training.values[name] for name in free}
    return training, fit(problems[1], (), {}, nuisances=[DRIFT], fixed=machine)


def exact(held_out: Fit, spread: Array) -> float:
    """−2 ln of the density where parameters have a covariance before the held-out data are seen."""
    channel = held_out.problem.plant.channels[0]
    design = np.column_stack([channel.times**power for power in range(len(spread))])
    misses = channel.data - held_out.problem.plant.predict({**held_out.values, DRIFT.name: 0.0})[0]
    covariance = np.eye(len(misses)) + (design @ spread @ design.T + DRIFT.sigma**2) / SIGMA**2
    return float(misses @ np.linalg.solve(covariance, misses) / SIGMA**2 + np.linalg.slogdet(covariance)[1])


STILL, LATER = np.zeros(40), np.linspace(0.0, 3.0, 40)


def test_what_the_training_data_do_not_show_may_be_anything_within_ten_prior_scales() -> None:
    training, held_out = both(("level", "slope"), (STILL, LATER), 0.5)
    spread = np.diag([training.covariance[0, 0], (10.0 * 2.0) ** 2])
    assert neg2_log_predictive(training, held_out) == pytest.approx(exact(held_out, spread), rel=1e-6)


def test_of_a_parameter_on_its_bound_the_quotient_is_taken_from_within() -> None:
    training, held_out = both(("level",), (STILL, LATER), 1.5, Limited)
    assert training.values["level"] == 1.0
    spread = training.covariance[:1, :1]
    assert neg2_log_predictive(training, held_out) == pytest.approx(exact(held_out, spread), rel=1e-6)


def test_a_parameter_that_cannot_be_moved_there_says_nothing() -> None:
    training, held_out = both(("level", "slope"), (LATER, LATER), 0.5, Limited)
    cast("Limited", held_out.problem.plant).slope = training.values["slope"]
    spread = training.covariance[:1, :1]
    assert neg2_log_predictive(training, held_out) == pytest.approx(exact(held_out, spread), rel=1e-6)


@pytest.mark.parametrize("free", [("level",), ()])
def test_of_what_training_data_leave_open_held_out_data_are_fitted_within_it(free: tuple[str, ...]) -> None:
    """A declared value with a tolerance: the density is that of the same model with all of it open."""
    rate = Nuisance("slope", 0.5, "N", is_of_machine=True)
    problems = []
    for seed, at in enumerate((LATER, LATER[::-1] + 1.0)):
        data = 0.5 + 0.7 * at + SIGMA * np.random.default_rng(seed).standard_normal(len(at))
        problems.append(Problem(Line(at, data), noises=NOISES))  # type: ignore[arg-type]
    held = {} if free else {"level": 0.5}
    training = fit(problems[0], free, {}, nuisances=[rate, DRIFT], fixed=held)
    known = knowledge_for(training)
    farthest = [1.0 / (10.0 * 2.0) ** 2] * len(free) + [0.0]
    np.testing.assert_allclose(known.information, training.machine.information + np.diag(farthest))
    held_out = fit(problems[1], free, training.values, nuisances=[rate, DRIFT], fixed=held, prior=known)
    channel = problems[1].plant.channels[0]
    design = np.column_stack([np.ones(40)] * len(free) + [channel.times])
    misses = channel.data - held.get("level", 0.0) - design @ known.coordinates
    unknown = design @ np.linalg.inv(known.information) @ design.T + DRIFT.sigma**2
    covariance = np.eye(40) + unknown / SIGMA**2
    expected = misses @ np.linalg.solve(covariance, misses) / SIGMA**2 + np.linalg.slogdet(covariance)[1]
    assert neg2_log_predictive(training, held_out) == pytest.approx(expected, abs=0.02)
