"""A pilot gap that is not as declared: added to `pilot_gap`."""

from __future__ import annotations

from valve_sim.model.effects.entry import Effect, Severity, Tag, Values, share
from valve_sim.model.parameters import Parameter


def _severity(values: Values, declared: Values) -> Severity | None:
    return share(values["offset"], declared["pilot_gap"], "the declared pilot gap")


EFFECT = Effect(
    "gap_offset",
    "the main plunger is picked up elsewhere than declared",
    (Parameter("offset", "m", "length added to pilot_gap", -0.1, 0.1, 5e-6, 0.0),),
    "manufacturing tolerance",
    title="Pilot gap not as declared",
    on_a_real_valve="The pilot plunger travels farther or less far than declared until the pin takes the main plunger "
    "along: tolerance, or a worn pin or pilot seat.",
    what_to_do="Measure the gap, and look for wear at the pin and at the pilot's seat.",
    severity=_severity,
    adds_to={"offset": "pilot_gap"},
    tags=(Tag.CONTACT,),
)
