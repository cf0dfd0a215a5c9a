"""Any parameters that are accepted: the run ends, the plungers stay between seat and stop, and nothing chatters on."""

from __future__ import annotations

import math

import numpy as np
import pytest
from hypothesis import HealthCheck, assume, given, seed, settings
from hypothesis import strategies as st

from benchmarks.fuzz import limited
from model.random_valves import any_valves
from valve_sim.model import (
    CATALOGUE,
    Drive,
    EventKind,
    Phase,
    SimulationError,
    Stepper,
    Tag,
    Valve,
    simulate,
)

BEYOND = 1e-9
"""m: how far beyond a contact a plunger may be shown."""
SECONDS = 0.02
MOST_EVENTS = 20_000
"""Of 20 ms: a contact slower than 1 or 5 mm/s does not rebound, so there cannot be many."""
SENSORS = tuple(effect.name for effect in CATALOGUE.tagged(Tag.SENSOR))
CALIBRATED = Valve().with_values(a0=3.0336, coil_time_constant=1e-3)


def valves(*, with_sensors: bool) -> st.SearchStrategy[Valve]:
    """Valves with up to three effects."""
    names = [name for name, effect in CATALOGUE.items() if effect.named and (with_sensors or name not in SENSORS)]
    return any_valves(names, 3)


drives = st.lists(st.tuples(st.floats(0.0, SECONDS), st.floats(-1e4, 1e4) | st.sampled_from((0.0, 9.0, -9.0, 30.0))),
                  min_size=1, max_size=6).map(sorted)  # fmt: skip
some = settings(max_examples=20, suppress_health_check=list(HealthCheck))


@pytest.fixture(scope="module", autouse=True)
def compiled() -> None:
    """What compiles is no hang: all is compiled before the first clock runs."""
    valve = Valve(CALIBRATED.parameters, {"sensor_delay": {"delay": 1e-3}})
    simulate(valve, Drive.of([0.0], [9.0]), [0.01])
    stepper = Stepper(valve)
    stepper.command(1e-3, 9.0)
    stepper.advance(0.01)


@seed(7)
@some
@given(valve=valves(with_sensors=False), commands=drives)
def test_plungers_stay_between_seat_and_stop(valve: Valve, commands: list[tuple[float, float]]) -> None:
    gap, stroke = valve.after_effects("pilot_gap", "stroke")
    assume("stop_compliance" not in valve.effects)  # beyond which plungers may be
    drive = Drive.of([time for time, _ in commands], [volts for _, volts in commands])
    with limited():
        try:
            response = simulate(valve, drive, np.linspace(0.0, SECONDS, 200))
        except SimulationError as error:
            assert "\n" not in str(error)
            return
    for name in ("pilot_position", "main_position", "pilot_velocity", "coil_current", "attraction"):
        assert np.isfinite(getattr(response, name)).all(), name
    pilot, main = response.pilot_position, response.main_position
    assert np.all((pilot >= -BEYOND) & (pilot <= stroke + BEYOND))
    assert np.all((main >= -BEYOND) & (main <= stroke - gap + BEYOND))
    assert np.all(np.abs(pilot[response.phase == Phase.CLOSED]) <= BEYOND)
    assert np.all(np.abs(pilot[response.phase == Phase.OPEN] - stroke) <= BEYOND)
    assert np.all(np.abs(pilot[response.phase == Phase.GAP_HOLD] - gap) <= BEYOND)
    times = [event.time for event in response.events]
    assert times == sorted(times)
    assert len(times) < MOST_EVENTS
    for event in response.events:
        assert event.kind in EventKind
        assert -BEYOND <= event.position <= stroke + BEYOND
        assert math.isfinite(event.velocity)


@seed(8)
@some
@given(valve=valves(with_sensors=True), commands=drives, step=st.floats(1e-5, 5e-3))
def test_a_stepper_of_any_valve_shows_finite_readings(
    valve: Valve, commands: list[tuple[float, float]], step: float
) -> None:
    stepper, waiting = Stepper(valve), list(commands)
    with limited():
        try:
            for time in np.arange(step, SECONDS, step).tolist():
                while waiting and waiting[0][0] <= time:
                    stepper.command(*waiting.pop(0))
                reading = stepper.advance(time)
                assert all(math.isfinite(value) for value in reading[:8])
        except SimulationError as error:
            assert "\n" not in str(error)
            return
