"""The core and the truth plants, which share no code and no scheme of integration, say the same of every valve.

A mistake in either of them shows here: that is what makes recordings of the plants a truth for all other tests.
"""

from __future__ import annotations

from collections.abc import Iterator, Sequence

import numpy as np
import pytest
from plants.common import PlantEvent
from plants.declared import UNCATALOGUED, DeclaredPlant
from plants.recording import train_profile

from model.core.cases import PLANT_EVENTS
from model.random_valves import RANGES
from valve_sim.model import CATALOGUE, Drive, Effect, EventKind, Parameter, Valve, simulate
from valve_sim.model.core.symbols import Motion, Own
from valve_sim.model.core.tracer import Node, exp, sin

CALIBRATED = Valve().with_values(a0=3.0336, coil_time_constant=0.9934e-3, coil_resistance=10.0)
TIMES = np.arange(3000) * 1e-4
pytestmark = pytest.mark.long  # test_core compares the core with DOP853: this is a test of the plant


def assert_alike(valve: Valve, drive: Drive, plant: DeclaredPlant, times: np.ndarray, late: float = 1e-11) -> None:
    """Positions agree to 0.1 nm, the current to 1 nA but where a command lets it jump, events to so many seconds."""
    ours = simulate(valve, drive, times, start_time=0.0)
    truth = plant.simulate(drive.times, drive.volts, times)
    assert np.max(np.abs(ours.pilot_position - truth.pilot_position)) < 1e-10
    assert np.max(np.abs(ours.main_position - truth.main_position)) < 1e-10
    away = np.abs(times[:, None] - drive.times).min(axis=1) > 1e-9
    assert np.max(np.abs(ours.coil_current - truth.coil_current)[away]) < 1e-9
    expected = events_of(truth.events)
    assert [event.kind for event in ours.events] == [kind for _, kind in expected]
    assert [event.time for event in ours.events] == pytest.approx([time for time, _ in expected], abs=late)


def events_of(events: Sequence[PlantEvent]) -> list[tuple[float, EventKind]]:
    """Events of the plant as the core tells them: a pilot that is seated and pulled off at one time has bounced."""
    found: list[tuple[float, EventKind]] = []
    for event in events:
        kind = PLANT_EVENTS[event.kind]
        if kind is EventKind.UNSEATED and found and found[-1] == (event.time, EventKind.SEATED):
            found[-1] = (event.time, EventKind.BOUNCED_AT_SEAT)
        else:
            found.append((event.time, kind))
    return found


@pytest.mark.parametrize("name", RANGES)
def test_an_effect_is_what_the_plant_says(name: str) -> None:
    effects = {name: {key: 0.9 * low + 0.1 * high for key, (low, high) in RANGES[name].items()}}
    drive = Drive(*train_profile()[:2])
    # The plant's steps know nothing of the corner that residual magnetism has where the current meets its floor.
    assert_alike(Valve(CALIBRATED.parameters, effects), drive, DeclaredPlant(effects), TIMES, late=1e-10)


# -- disturbances that the catalogue does not hold, written as effects of one's own ------------------------------------

DISTURBANCES = {
    "force_bump": {"amplitude": 0.4, "centre": 0.7e-3, "width": 0.1e-3},
    "force_ripple": {"amplitude": 0.3, "wavelength": 0.2e-3, "phase": 0.4},
    "vibration": {"amplitude": 0.1, "frequency": 180.0, "phase": 0.3},
    "damping_drift": {"rate": 30.0},
    "damping_bump": {"amplitude": 4.0, "centre": 0.6e-3, "width": 0.2e-3},
}


def disturbing(name: str, m: Motion, own: Own) -> Node:
    """The force of a disturbance, N."""
    if name == "damping_drift":
        return -own.rate * m.t * m.v
    if name == "vibration":
        return own.amplitude * sin(2.0 * np.pi * own.frequency * m.t + own.phase)
    if name == "force_ripple":
        return own.amplitude * sin(2.0 * np.pi * m.x / own.wavelength + own.phase)
    bump = own.amplitude * exp(-(((m.x - own.centre) / own.width) ** 2))
    return bump if name == "force_bump" else -bump * m.v


@pytest.fixture
def disturbance(request: pytest.FixtureRequest) -> Iterator[str]:
    """The name of a disturbance, which is in the catalogue for as long as a test runs."""
    name = str(request.param)
    parameters = tuple(Parameter(own, "–", "of a disturbance") for own in UNCATALOGUED[name])
    force = lambda m, own: disturbing(name, m, own)  # noqa: E731 - an expression of the motion
    CATALOGUE.register(Effect(name, "a disturbance", parameters, "this test", force=force))
    yield name
    CATALOGUE.unregister(name)


@pytest.mark.parametrize("disturbance", DISTURBANCES, indirect=True)
def test_a_disturbance_is_what_it_says(disturbance: str) -> None:
    effects, declared = {disturbance: DISTURBANCES[disturbance]}, {"seat_load": 0.3}
    valve = Valve(CALIBRATED.with_values(**declared).parameters, effects)
    assert_alike(valve, Drive.of([0.0, 0.025], [9.0, 0.0]), DeclaredPlant(effects, declared), TIMES[:600])
