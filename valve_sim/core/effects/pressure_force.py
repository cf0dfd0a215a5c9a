"""Pressure across the main plunger, which equalises once the pilot has opened."""

from __future__ import annotations

from valve_sim.core.effects.entry import Effect, Motion, Own
from valve_sim.core.tracer import Node, exp, where
from valve_sim.model.parameters import Parameter


def pressure(m: Motion, own: Own) -> Node:
    """−F_p exp(−(t − t_o)/τ_p) in Phase 2, N."""
    return where(m.lifted, -own.force * exp(-m.since / own.equalisation_time), 0.0)


EFFECT = Effect(
    name="pressure_force",
    title="Pressure on the main plunger",
    summary="pressure across the main plunger until the pilot orifice has equalised it",
    parameters=(
        Parameter("force", "N", "ΔP · A, holds the main plunger closed", -100000.0, 100000.0, 0.3, 0.0),
        Parameter(
            "equalisation_time", "s", "time constant of the equalisation", 1e-05, 1000.0, 0.005, infinite_at_upper=True
        ),
    ),
    source="70 MPa on a 0.3 mm orifice: 4.9 N",
    on_a_real_valve=(
        "Pressure still holds the main plunger on its seat when the pilot has opened, until it has equalised "
        "through the pilot orifice."
    ),
    what_to_do="Check the inlet pressure, and the pilot orifice for dirt that slows the equalisation.",
    force=pressure,
)
