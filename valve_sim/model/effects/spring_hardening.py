"""A spring that stiffens as it is compressed."""

from __future__ import annotations

from valve_sim.model.effects.entry import Effect, Severity, Tag, Values, share
from valve_sim.model.parameters import Parameter


def spring_hardening(x: float, v: float, u: float, t: float, coefficient: float) -> float:
    """−K x³, N."""
    return -coefficient * x**3


def _severity(values: Values, declared: Values) -> Severity | None:
    stroke = declared["stroke"]
    force = declared["spring_preload"] + declared["spring_rate"] * stroke
    return share(values["coefficient"] * stroke**3, force, "the spring force at the full stroke")


EFFECT = Effect(
    "spring_hardening",
    "the spring stiffens as it is compressed",
    (Parameter("coefficient", "N/m³", "coefficient K in −K x³", -1e13, 1e13, 1e8, 0.0),),
    "conical and closely wound springs",
    title="Spring hardening",
    on_a_real_valve="The spring does not follow a straight line: coils touch each other, or the spring is conical or "
    "tired.",
    what_to_do="Measure the spring's force over its travel, and replace it if it is not the one declared.",
    severity=_severity,
    term=spring_hardening,
    phase_2_only=True,
    tags=(Tag.FORCE,),
)
