"""Dry friction of one level against the motion."""

from __future__ import annotations

from valve_sim.core.effects.entry import Effect
from valve_sim.model.parameters import Parameter

EFFECT = Effect(
    name="coulomb_friction",
    title="Coulomb friction",
    summary="dry friction of one level against the motion",
    parameters=(Parameter("force", "N", "friction force", 0, 100000.0, 0.05, 0.0),),
    source="Armstrong-Hélouvry, Dupont, Canudas de Wit, Automatica 30 (1994) 1083",
    on_a_real_valve=(
        "The plungers rub in their guide with the same force at every speed: dirt, a worn or dry guide, or a "
        "plunger that is pressed to one side."
    ),
    what_to_do=(
        "Clean the guide and look for scratches and swollen seals; check that nothing presses the plungers sideways."
    ),
    confused_with=(
        "stiction",
        "asymmetric_friction",
        "squeeze_film",
    ),
    friction=lambda m, own: own.force,
)
