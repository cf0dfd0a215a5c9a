"""Gas squeezed out of the closing gaps at seat and stop."""

from __future__ import annotations

from valve_sim.core.effects.entry import Effect, Motion, Own
from valve_sim.core.tracer import Node, where
from valve_sim.model.parameters import Parameter


def squeezed(m: Motion, own: Own) -> Node:
    """−B v [(h/(x + h))³ + (h/(stroke − x + h))³], N; beyond a compliant stop the film is as thin as at contact."""
    h = own.film_thickness
    at_stop = where(m.beyond, 1.0, h / (m.p.stroke - m.x + h))
    return -own.coefficient * m.v * ((h / (m.x + h)) ** 3 + at_stop**3)


EFFECT = Effect(
    name="squeeze_film",
    title="Squeeze film",
    summary="gas squeezed out of the closing gaps at seat and stop",
    parameters=(
        Parameter("coefficient", "N·s/m", "B, damping at contact", 0, 1000000.0, 2.0, 0.0),
        Parameter("film_thickness", "m", "h, film left at contact", 1e-06, 0.1, 0.0001),
    ),
    source="Reynolds: 3π η R⁴ v / (2 h³) for a disc",
    on_a_real_valve=(
        "Fluid between flat faces must get out of the way as they meet and in again as they part, which "
        "brakes the plungers close to seat and stop."
    ),
    what_to_do=(
        "Look for oil or condensate between plunger and core, and check that faces and their grooves are as designed."
    ),
    force=squeezed,
)
