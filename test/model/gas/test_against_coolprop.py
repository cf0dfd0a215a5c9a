"""Abel–Noble hydrogen against real hydrogen, as CoolProp has it: density and flux, from 2 to 87.5 MPa."""

from __future__ import annotations

import math

import numpy as np
import pytest

from valve_sim.model import Drive, simulate
from valve_sim.model.core import layout
from valve_sim.model.live import Live

from .cases import gas_valve

TABLE = (
    (2e06, 1.6628428, 1257.6319, 771.47105),
    (3.5e07, 23.994753, 21178.674, 12387.908),
    (7e07, 40.172161, 40532.7, 22820.393),
    (8.75e07, 46.475269, 49594.227, 27505.646),
)
"""Pressure, Pa; density, kg/m³; choked flux, and flux to 90 % of the pressure, kg/(m² s): hydrogen, 288.15 K,
CoolProp 8.0.0, whose equation of state is that of Leachman et al., J. Phys. Chem. Ref. Data 38 (2009) 721."""
PILOT = 0.15e-3
"""m, small enough to open at any of the pressures."""


def flux(inlet: float, outlet: float) -> float:
    """What flows through the pilot, fully open below the main plunger's seat, into a large volume, kg/(m² s)."""
    valve = gas_valve(inlet_pressure=inlet, outlet_pressure=outlet, outlet_volume=10.0, pilot_orifice_diameter=PILOT)
    response = simulate(valve, Drive.of([0.0], [9.0]), np.linspace(0.0, 0.02, 201))
    assert response.mass_flow is not None
    only_pilot = (response.pilot_position > PILOT / 4.0) & (response.main_position == 0.0)
    return float(response.mass_flow[only_pilot][0]) / (0.8 * math.pi / 4.0 * PILOT**2)


@pytest.mark.parametrize("row", TABLE, ids=lambda row: f"{1e-6 * row[0]:g} MPa")
def test_real_hydrogen(row: tuple[float, ...]) -> None:
    pressure, density, choked, subsonic = row
    block = Live.at_rest(gas_valve(outlet_pressure=pressure), 0.0, 1e-8).block
    assert block[int(block[layout.DENSITY])] == pytest.approx(density, rel=0.012)
    assert flux(pressure, 1e5) == pytest.approx(choked, rel=0.01)
    assert flux(pressure, 0.9 * pressure) == pytest.approx(subsonic, rel=0.01)
    assert flux(pressure, 0.3 * pressure) == pytest.approx(flux(pressure, 1e5), rel=1e-9)


def test_it_flows_back_as_it_flows_in() -> None:
    """From a large volume at a higher pressure, through the pilot that is open, into the tank."""
    assert flux(9e6, 10e6) == pytest.approx(-flux(10e6, 9e6), rel=1e-6)
    assert flux(2e6, 10e6) == pytest.approx(-flux(10e6, 2e6), rel=1e-6)
