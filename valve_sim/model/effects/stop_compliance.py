"""A core that gives way: beyond the stroke the contact is a spring with damping."""

from __future__ import annotations

from valve_sim.model.core.symbols import Motion, Own, replaced
from valve_sim.model.core.tracer import Node, maximum, sqrt, where
from valve_sim.model.effects.entry import Effect, Tag
from valve_sim.model.parameters import Parameter


def contact(m: Motion, own: Own) -> Node:
    """−max(0, (x − stroke)/c + 2 ζ √(m_2/c) v), N: it pushes the plungers back, and never pulls them."""
    damping = 2.0 * own.damping_ratio * sqrt(m.p.moving_mass / own.compliance)
    push = (m.x - m.p.stroke) / own.compliance + damping * m.v
    return where(m.beyond, -maximum(where(m.beyond, push, -1.0), 0.0), 0.0)


EFFECT = Effect(
    "stop_compliance",
    "the core gives way to the plungers like a spring",
    (
        Parameter(
            "compliance", "m/N", "compliance of the contact at x = stroke; below 1e-11: rigid", 0, 1e-6, 1e-8, 0.0
        ),
        Parameter("damping_ratio", "–", "damping ratio of the moving mass on that spring", 0, 10.0, 0.3),
    ),
    "K. H. Hunt, F. R. E. Crossley, J. Appl. Mech. 42 (1975) 440: contact as a spring with damping",
    title="Compliant stop",
    on_a_real_valve="The core, its thread or a damping washer gives way at the impact, and the plungers ring on it.",
    what_to_do="Check that the core is tight and the damping washer whole; declare the compliance of a soft stop.",
    confused_with=("stop_bounce",),
    force=contact,
    changes={"stop_compliance": replaced("compliance")},
    stands_alone=("stop_bounce",),
    with_gas=False,
    tried=False,  # at a compliance of 0 it has no derivative, and a rebound looks like it
    tags=(Tag.CONTACT,),
)
