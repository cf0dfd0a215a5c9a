"""A pilot gap that is not as declared."""

from __future__ import annotations

from valve_sim.core.effects.entry import Effect, added
from valve_sim.model.parameters import Parameter

EFFECT = Effect(
    name="gap_offset",
    title="Pilot gap not as declared",
    summary="the main plunger is picked up elsewhere than declared",
    parameters=(Parameter("offset", "m", "added to pilot_gap", -0.1, 0.1, 5e-06, 0.0),),
    source="manufacturing tolerance",
    on_a_real_valve=(
        "The pilot plunger travels farther or less far than declared until the pin takes the main plunger "
        "along: tolerance, or a worn pin or pilot seat."
    ),
    what_to_do="Measure the gap, and look for wear at the pin and at the pilot's seat.",
    changes={"pilot_gap": added("offset")},
)
