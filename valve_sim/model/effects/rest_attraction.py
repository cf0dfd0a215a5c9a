"""Attraction at the largest gap: added to a0."""

from __future__ import annotations

from valve_sim.model.effects.entry import Effect, Tag, share_of_preload
from valve_sim.model.parameters import Parameter

EFFECT = Effect(
    "rest_attraction",
    "attraction at the largest gap that the polynomial lacks",
    (Parameter("force", "N", "force added to a0", -1e5, 1e5, 0.1, 0.0),),
    "Appl. Sci. 2021, 11, 2329 and Appl. Sci. 2016, 6, 288 (same group's valves)",
    title="Attraction at the largest gap",
    on_a_real_valve="The coil already pulls when the plunger is farthest away, by another force than the declared "
    "attraction says.",
    what_to_do="Measure the static force of the coil on the closed valve, and fit the attraction again (fit-force).",
    severity=share_of_preload("force"),
    adds_to={"force": "a0"},
    confused_with=("constant_force",),
    tags=(Tag.COIL,),
)
