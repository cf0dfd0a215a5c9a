"""Iron that stays magnetised: a mechanism of the core, (8)."""

from __future__ import annotations

from valve_sim.model.core.symbols import replaced
from valve_sim.model.effects.entry import Effect, Severity, Tag, Values
from valve_sim.model.parameters import Parameter


def _severity(values: Values, declared: Values) -> Severity | None:
    return Severity(values["current"] ** 2, "the attraction at the reference current, after switch-off")


EFFECT = Effect(
    "residual_magnetism",
    "iron that stays magnetised keeps pulling after switch-off",
    (Parameter("current", "–", "remaining current, in units of u", 0, 1, 0.05, 0.0),),
    "0.1–1 N after switch-off are documented for such valves",
    title="Residual magnetism",
    on_a_real_valve="The iron stays magnetised after switch-off, goes on pulling, and makes the valve close late or "
    "not at all.",
    what_to_do="Check that the non-magnetic spacer at the core is in place, and demagnetise or replace the plunger.",
    severity=_severity,
    tags=(Tag.COIL,),
    changes={"residual_current": replaced("current")},
)
