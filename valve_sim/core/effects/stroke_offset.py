"""A stroke that is not as declared."""

from __future__ import annotations

from valve_sim.core.effects.entry import Effect, added
from valve_sim.model.parameters import Parameter

EFFECT = Effect(
    name="stroke_offset",
    title="Stroke not as declared",
    summary="the core stops the plungers elsewhere than declared",
    parameters=(Parameter("offset", "m", "added to stroke", -0.1, 0.1, 5e-06, 0.0),),
    source="manufacturing tolerance",
    on_a_real_valve=(
        "The plungers travel farther or less far than declared: tolerance, wear of the stop, a deposit on it, "
        "or a loose core."
    ),
    what_to_do="Measure the stroke, look for deposits and wear at the stop, and check the sensor's scale.",
    confused_with=("sensor_gain",),
    changes={"stroke": added("offset")},
)
