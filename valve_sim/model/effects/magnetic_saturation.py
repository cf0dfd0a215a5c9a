"""Saturating iron: a mechanism of the core, (7)."""

from __future__ import annotations

import math

from valve_sim.model.core.symbols import Own
from valve_sim.model.core.tracer import Node
from valve_sim.model.effects.entry import Effect, Severity, Tag, Values
from valve_sim.model.parameters import Parameter


def _severity(values: Values, declared: Values) -> Severity | None:
    return Severity(values["current"] ** -2, "the attraction, between a small current and the reference current")


def saturated_square(s: Node, own: Own) -> Node:
    """S (1 + k)/(1 + k s), k = 1/u_s²."""
    # Squared after division: a knee at infinity, which is off, then has derivatives, too.
    inverse = 1.0 / own.current
    k = inverse * inverse
    return s * (1.0 + k) / (1.0 + k * s)


EFFECT = Effect(
    "magnetic_saturation",
    "the pull grows more slowly than u² at high current",
    (Parameter("current", "–", "u_s, knee of the saturation, in units of u", 0.05, 1e3, 5.0, math.inf),),
    "B 1.32 T closed, 0.50 T open in the paper's finite-element figure",
    title="Magnetic saturation",
    on_a_real_valve="The iron carries no more flux at high current, so that more voltage brings less extra pull than "
    "it should.",
    what_to_do="It belongs to the magnetic circuit; declare it, and do not count on higher voltage for more pull.",
    severity=_severity,
    tags=(Tag.COIL,),
    square=saturated_square,
)
