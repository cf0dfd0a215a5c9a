"""Derivatives of a valve with gas by variational equations: against an independent plant; where pressures change."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import replace

import numpy as np
import pytest
from plants.gas import GasValve

from valve_sim.identification.plants.protocol import Direction
from valve_sim.identification.plants.valve import ValvePlant
from valve_sim.model import Drive, Valve
from valve_sim.recordings import Signal, Trace

from .cases import gas_valve, independent

TIMES = np.arange(1.0, 800.0) * 1e-3
COMMANDS = ((0.02, 9.0), (0.62, 0.0))
NOTHING = np.empty(0)
STEP = 1e-3
"""Of a value, in a difference quotient."""
ACCURACY = 5e-3
"""Of a derivative, as a share of its norm over a recording."""


def plant_of(valve: Valve, **measured: Signal | float) -> ValvePlant:
    pressure = Signal(TIMES, np.zeros_like(TIMES))
    drive = Drive.of(*zip(*COMMANDS, strict=True))
    return ValvePlant([Trace("outlet", drive, NOTHING, NOTHING, outlet_pressure=pressure, **measured)], valve)  # type: ignore[arg-type] # by name


def derivative(plant: ValvePlant, values: Mapping[str, float], name: str, size: float) -> np.ndarray:
    """For a change by its size."""
    columns, known, _ = plant.sensitivities(values, [Direction({name: size}, 1e-5)])
    assert known.all()
    return np.asarray(columns[-1][:, 0])


def quotient(plant: ValvePlant, values: Mapping[str, float], name: str, step: float) -> np.ndarray:
    """The same from two runs."""
    above, below = (plant.predict({**values, name: values[name] + way * step})[-1] for way in (1.0, -1.0))
    return np.asarray(above - below) / 2.0


def moved(plant: GasValve, name: str, by: float) -> GasValve:
    group, _, own = name.partition(".")
    if name in ("seat_leak.area", "pilot_clogging.ratio", "coulomb_friction.force"):
        field = {"seat_leak": "leak", "pilot_clogging": "clogging", "coulomb_friction": "friction"}[group]
        return replace(plant, **{field: getattr(plant, field) + by}, events=[])  # type: ignore[arg-type]
    if own:
        return replace(plant, gas={**plant.gas, own: plant.gas[own] + by}, fluid=None, events=[])
    return replace(plant, valve={**plant.valve, name: plant.valve[name] + by}, events=[])


LEAKING = {"seat_leak": {"area": 1e-9}, "pilot_clogging": {"ratio": 0.7}, "coulomb_friction": {"force": 0.1}}
SIZES = {
    "seat_leak.area": 1e-9, "pilot_clogging.ratio": 0.7, "coulomb_friction.force": 0.1, "gas.outlet_volume": 1e-5,
    "gas.pilot_orifice_diameter": 0.2e-3, "gas.inlet_pressure": 35e6, "gas.inlet_temperature": 288.15,
    "gas.discharge_coefficient": 0.8, "gas.seat_diameter": 4e-3, "gas.demand_orifice_diameter": 0.05e-3,
    "seat_load": 0.3, "pilot_damping": 1.0,
}  # fmt: skip


SHORT = ("pilot_clogging.ratio", "gas.inlet_pressure", "seat_load")


@pytest.mark.parametrize(
    "name", [pytest.param(name, marks=() if name in SHORT else pytest.mark.long) for name in SIZES]
)
def test_derivatives_are_those_of_an_independent_plant(name: str) -> None:
    """Through lift-off, a lift that no longer limits the flow, waiting, opening and closing, with effects of gas."""
    valve = replace(gas_valve(demand_orifice_diameter=0.05e-3), effects=LEAKING)
    plant = plant_of(valve)
    by = STEP * SIZES[name]
    values = {name: plant.declared(name)} if "." not in name or name.startswith("gas.") else {
        name: LEAKING[name.partition(".")[0]][name.partition(".")[2]]
    }  # fmt: skip
    theirs = replace(independent(valve), leak=1e-9, clogging=0.7, friction=0.1, rtol=1e-9)
    above, below = (moved(theirs, name, way * by).run(COMMANDS, TIMES)[1] for way in (1.0, -1.0))
    expected = (above - below) / 2.0
    found = derivative(plant, values, name, by)
    assert np.linalg.norm(found - expected) < ACCURACY * np.linalg.norm(expected)


@pytest.mark.parametrize("name", ["clock_offset[0]", "gas.outlet_volume"])
def test_derivatives_where_the_pressures_at_both_ends_are_measured(name: str) -> None:
    """A tank that empties, and a line whose pressure rises in steps, on the recording's clock."""
    valve = gas_valve(demand_orifice_diameter=0.05e-3)
    stamps = np.array([0.0, 0.3, 0.5, 0.9])
    plant = plant_of(
        valve,
        inlet_pressure=Signal(stamps, np.array([35e6, 33e6, 33.5e6, 30e6])),
        demand_pressure=Signal(stamps, np.array([1e5, 20e6, 25e6, 5e6])),
    )
    at = {name: 0.0 if name.startswith("clock") else plant.declared(name)}
    by = 1e-5 if name.startswith("clock") else 1e-4 * at[name]
    expected = quotient(plant, at, name, by)
    found = derivative(plant, at, name, by)
    assert np.linalg.norm(found - expected) < ACCURACY * np.linalg.norm(expected)
