"""Smooth curves beside a model, on sums of curves over known coordinates."""

from __future__ import annotations

from collections.abc import Mapping

import numpy as np

from identification.fit.linear_plant import SIGMA, TIMES, LinearPlant, measured, problem_of
from valve_sim.identification.fit.fitter import SPLINES
from valve_sim.identification.fit.search import Search
from valve_sim.identification.plants.protocol import Array, ForceMap
from valve_sim.model import SimulationError
from valve_sim.model.effects import basis

PLACES = {
    "x": 0.5 + 0.5 * np.sin(2.0 * np.pi * 7.3 * TIMES),
    "v": 0.5 + 0.5 * np.sin(2.0 * np.pi * 3.1 * TIMES + 1.0),
    "t": TIMES / TIMES[-1],
}
"""(n,) of each coordinate, from 0 to 1."""


def a_map(variable: str, unit: str = "m") -> ForceMap:
    names = tuple(f"{variable}{number}" for number in range(SPLINES))
    return ForceMap(variable, names, {f"low of {variable}": 0.0}, 0.0, 1.0, unit, "count")


MAPS = [a_map("x"), a_map("v"), a_map("t", "s")]
BUMP = 3.0 * np.exp(-(((PLACES["x"] - 0.6) / 0.15) ** 2))


def curves(values: Mapping[str, float], impossible: str = "") -> Array:
    """What the curves with these coefficients add."""
    total = np.zeros(len(TIMES))
    if f"low of {impossible}" in values:
        raise SimulationError("it cannot be simulated")
    for choice in MAPS:
        coefficients = np.array([values.get(name, 0.0) for name in choice.coefficients])
        if not coefficients.any():
            continue
        total += basis(PLACES[choice.variable], 0.0, 1.0, SPLINES) @ coefficients[:SPLINES]
    return total


def found(added: Array, impossible: str = "") -> tuple[dict[str, float], Search]:
    """Ln p with each curve less that without, by variable."""
    plant = LinearPlant(measured() + added, lambda values: curves(values, impossible), force_maps=MAPS)
    search = Search(problem_of(plant))  # type: ignore[arg-type]
    search.fit_declared()
    return {name: one.plain - search.tried[()].plain for name, one in search.curves.items()}, search


def test_the_curve_that_acts_is_the_most_probable_and_is_the_one_behind_the_data() -> None:
    gains, search = found(BUMP)
    assert set(gains) == {"curve(x)", "curve(v)"}, "none over time, which follows anything"
    assert gains["curve(x)"] > gains["curve(v)"] + 50.0
    values = search.curves["curve(x)"].result.values
    curve = basis(PLACES["x"], 0.0, 1.0, SPLINES) @ [values.get(name, 0.0) for name in MAPS[0].coefficients[:SPLINES]]
    assert np.sqrt(np.mean((curve - BUMP) ** 2)) < 0.2 * SIGMA
    assert max(found(np.zeros(len(TIMES)))[0].values()) < 0.0


def test_what_cannot_be_simulated_is_left_out() -> None:
    assert set(found(BUMP, impossible="v")[0]) == {"curve(x)"}
