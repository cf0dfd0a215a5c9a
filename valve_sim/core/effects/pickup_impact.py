"""Velocity lost at pick-up, in place of the declared ratio."""

from __future__ import annotations

from valve_sim.core.effects.entry import Effect, replaced
from valve_sim.model.parameters import Parameter

EFFECT = Effect(
    name="pickup_impact",
    title="Impact at pick-up",
    summary="velocity lost when the main plunger is picked up",
    parameters=(Parameter("velocity_ratio", "–", "in place of pickup_velocity_ratio", 0, 1, 0.1, 1.0),),
    source="momentum: pilot_mass / moving_mass = 0.813 for a plastic impact",
    on_a_real_valve="The pilot plunger hits the resting main plunger through the pin and loses speed.",
    what_to_do=(
        "It belongs to every such valve and needs no repair; declare it, and check pin and masses if it is new."
    ),
    changes={"pickup_velocity_ratio": replaced("velocity_ratio")},
)
