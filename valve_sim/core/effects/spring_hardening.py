"""A spring that stiffens."""

from __future__ import annotations

from valve_sim.core.effects.entry import Effect
from valve_sim.core.tracer import where
from valve_sim.model.parameters import Parameter

EFFECT = Effect(
    name="spring_hardening",
    title="Spring hardening",
    summary="the spring stiffens as it is compressed",
    parameters=(Parameter("coefficient", "N/m³", "K in −K x³", -10000000000000.0, 10000000000000.0, 100000000.0, 0.0),),
    source="conical and closely wound springs",
    on_a_real_valve=(
        "The spring does not follow a straight line: coils touch each other, or the spring is conical or tired."
    ),
    what_to_do="Measure the spring's force over its travel, and replace it if it is not the one declared.",
    force=lambda m, own: where(m.lifted, -own.coefficient * m.x**3, 0.0),
)
