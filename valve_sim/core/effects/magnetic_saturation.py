"""Saturating iron, (7)."""

from __future__ import annotations

import math

from valve_sim.core.effects.entry import Effect, Own
from valve_sim.core.tracer import Node
from valve_sim.model.parameters import Parameter


def saturated(s: Node, own: Own) -> Node:
    """S (1 + k)/(1 + k s), k = 1/u_s²."""
    k = own.current**-2
    return s * (1.0 + k) / (1.0 + k * s)


EFFECT = Effect(
    name="magnetic_saturation",
    title="Magnetic saturation",
    summary="the pull grows more slowly than u² at high current",
    parameters=(Parameter("current", "–", "u_s, the knee, in units of u", 0.05, 1000.0, 5.0, math.inf),),
    source="B 1.32 T closed, 0.50 T open in the paper's finite-element figure",
    on_a_real_valve=(
        "The iron carries no more flux at high current, so that more voltage brings less extra pull than it should."
    ),
    what_to_do="It belongs to the magnetic circuit; declare it, and do not count on higher voltage for more pull.",
    square=saturated,
)
