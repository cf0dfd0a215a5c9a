"""Drag that grows with the square of the speed."""

from __future__ import annotations

from valve_sim.core.effects.entry import Effect
from valve_sim.model.parameters import Parameter

EFFECT = Effect(
    name="quadratic_drag",
    title="Quadratic drag",
    summary="drag that grows with the square of the speed",
    parameters=(Parameter("coefficient", "N·s²/m²", "C in −C v |v|", 0, 1000000.0, 2.0, 0.0),),
    source="fluid displaced through a clearance at high Reynolds number",
    on_a_real_valve=(
        "The plungers push gas or liquid through a narrow clearance, and are held back the more the faster they move."
    ),
    what_to_do="Check which fluid is in the valve and how dense it is, and whether bores that let it pass are free.",
    confused_with=("squeeze_film",),
    force=lambda m, own: -own.coefficient * m.direction * m.v**2,
)
