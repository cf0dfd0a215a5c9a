"""Gas that passes a closed valve: more of the flow's area, at every lift."""

from __future__ import annotations

from valve_sim.model.core.symbols import replaced
from valve_sim.model.effects.entry import Effect, Tag
from valve_sim.model.parameters import Parameter

EFFECT = Effect(
    "seat_leak",
    "gas passes the closed valve",
    (Parameter("area", "m²", "area of the leak, open at every lift", 0, 1e-4, 1e-9, 0.0),),
    "scratched or dirty seats; EN 12266-1 grades the leakage of closed valves",
    title="Leaking seat",
    on_a_real_valve="Gas passes the closed valve: the seat is scratched, dirty or worn, or a seal is damaged.",
    what_to_do="Close the valve and watch the pressure behind it; clean or replace seat and seals.",
    changes={"leak_area": replaced("area")},
    with_gas=True,
    tags=(Tag.GAS,),
)
