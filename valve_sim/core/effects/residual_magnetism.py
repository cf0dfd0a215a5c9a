"""Iron that stays magnetised, (8)."""

from __future__ import annotations

from valve_sim.core.effects.entry import Effect, replaced
from valve_sim.model.parameters import Parameter

EFFECT = Effect(
    name="residual_magnetism",
    title="Residual magnetism",
    summary="iron that stays magnetised keeps pulling after switch-off",
    parameters=(Parameter("current", "–", "the u that stays", 0, 1, 0.05, 0.0),),
    source="0.1–1 N after switch-off are documented for such valves",
    on_a_real_valve=(
        "The iron stays magnetised after switch-off, goes on pulling, and makes the valve close late or not at all."
    ),
    what_to_do="Check that the non-magnetic spacer at the core is in place, and demagnetise or replace the plunger.",
    changes={"residual_current": replaced("current")},
)
