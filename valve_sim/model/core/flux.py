"""Whether a current follows from the flux of a valve: what only shows when all of its effects are taken together."""

from __future__ import annotations

from collections.abc import Sequence
from typing import Any, Final

import numpy as np

from valve_sim.model.core.equations import System, build
from valve_sim.model.core.symbols import Effect
from valve_sim.model.core.tracer import evaluate

_PLACES: Final = 65
_CURRENTS: Final = np.geomspace(1e-3, 1e3, 241)
"""Places along the stroke, and currents u, at which the flux is checked to grow with the current."""


def numbers_after_effects(system: System, numbers: Sequence[float], *names: str) -> list[float]:
    """Some numbers of a valve as its effects leave them, by `System.numbers`' names."""
    values = dict(zip(system.parameters, numbers, strict=True))
    return [float(found) for found in evaluate([system.numbers[name] for name in names], values)]


def why_no_flux(effects: Sequence[Effect], shapes: Sequence[float], numbers: Sequence[float]) -> str:
    """What is wrong with the flux of a valve, for a message that names the effect; empty if nothing is.

    The flux must grow with the current, from seat to stop and at any current: otherwise none follows from it.
    """
    if all("motional_share" not in effect.changes for effect in effects):
        return ""
    system = build(effects, shapes=shapes)
    assert system.flux_slope is not None
    stroke, lag = numbers_after_effects(system, numbers, "stroke", "coil_time_constant")
    if lag == 0.0:
        return (
            "motional_emf: found a coil time constant of 0 s, expected above 0: a coil without inductance has no flux; "
            "declare valve.coil_time_constant, the coil's L/R at its largest gap"
        )
    x = np.linspace(0.0, stroke, _PLACES)[:, None]
    currents = np.concatenate([[0.0], _CURRENTS])[None, :]
    values: dict[str, Any] = dict(zip(system.parameters, numbers, strict=True))
    (slopes,) = evaluate([system.flux_slope], {**values, "x": x, "w": currents})
    slopes = np.broadcast_to(slopes, (len(x), currents.size))
    # Once more around the smallest, between its neighbours.
    at = int(np.argmin(np.min(slopes, axis=0)))
    near = np.linspace(currents[0, max(at - 1, 0)], currents[0, min(at + 1, currents.size - 1)], len(_CURRENTS))
    (finer,) = evaluate([system.flux_slope], {**values, "x": x, "w": near[None, :]})
    smallest = min(float(np.min(slopes)), float(np.min(finer)))
    if smallest > 0.0:
        return ""
    return (
        f"motional_emf: found a coil time constant of {lag:g} s, expected above {lag - smallest:.6g} s: somewhere in "
        "the stroke more current would make less flux; check valve.coil_time_constant, the attraction, "
        "valve.coil_resistance and magnetic_saturation"
    )
