"""How large an effect would have to be: what is named at the stated limit, and by the valve's own sensors."""

from __future__ import annotations

import math
from collections.abc import Mapping, Sequence
from dataclasses import replace

import numpy as np
import pytest
from plants.declared import CAMPAIGN_VALVE, DeclaredPlant
from plants.recording import Recorder, record, train_profile

from benchmarks.campaign.declared import as_trace, declared_valve
from identification.fit.linear_plant import COLUMNS, LinearPlant, measured, problem_of
from identification.recordings import Short
from valve_sim.identification.diagnosis.run import diagnose_plant
from valve_sim.identification.fit.detection_limits import Limits, detection_limits
from valve_sim.identification.fit.fitter import Fitter
from valve_sim.identification.fit.posterior import decide, rivals_of
from valve_sim.identification.fit.problem import Problem
from valve_sim.identification.fit.search import Search
from valve_sim.identification.plants.protocol import Array, EffectChoice, Nuisance
from valve_sim.identification.plants.valve import ValvePlant
from valve_sim.identification.reporting.diagnosis_document import diagnosis_document
from valve_sim.model import Parameter, Valve

SIGMA = 0.02 * float(CAMPAIGN_VALVE["coil_time_constant"])  # type: ignore[arg-type]
EXACT, WITHIN = declared_valve(CAMPAIGN_VALVE), declared_valve(CAMPAIGN_VALVE, {"coil_time_constant": SIGMA})

# -- a linear plant: the rate at the limit -----------------------------------------------------------------------------

DRIFT = Nuisance("known", 0.03, "m", is_of_machine=True)
KINDS = {
    "two-sided": Parameter("size", "m", "added", -1e6, 1e6, 0.3, 0.0),
    "upwards": Parameter("size", "m", "added", 0.0, 1e6, 0.3, 0.0),
    "a ratio of at most 1": Parameter("size", "1", "of it", 0.0, 1.0, 0.3, 1.0),
    "small by its prior": Parameter("size", "m", "added", -1e6, 1e6, 0.01, 0.0),
}
RECORDINGS, AT_TWICE = 20, 10


def limits(problem: Problem, free: Sequence[str] | None = None, more: int = 0) -> Limits:
    """Beside the declared model, of its effects and of so many more rivals."""
    own = rivals_of(problem.plant)
    fitter = Fitter(problem, replace(own, effects=own.effects | set(map(str, range(more)))), free=free)
    return detection_limits(fitter, fitter.fitted_declared())


def plant_of(switch: Parameter, off_by: float, seed: int) -> LinearPlant:
    """Four effects, each with a column of its own, the first half like a declared value's; only the first acts."""
    names = ("first", "second", "third", "fourth")
    assert switch.off is not None

    def shown(values: Mapping[str, float]) -> Array:
        sizes = [values.get(f"{name}.size", switch.off) - switch.off for name in names]
        mixed = COLUMNS[:, 1] + 0.5 * COLUMNS[:, 5]
        columns = np.column_stack([mixed, COLUMNS[:, 2:5]])
        return np.asarray(columns @ np.array(sizes) + values.get("known", 0.0) * COLUMNS[:, 5])

    effects = [EffectChoice(name, (switch,)) for name in names]
    known = float(np.random.default_rng(seed).normal(0.0, DRIFT.sigma))
    acting = shown({"first.size": switch.off + off_by, "known": known})
    return LinearPlant(measured(seed) + acting, shown, effects=effects, nuisances=[DRIFT])


@pytest.mark.long
@pytest.mark.parametrize("kind", KINDS)
def test_at_the_stated_limit_an_effect_is_named_in_half_of_recordings(kind: str) -> None:
    """35 to 65 % of recordings of which each states its own limit before anything acts."""
    switch, named, at_twice = KINDS[kind], [], []
    sign = -1.0 if switch.off == switch.upper else 1.0
    for seed in range(RECORDINGS):
        problem = problem_of(plant_of(switch, 0.0, seed))
        limit = limits(problem)["first"]["size"]
        for share, found in ((1.0, named), (2.0, at_twice))[: 2 if seed < AT_TWICE else 1]:
            search = Search(problem_of(plant_of(switch, sign * share * limit, seed)))
            search.run()
            decision = decide(search.posterior())
            found.append(decision.kind == "effects" and decision.names == ("first",))
    assert 0.35 <= np.mean(named) <= 0.65
    assert np.mean(at_twice) >= 0.9


def test_what_cannot_be_named_within_its_range_has_no_limit() -> None:
    narrow = Parameter("size", "m", "added", 0.0, 0.01, 0.3, 0.0)
    problem = problem_of(plant_of(narrow, 0.0, 1))
    assert limits(problem)["first"]["size"] == math.inf


def test_more_rivals_raise_the_limit_as_the_prior_falls() -> None:
    problem = problem_of(plant_of(KINDS["two-sided"], 0.0, 1))
    few, many = (limits(problem, more=more) for more in (0, 200))
    assert 1.05 * few["first"]["size"] < many["first"]["size"] < 1.6 * few["first"]["size"]


# -- a valve -----------------------------------------------------------------------------------------------------------


def limits_of(valve: Valve, *freed: str) -> Limits:
    trace = as_trace(record(DeclaredPlant(), train_profile(), Recorder(), 8), "train")
    plant = ValvePlant([trace], valve)
    return limits(Problem(plant), free=(*plant.base, *freed))


@pytest.fixture(scope="module")
def exact() -> Limits:
    return limits_of(EXACT)


def test_limits_of_a_valve_are_of_the_size_that_its_sensor_can_see(exact: Limits) -> None:
    assert 0.5e-3 < exact["coulomb_friction"]["force"] < 5e-3
    assert 1e-4 < exact["drive_gain"]["gain"] < 2e-3
    # Infinite where it does nothing: the limit is the current from which downwards it shows.
    assert 1.0 < exact["magnetic_saturation"]["current"] < 1e3


def test_a_tolerance_hides_the_effect_that_is_the_same_thing(exact: Limits) -> None:
    within = limits_of(WITHIN)
    for name, parameter in (("coil_lag", "time_constant"), ("valve.coil_time_constant", "coil_time_constant")):
        assert 2.5 * SIGMA < within[name][parameter] < 6.0 * SIGMA
    assert exact["coil_lag"]["time_constant"] < 0.2 * SIGMA


def test_what_a_clock_can_do_is_priced_by_its_prior(exact: Limits) -> None:
    """A sensor that is late is a clock that is off, which is known to 50 µs."""
    assert 2.5 * 50e-6 < exact["sensor_delay"]["delay"] < 6.0 * 50e-6


def test_what_is_in_the_fit_has_no_limit() -> None:
    assert "constant_force" not in limits_of(EXACT, "constant_force.force")


def test_a_report_that_nothing_is_missing_says_what_would_have_shown() -> None:
    trace = as_trace(record(DeclaredPlant(), train_profile(), Recorder(), 8), "train")
    found = diagnose_plant(Short([trace], EXACT, ["coulomb_friction"]), None)
    assert found.verdict.kind == "none"
    limits = diagnosis_document(found).to_json()["detection_limits"]
    assert set(limits) == set(found.plant.effects)
    assert 0.5e-3 < limits["coulomb_friction"]["force"] < 5e-3
    shown = f"Coulomb friction {limits['coulomb_friction']['force']:.5f}"[:-1]
    assert shown in " ".join(diagnosis_document(found).to_text().split())
