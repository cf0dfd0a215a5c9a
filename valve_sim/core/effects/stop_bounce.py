"""Rebound at the core and at the seat."""

from __future__ import annotations

from valve_sim.core.effects.entry import Effect, replaced
from valve_sim.model.parameters import Parameter

EFFECT = Effect(
    name="stop_bounce",
    title="Bounce",
    summary="rebound at the core and at the seat",
    parameters=(
        Parameter("restitution_stop", "–", "speed after over speed before, at x = stroke", 0, 0.95, 0.2, 0.0),
        Parameter("restitution_seat", "–", "likewise at x = 0", 0, 0.95, 0.2, 0.0),
    ),
    source="restitution 0.1–0.6 of steel on steel",
    on_a_real_valve="The plungers rebound when they hit the core or the seat, so that the valve opens or closes twice.",
    what_to_do="Check the damping washer and the soft seat for wear; a lower voltage makes the impact softer.",
    changes={
        "restitution_stop": replaced("restitution_stop"),
        "restitution_seat": replaced("restitution_seat"),
    },
    stands_alone=("stop_compliance",),
)
