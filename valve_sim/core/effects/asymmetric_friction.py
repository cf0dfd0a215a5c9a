"""Friction and damping by direction."""

from __future__ import annotations

from valve_sim.core.effects.entry import Effect, Motion, Own
from valve_sim.core.tracer import Node, where
from valve_sim.model.parameters import Parameter


def friction(m: Motion, own: Own) -> Node:
    """F_±, N."""
    return where(m.direction > 0.0, own.force_opening, own.force_closing)


def damping(m: Motion, own: Own) -> Node:
    """−c_± v, N."""
    return -where(m.direction > 0.0, own.damping_opening, own.damping_closing) * m.v


EFFECT = Effect(
    name="asymmetric_friction",
    title="Friction that differs by direction",
    summary="friction and extra damping that differ by direction",
    parameters=(
        Parameter("force_opening", "N", "dry friction while opening", 0, 100000.0, 0.05, 0.0),
        Parameter("force_closing", "N", "dry friction while closing", 0, 100000.0, 0.05, 0.0),
        Parameter("damping_opening", "N·s/m", "extra damping while opening", 0, 10000.0, 0.5, 0.0),
        Parameter("damping_closing", "N·s/m", "extra damping while closing", 0, 10000.0, 0.5, 0.0),
    ),
    source="Janot, Gautier, Brunot 2019 (EMPS: friction by direction)",
    on_a_real_valve=(
        "The plungers rub harder one way than the other: a lip seal, a tilted plunger, or a side force that "
        "the coil makes."
    ),
    what_to_do="Check the direction of lip seals, and whether the plunger tilts while the coil pulls.",
    confused_with=("squeeze_film",),
    friction=friction,
    force=damping,
)
