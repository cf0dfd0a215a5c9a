"""Velocity lost at pick-up, in place of the declared ratio."""

from __future__ import annotations

from valve_sim.model.core.symbols import replaced
from valve_sim.model.effects.entry import Effect, Severity, Tag, Values
from valve_sim.model.parameters import Parameter


def _severity(values: Values, declared: Values) -> Severity | None:
    return Severity(1.0 - values["velocity_ratio"], "the velocity at pick-up")


EFFECT = Effect(
    "pickup_impact",
    "velocity lost when the main plunger is picked up",
    (Parameter("velocity_ratio", "–", "velocity ratio in place of pickup_velocity_ratio", 0, 1, 0.1, 1.0),),
    "momentum: pilot_mass / moving_mass = 0.813 for a plastic impact",
    title="Impact at pick-up",
    on_a_real_valve="The pilot plunger hits the resting main plunger through the pin and loses speed.",
    what_to_do="It belongs to every such valve and needs no repair; declare it, and check pin and masses if it is new.",
    severity=_severity,
    tags=(Tag.CONTACT,),
    changes={"pickup_velocity_ratio": replaced("velocity_ratio")},
)
