"""Dry friction with a breakaway peak: a mechanism of the core, because it makes plungers stick."""

from __future__ import annotations

from valve_sim.model.core.symbols import Motion, Own
from valve_sim.model.core.tracer import Node, exp
from valve_sim.model.effects.entry import Effect, Severity, Tag, Values, share
from valve_sim.model.parameters import Parameter


def _severity(values: Values, declared: Values) -> Severity | None:
    return share(values["force"] + values["breakaway"], declared["spring_preload"], "the spring preload")


def friction(m: Motion, own: Own) -> Node:
    """F + F_b exp(−(v/v_s)²), N."""
    return own.force + own.breakaway * exp(-((m.v / own.stribeck_velocity) ** 2))


EFFECT = Effect(
    "stiction",
    "dry friction that must first be broken away and falls with speed",
    (
        Parameter("force", "N", "friction force", 0, 1e5, 0.05, 0.0),
        Parameter("breakaway", "N", "extra force at rest", 0, 1e5, 0.05, 0.0),
        Parameter("stribeck_velocity", "m/s", "speed at which it has faded", 1e-5, 1e3, 0.02),
    ),
    "Armstrong-Hélouvry, Dupont, Canudas de Wit, Automatica 30 (1994) 1083",
    title="Stiction",
    on_a_real_valve="The plungers stick where they rest and then slide more easily: gummed lubricant, a sticky seal, "
    "or surfaces that cling.",
    what_to_do="Clean seat and guide, replace sticky seals, and compare strokes after a long and after a short rest.",
    severity=_severity,
    confused_with=("asymmetric_friction", "squeeze_film"),
    tags=(Tag.DISSIPATIVE,),
    friction=friction,
)
