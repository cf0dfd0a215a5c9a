"""What differs by interval between commands: runs in pieces, their derivatives, and what a source's resistance does."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import pytest
from plants.declared import DeclaredPlant
from plants.laboratory import Laboratory, measure
from plants.recording import Recorder, record, train_profile
from plants.tolerances import SHEET_VALVE

from benchmarks.campaign.declared import as_trace, declared_valve
from valve_sim.identification.plants.protocol import Array, Direction
from valve_sim.identification.plants.valve import ValvePlant

VALUES = {"main_damping": 4.0, "spring_preload": 2.5, "coil_time_constant": 1e-3, "clock_offset[0]": 0.0}


@pytest.fixture(scope="module")
def plant() -> ValvePlant:
    recording = record(DeclaredPlant({}, SHEET_VALVE), train_profile(), Recorder(with_current=True), 3)
    return ValvePlant([as_trace(recording, "x")], declared_valve(SHEET_VALVE))


def test_a_stroke_that_differs_changes_no_other(plant: ValvePlant) -> None:
    plain = plant.predict({})[0]
    changed = plant.predict({"stroke_variation[0,3,main_damping]": 0.2})[0]
    strokes = plant.channels[0].group
    assert np.max(np.abs(changed - plain)[strokes == 3]) > 1e-6
    assert not np.any((changed - plain)[strokes != 3])


@pytest.mark.parametrize(
    ("name", "step"),
    [
        ("stroke_variation[0,3,main_damping]", 1e-6),
        ("stroke_variation[0,5,seat_load]", 1e-6),
        ("supply[0]", 1e-6),
        ("clock_rate[0]", 1e-8),
    ],
)
def test_derivatives_are_those_of_the_prediction(plant: ValvePlant, name: str, step: float) -> None:
    at = {own.name: 0.0 for own in plant.varying}
    at |= {**VALUES, "clock_rate[0]": 1e-4, "stroke_variation[0,3,main_damping]": 0.2, "supply[0]": 0.4}
    found = plant.sensitivities(at, [Direction({name: 1.0}, step)])
    assert found.known.all()
    there = [plant.predict({**at, name: at[name] + sign * step}) for sign in (1.0, -1.0)]
    for column, ahead, behind in zip(found.columns, *there, strict=True):
        quotient = (ahead - behind) / (2.0 * step)
        rounding = 4e-14 * float(np.max(np.abs(ahead))) / step
        np.testing.assert_allclose(column[:, 0], quotient, atol=2e-5 * float(np.max(np.abs(quotient))) + rounding)


@pytest.mark.parametrize("values", [{}, {"stroke_variation[0,3,main_damping]": 0.2}], ids=["plain", "in pieces"])
def test_a_sensor_that_averages_shows_means_and_their_derivatives(plant: ValvePlant, values: dict[str, float]) -> None:
    mean = ValvePlant([replace(plant.traces[0], averaging=8)], plant.valve)
    seen, shown = plant.predict(values)[0], mean.predict(values)[0]
    for last in (7, 1000, len(seen) - 1):
        assert shown[last] == pytest.approx(np.mean(seen[last - 7 : last + 1]), abs=1e-12)
    direction = Direction({"main_damping": 1.0}, 1e-6)
    of_seen, of_shown = (own.sensitivities(values, [direction]).columns[0][:, 0] for own in (plant, mean))
    assert of_shown[1000] == pytest.approx(np.mean(of_seen[993:1001]), abs=1e-9)
    # Nothing else is averaged.
    np.testing.assert_array_equal(plant.predict(values)[1], mean.predict(values)[1])


def _error(plant: ValvePlant, values: dict[str, float]) -> Array:
    return plant.channels[0].data - plant.predict(values)[0]


def test_a_source_with_a_resistance_is_what_its_circuit_does() -> None:
    laboratory = Laboratory(position_noise=1e-9, supply_resistance=0.5)
    recording = measure(SHEET_VALVE, {}, train_profile(), laboratory, 1)
    plant = ValvePlant([as_trace(recording, "x")], declared_valve(SHEET_VALVE))
    dampings = {name: float(np.asarray(SHEET_VALVE[name])) for name in ("pilot_damping", "main_damping")}
    without, beside = _error(plant, dampings), _error(plant, {**dampings, "supply[0]": 0.5})
    assert np.max(np.abs(beside)) < 0.01 * np.max(np.abs(without))


def test_a_clock_that_runs_fast_makes_commands_later_and_later() -> None:
    recording = measure(SHEET_VALVE, {}, train_profile(), Laboratory(position_noise=1e-9, clock_rate=200e-6), 1)
    plant = ValvePlant([as_trace(recording, "x")], declared_valve(SHEET_VALVE))
    dampings = {name: float(np.asarray(SHEET_VALVE[name])) for name in ("pilot_damping", "main_damping")}
    without, beside = _error(plant, dampings), _error(plant, {**dampings, "clock_rate[0]": 200e-6})
    assert np.max(np.abs(beside)) < 0.01 * np.max(np.abs(without))
