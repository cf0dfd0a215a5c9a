"""The core against solutions in closed form, an independent integrator, and the conservation of energy."""

from __future__ import annotations

import math
from typing import Any

import numpy as np
import pytest

from model.core.cases import CALIBRATED, STROKE, drawn
from valve_sim.model import Valve, simulate
from valve_sim.model.core_types import EventKind, Phase
from valve_sim.model.drives import step

AT_DEFAULT = 1e-10
"""s: what the default tolerance leaves of the error of an event; the worst are contacts at millimetres a second."""
FLAT = Valve().with_values(a0=10.0, a1=0.0, a2=0.0, a3=0.0, pilot_damping=0.0, main_damping=0.0, spring_rate=0.0)
"""Of constant force and without inductance: it moves in parabolas."""


def times_of(response: Any, *kinds: EventKind) -> list[float]:
    return [event.time for event in response.events if event.kind in kinds]


def test_a_constant_force_makes_parabolas() -> None:
    p = FLAT.parameters
    response = simulate(FLAT, step(9.0, 1e-3), np.linspace(1e-3, 20e-3, 40))
    a1 = 10.0 / p.pilot_mass
    t1 = 1e-3 + math.sqrt(2.0 * p.pilot_gap / a1)
    v1, a2 = a1 * (t1 - 1e-3), (10.0 - p.spring_preload) / p.moving_mass
    t2 = t1 + (-v1 + math.sqrt(v1**2 + 2.0 * a2 * (p.stroke - p.pilot_gap))) / a2
    assert times_of(response, EventKind.PICKED_UP, EventKind.REACHED_STOP) == pytest.approx([t1, t2], abs=1e-15)
    moving = (response.time > t1) & (response.time < t2)
    after = response.time[moving] - t1
    expected = p.pilot_gap + v1 * after + 0.5 * a2 * after**2
    assert response.pilot_position[moving] == pytest.approx(expected, rel=1e-13)


def test_a_bounce_returns_its_share_of_the_velocity() -> None:
    valve = Valve(FLAT.parameters, {"stop_bounce": {"restitution_stop": 0.5, "restitution_seat": 0.0}})
    response = simulate(valve, step(9.0), [0.05])
    first, second = times_of(response, EventKind.BOUNCED_AT_STOP)[:2]
    speeds = [event.velocity for event in response.events if event.kind is EventKind.BOUNCED_AT_STOP]
    a = (10.0 - valve.parameters.spring_preload) / valve.parameters.moving_mass
    assert second - first == pytest.approx(2.0 * 0.5 * speeds[0] / a, rel=1e-12)
    assert speeds[1] == pytest.approx(0.5 * speeds[0], rel=1e-12)


@pytest.mark.parametrize("tau_e", [0.9934e-3, 0.9934e-3 * (1 + 1e-9), 0.99e-3, 2e-4, 1e-9, 5e-3])
def test_eddy_currents_delay_the_pull(tau_e: float) -> None:
    """The attraction of a valve that cannot move is that of two poles in series, equal ones too."""
    valve = Valve(CALIBRATED.with_values(seat_load=1e3).parameters, {"eddy_lag": {"time_constant": tau_e}})
    times = np.linspace(1e-4, 12e-3, 60)
    response = simulate(valve, step(9.0), times)
    tau = valve.parameters.coil_time_constant
    if abs(tau_e / tau - 1.0) < 1e-6:
        w = 1.0 - np.exp(-times / tau) * (1.0 + times / tau)
    else:
        w = 1.0 - (tau * np.exp(-times / tau) - tau_e * np.exp(-times / tau_e)) / (tau - tau_e)
    assert response.attraction == pytest.approx(3.0336 * w**2, rel=1e-8, abs=1e-12)


def test_a_compliant_stop_is_a_damped_spring() -> None:
    compliance, ratio = 1e-7, 0.05
    valve = Valve(FLAT.parameters, {"stop_compliance": {"compliance": compliance, "damping_ratio": ratio}})
    p = valve.parameters
    response = simulate(valve, step(9.0), np.arange(1, 2000) * 1e-5)
    hit = next(event for event in response.events if event.kind is EventKind.REACHED_STOP)
    away = next(event for event in response.events if event.kind is EventKind.RELEASED)
    omega = math.sqrt(1.0 / (compliance * p.moving_mass))
    force = 10.0 - p.spring_preload
    sag, damped = force * compliance, omega * math.sqrt(1.0 - ratio**2)
    within = (response.time > hit.time) & (response.time < hit.time + 0.5 * math.pi / damped)
    after = response.time[within] - hit.time
    sine = (hit.velocity - ratio * omega * sag) / damped
    decay = np.exp(-ratio * omega * after)
    expected = p.stroke + sag + decay * (-sag * np.cos(damped * after) + sine * np.sin(damped * after))
    assert within.sum() > 5
    assert response.pilot_position[within] == pytest.approx(expected, abs=1e-13)
    assert (response.phase[within] == Phase.OPEN).all()
    assert away.time > hit.time and 0.0 > away.velocity > -hit.velocity
    rested = simulate(valve, step(9.0), [2.0]).pilot_position[-1]
    assert rested == pytest.approx(p.stroke + sag, abs=1e-12)


@pytest.mark.parametrize("kind", ["random", "flux", "release"])
def test_events_converge_with_the_tolerance(kind: str) -> None:
    """Each hundredth of the tolerance leaves much less of the error, down to rounding."""
    worst = np.zeros(3)
    for seed in range(12):
        valve, drive, _ = drawn(kind, seed)
        exact = simulate(valve, drive, [0.05], tolerance=1e-13).events
        for place, tolerance in enumerate((1e-6, 1e-8, 1e-10)):
            found = simulate(valve, drive, [0.05], tolerance=tolerance).events
            assert [event.kind for event in found] == [event.kind for event in exact]
            off = max((abs(a.time - b.time) for a, b in zip(found, exact, strict=True)), default=0.0)
            worst[place] = max(worst[place], off)
    assert worst[1] < min(max(0.1 * worst[0], 1e-13), AT_DEFAULT)
    assert worst[2] < max(0.1 * worst[1], 1e-13)


@pytest.mark.parametrize("tau", [0.0, 1e-13, 1e-10, 1e-7, 1e-5])
def test_tiny_time_constants_need_no_tiny_steps(tau: float) -> None:
    """The motion tends to that of a coil without inductance, by no more than the time constant."""
    valve = Valve(CALIBRATED.with_values(coil_time_constant=tau).parameters, {"eddy_lag": {"time_constant": tau}})
    at_once = simulate(CALIBRATED.with_values(coil_time_constant=0.0), STROKE, [0.03]).events
    found = simulate(valve, STROKE, [0.03]).events
    assert [event.kind for event in found] == [event.kind for event in at_once]
    assert [event.time for event in found] == pytest.approx([event.time for event in at_once], abs=8.0 * tau + 1e-13)
