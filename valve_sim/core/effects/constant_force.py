"""A constant force in both phases."""

from __future__ import annotations

from valve_sim.core.effects.entry import Effect
from valve_sim.model.parameters import Parameter

EFFECT = Effect(
    name="constant_force",
    title="Constant force",
    summary="a constant force in both phases, + opens: gravity, zero of the load cell",
    parameters=(Parameter("force", "N", "+ opens", -100000.0, 100000.0, 0.05, 0.0),),
    source="free-body diagram; the paper's load cell is ±0.25 %",
    on_a_real_valve=(
        "Something pushes the plungers one way all the time: their weight in another mounting position, a "
        "spring preload or a load-cell zero not as declared."
    ),
    what_to_do="Check the mounting position, the spring's preload and the zero of the load cell.",
    force=lambda m, own: own.force,
)
