"""A stop elsewhere: more of the stroke."""

from __future__ import annotations

from valve_sim.model.effects.entry import Effect, Severity, Tag, Values, share
from valve_sim.model.parameters import Parameter


def _severity(values: Values, declared: Values) -> Severity | None:
    return share(values["offset"], declared["stroke"], "the declared stroke")


EFFECT = Effect(
    "stroke_offset",
    "the core stops the plungers elsewhere than declared",
    (Parameter("offset", "m", "length added to stroke", -0.1, 0.1, 5e-6, 0.0),),
    "manufacturing tolerance",
    title="Stroke not as declared",
    on_a_real_valve="The plungers travel farther or less far than declared: tolerance, wear of the stop, a deposit on "
    "it, or a loose core.",
    what_to_do="Measure the stroke, look for deposits and wear at the stop, and check the sensor's scale.",
    severity=_severity,
    adds_to={"offset": "stroke"},
    confused_with=("sensor_gain",),
    tags=(Tag.CONTACT,),
)
