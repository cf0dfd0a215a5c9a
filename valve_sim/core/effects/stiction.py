"""Dry friction with a breakaway peak (6): F + F_b exp(−(v/v_s)²)."""

from __future__ import annotations

from valve_sim.core.effects.entry import Effect, Motion, Own
from valve_sim.core.tracer import Node, exp
from valve_sim.model.parameters import Parameter


def friction(m: Motion, own: Own) -> Node:
    """F + F_b exp(−(v/v_s)²), N."""
    return own.force + own.breakaway * exp(-((m.v / own.stribeck_velocity) ** 2))


EFFECT = Effect(
    name="stiction",
    title="Stiction",
    summary="dry friction that must first be broken away and falls with speed",
    parameters=(
        Parameter("force", "N", "friction force", 0, 100000.0, 0.05, 0.0),
        Parameter("breakaway", "N", "extra force at rest", 0, 100000.0, 0.05, 0.0),
        Parameter("stribeck_velocity", "m/s", "speed at which it has faded", 1e-05, 1000.0, 0.02),
    ),
    source="Armstrong-Hélouvry, Dupont, Canudas de Wit, Automatica 30 (1994) 1083",
    on_a_real_valve=(
        "The plungers stick where they rest and then slide more easily: gummed lubricant, a sticky seal, or "
        "surfaces that cling."
    ),
    what_to_do="Clean seat and guide, replace sticky seals, and compare strokes after a long and after a short rest.",
    confused_with=(
        "asymmetric_friction",
        "squeeze_film",
    ),
    friction=friction,
)
