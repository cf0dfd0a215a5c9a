"""Drag of a fluid at high Reynolds number."""

from __future__ import annotations

from valve_sim.model.effects.entry import FASTEST, Effect, Severity, Tag, Values, share
from valve_sim.model.parameters import Parameter


def _severity(values: Values, declared: Values) -> Severity | None:
    force = values["coefficient"] * FASTEST**2
    return share(force, declared["spring_preload"], f"the spring preload, at {FASTEST:g} m/s")


EFFECT = Effect(
    "quadratic_drag",
    "drag that grows with the square of the speed",
    (Parameter("coefficient", "N·s²/m²", "coefficient C in −C v |v|", 0, 1e6, 2.0, 0.0),),
    "fluid displaced through a clearance at high Reynolds number",
    title="Quadratic drag",
    on_a_real_valve="The plungers push gas or liquid through a narrow clearance, and are held back the more the "
    "faster they move.",
    what_to_do="Check which fluid is in the valve and how dense it is, and whether bores that let it pass are free.",
    severity=_severity,
    confused_with=("squeeze_film",),
    tags=(Tag.DISSIPATIVE, Tag.LIKE_DAMPING),
    force=lambda m, own: -own.coefficient * m.direction * m.v**2,
)
