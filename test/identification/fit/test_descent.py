"""One descent: its optimum is the one that SciPy finds, within ranges; intervals follow from it."""

from __future__ import annotations

import math
from collections.abc import Mapping, Sequence

import numpy as np
import pytest
from scipy.optimize import least_squares, lsq_linear

from identification.diagnosis.test_sound_verdicts import Decay
from identification.fit.linear_plant import COLUMNS, SIGMA, LinearPlant, measured, problem_of
from identification.freed import fit
from identification.recordings import TRUTH, one_opening, recorded
from valve_sim.files.parameter_files import default_valve
from valve_sim.identification.fit.intervals import Unbounded, covariance_interval, profile_interval
from valve_sim.identification.fit.priors import Cauchy
from valve_sim.identification.fit.problem import Problem
from valve_sim.identification.plants.protocol import (
    Direction,
    Nuisance,
    Sensitivities,
    from_internal,
    internal_bounds,
)
from valve_sim.identification.plants.valve import ValvePlant
from valve_sim.model import DECLARED, SimulationError

EXACT_VALVE = default_valve().exact()

BOTH = ("pilot_damping", "main_damping")


@pytest.fixture(scope="module")
def problem() -> Problem:
    return Problem(ValvePlant([recorded()], EXACT_VALVE))


def test_it_finds_the_optimum_that_scipy_finds(problem: Problem) -> None:
    nuisances = problem.plant.nuisances[:1]
    ours = fit(problem, BOTH, {}, nuisances=nuisances)
    sigma = nuisances[0].sigma

    def residuals(at: np.ndarray) -> np.ndarray:
        values = {"pilot_damping": at[0], "main_damping": at[1], nuisances[0].name: at[2] * sigma}
        priors = [math.log(at[place] / problem.plant.declared(name)) for place, name in enumerate(BOTH)]
        return np.concatenate([problem.residuals(values), priors, at[2:]])

    theirs = least_squares(residuals, [1.0, 4.0, 0.0], x_scale=[0.01, 0.01, 0.01], diff_step=1e-4)
    assert ours.converged
    assert ours.chi2 == pytest.approx(2.0 * theirs.cost, abs=0.02)
    for name, value in zip(BOTH, theirs.x, strict=False):
        assert abs(ours.values[name] - value) < 0.1 * ours.stderr(name)


def test_within_ranges_it_ends_at_the_bounded_least_squares() -> None:
    """Of twelve columns with ranges that most optima lie beyond; SciPy has a reflective Newton method for it."""
    for seed in range(10):
        random = np.random.default_rng(seed)
        ends = np.sort(random.normal(0.0, 0.1, (COLUMNS.shape[1], 2)), axis=1)
        own = [Nuisance(f"n{place}", 0.5, "m", lower=low, upper=high) for place, (low, high) in enumerate(ends)]
        plant = LinearPlant(
            measured(seed) + COLUMNS @ random.normal(0.0, 0.1, len(own)),
            lambda values: COLUMNS @ np.array([values.get(f"n{place}", 0.0) for place in range(COLUMNS.shape[1])]),
        )
        found = fit(problem_of(plant), (), {}, nuisances=own)
        rows = np.vstack([COLUMNS / SIGMA, np.eye(len(own)) / 0.5])
        data = np.concatenate([plant.channels[0].data / SIGMA, np.zeros(len(own))])
        expected = lsq_linear(rows, data, (ends[:, 0], ends[:, 1]), tol=1e-14)
        assert found.converged
        assert found.chi2 == pytest.approx(2.0 * expected.cost, rel=1e-7)
        errors = np.sqrt(np.diag(found.covariance))
        assert np.all(np.abs(found.coordinates - expected.x) < 0.1 * errors), "it ends within a tenth of an error"
        assert 2 < np.sum([found.on_bound(one.name) is not None for one in own]) < 12


def test_profile_and_covariance_agree_where_the_data_hold_a_parameter(problem: Problem) -> None:
    found = fit(problem, BOTH, {}, nuisances=problem.plant.nuisances)
    for name in BOTH:
        profile, curve = profile_interval(found, name)
        plain = covariance_interval(found, name)
        assert (profile.low, profile.high) == pytest.approx((plain.low, plain.high), abs=0.1 * plain.stderr)
        assert profile.low < TRUTH[name] < profile.high
        assert [value for value, _ in curve] == sorted(value for value, _ in curve)
        assert min(rise for _, rise in curve) == 0.0


def test_a_parameter_without_influence_stays_flat() -> None:
    """The current is not measured, so its scale moves nothing."""
    problem = Problem(ValvePlant([one_opening()], EXACT_VALVE))
    found = fit(problem, ("coil_resistance", "main_damping"), {}, nuisances=problem.plant.nuisances)
    # What its prior says, by the parabola that touches a Cauchy density.
    prior = problem.prior("coil_resistance")
    assert isinstance(prior, Cauchy)
    assert found.stderr("coil_resistance") == pytest.approx(prior.scale / math.sqrt(2.0))
    assert abs(found.correlation()[0, 1]) < 1e-9
    interval, _ = profile_interval(found, "coil_resistance")
    assert interval.unbounded is Unbounded.FLAT_PROFILE
    lower, upper = internal_bounds(DECLARED["coil_resistance"])
    assert (interval.low, interval.high) == pytest.approx(
        (
            from_internal(DECLARED["coil_resistance"], lower),
            from_internal(DECLARED["coil_resistance"], upper),
        )
    )


def test_held_out_samples_take_no_part() -> None:
    trace = recorded()
    spoiled = trace.pilot_position.copy()
    spoiled[trace.times > 0.25] += 1e-4
    broken = type(trace)(trace.source, trace.drive, trace.times, spoiled)
    whole = Problem(
        ValvePlant([broken], EXACT_VALVE),
        noises=Problem(ValvePlant([trace], EXACT_VALVE)).noises,
    )
    first = whole.restricted(lambda channel, group: group < 4)
    found = fit(first, BOTH, {}, nuisances=first.plant.nuisances)
    assert 0 < first.samples < whole.samples
    for name, truth in TRUTH.items():
        assert abs(found.values[name] - truth) < 4.0 * found.stderr(name)


def test_what_cannot_be_simulated_is_an_error(problem: Problem, monkeypatch: pytest.MonkeyPatch) -> None:
    def refuse(*values: object) -> None:
        raise SimulationError("no")

    for member in ("predict", "sensitivities"):
        monkeypatch.setattr(problem.plant, member, refuse)
    with pytest.raises(SimulationError, match="no"):
        fit(problem, BOTH, {})


class Steep(Decay):
    """A decay whose derivatives are finite, and their squares are not."""

    def sensitivities(self, values: Mapping[str, float], directions: Sequence[Direction]) -> Sensitivities:
        columns = np.full((len(self.times), len(directions)), 1e200)
        return Sensitivities([columns], np.ones(len(directions), dtype=bool), self.predict(values))


def test_derivatives_that_are_too_large_to_be_squared_are_an_error() -> None:
    problem = Problem(Steep("current", "A", Decay("current", "A").predict({"gain": 1.3})))
    with pytest.raises(SimulationError, match="derivatives are too large"):
        fit(problem, ("gain",), {})
