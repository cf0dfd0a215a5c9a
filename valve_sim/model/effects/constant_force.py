"""A constant force in both phases."""

from __future__ import annotations

from valve_sim.model.effects.entry import Effect, Tag, share_of_preload
from valve_sim.model.parameters import Parameter


def constant_force(x: float, v: float, u: float, t: float, force: float) -> float:
    """N, + opens."""
    return force


EFFECT = Effect(
    "constant_force",
    "a constant force in both phases, + opens: gravity, zero of the load cell",
    (Parameter("force", "N", "force, + opens", -1e5, 1e5, 0.05, 0.0),),
    "free-body diagram; the paper's load cell is ±0.25 %",
    title="Constant force",
    on_a_real_valve="Something pushes the plungers one way all the time: their weight in another mounting position, a "
    "spring preload or a load-cell zero not as declared.",
    what_to_do="Check the mounting position, the spring's preload and the zero of the load cell.",
    severity=share_of_preload("force"),
    term=constant_force,
    tags=(Tag.FORCE,),
)
