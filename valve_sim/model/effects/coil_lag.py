"""A later current: more of the coil's time constant."""

from __future__ import annotations

from valve_sim.model.effects.entry import Effect, Severity, Tag, Values, share
from valve_sim.model.parameters import Parameter


def _severity(values: Values, declared: Values) -> Severity | None:
    return share(values["time_constant"], declared["coil_time_constant"], "the declared coil time constant")


EFFECT = Effect(
    "coil_lag",
    "the coil current itself is later than declared",
    (Parameter("time_constant", "s", "time constant added to coil_time_constant", 0, 1.0, 1e-4, 0.0),),
    "τ = L/R of a solenoid coil",
    title="Coil lag",
    on_a_real_valve="The current rises and falls more slowly than declared: more inductance, less resistance, or a "
    "suppression diode that lets the current run on.",
    what_to_do="Record the coil current, and compare inductance, resistance and suppression circuit with the data "
    "sheet.",
    severity=_severity,
    adds_to={"time_constant": "coil_time_constant"},
    confused_with=("residual_magnetism",),
    tags=(Tag.COIL,),
)
