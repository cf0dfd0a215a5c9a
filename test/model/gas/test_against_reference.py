"""The core with gas against an independent, all-implicit integration: events, pressure, flow, and the mass balance."""

from __future__ import annotations

import numpy as np
import pytest

from valve_sim.model import Drive, EventKind, simulate

from .cases import CASES, Case, compared, gas_valve, independent, ours

SHORT = ("35 MPa, 10 cm³, dead end", "released while it flows", "flows back, 2 to 3 MPa")


@pytest.mark.parametrize(
    "case",
    [pytest.param(case, id=case.name, marks=() if case.name in SHORT else pytest.mark.long) for case in CASES],
)
def test_agrees_with_an_implicit_integration(case: Case) -> None:
    """`python -m benchmarks.accuracy gas` prints by how much."""
    found = compared(case)
    assert found.is_good, (found.late, found.off, found.run.events, found.events)


def test_what_comes_in_and_does_not_go_out_is_there() -> None:
    """The balance of mass, with flows added up apart from the density: the demand's by the independent plant."""
    (case,) = (case for case in CASES if case.name == "released while it flows")
    valve, times = case.valve, np.linspace(0.0, case.end, 300_001)
    response = ours(case, times)
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
