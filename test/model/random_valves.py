"""Seeded random valves and drives that move, each effect in its turn."""

from __future__ import annotations

import numpy as np

from valve_sim.model import Drive, Valve

TIMES = np.arange(1, 251) * 1e-4
"""s: a stroke up and a stroke down."""

RANGES: dict[str, dict[str, tuple[float, float]]] = {
    "coulomb_friction": {"force": (0.02, 0.8)},
    "stiction": {"force": (0.02, 0.4), "breakaway": (0.02, 0.4), "stribeck_velocity": (0.01, 0.1)},
    "asymmetric_friction": {
        "force_opening": (0.02, 0.5), "force_closing": (0.02, 0.5),
        "damping_opening": (0.1, 3), "damping_closing": (0.1, 3),
    },
    "constant_force": {"force": (-0.5, 0.5)},
    "rest_attraction": {"force": (-0.5, 1)},
    "drive_gain": {"gain": (0.9, 1.1)},
    "coil_lag": {"time_constant": (1e-4, 1e-3)},
    "eddy_lag": {"time_constant": (1e-4, 1e-3)},
    "coil_heating": {"temperature_rate": (10, 1000), "cooling_time_constant": (0.1, 10)},
    "magnetic_saturation": {"current": (1, 5)},
    "residual_magnetism": {"current": (0.05, 0.4)},
    "pressure_force": {"force": (0.1, 3), "equalisation_time": (1e-3, 1e-2)},
    "quadratic_drag": {"coefficient": (0.5, 10)},
    "squeeze_film": {"coefficient": (0.5, 20), "film_thickness": (2e-5, 2e-4)},
    "stop_bounce": {"restitution_stop": (0.1, 0.6), "restitution_seat": (0.1, 0.6)},
    "pickup_impact": {"velocity_ratio": (0.6, 1)},
    "spring_hardening": {"coefficient": (1e8, 1e9)},
    "stroke_offset": {"offset": (-3e-5, 3e-5)},
    "gap_offset": {"offset": (-3e-5, 3e-5)},
    "sensor_delay": {"delay": (5e-5, 5e-4)},
    "sensor_bandwidth": {"cutoff_frequency": (500, 5000)},
    "sensor_gain": {"gain": (0.98, 1.02)},
}  # fmt: skip
"""Sizes at which each effect is felt and the valve still moves."""


def random_valve(seed: int) -> tuple[Valve, Drive]:
    """A valve with no effect (every third seed) or one to three, and a 15 ms pulse."""
    random = np.random.default_rng(seed)
    base = Valve().with_values(
        a0=random.uniform(2, 4), coil_time_constant=random.choice([0.0, random.uniform(2e-4, 1.5e-3)]),
        pilot_damping=random.uniform(0, 3), main_damping=random.uniform(0, 8), seat_load=random.uniform(0, 0.5),
        pickup_velocity_ratio=random.uniform(0.7, 1), spring_preload=random.uniform(2, 3),
    )  # fmt: skip
    count = 0 if seed % 3 == 0 else int(random.integers(1, 4))
    names = random.choice(list(RANGES), count, replace=False)
    effects = {
        str(name): {key: float(random.uniform(*limits)) for key, limits in RANGES[name].items()} for name in names
    }
    return Valve(base.parameters, effects), Drive.of([1e-3, 16e-3], [random.uniform(8, 14), 0.0])
