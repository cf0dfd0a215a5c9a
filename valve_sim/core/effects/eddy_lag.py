"""Eddy currents: a second pole between current and pull, (9)."""

from __future__ import annotations

from valve_sim.core.effects.entry import Effect, replaced
from valve_sim.model.parameters import Parameter

EFFECT = Effect(
    name="eddy_lag",
    title="Eddy currents",
    summary="eddy currents: a second pole between current and pull",
    parameters=(Parameter("time_constant", "s", "of the second pole", 0, 1.0, 0.0001, 0.0),),
    source="1–10 ms are documented for solid cores; grows as the gap closes",
    on_a_real_valve=(
        "The pull follows the current late, because currents in the solid iron hold the magnetic field back."
    ),
    what_to_do="It belongs to a solid core and needs no repair; declare it, and check the iron's grade if it is new.",
    confused_with=(
        "coil_lag",
        "residual_magnetism",
    ),
    changes={"eddy_time_constant": replaced("time_constant")},
)
