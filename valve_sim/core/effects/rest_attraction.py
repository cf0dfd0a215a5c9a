"""Attraction at the largest gap that the polynomial lacks."""

from __future__ import annotations

from valve_sim.core.effects.entry import Effect, added
from valve_sim.model.parameters import Parameter

EFFECT = Effect(
    name="rest_attraction",
    title="Attraction at the largest gap",
    summary="attraction at the largest gap that the polynomial lacks",
    parameters=(Parameter("force", "N", "added to a0", -100000.0, 100000.0, 0.1, 0.0),),
    source="Appl. Sci. 2021, 11, 2329 and Appl. Sci. 2016, 6, 288 (same group's valves)",
    on_a_real_valve=(
        "The coil already pulls when the plunger is farthest away, by another force than the declared attraction says."
    ),
    what_to_do="Measure the static force of the coil on the closed valve, and fit the attraction again (fit-force).",
    confused_with=("constant_force",),
    changes={"a0": added("force")},
)
