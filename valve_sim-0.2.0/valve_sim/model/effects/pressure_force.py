"""Pressure across the main plunger: a mechanism of the core, because it starts again at each opening."""

from __future__ import annotations

from valve_sim.model.core.symbols import Motion, Own
from valve_sim.model.core.tracer import Node, exp, where
from valve_sim.model.effects.entry import Effect, Tag, share_of_preload
from valve_sim.model.parameters import Parameter


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
    with_gas=False,
    tags=(Tag.FORCE,),
    force=pressure_of,
)
