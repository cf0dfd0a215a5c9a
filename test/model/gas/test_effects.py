"""Effects of gas, and a tank's pressure that changes, against the independent plant."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import pytest

from valve_sim.model import Drive, simulate
from valve_sim.model.drives import Supply

from .cases import gas_valve, independent

OPENING = Drive.of([0.02], [9.0])
TIMES = np.arange(150) * 1e-3
LEAK, RATIO = 5e-9, 0.6


def test_leak_and_clogging_are_what_the_plant_says() -> None:
    valve = gas_valve(inlet_pressure=5e6)
    both = replace(valve, effects={"seat_leak": {"area": LEAK}, "pilot_clogging": {"ratio": RATIO}})
    plant = independent(valve)
    plant.leak, plant.clogging, plant.rtol = LEAK, RATIO, 1e-8
    _, expected, _ = plant.run([(0.02, 9.0)], TIMES)
    response = simulate(both, OPENING, TIMES, start_time=0.0)
    assert response.outlet_pressure is not None and response.mass_flow is not None
    np.testing.assert_allclose(response.outlet_pressure, expected, rtol=1e-4)
    # The leak fills the line before the command comes.
    assert response.mass_flow[10] > 0.0
    assert response.outlet_pressure[19] > 1.1 * valve.gas.outlet_pressure  # type: ignore[union-attr]


@pytest.mark.parametrize("falls", [0.0, 2e6])
def test_a_measured_tank_takes_the_place_of_the_declared_one(falls: float) -> None:
    """With a pressure that falls linearly, by as many Pa/s, after 20 ms: samples at knots of the line are enough."""
    valve = gas_valve(inlet_pressure=8e6)
    supply = Supply(np.array([0.02, 0.05, 0.15]), 5e6 - falls * np.array([0.0, 0.03, 0.13]))
    shown = simulate(valve, OPENING, TIMES, start_time=0.0, supply=supply).outlet_pressure
    plant = independent(gas_valve(inlet_pressure=5e6))
    plant.rtol = 1e-8
    steps = np.arange(0.02, 0.15, 5e-4)
    inlet = list(zip(steps.tolist(), (5e6 - falls * (steps + 2.5e-4 - 0.02)).tolist(), strict=True)) if falls else []
    _, expected, _ = plant.run([(0.02, 9.0)], TIMES, inlet)
    np.testing.assert_allclose(shown, expected, rtol=3e-4)
    declared = simulate(valve, OPENING, TIMES, start_time=0.0).outlet_pressure
    assert declared is not None and declared[-1] > 1.2 * expected[-1]


def test_a_measured_demand_takes_the_place_of_the_declared_one() -> None:
    """Each pressure holds until the next; the gas flows to the demand, and back from it."""
    valve = gas_valve(inlet_pressure=5e6, outlet_volume=2e-6, demand_orifice_diameter=0.1e-3, demand_pressure=2e6)
    times, pressures = np.array([0.01, 0.04, 0.08]), np.array([4e6, 6e6, 3e6])
    supply = Supply(np.empty(0), np.empty(0), times, pressures)
    shown = simulate(valve, OPENING, TIMES, start_time=0.0, supply=supply).outlet_pressure
    plant = independent(valve)
    plant.gas = {**plant.gas, "demand_pressure": 4e6}
    plant.rtol = 1e-8
    demand = list(zip(times.tolist(), pressures.tolist(), strict=True))
    _, expected, _ = plant.run([(0.02, 9.0)], TIMES, demand=demand)
    np.testing.assert_allclose(shown, expected, rtol=3e-4)
    declared = simulate(valve, OPENING, TIMES, start_time=0.0).outlet_pressure
    assert declared is not None and np.abs(declared / expected - 1.0).max() > 0.1
