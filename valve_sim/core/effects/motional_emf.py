"""The voltage that motion induces in the coil, (C1) to (C4)."""

from __future__ import annotations

from valve_sim.core.effects.entry import Effect, replaced
from valve_sim.model.parameters import Parameter

EFFECT = Effect(
    name="motional_emf",
    title="Motional EMF",
    summary="motion induces a voltage in the coil, which pays for the work of the attraction",
    parameters=(
        Parameter(
            "share",
            "–",
            "of what energy conservation demands with the declared resistance",
            0,
            10,
            1.0,
            0.0,
            not_declared=-1.0,
        ),
    ),
    source="H. H. Woodson, J. R. Melcher: Electromechanical Dynamics, part I, Wiley 1968, chapter 3",
    on_a_real_valve=(
        "The current dips while the plungers move towards the core, because their motion induces a voltage "
        "against that of the driver."
    ),
    what_to_do="It belongs to every coil; declare it, with the coil's resistance and time constant as measured.",
    confused_with=(
        "eddy_lag",
        "coil_lag",
        "coil_heating",
        "drive_gain",
    ),
    changes={"motional_share": replaced("share")},
)
