"""Pressure across the main plunger: a mechanism of the core, because it starts again at each opening."""

from __future__ import annotations

import math
from typing import Any

from valve_sim.model.compiling import inlined
from valve_sim.model.core.symbols import Motion, Own
from valve_sim.model.core.tracer import Node, exp, where
from valve_sim.model.core_types import MAIN
from valve_sim.model.effects.entry import Effect, Tag, set_fields, share_of_preload
from valve_sim.model.parameters import Parameter


@inlined
def pressure(p: Any, t: float, motion: Any, coil: Any, condition: Any) -> float:
    """−F_p exp(−(t − t_o)/τ_p) in Phase 2, N; t_o is when the pilot last left its seat."""
    mode, _, unseated_time = condition
    if mode < MAIN or p.pressure_force == 0.0:
        return 0.0
    return -p.pressure_force * math.exp(-(t - unseated_time) / p.equalisation_time)  # type: ignore[no-any-return]


@inlined
def pressure_slopes(p: Any, g: Any, t: float, motion: Any, coil: Any, condition: Any) -> None:
    """The derivatives of `pressure`."""
    mode, _, unseated_time = condition
    g.pressure_force, g.equalisation_time = 0.0, 0.0
    if mode >= MAIN and (p.pressure_force != 0.0 or g.asks_shapes != 0):
        elapsed = (t - unseated_time) / p.equalisation_time
        g.pressure_force = -math.exp(-elapsed)
        g.unseated_time += p.pressure_force * g.pressure_force / p.equalisation_time
        g.equalisation_time = g.unseated_time * elapsed


def pressure_of(m: Motion, own: Own) -> Node:
    """−F_p exp(−(t − t_o)/τ_p) in Phase 2, N."""
    return where(m.lifted, -own.force * exp(-m.since / own.equalisation_time), 0.0)


EFFECT = Effect(
    "pressure_force",
    "pressure across the main plunger until the pilot orifice has equalised it",
    (
        Parameter("force", "N", "ΔP · A, holds the main plunger closed", -1e5, 1e5, 0.3, 0.0),
        Parameter(
            "equalisation_time", "s", "time constant of the equalisation", 1e-5, 1e3, 5e-3, infinite_at_upper=True
        ),
    ),
    "70 MPa on a 0.3 mm orifice: 4.9 N",
    title="Pressure on the main plunger",
    on_a_real_valve="Pressure still holds the main plunger on its seat when the pilot has opened, until it has "
    "equalised through the pilot orifice.",
    what_to_do="Check the inlet pressure, and the pilot orifice for dirt that slows the equalisation.",
    severity=share_of_preload("force"),
    rewrite=set_fields(pressure_force="force", equalisation_time="equalisation_time"),
    core_force=pressure,
    core_force_slopes=pressure_slopes,
    fields={"pressure_force": 0.0, "equalisation_time": 1.0},
    with_gas=False,
    tags=(Tag.FORCE,),
    force=pressure_of,
)
