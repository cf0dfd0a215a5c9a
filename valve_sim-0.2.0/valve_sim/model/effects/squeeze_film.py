"""Gas squeezed out of the closing gaps at seat and stop."""

from __future__ import annotations

from valve_sim.model.core.symbols import Motion, Own
from valve_sim.model.core.tracer import Node, where
from valve_sim.model.effects.entry import Effect, Severity, Tag, Values, share
from valve_sim.model.parameters import Parameter


def _severity(values: Values, declared: Values) -> Severity | None:
    return share(values["coefficient"], declared["main_damping"], "the declared main damping, at contact")


def squeezed(m: Motion, own: Own) -> Node:
    """−B v [(h/(x + h))³ + (h/(stroke − x + h))³], N; beyond a compliant stop the film is as thin as at contact."""
    h = own.film_thickness
    at_stop = where(m.beyond, 1.0, h / (m.p.stroke - m.x + h))
    return -own.coefficient * m.v * ((h / (m.x + h)) ** 3 + at_stop**3)


EFFECT = Effect(
    "squeeze_film",
    "gas squeezed out of the closing gaps at seat and stop",
    (
        Parameter("coefficient", "N·s/m", "B, damping at contact", 0, 1e6, 2.0, 0.0),
        Parameter("film_thickness", "m", "h, film left at contact", 1e-6, 1e-1, 1e-4),
    ),
    "Reynolds: 3π η R⁴ v / (2 h³) for a disc",
    title="Squeeze film",
    on_a_real_valve="Fluid between flat faces must get out of the way as they meet and in again as they part, which "
    "brakes the plungers close to seat and stop.",
    what_to_do="Look for oil or condensate between plunger and core, and check that faces and their grooves are as "
    "designed.",
    severity=_severity,
    tags=(Tag.DISSIPATIVE, Tag.LIKE_DAMPING),
    force=squeezed,
)
