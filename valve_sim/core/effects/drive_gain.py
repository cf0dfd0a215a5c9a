"""Another current than the voltage should give."""

from __future__ import annotations

from valve_sim.core.effects.entry import Effect, replaced
from valve_sim.model.parameters import Parameter

EFFECT = Effect(
    name="drive_gain",
    title="Drive gain",
    summary="harness or coil resistance not as declared",
    parameters=(Parameter("gain", "–", "u over declared u", 0.05, 20, 0.01, 1.0),),
    source="Ohm's law",
    on_a_real_valve=(
        "The coil gets another current than its voltage and declared resistance give: a long or corroded "
        "harness, another coil, a warm coil, or a driver that is off."
    ),
    what_to_do="Measure the coil's resistance at its connector and the voltage there while the valve is held open.",
    confused_with=(
        "rest_attraction",
        "magnetic_saturation",
        "coil_heating",
    ),
    changes={"drive_gain": replaced("gain")},
)
