"""Every parameter freed beside the dampings, on recordings of plants that share no code with the package."""

from __future__ import annotations

import itertools
import math
from dataclasses import replace
from functools import cache

import numpy as np
import pytest
from plants.declared import CAMPAIGN_VALVE
from plants.recording import Profile, Recorder

from identification.recordings import TRUTH, recorded
from valve_sim.files.parameter_files import default_valve
from valve_sim.identification.diagnosis.identify import Identification, identify
from valve_sim.identification.fit.intervals import Unbounded
from valve_sim.identification.fit.priors import Cauchy, LogNormal
from valve_sim.identification.plants.protocol import perturbed, to_internal
from valve_sim.identification.plants.valve_model import DAMPINGS
from valve_sim.model import CATALOGUE, DECLARED
from valve_sim.recordings import Trace

BENCH = [entry for entry in CATALOGUE.values() if entry.named and entry.is_of(has_gas=False)]
EFFECTS = [f"{entry.name}.{one.name}" for entry in BENCH for one in entry.parameters]
EVERY = [*DECLARED, *EFFECTS]
RECORDERS = {
    "clean": Recorder(position_noise=0.0, current_noise=0.0, with_current=True),
    "noisy": Recorder(with_current=True),
}
PROFILES = {
    "two strokes": Profile(np.array([0.005, 0.03, 0.05, 0.07]), np.array([9.0, 0.0, 12.0, 0.0]), 0.09),
    "at rest": Profile(np.array([0.001]), np.array([0.0]), 0.01),
}
CHANGED: dict[str, float] = {"seat_load": 0.03, "pickup_velocity_ratio": 0.95, "coil_resistance": 12.0}
"""What is so small, or so near its bound, that a share of it would not do; of the others 3 % are missed."""
SHORT = ("pilot_mass", "coil_resistance", "stiction.stribeck_velocity", "sensor_delay.delay")
BOTH = (("two strokes", "noisy"), ("at rest", "clean"))
"""What is tried of these in short: a parameter that moves the valve, one of the current, a shape, a sensor's."""
SEEN = 10.0
"""Noise standard deviations by which all samples together must change for a parameter to be plainly seen."""


@cache
def recording(noise: str, profile: str = "two strokes", **changed: float) -> Trace:
    """Dampings as in `TRUTH`, the rest as declared but for what is changed."""
    return recorded(RECORDERS[noise], PROFILES[profile], **changed)


def freed(trace: Trace, name: str) -> Identification:
    return identify([trace], default_valve().exact(), tuple(dict.fromkeys((*DAMPINGS, name))))


def change(result: Identification, name: str) -> float:
    """By how many standard deviations of noise all samples together change with a parameter, as declared."""
    problem = result.fit.problem
    moved = perturbed(problem.plant.parameter(name), problem.plant.declared(name))
    return float(np.linalg.norm(problem.residuals({name: moved}) - problem.residuals({})))


def is_where_its_prior_has_it(result: Identification, name: str) -> bool:
    """Whether an estimate of which the data say nothing is at its most probable value before them."""
    at, prior = float(result.fit.coordinates[result.fit.free.index(name)]), result.fit.problem.prior(name)
    if isinstance(prior, Cauchy):
        return abs(at - prior.centre) < 1e-3 * prior.scale
    if isinstance(prior, LogNormal):
        return at == pytest.approx(prior.median, rel=1e-3)
    plant = result.fit.problem.plant
    return at == pytest.approx(to_internal(plant.parameter(name), plant.declared(name)), rel=1e-9)


@pytest.mark.parametrize(
    ("name", "profile", "noise"),
    [
        pytest.param(name, *how, marks=() if name in SHORT and how in BOTH else pytest.mark.long)
        for name in EVERY
        for how in itertools.product(PROFILES, RECORDERS)
    ],
)
def test_every_parameter_gets_an_honest_interval(name: str, profile: str, noise: str) -> None:
    result = freed(recording(noise, profile), name)
    found, parameter = result.intervals[name], result.fit.problem.plant.parameter(name)
    assert parameter.lower <= found.low <= found.value <= found.high
    assert math.isfinite(found.high) or (parameter.off is not None and math.isinf(parameter.off))
    effect, dot, _ = name.partition(".")
    assert not dot or set(result.valve.effects[effect]) == set(CATALOGUE[effect].names), "a file needs all of them"
    seen, is_flat = change(result, name), found.unbounded is Unbounded.FLAT_PROFILE
    if seen == 0.0:
        assert is_flat
        assert (found.low, found.high) != (found.value, found.value)
        assert is_where_its_prior_has_it(result, name)
    if seen > SEEN:
        assert not is_flat


@pytest.mark.parametrize(
    "name",
    [
        pytest.param(name, marks=() if name in SHORT else pytest.mark.long)
        for name in sorted({*CAMPAIGN_VALVE} - {"attraction_polynomial"})
    ],
)
def test_every_declared_parameter_that_is_wrong_is_found(name: str) -> None:
    truth = CHANGED.get(name, 1.03 * float(CAMPAIGN_VALVE[name]))  # type: ignore[arg-type]
    found = freed(recording("noisy", **{name: truth}), name).intervals[name]
    assert abs(found.value - truth) < 3.0 * found.stderr
    assert found.stderr < 0.1 * truth
    assert found.unbounded is None


@pytest.mark.parametrize("place", [0, pytest.param(2, marks=pytest.mark.long)])
def test_of_several_bags_one_that_shows_a_parameter_is_enough(place: int) -> None:
    # Of the others, one has no current, in which alone a resistance shows, and one no motion.
    told, at_rest = (recording("noisy", profile, coil_resistance=12.0) for profile in PROFILES)
    traces = [replace(told, source="without a current", coil_current=None), at_rest]
    traces.insert(place, told)
    free = (*DAMPINGS, "coil_resistance")
    together, alone = (identify(given, default_valve().exact(), free).intervals for given in (traces, [told]))
    for name, truth in {**TRUTH, "coil_resistance": 12.0}.items():
        assert abs(together[name].value - truth) < 3.0 * together[name].stderr
    assert together["coil_resistance"].stderr == pytest.approx(alone["coil_resistance"].stderr, rel=0.1)
    assert together["main_damping"].stderr < 0.9 * alone["main_damping"].stderr
