"""A monitor beside a valve whose declared values are off within their tolerances, by the independent plant."""

from dataclasses import replace

import numpy as np
import pytest
from plants.declared import CAMPAIGN_VALVE

from identification.live_strokes import LiveValve, feed
from identification.one_thread import Monitor
from valve_sim.identification.monitoring.findings import StrokeState
from valve_sim.identification.plants.commissioned import in_service
from valve_sim.identification.plants.valve import ValvePlant
from valve_sim.model import Drive, Valve
from valve_sim.recordings import Trace

pytestmark = pytest.mark.long

TRUTH = {"pilot_damping": 1.3, "main_damping": 3.5, "spring_preload": 2.6, "stroke": 1.236e-3, "moving_mass": 0.1342}
TOLERANCES = {"spring_preload": 0.076, "stroke": 4e-6, "moving_mass": 1.3e-4}


def declared(tolerances):
    values = {**CAMPAIGN_VALVE, "attraction_polynomial": list(CAMPAIGN_VALVE["attraction_polynomial"])}
    return Valve.from_mapping({"valve": values, "tolerances": tolerances}, "the data sheet")


@pytest.fixture(scope="module")
def commissioned():
    """A monitor that has seen 20 strokes, and one more of each."""
    monitor, valve = Monitor(declared(TOLERANCES), refit=False), LiveValve(7, TRUTH, rate=5e3, offset=200e-6)
    reports = [report for _ in range(24) for report in feed(monitor, valve.stroke())]
    return monitor, reports


def test_commissioning_finds_the_valve_as_it_is(commissioned):
    monitor, reports = commissioned
    baseline = monitor.stroke_monitor.baseline
    assert set(baseline.estimated) == set(TRUTH)
    found = baseline.valve.declared()
    for name, error in zip(baseline.estimated, np.sqrt(np.diag(baseline.covariance)), strict=True):
        assert abs(found[name] - TRUTH[name]) < 4.0 * error
    assert baseline.valve.tolerances.is_exact
    watched = [report.rms / report.noise for report in reports if report.state is StrokeState.WATCHING]
    assert len(watched) >= 3
    assert np.mean(watched) == pytest.approx(1.0, abs=0.1)


def test_what_a_valve_is_built_with_is_no_fault_of_a_commissioned_one(commissioned):
    baseline = commissioned[0].stroke_monitor.baseline
    times = np.arange(0.0, 0.03, 1e-4)
    trace = Trace("a stroke", Drive.of([1e-3], [9.0]), times, np.zeros_like(times))
    any_valve = set(ValvePlant([trace], baseline.valve).effects)
    watched = set(in_service(trace, baseline.commissioned, baseline.scatter).effects)
    assert any_valve - watched == {"motional_emf"}
    assert watched - any_valve == {"pilot_damping", "main_damping"}


def test_a_declared_effect_of_another_size_bears_its_own_name_and_not_that_of_a_value_which_is_the_same(commissioned):
    found = commissioned[0].stroke_monitor.baseline.commissioned
    worn = replace(found.valve, effects={"drive_gain": {"gain": 0.95}, "motional_emf": {"share": 1.0}})
    trace = Trace("at rest", Drive.of([1e-3], [9.0]), np.arange(0.0, 0.01, 1e-4), np.zeros(100))
    effects = in_service(trace, found._replace(valve=worn), 50e-6).effects
    assert effects["drive_gain"].is_on
    assert effects["drive_gain"].parameters[0].off == 0.95
    assert "valve.reference_voltage" not in effects
    assert "motional_emf" not in effects
