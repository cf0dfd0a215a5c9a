"""A line that three valves feed, and the tank that it fills: the balance of mass, and an independent integration."""

from __future__ import annotations

import math

import numpy as np
import pytest
from plants.gas import Flux, NobleAbel
from scipy.integrate import solve_ivp

from valve_sim.model.gas.line import Gas, Line

GAS = Gas()
SIZES = {"volume": 5e-6, "filled": 20e-6}
AREA, ORIFICE = 0.8 * math.pi / 4.0 * 0.06e-3**2, 0.8 * math.pi / 4.0 * 0.3e-3**2
LINE = Line(GAS, (AREA, AREA, 2.0 * AREA), ORIFICE, **SIZES)


def masses(line: float, tank: float) -> tuple[float, float]:
    return GAS.mass(line, LINE.volume), GAS.mass(tank, LINE.filled)


def test_no_mass_is_lost_whatever_flows_and_however_long_a_step_is() -> None:
    random = np.random.default_rng(20)
    for _ in range(100):
        before = masses(*10.0 ** random.uniform(5.0, 7.9, 2))
        seconds, is_open = 10.0 ** random.uniform(-4.0, 2.0), bool(random.integers(2))
        after, came = LINE.step(before, 10.0 ** random.uniform(5.0, 7.9, 3), seconds, is_open=is_open)
        scale = sum(before) + sum(map(abs, came))
        assert sum(after) == pytest.approx(sum(before) + sum(came), abs=1e-12 * scale)
        assert min(after) > 0.0
        assert is_open or after[1] == before[1]


def test_agrees_with_an_implicit_integration_of_another_flux() -> None:
    """While a line at 20 MPa fills an empty tank, one valve feeds it and two others take gas back."""
    fluid = NobleAbel(temperature=288.15)
    flux, pressures = Flux(fluid), (25e6, 1e6, 0.2e6)

    def pressure(density: float) -> float:
        return density * fluid.constant * 288.15 / (1.0 - fluid.covolume * density)

    def rates(t: float, densities: np.ndarray) -> list[float]:
        line, tank = (pressure(density) for density in densities)
        came = sum(area * flux(p, line) for area, p in zip(LINE.areas, pressures, strict=True))
        went = LINE.orifice * flux(line, tank)
        return [(came - went) / LINE.volume, went / LINE.filled]

    found = masses(20e6, 2e6)
    start = [found[0] / LINE.volume, found[1] / LINE.filled]
    theirs = solve_ivp(rates, (0.0, 0.5), start, method="Radau", rtol=1e-7, t_eval=[0.1, 0.5])
    given = 0.0
    for k in range(1, 2001):
        found, came = LINE.step(found, pressures, 2.5e-4)
        given += sum(came)
        if k in (400, 2000):
            expected = [pressure(density) for density in theirs.y[:, [400, 2000].index(k)]]
            ours = GAS.pressure(found[0], LINE.volume), GAS.pressure(found[1], LINE.filled)
            np.testing.assert_allclose(ours, expected, rtol=2e-3)
    assert sum(found) == pytest.approx(sum(masses(20e6, 2e6)) + given, rel=1e-9)


def test_equal_pressures_stay_and_none_passes_another() -> None:
    """However long the step: a stiff end of equalisation neither overshoots nor chatters."""
    found, came = LINE.step(masses(5e6, 5e6), (5e6, 5e6, 5e6), 10.0)
    assert GAS.pressure(found[1], LINE.filled) == pytest.approx(5e6, rel=1e-12)
    assert sum(map(abs, came)) < 1e-9 * sum(found)
    found, highest = masses(20e6, 2e6), 20e6
    for _ in range(100):
        found, _ = LINE.step(found, (1e6, 1e6, 1e6), 1.0)
        pressures = GAS.pressure(found[0], LINE.volume), GAS.pressure(found[1], LINE.filled)
        assert 1e6 * (1.0 - 1e-7) <= min(pressures) <= max(pressures) <= highest  # the flow grows with the root
        highest = max(pressures)
    assert highest == pytest.approx(1e6, rel=1e-6)
