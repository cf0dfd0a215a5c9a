"""Rebound at the core and at the seat: a mechanism of the core, because it is an event."""

from __future__ import annotations

from valve_sim.model.core.symbols import replaced
from valve_sim.model.effects.entry import Effect, Severity, Tag, Values
from valve_sim.model.parameters import Parameter


def _severity(values: Values, declared: Values) -> Severity | None:
    largest = max(values["restitution_stop"], values["restitution_seat"])
    return Severity(largest**2, "the energy of the impact")


EFFECT = Effect(
    "stop_bounce",
    "rebound at the core and at the seat",
    (
        Parameter("restitution_stop", "–", "coefficient of restitution at the stop", 0, 0.95, 0.2, 0.0),
        Parameter("restitution_seat", "–", "coefficient of restitution at the seat", 0, 0.95, 0.2, 0.0),
    ),
    "restitution 0.1–0.6 of steel on steel",
    title="Bounce",
    on_a_real_valve="The plungers rebound when they hit the core or the seat, so that the valve opens or closes twice.",
    what_to_do="Check the damping washer and the soft seat for wear; a lower voltage makes the impact softer.",
    severity=_severity,
    tags=(Tag.CONTACT,),
    changes={"restitution_stop": replaced("restitution_stop"), "restitution_seat": replaced("restitution_seat")},
    stands_alone=("stop_compliance",),
)
