"""Derivatives by variational equations against central differences of tightly integrated traces."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import pytest

from model.derivatives import ACCURACY, BY_QUOTIENT, PULSE, Case, errors_of
from model.random_valves import RANGES
from valve_sim.model import Drive, Valve


def check(case: Case, names: list[str]) -> None:
    """Every derivative is that of the central differences."""
    for name, errors in errors_of(case, names).items():
        assert errors, f"{name}: other events happen however small the step"
        assert min(errors) < ACCURACY, f"{name}: {errors}"


def eventful(seed: int) -> Case:
    """A valve that rubs, sticks or bounces, under four random voltages."""
    random = np.random.default_rng(seed)
    valve = Valve().with_values(
        a0=random.uniform(1, 4), coil_time_constant=random.uniform(2e-4, 1.5e-3), pilot_damping=random.uniform(0, 30),
        main_damping=random.uniform(0, 8), seat_load=random.uniform(0, 1), pickup_velocity_ratio=random.uniform(0.0, 1),
        spring_preload=random.uniform(2, 3),
    )  # fmt: skip
    effects = {}
    for name, share in (("stiction", 0.5), ("stop_bounce", 0.4)):
        if random.random() < share:
            effects[name] = {key: float(random.uniform(*limits)) for key, limits in EVENTFUL[name].items()}
    times, volts = np.cumsum(random.uniform(2e-3, 14e-3, 4)), random.uniform(0, 12, 4)
    volts[-1] = 0.0
    return Case(replace(valve, effects=effects), Drive.of(times, volts))


EVENTFUL = {
    "stiction": {"force": (0.02, 0.8), "breakaway": (0.02, 0.6), "stribeck_velocity": (0.01, 0.1)},
    "stop_bounce": RANGES["stop_bounce"],
}
SEEDS = (4551, 982, 2106, 2134, 165, 4423, 313, 125, 3821, 94, 1084, 1557)
"""Of runs that cross every kind of event between them."""


@pytest.mark.parametrize("seed", SEEDS)
def test_every_kind_of_event_is_crossed(seed: int) -> None:
    case = eventful(seed)
    check(case, case.names())


@pytest.mark.parametrize("name", sorted(set(RANGES) - BY_QUOTIENT))
def test_every_effect_and_every_declared_value(name: str) -> None:
    values = {key: 0.4 * low + 0.6 * high for key, (low, high) in RANGES[name].items()}
    case = Case(
        replace(Valve().with_values(a0=3.0, coil_time_constant=8e-4, seat_load=0.2), effects={name: values}), PULSE
    )
    check(case, [found for found in case.names() if found != "pickup_velocity_ratio" or name != "pickup_impact"])
