"""A later current: more of the coil's time constant τ."""

from __future__ import annotations

from valve_sim.core.effects.entry import Effect, added
from valve_sim.model.parameters import Parameter

EFFECT = Effect(
    name="coil_lag",
    title="Coil lag",
    summary="the coil current itself is later than declared",
    parameters=(Parameter("time_constant", "s", "added to coil_time_constant", 0, 1.0, 0.0001, 0.0),),
    source="τ = L/R of a solenoid coil",
    on_a_real_valve=(
        "The current rises and falls more slowly than declared: more inductance, less resistance, or a "
        "suppression diode that lets the current run on."
    ),
    what_to_do=(
        "Record the coil current, and compare inductance, resistance and suppression circuit with the data sheet."
    ),
    confused_with=("residual_magnetism",),
    changes={"coil_time_constant": added("time_constant")},
)
