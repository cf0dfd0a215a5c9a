"""How large an effect would have to be: refits to an independent plant that has so much of it agree."""

from __future__ import annotations

import math

import pytest
from plants.declared import CAMPAIGN_VALVE, DeclaredPlant
from plants.recording import Recorder, record, train_profile

from benchmarks.campaign.cases import declared_valve
from benchmarks.campaign.running import as_trace
from valve_sim.identification.diagnosis.run import diagnose
from valve_sim.identification.estimation.problem import Problem
from valve_sim.identification.estimation.result import Fit
from valve_sim.identification.estimation.solver import fit
from valve_sim.identification.plants.valve import ValvePlant
from valve_sim.identification.reporting.detection_limits import limit_rows
from valve_sim.identification.reporting.diagnosis_json import to_json
from valve_sim.identification.reporting.text import diagnosis_text
from valve_sim.identification.selection.detection_limits import detection_limits
from valve_sim.model import Valve

SIGMA = 0.02 * float(CAMPAIGN_VALVE["coil_time_constant"])  # type: ignore[arg-type]
EXACT, WITHIN = declared_valve(CAMPAIGN_VALVE), declared_valve(CAMPAIGN_VALVE, {"coil_time_constant": SIGMA})


def fitted(plant: DeclaredPlant, valve: Valve, *freed: str) -> Fit:
    trace = as_trace(record(plant, train_profile(), Recorder(), 8), "train")
    problem = Problem(ValvePlant([trace], valve))
    return fit(problem, (*problem.plant.base, *freed), {}, nuisances=problem.plant.nuisances)


@pytest.fixture(scope="module")
def exact() -> Fit:
    return fitted(DeclaredPlant(), EXACT)


@pytest.mark.parametrize(
    ("effect", "parameter", "off"),
    [
        ("coulomb_friction", "force", 0.0),
        ("drive_gain", "gain", 1.0),
        ("quadratic_drag", "coefficient", 0.0),
        ("magnetic_saturation", "current", math.inf),
    ],
)
def test_three_times_the_limit_gains_what_it_should(exact: Fit, effect: str, parameter: str, off: float) -> None:
    limit = detection_limits(exact)[effect][parameter]
    at = limit / 3.0 if math.isinf(off) else off + 3.0 * limit
    lacking = fitted(DeclaredPlant({effect: {parameter: at}}), EXACT)
    refitted = fitted(DeclaredPlant({effect: {parameter: at}}), EXACT, f"{effect}.{parameter}")
    price = math.log(exact.problem.effective_samples)
    amplitude = 9.0 if effect != "magnetic_saturation" else 81.0
    # The noise adds or takes away two standard deviations of a normal number.
    expected = math.sqrt(amplitude * (10.0 + price))
    assert math.sqrt(lacking.score - refitted.score + price) == pytest.approx(expected, abs=2.0, rel=0.1)


def test_a_tolerance_hides_the_effect_that_is_the_same_thing(exact: Fit) -> None:
    without = detection_limits(exact)["coil_lag"]["time_constant"]
    within = detection_limits(fitted(DeclaredPlant(), WITHIN))
    # The square root of 10 + ln 100, in tolerances.
    assert within["coil_lag"]["time_constant"] == pytest.approx(3.82 * SIGMA, rel=0.02)
    assert within["valve.coil_time_constant"] == {"coil_time_constant": pytest.approx(3.82 * SIGMA, rel=0.02)}
    assert without < 0.2 * SIGMA


def test_what_a_clock_can_do_is_priced_by_its_prior(exact: Fit) -> None:
    """A sensor that is late is a clock that is off, which is known to 50 µs."""
    price = math.log(exact.problem.effective_samples)
    late = detection_limits(exact)["sensor_delay"]["delay"]
    assert late == pytest.approx(50e-6 * math.sqrt(10.0 + price), rel=0.05)


def test_what_is_in_the_fit_has_no_limit() -> None:
    assert "constant_force" not in detection_limits(fitted(DeclaredPlant(), EXACT, "constant_force.force"))


def test_a_report_that_nothing_is_missing_says_what_would_have_shown() -> None:
    trace = as_trace(record(DeclaredPlant(), train_profile(), Recorder(), 8), "train")
    found = diagnose([trace], [], EXACT)
    assert found.verdict.kind == "none"
    assert not found.candidates
    limits = to_json(found)["detection_limits"]
    assert set(limits) == set(found.plant.effects)
    assert 0.5e-3 < limits["coulomb_friction"]["force"] < 5e-3
    shown = dict(limit_rows(found))["Coulomb friction"]
    assert shown == f"{limits['coulomb_friction']['force']:.5f} N"
    assert f"Coulomb friction {shown}" in " ".join(diagnosis_text(found).split())
