"""Arrival times hold their stated errors: strokes of the independent plants at any rate and noise."""

from __future__ import annotations

from functools import cache
from typing import NamedTuple

import numpy as np
import pytest
from plants.common import Plant, PlantRun
from plants.declared import DeclaredPlant
from plants.mismatched import MismatchedPlant
from plants.recording import train_profile
from plants.reluctance import AS_BUILT, ReluctancePlant

from valve_sim.model import Drive
from valve_sim.traces import Trace, events_from_sensors

FINE = 100e3
"""Hz, of which the rates below are a part."""
GAP = 0.26e-3
TRUTH = {
    "pilot_reaches_main": ("picked_up",),
    "reaches_stop": ("opened",),
    "main_seats": ("main_seated",),
    "reaches_seat": ("seated",),
}
PLANTS: tuple[Plant, ...] = (
    DeclaredPlant(step=1e-5),
    DeclaredPlant({}, {"pilot_damping": 2.5, "main_damping": 8.0}, step=1e-5),
    DeclaredPlant({"coulomb_friction": {"force": 0.15}}, step=1e-5),
    DeclaredPlant({"pickup_impact": {"velocity_ratio": 0.82}}, step=1e-5),
    DeclaredPlant({"squeeze_film": {"coefficient": 20.0, "film_thickness": 20e-6}}, step=1e-5),
    MismatchedPlant(sensor_cutoff=0.0),
    ReluctancePlant(build=AS_BUILT._replace(sensor_cutoff=0.0)),
)
"""Ideal sensors: how late a sensor shows a position is not in the error."""


class Strokes(NamedTuple):
    """Eight strokes as they were, each 10 µs, m."""

    drive: Drive
    times: np.ndarray
    run: PlantRun


@cache
def strokes(index: int) -> Strokes:
    profile = train_profile()
    starts = profile.times + np.random.default_rng(index).uniform(0.0, 2e-3, len(profile.times))
    times = np.arange(round(profile.duration * FINE)) / FINE
    return Strokes(Drive(starts, profile.volts), times, PLANTS[index].simulate(starts, profile.volts, times))


def measured(index: int, rate: float, noise: float, random: np.random.Generator) -> Trace:
    """Samples that begin anywhere between two of the plant's."""
    drive, times, run = strokes(index)
    chosen = slice(int(random.integers(round(FINE / rate))), None, round(FINE / rate))
    position = run.pilot_position[chosen]
    return Trace("plant", drive, times[chosen], position + random.normal(0.0, noise, len(position)))


@pytest.mark.parametrize(("rate", "noise"), [(500.0, 1e-6), (2e3, 5e-6), (5e3, 0.2e-6), (20e3, 1e-6)])
@pytest.mark.parametrize("plants", [4, pytest.param(len(PLANTS), marks=pytest.mark.long)])
def test_arrivals_are_within_their_errors_at_any_rate(rate: float, noise: float, plants: int) -> None:
    """The plants of another form are compiled for it, which takes a quarter of a minute."""
    random = np.random.default_rng(round(rate + noise * 1e9))
    deviations = []
    for index in range(plants):
        events = strokes(index).run.events
        for stroke, found in events_from_sensors(measured(index, rate, noise, random), GAP):
            closes = stroke.kind == "closing"
            assert [event.kind for event in found] == list(TRUTH)[2 * closes : 2 + 2 * closes]
            for event in found:
                inside = (one for one in events if stroke.start < one.time < stroke.stop)
                truth = next(one.time for one in inside if one.kind in TRUTH[event.kind])
                deviations.append((event.time - truth) / event.stderr)
                assert event.stderr < 1.0 / rate + 8.0 * noise / 0.1
    assert len(deviations) == 4 * 8 * plants
    assert np.mean(np.abs(deviations) < 1.96) >= 0.95
    assert np.mean(np.abs(deviations) < 3.0) >= 0.985


def test_dense_samples_tell_more_than_their_interval() -> None:
    random = np.random.default_rng(4)
    found = [event for index in range(3) for one in events_from_sensors(measured(index, 20e3, 1e-6, random), GAP)
             for event in one.events]  # fmt: skip
    assert np.median([event.stderr for event in found]) < 8e-6


@pytest.mark.parametrize(("colour", "step"), [(0.7, 0.0), (0.0, 5e-6)])
def test_noise_with_a_colour_and_a_coarse_sensor_widen_the_errors(colour: float, step: float) -> None:
    random = np.random.default_rng(9)
    deviations = []
    for index in range(3):
        trace = measured(index, 20e3, 0.0, random)
        noise = random.normal(0.0, 1e-6, len(trace.times))
        for number in range(1, len(noise)):
            noise[number] = colour * noise[number - 1] + np.sqrt(1.0 - colour**2) * noise[number]
        trace.pilot_position[:] += noise
        if step > 0.0:
            trace.pilot_position[:] = step * np.round(trace.pilot_position / step)
        truth = {"opened": "reaches_stop", "seated": "reaches_seat"}
        for stroke, found in events_from_sensors(trace, GAP):
            times = {event.kind: event for event in found}
            for one in strokes(index).run.events:
                if one.kind in truth and stroke.start < one.time < stroke.stop:
                    event = times[truth[one.kind]]
                    deviations.append((event.time - one.time) / event.stderr)
    assert np.mean(np.abs(deviations) < 1.96) >= 0.93
