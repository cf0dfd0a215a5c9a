"""A coil that warms up, (10)."""

from __future__ import annotations

from valve_sim.core.effects.entry import Effect, replaced
from valve_sim.model.parameters import Parameter

EFFECT = Effect(
    name="coil_heating",
    title="Coil heating",
    summary="the coil warms up and its resistance rises",
    parameters=(
        Parameter("temperature_rate", "K/s", "heating at u = 1", 0, 1000000.0, 10.0, 0.0),
        Parameter(
            "cooling_time_constant", "s", "of the coil's temperature", 0.001, 1000000.0, 1.0, infinite_at_upper=True
        ),
    ),
    source="IEC 60028: copper, 0.00393 1/K",
    on_a_real_valve=(
        "The coil warms up while it is powered, its resistance rises, and it pulls less from stroke to stroke."
    ),
    what_to_do="Check duty cycle, supply voltage and cooling, or reduce the voltage once the valve is open.",
    changes={
        "temperature_rate": replaced("temperature_rate"),
        "cooling_time_constant": replaced("cooling_time_constant"),
    },
)
