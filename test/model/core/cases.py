"""Valves and drives that the tests of the core share."""

from __future__ import annotations

from collections.abc import Callable, Mapping
from dataclasses import replace
from typing import Any

import numpy as np
from plants.single_plunger import SINGLE_VALVE

from model.flux_cases import TIMES as FLUX_TIMES
from model.flux_cases import random_case, random_release
from model.gas.cases import gas_valve
from model.random_valves import TIMES, random_valve
from valve_sim.model import EventKind, Valve
from valve_sim.model.drives import Drive

CALIBRATED = Valve().with_values(a0=3.0336, coil_time_constant=0.9934e-3)
STROKE = Drive.of([1e-3, 16e-3], [9.0, 0.0])
PLANT_EVENTS = {
    "unseated": EventKind.UNSEATED, "picked_up": EventKind.PICKED_UP, "opened": EventKind.REACHED_STOP,
    "released": EventKind.RELEASED, "main_seated": EventKind.MAIN_SEATED, "seated": EventKind.SEATED,
    "held_at_gap": EventKind.HELD_AT_GAP, "dropped_from_gap": EventKind.DROPPED, "lifted_from_gap": EventKind.LIFTED,
    "stop_rebound": EventKind.BOUNCED_AT_STOP, "seat_rebound": EventKind.BOUNCED_AT_SEAT, "stuck": EventKind.STUCK,
    "freed": EventKind.BROKE_AWAY,
}  # fmt: skip
"""What happened, by the names that the truth plants give it."""


def random_gas(seed: int) -> tuple[Valve, Drive]:
    """A random valve with gas: its volume and demand from nothing to much, at times with friction and bounces."""
    random = np.random.default_rng(seed)
    valve = gas_valve(
        inlet_pressure=random.uniform(2e6, 80e6),
        outlet_volume=10 ** random.uniform(-8.0, -5.0),
        demand_orifice_diameter=random.choice([0.0, 1e-4]),
    )
    effects = {"coulomb_friction": {"force": 0.1}, "stop_bounce": {"restitution_stop": 0.3, "restitution_seat": 0.2}}
    kept = {name: own for name, own in effects.items() if random.random() < 0.5}
    return replace(valve, effects=kept), Drive.of([1e-3, random.uniform(5e-3, 0.1)], [random.uniform(7.0, 14.0), 0.0])


def one_plunger(seed: int) -> tuple[Valve, Drive]:
    """A valve with one plunger that a pressure holds, a spring and two voltages throw back, and a slow sensor shows."""
    effects = {
        "pressure_force": {"force": 1.2, "equalisation_time": 4e-3}, "sensor_bandwidth": {"cutoff_frequency": 900.0},
    }  # fmt: skip
    valve = Valve.from_mapping({"valve": {**SINGLE_VALVE, "pilot_gap": 0.0}, "effects": effects}, "drawn")
    return valve, Drive.of([1e-3, 26e-3], [np.random.default_rng(seed).uniform(20.0, 30.0), 0.0])


DRAWN: Mapping[str, tuple[Callable[[int], tuple[Valve, Drive]], Any]] = {
    "random": (random_valve, TIMES),
    "flux": (random_case, FLUX_TIMES),
    "release": (random_release, FLUX_TIMES),
    "one plunger": (one_plunger, np.linspace(0.0, 0.06, 301)),
    "gas": (random_gas, np.linspace(0.0, 0.15, 301)),
}
"""By kind: what draws a valve and its drive from a seed, and the times of its samples."""


def drawn(kind: str, seed: int) -> tuple[Valve, Drive, np.ndarray]:
    """A random valve, its drive, and times."""
    draw, times = DRAWN[kind]
    valve, drive = draw(seed)
    return Valve(valve.parameters, valve.effects, valve.gas), drive, times
