"""Friction and damping by direction: a mechanism of the core, because dry friction can hold the plungers."""

from __future__ import annotations

from valve_sim.model.core.symbols import Motion, Own
from valve_sim.model.core.tracer import Node, where
from valve_sim.model.effects.entry import Effect, Severity, Tag, Values, share
from valve_sim.model.parameters import Parameter


def _severity(values: Values, declared: Values) -> Severity | None:
    return share(
        max(values["force_opening"], values["force_closing"]), declared["spring_preload"], "the spring preload"
    )


def dry_friction(m: Motion, own: Own) -> Node:
    """F_±, N."""
    return where(m.direction > 0.0, own.force_opening, own.force_closing)


def damping_force(m: Motion, own: Own) -> Node:
    """−c_± v, N."""
    return -where(m.direction > 0.0, own.damping_opening, own.damping_closing) * m.v


EFFECT = Effect(
    "asymmetric_friction",
    "friction and extra damping that differ by direction",
    (
        Parameter("force_opening", "N", "dry friction while opening", 0, 1e5, 0.05, 0.0),
        Parameter("force_closing", "N", "dry friction while closing", 0, 1e5, 0.05, 0.0),
        Parameter("damping_opening", "N·s/m", "extra damping while opening", 0, 1e4, 0.5, 0.0),
        Parameter("damping_closing", "N·s/m", "extra damping while closing", 0, 1e4, 0.5, 0.0),
    ),
    "Janot, Gautier, Brunot 2019 (EMPS: friction by direction)",
    title="Friction that differs by direction",
    on_a_real_valve="The plungers rub harder one way than the other: a lip seal, a tilted plunger, or a side force "
    "that the coil makes.",
    what_to_do="Check the direction of lip seals, and whether the plunger tilts while the coil pulls.",
    severity=_severity,
    confused_with=("squeeze_film",),
    tags=(Tag.DISSIPATIVE,),
    force=damping_force,
    friction=dry_friction,
)
