"""The voltage that motion induces in the coil: a mechanism of the core, (C1) to (C4)."""

from __future__ import annotations

from valve_sim.model.core.symbols import replaced
from valve_sim.model.effects.entry import Effect, Severity, Tag, Values
from valve_sim.model.parameters import Parameter


def _severity(values: Values, declared: Values) -> Severity | None:
    return Severity(abs(values["share"]), "what energy conservation demands with the declared resistance")


_SHARE = Parameter(
    "share",
    "–",
    "share of what energy conservation demands with the declared resistance",
    0,
    10,
    1.0,
    0.0,
    not_declared=-1.0,
)

EFFECT = Effect(
    "motional_emf",
    "motion induces a voltage in the coil, which pays for the work of the attraction",
    (_SHARE,),
    "H. H. Woodson, J. R. Melcher: Electromechanical Dynamics, part I, Wiley 1968, chapter 3",
    title="Motional EMF",
    on_a_real_valve="The current dips while the plungers move towards the core, because their motion induces a voltage "
    "against that of the driver.",
    what_to_do="It belongs to every coil; declare it, with the coil's resistance and time constant as measured.",
    severity=_severity,
    needs_inductance=True,
    confused_with=("eddy_lag", "coil_lag", "coil_heating", "drive_gain"),
    tags=(Tag.COIL, Tag.BUILT_IN),
    changes={"motional_share": replaced("share")},
)
