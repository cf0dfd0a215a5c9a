"""The periods that are likely, on data with sines in them, against least squares."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from functools import lru_cache

import numpy as np
import pytest

from identification.selection.linear_plant import (
    COLUMNS,
    SAMPLES,
    SIGMA,
    TIMES,
    LinearPlant,
    least_squares,
    measured,
    problem_of,
)
from valve_sim.identification.estimation.solver import fit
from valve_sim.identification.plants.protocol import Array, ForceMap
from valve_sim.identification.selection.periods import AMPLITUDE, TRIED, Period, likely_periods
from valve_sim.model import SimulationError
from valve_sim.model.effects import basis

NAMES = tuple(f"c{number}" for number in range(8))
SPAN = 1.2
CHOICE = ForceMap("x, periodic", NAMES, {"low": -0.1}, -0.1, -0.1 + SPAN, "m", "count", end="end")


def curve(values: Mapping[str, float]) -> Array:
    """The force over one period from −0.1 s on, as it is seen."""
    coefficients = [values.get(name, 0.0) for name in NAMES]
    if not any(coefficients):
        return np.zeros(SAMPLES)
    return np.asarray(shapes(values["low"], values["end"]) @ coefficients)


@lru_cache(maxsize=8)
def shapes(low: float, end: float) -> Array:
    return basis(TIMES, low, end, len(NAMES), periodic=True)


def wave(cycles: float) -> Array:
    return np.sin(2.0 * np.pi * cycles / SPAN * TIMES + 0.4)


def found(data: Array, choice: ForceMap = CHOICE, free: Sequence[str] = ("level",), **more: Array) -> list[Period]:
    def shown(values: Mapping[str, float]) -> Array:
        return curve(values) + values.get("known", 0.0) * wave(10.0)

    return likely_periods(choice, fit(problem_of(LinearPlant(data, shown, **more)), free, {}))[0]  # type: ignore[arg-type]


def gain_of(cycles: float, data: Array) -> float:
    """By least squares with the two curves that a cosine and a sine of coefficients make."""
    angles = 2.0 * np.pi * np.arange(8) / 8
    shapes = basis(TIMES, -0.1, -0.1 + SPAN / cycles, 8, periodic=True)
    own, both = COLUMNS[:, :1], shapes @ np.column_stack([np.cos(angles), np.sin(angles)])
    return least_squares(own, data / SIGMA) - least_squares(np.column_stack([own, both]), data / SIGMA)


def test_the_strongest_periods_are_found_with_their_gains() -> None:
    strengths = {10.0: 0.4, 13.0: 0.6, 4.0 + 1.0 / 3.0: 0.5}
    data = measured() + sum(strength * wave(cycles) for cycles, strength in strengths.items())
    periods = found(data)
    assert [period.gain for period in periods] == sorted((period.gain for period in periods), reverse=True)
    for period, cycles in zip(periods, (13.0, 4.0 + 1.0 / 3.0, 10.0), strict=False):
        assert period.length == pytest.approx(SPAN / cycles)
        assert period.gain == pytest.approx(gain_of(cycles, data), abs=0.02)
        # A third of a cycle more or less is a standard deviation off.
        assert 2.0 * period.sigma == pytest.approx(SPAN / (cycles - 1.0 / 3.0) - SPAN / (cycles + 1.0 / 3.0), rel=0.01)


def test_the_wave_of_a_period_is_the_one_in_the_data() -> None:
    (period, *_) = found(measured() + 0.5 * wave(10.0))
    there = curve({**period.wave, "low": -0.1, "end": -0.1 + period.length})
    np.testing.assert_allclose(there, 0.5 * wave(10.0), atol=0.06)


@pytest.mark.parametrize(
    ("unit", "cycles", "is_found"),
    [("m", 2.0, True), ("m", 14.0 + 2.0 / 3.0, True), ("m", 17.0, False), ("s", 249.0, True)],
)
def test_periods_are_looked_for_from_two_to_a_range_to_shorter_than_is_felt(
    unit: str, cycles: float, is_found: bool
) -> None:
    choice = ForceMap("any", NAMES, {"low": -0.1}, -0.1, -0.1 + SPAN, unit, "count", end="end")
    best, *others = found(measured() + wave(cycles), choice)
    assert len(others) <= TRIED - 1
    assert unit == "m" or len(others) == TRIED - 1
    assert (best.length == pytest.approx(SPAN / cycles)) is is_found


def test_what_is_fitted_anyway_gains_nothing_again() -> None:
    data = measured() + wave(10.0)
    assert found(data)[0].gain > 2000.0
    assert all(period.gain < 30.0 for period in found(data, free=("level", "known")))


def test_all_samples_and_those_in_motion_propose_by_turns() -> None:
    """Ten cycles are seen where the machine is still, four where it moves; neither piece tells it to a third."""
    still = TIMES > 0.6
    periods = found(measured() + wave(10.0) * still + 0.4 * wave(4.0) * ~still, still=still)
    assert [period.length for period in periods[:2]] == pytest.approx([SPAN / 10.0, SPAN / 4.0], rel=0.1)
    lengths = [period.length for period in periods]
    assert len(set(lengths)) == len(lengths)


def test_periods_that_cannot_be_simulated_gain_nothing() -> None:
    def shown(values: Mapping[str, float]) -> Array:
        assert max(abs(values.get(name, 0.0)) for name in NAMES) <= AMPLITUDE
        if values.get("end", 0.0) < -0.1 + SPAN / 11.5:
            raise SimulationError("too fast")
        return curve(values)

    plant = LinearPlant(measured() + wave(13.0) + 0.5 * wave(10.0), shown)
    plant.declared = lambda name: 1.0 if name == "end" else 0.0  # type: ignore[method-assign]
    base = fit(problem_of(plant), ("level",), {}, fixed={"end": 1.0})
    assert likely_periods(CHOICE, base)[0][0].length == pytest.approx(SPAN / 10.0)
