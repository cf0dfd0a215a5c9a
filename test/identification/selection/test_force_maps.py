"""Which force maps are fitted beside a model, and what is said of them: on sums of curves over known coordinates."""

from __future__ import annotations

from collections.abc import Mapping, Sequence

import numpy as np

from identification.selection.linear_plant import TIMES, LinearPlant, measured, problem_of
from valve_sim.identification.fit.result import fit
from valve_sim.identification.plants.protocol import Array, ForceMap
from valve_sim.identification.selection.force_maps import NonparametricFit, competing_curves, fit_maps
from valve_sim.model import SimulationError
from valve_sim.model.effects import basis

PLACES = {
    "x": 0.5 + 0.5 * np.sin(2.0 * np.pi * 7.3 * TIMES),
    "v": 0.5 + 0.5 * np.sin(2.0 * np.pi * 3.1 * TIMES + 1.0),
    "t": TIMES / TIMES[-1],
}
"""(n,) of each coordinate, from 0 to 1."""


def a_map(variable: str, unit: str = "m") -> ForceMap:
    names = tuple(f"{variable}{number}" for number in range(12))
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
        total += basis(PLACES[choice.variable], 0.0, 1.0, 12) @ coefficients
    return total


def found(
    added: Array, impossible: str = "", maps: Sequence[ForceMap] = MAPS
) -> tuple[list[NonparametricFit], list[str]]:
    """The maps of these data, best first, and what was said to be tried."""
    said: list[str] = []
    plant = LinearPlant(measured() + added, lambda values: curves(values, impossible), force_maps=maps)
    base = fit(problem_of(plant), ("level",), {})

    def say(what: str, fraction: float) -> None:
        said.append(what)

    return fit_maps(base, competing_curves(base, say), say), said


def test_maps_come_by_their_evidence_and_what_acts_is_first() -> None:
    """A curve that competes is not fitted again."""
    maps, said = found(BUMP)
    evidence, variables = [one.fit.log_evidence for one in maps], [one.choice.variable for one in maps]
    assert evidence == sorted(evidence, reverse=True)
    assert variables[0] == "x"
    assert {"x", "v", "t"} == set(variables)
    assert len(said) == len(set(said))


def test_what_cannot_be_simulated_is_left_out() -> None:
    variables = [one.choice.variable for one in found(BUMP, impossible="v")[0]]
    assert "v" not in variables and "x" in variables
