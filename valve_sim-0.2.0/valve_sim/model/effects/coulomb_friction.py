"""Dry friction of one level: a mechanism of the core, because it makes plungers stick."""

from __future__ import annotations

from valve_sim.model.effects.entry import Effect, Tag, share_of_preload
from valve_sim.model.parameters import Parameter

EFFECT = Effect(
    "coulomb_friction",
    "dry friction of one level against the motion",
    (Parameter("force", "N", "friction force", 0, 1e5, 0.05, 0.0),),
    "Armstrong-Hélouvry, Dupont, Canudas de Wit, Automatica 30 (1994) 1083",
    title="Coulomb friction",
    on_a_real_valve="The plungers rub in their guide with the same force at every speed: dirt, a worn or dry guide, "
    "or a plunger that is pressed to one side.",
    what_to_do="Clean the guide and look for scratches and swollen seals; check that nothing presses the plungers "
    "sideways.",
    severity=share_of_preload("force"),
    confused_with=("stiction", "asymmetric_friction", "squeeze_film"),
    tags=(Tag.DISSIPATIVE, Tag.LIKE_DAMPING),
    friction=lambda m, own: own.force,
)
