"""Another current than the voltage should give."""

from __future__ import annotations

from valve_sim.model.core.symbols import replaced
from valve_sim.model.effects.entry import Effect, Severity, Tag, Values
from valve_sim.model.parameters import Parameter


def _severity(values: Values, declared: Values) -> Severity | None:
    return Severity(abs(values["gain"] ** 2 - 1.0), "the attraction")


EFFECT = Effect(
    "drive_gain",
    "harness or coil resistance not as declared",
    (Parameter("gain", "–", "current over declared current", 0.05, 20, 0.01, 1.0),),
    "Ohm's law",
    title="Drive gain",
    on_a_real_valve="The coil gets another current than its voltage and declared resistance give: a long or corroded "
    "harness, another coil, a warm coil, or a driver that is off.",
    what_to_do="Measure the coil's resistance at its connector and the voltage there while the valve is held open.",
    severity=_severity,
    confused_with=("rest_attraction", "magnetic_saturation", "coil_heating"),
    tags=(Tag.COIL,),
    changes={"drive_gain": replaced("gain")},
)
