"""Seeded random valves whose coils follow their flux or freewheel, under the drives that such coils get."""

from __future__ import annotations

from collections.abc import Callable
from typing import Any

import numpy as np

from valve_sim.model import Drive, ParameterError, Valve, simulate
from valve_sim.model.drives import peak_and_hold, pulse_width_modulated, step

from .flux_reference import FluxReference
from .random_valves import RANGES

COIL = ("eddy_lag", "magnetic_saturation", "coil_heating", "residual_magnetism", "drive_gain", "coil_lag")
MECHANICAL = (
    "coulomb_friction", "stiction", "asymmetric_friction", "constant_force", "rest_attraction", "pressure_force",
    "quadratic_drag", "squeeze_film", "stop_bounce", "pickup_impact", "spring_hardening", "stroke_offset", "gap_offset",
)  # fmt: skip
TIMES = np.arange(1, 401) * 1e-4
"""s."""


def random_drive(random: Any) -> Drive:
    """A step, a peak and a hold, a modulated one, or any commands; often of both signs."""
    kind, sign = int(random.integers(0, 4)), float(random.choice([1.0, 1.0, -1.0]))
    start, volts = 1e-3, sign * random.uniform(9, 14)
    if kind == 0:
        return step(volts, start, start + random.uniform(8e-3, 18e-3))
    if kind == 1:
        return peak_and_hold((1.5 * volts, 0.4 * volts), start, (random.uniform(5e-3, 9e-3), 8e-3))
    if kind == 2:
        return pulse_width_modulated(2.0 * volts, random.uniform(0.4, 0.8), 2000.0, start, start + 12e-3)
    levels = random.choice([0.0, 0.0, volts, -volts, 0.5 * volts], 7)
    return Drive.of(start + np.cumsum(random.uniform(5e-4, 6e-3, 7)) - 5e-4, levels)


def random_case(seed: int) -> tuple[Valve, Drive]:
    """A valve with up to two effects of the coil and two others, most with `motional_emf`."""
    random = np.random.default_rng([seed, 18])
    while True:
        base = Valve().with_values(
            a0=random.uniform(2, 7), coil_time_constant=random.uniform(1.2e-3, 3e-3),
            coil_resistance=81.0 / random.uniform(8, 25), pilot_damping=random.uniform(0, 3),
            main_damping=random.uniform(0, 8), seat_load=random.uniform(0, 0.5),
            pickup_velocity_ratio=random.uniform(0.7, 1), release_voltage=random.choice([0.0, random.uniform(0.5, 40)]),
        )  # fmt: skip
        chosen = [*random.choice(COIL, random.integers(0, 3), replace=False)]
        chosen += [*random.choice(MECHANICAL, random.integers(0, 3), replace=False)]
        effects = {
            str(name): {key: float(random.uniform(*limits)) for key, limits in RANGES[name].items()} for name in chosen
        }
        if random.uniform() < 0.85:
            effects["motional_emf"] = {"share": float(random.choice([0.0, 0.3, 1.0, 1.0, 1.0]))}
        drive = random_drive(random)
        valve = Valve(base.parameters, effects)
        try:
            Valve.from_mapping(valve.to_mapping(), "drawn")
        except ParameterError:
            continue
        return valve, drive


def random_release(seed: int) -> tuple[Valve, Drive]:
    """A valve whose current freewheels and has a closed form, with up to three effects, and a pulse or any commands."""
    random = np.random.default_rng([seed, 43])
    base = Valve().with_values(
        a0=random.uniform(2, 7), coil_time_constant=random.uniform(2e-4, 3e-3),
        pilot_damping=random.uniform(0, 3), main_damping=random.uniform(0, 8), seat_load=random.uniform(0, 0.5),
        pickup_velocity_ratio=random.uniform(0.7, 1), release_voltage=random.uniform(0.5, 40),
    )  # fmt: skip
    chosen = random.choice(
        [*(name for name in COIL if name != "coil_heating"), *MECHANICAL], random.integers(0, 4), False
    )
    effects = {
        str(name): {key: float(random.uniform(*limits)) for key, limits in RANGES[name].items()} for name in chosen
    }
    return Valve(base.parameters, effects), random_drive(random)


def differences(
    seed: int, tolerance: float, drawn: Callable[[int], tuple[Valve, Drive]] = random_case
) -> tuple[float, float, float, bool]:
    """Largest difference of position, m, of event time, s, and of current, A; whether the events are the same."""
    valve, drive = drawn(seed)
    ours = simulate(valve, drive, TIMES, tolerance=tolerance)
    theirs = FluxReference(valve.declared(), valve.effects, float(min(drive.times[0], TIMES[0])))
    position, main, current = theirs.follow(drive, TIMES)
    kinds = [event.kind.name for event in ours.events] == [kind for _, kind in theirs.events]
    late = [abs(event.time - when) for event, (when, _) in zip(ours.events, theirs.events, strict=False)]
    return (
        float(max(np.abs(ours.pilot_position - position).max(), np.abs(ours.main_position - main).max())),
        max(late, default=0.0), float(np.abs(ours.coil_current - current).max()), kinds,
    )  # fmt: skip
