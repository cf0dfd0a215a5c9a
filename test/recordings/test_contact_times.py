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
from valve_sim.recordings import Trace, events_from_sensors

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


class Sensor(NamedTuple):
    """Noise with a correlation of neighbouring samples, and steps, m."""

    noise: float
    colour: float = 0.0
    step: float = 0.0


def measured(index: int, rate: float, sensor: Sensor, random: np.random.Generator) -> Trace:
    """Samples that begin anywhere between two of the plant's."""
    drive, times, run = strokes(index)
    chosen = slice(int(random.integers(round(FINE / rate))), None, round(FINE / rate))
    position = run.pilot_position[chosen].copy()
    noise = random.normal(size=len(position))
    for number in range(1, len(noise) if sensor.colour else 0):
        noise[number] = sensor.colour * noise[number - 1] + np.sqrt(1.0 - sensor.colour**2) * noise[number]
    position += sensor.noise * noise
    if sensor.step > 0.0:
        position = sensor.step * np.round(position / sensor.step)
    return Trace("plant", drive, times[chosen], position)


SENSORS = {
    "fine": Sensor(0.2e-6), "usual": Sensor(1e-6), "noisy": Sensor(5e-6), "noisier": Sensor(20e-6),
    "coloured": Sensor(1e-6, colour=0.9), "coarse": Sensor(1e-6, step=5e-6), "coarser": Sensor(1e-6, step=20e-6),
    "coarse, no noise": Sensor(0.0, step=3e-6), "no noise": Sensor(0.0),
}  # fmt: skip


def deviations_of(trace: Trace, index: int) -> list[float]:
    """Of each arrival found, in its standard errors; every one of a stroke is found."""
    deviations = []
    for stroke, found in events_from_sensors(trace, GAP):
        kinds = list(TRUTH)[2:] if stroke.kind == "closing" else list(TRUTH)[:2]
        assert {event.kind for event in found} == set(kinds)
        for event in found:
            inside = (one for one in strokes(index).run.events if stroke.start < one.time < stroke.stop)
            truth = next(one.time for one in inside if one.kind in TRUTH[event.kind])
            deviations.append((event.time - truth) / event.stderr)
            assert event.stderr < 3e-3
    return deviations


@pytest.mark.parametrize("sensor", SENSORS)
@pytest.mark.parametrize("plants", [4, pytest.param(len(PLANTS), marks=pytest.mark.long)])
def test_arrivals_are_within_their_errors_at_any_rate(plants: int, sensor: str) -> None:
    """The plants of another form are compiled for it, which takes a quarter of a minute."""
    every: list[float] = []
    for rate in (500.0, 1e3, 2e3, 5e3, 10e3, 20e3, 50e3):
        random, found = np.random.default_rng([round(rate), list(SENSORS).index(sensor)]), []
        for index in range(plants):
            found += deviations_of(measured(index, rate, SENSORS[sensor], random), index)
        assert len(found) == 4 * 8 * plants
        assert np.mean(np.abs(found) < 1.96) >= 0.93
        every += found
    assert np.mean(np.abs(every) < 1.96) >= 0.95
    assert np.mean(np.abs(every) < 3.0) >= 0.985


def test_dense_samples_tell_more_than_their_interval() -> None:
    random = np.random.default_rng(4)
    traces = [measured(index, 20e3, SENSORS["usual"], random) for index in range(3)]
    found = [event for trace in traces for one in events_from_sensors(trace, GAP) for event in one.events]
    assert np.median([event.stderr for event in found]) < 8e-6


def test_a_spike_before_each_arrival_is_none() -> None:
    """Of one reading in motion, by less than the plunger moves in five."""
    random, deviations = np.random.default_rng(3), []
    for index in range(3):
        trace, events = measured(index, 20e3, SENSORS["usual"], random), strokes(index).run.events
        for one in events:
            at = int(np.searchsorted(trace.times, one.time)) - int(random.integers(2, 15))
            trace.pilot_position[at] += random.choice([-1.0, 1.0]) * random.uniform(30e-6, 100e-6)
        deviations += deviations_of(trace, index)
    assert np.mean(np.abs(deviations) < 1.96) >= 0.85
