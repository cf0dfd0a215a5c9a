"""Eddy currents: a mechanism of the core, a second pole between current and pull, (9)."""

from __future__ import annotations

from valve_sim.model.core.symbols import replaced
from valve_sim.model.effects.entry import Effect, Severity, Tag, Values, share
from valve_sim.model.parameters import Parameter


def _severity(values: Values, declared: Values) -> Severity | None:
    return share(values["time_constant"], declared["coil_time_constant"], "the declared coil time constant")


EFFECT = Effect(
    "eddy_lag",
    "eddy currents: a second pole between current and pull",
    (Parameter("time_constant", "s", "time constant of the second pole", 0, 1.0, 1e-4, 0.0),),
    "1–10 ms are documented for solid cores; grows as the gap closes",
    title="Eddy currents",
    on_a_real_valve="The pull follows the current late, because currents in the solid iron hold the magnetic field "
    "back.",
    what_to_do="It belongs to a solid core and needs no repair; declare it, and check the iron's grade if it is new.",
    severity=_severity,
    confused_with=("coil_lag", "residual_magnetism"),
    tags=(Tag.COIL,),
    changes={"eddy_time_constant": replaced("time_constant")},
)
