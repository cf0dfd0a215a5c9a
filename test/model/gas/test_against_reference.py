"""The core with gas against an independent, all-implicit integration: events, pressure, flow, and the mass balance."""

from __future__ import annotations

import numpy as np
import pytest
from plants.gas import GasValve

from valve_sim.model import Drive, EventKind, Response, Valve, simulate

from .cases import gas_valve, independent

OPENING = ((0.0, 9.0),)
CASES = {
    "35 MPa, dead end": (gas_valve(), OPENING, 0.56),
    "70 MPa, dead end": (gas_valve(inlet_pressure=70e6), OPENING, 0.5),
    "a demand holds the main plunger down": (
        gas_valve(inlet_pressure=10e6, demand_orifice_diameter=0.2e-3), OPENING, 0.2,
    ),
    "closes while gas flows": (
        gas_valve(inlet_pressure=2e6, demand_orifice_diameter=0.5e-3, pilot_orifice_diameter=1e-3),
        ((0.0, 9.0), (0.1, 0.0)), 0.3,
    ),
    "flows back": (gas_valve(inlet_pressure=2e6, outlet_pressure=3e6), OPENING, 0.1),
    "nearly equal from the start": (gas_valve(outlet_pressure=35e6 - 100.0), OPENING, 0.05),
}  # fmt: skip


def compare(valve: Valve, drive: tuple[tuple[float, float], ...], end: float) -> tuple[Response, GasValve]:
    """Fail unless events and pressure of both agree; returns both."""
    times = np.linspace(end / 200, end, 200)
    ours = simulate(valve, Drive.of(*zip(*drive, strict=True)), times, start_time=0.0)
    theirs = independent(valve)
    _, pressure, _ = theirs.run(drive, times)
    found = sorted((event.time, event.kind.name) for event in ours.events)
    expected = sorted(theirs.events)
    assert [kind for _, kind in found] == [kind for _, kind in expected]
    for (time, kind), (due, _) in zip(found, expected, strict=True):
        assert abs(time - due) < 5e-6 + 1e-3 * due, (kind, time, due)
    assert ours.outlet_pressure is not None
    np.testing.assert_allclose(ours.outlet_pressure, pressure, rtol=2e-3)
    return ours, theirs


@pytest.mark.parametrize("case", [
    pytest.param(case, marks=pytest.mark.long) if case.startswith(("70 MPa", "a demand", "nearly")) else case
    for case in CASES
])  # fmt: skip
def test_agrees_with_an_implicit_integration(case: str) -> None:
    compare(*CASES[case])


def test_what_comes_in_and_does_not_go_out_is_there() -> None:
    """The balance of mass, with flows added up apart from the density: the demand's by the independent plant."""
    valve, drive, end = CASES["closes while gas flows"]
    times = np.linspace(0.0, end, 300_001)
    response = simulate(valve, Drive.of(*zip(*drive, strict=True)), times, start_time=0.0)
    assert response.mass_flow is not None and response.outlet_pressure is not None and valve.gas is not None
    plant = independent(valve)
    taken = np.array([plant.flow_out(pressure) for pressure in response.outlet_pressure[::100]])
    came, went = np.trapezoid(response.mass_flow, times), np.trapezoid(taken, times[::100])
    assert plant.fluid is not None
    first, last = plant.fluid.density(response.outlet_pressure[[0, -1]])
    stored = valve.gas.outlet_volume * (last - first)
    assert went > 0.1 * came
    assert stored == pytest.approx(came - went, abs=2e-5 * came)


def test_equal_pressures_stay_equal_and_cost_no_steps() -> None:
    """After equalisation at a dead end nothing flows, however long it is looked at."""
    response = simulate(gas_valve(inlet_pressure=5e6), Drive.of([0.0], [9.0]), np.linspace(0.3, 100.0, 50))
    assert response.mass_flow is not None and response.outlet_pressure is not None
    assert response.phase[-1] == 4
    np.testing.assert_allclose(response.outlet_pressure[1:], 5e6, rtol=1e-12)
    assert np.abs(response.mass_flow[1:]).max() < 1e-7


def test_the_pilot_waits_at_the_gap_and_bounces_never() -> None:
    """Pressed down by gas, a main plunger that is touched stays: one contact, not thousands."""
    kinds = [event.kind for event in simulate(gas_valve(), Drive.of([0.0], [9.0]), [0.0, 0.1]).events]
    assert kinds == [EventKind.UNSEATED, EventKind.PICKED_UP, EventKind.HELD_AT_GAP]


def test_a_pilot_that_is_too_large_never_opens() -> None:
    assert not gas_valve(inlet_pressure=70e6, pilot_orifice_diameter=0.225e-3).can_open()
    assert gas_valve(inlet_pressure=70e6, pilot_orifice_diameter=0.22e-3).can_open()
