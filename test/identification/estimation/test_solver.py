"""Least squares on whitened residuals: optimum, bounds, intervals, starts."""

from __future__ import annotations

import math
from collections.abc import Mapping, Sequence
from dataclasses import replace

import numpy as np
import pytest
from scipy.optimize import least_squares

from identification.diagnosis.test_sound_verdicts import Decay
from identification.recordings import TRUTH, one_opening, recorded
from valve_sim.files.parameter_files import default_valve
from valve_sim.identification.estimation.descent import Descent
from valve_sim.identification.fit.intervals import Unbounded, covariance_interval, profile_interval
from valve_sim.identification.fit.priors import Cauchy
from valve_sim.identification.fit.problem import Problem
from valve_sim.identification.fit.result import fit
from valve_sim.identification.plants.protocol import (
    Direction,
    Sensitivities,
    from_internal,
    internal_bounds,
)
from valve_sim.identification.plants.valve import ValvePlant
from valve_sim.model import CATALOGUE, DECLARED, SimulationError, Tolerances, Valve, simulate
from valve_sim.traces import Signal, Trace

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
    def refuse(values: object) -> None:
        raise SimulationError("no")

    monkeypatch.setattr(problem.plant, "predict", refuse)
    with pytest.raises(SimulationError, match="start of the fit"):
        fit(problem, BOTH, {})


class Steep(Decay):
    """A decay whose derivatives are finite, and their squares are not."""

    def sensitivities(self, values: Mapping[str, float], directions: Sequence[Direction]) -> Sensitivities:
        columns = np.full((len(self.times), len(directions)), 1e200)
        return Sensitivities([columns], np.ones(len(directions), dtype=bool))


def test_derivatives_that_are_too_large_to_be_squared_are_an_error() -> None:
    problem = Problem(Steep("current", "A", Decay("current", "A").predict({"gain": 1.3})))
    with pytest.raises(SimulationError, match="derivatives are too large"):
        fit(problem, ("gain",), {})


def tolerant() -> Valve:
    """The default valve, whose declared values are known within tolerances."""
    declared = {"spring_rate": 4.0, "spring_preload": 0.02, "pilot_gap": 2e-6, "stroke": 2e-6, "moving_mass": 1e-4}
    covariance = tuple(map(tuple, np.diag([0.03, 100.0, 1e5, 1e8]) ** 2))
    return replace(default_valve(), tolerances=Tolerances(declared, covariance))


def with_current(trace: Trace) -> Trace:
    """A recording with a coil current beside, from the default valve, sampled at no command's own time."""
    times = trace.times + 13e-6
    current = simulate(default_valve(), trace.drive, times).coil_current
    noise = 1e-3 * np.random.default_rng(2).standard_normal(len(current))
    return replace(trace, coil_current=Signal(times, current + noise))


def searched(plant: ValvePlant, effect: str | None) -> tuple[Descent, np.ndarray]:
    """A search with everything free beside an effect, and where it starts."""
    parameters = CATALOGUE[effect].parameters if effect else ()
    start = {f"{effect}.{parameter.name}": parameter.prior_scale for parameter in parameters}
    nuisances = (*plant.nuisances, *plant.timing_errors)
    search = Descent(Problem(plant), (*BOTH, "reference_voltage", *start), nuisances, {}, None)
    return search, search.start(start)


def residuals(search: Descent, at: np.ndarray) -> np.ndarray:
    found = search.residuals(at)
    assert found is not None
    return found


def size(search: Descent, column: int) -> float:
    """Of a step in a coordinate: short, yet long enough for what the integrator's tolerance adds."""
    nuisance = column - len(search.free)
    if nuisance >= 0 and search.nuisances[nuisance].is_of_machine:
        return 2e-5 * search.nuisances[nuisance].sigma
    return 1e-3 * float(search.steps[column])


@pytest.mark.parametrize("effect", [None, "squeeze_film", "eddy_lag", "magnetic_saturation"])
def test_derivatives_of_the_plant_are_those_of_small_differences(effect: str | None) -> None:
    trace = with_current(recorded())
    search, at = searched(ValvePlant([trace, replace(trace, source="again")], tolerant()), effect)
    jacobian = search.jacobian(at, residuals(search, at))
    columns = range(len(search.free)) if effect else range(len(at))
    for column in columns:
        # So short that no sample lies between an event and where the step moves it.
        step = size(search, column) * (np.arange(len(at)) == column)
        expected = (residuals(search, at + step) - residuals(search, at - step)) / (2.0 * step[column])
        assert np.linalg.norm(jacobian[:, column] - expected) < 1e-5 * np.linalg.norm(expected), search.values(at)
