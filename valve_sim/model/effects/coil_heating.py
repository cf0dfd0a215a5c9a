"""A coil that warms up: a mechanism of the core, (10)."""

from __future__ import annotations

import math

from valve_sim.model.core.symbols import replaced
from valve_sim.model.effects.entry import Effect, Severity, Tag, Values
from valve_sim.model.parameters import Parameter


def _severity(values: Values, declared: Values) -> Severity | None:
    cooling = values["cooling_time_constant"]
    warmer = values["temperature_rate"] * cooling * -math.expm1(-1.0 / cooling)
    return Severity(0.00393 * warmer, "the coil's resistance, after one second at the reference voltage")


EFFECT = Effect(
    "coil_heating",
    "the coil warms up and its resistance rises",
    (
        Parameter("temperature_rate", "K/s", "heating rate at u = 1", 0, 1e6, 10.0, 0.0),
        Parameter(
            "cooling_time_constant", "s", "time constant of the coil's cooling", 1e-3, 1e6, 1.0, infinite_at_upper=True
        ),
    ),
    "IEC 60028: copper, 0.00393 1/K",
    title="Coil heating",
    on_a_real_valve="The coil warms up while it is powered, its resistance rises, and it pulls less from stroke to "
    "stroke.",
    what_to_do="Check duty cycle, supply voltage and cooling, or reduce the voltage once the valve is open.",
    severity=_severity,
    tags=(Tag.COIL,),
    changes={
        "temperature_rate": replaced("temperature_rate"),
        "cooling_time_constant": replaced("cooling_time_constant"),
    },
)
