"""A pilot orifice that lets less gas through than it should."""

from __future__ import annotations

from valve_sim.model.core.symbols import replaced
from valve_sim.model.effects.entry import Effect, Severity, Tag, Values
from valve_sim.model.parameters import Parameter


def _severity(values: Values, declared: Values) -> Severity | None:
    return Severity(1.0 - values["ratio"], "the pilot orifice's area")


EFFECT = Effect(
    "pilot_clogging",
    "the pilot orifice lets less gas through",
    (Parameter("ratio", "–", "what is left of the pilot orifice's area; 1: free", 1e-3, 1, 0.1, 1.0),),
    "particles, oil or ice in an orifice of some tenths of a millimetre",
    title="Clogged pilot orifice",
    on_a_real_valve="Dirt, oil or ice narrows the pilot orifice: the pressure takes longer to equalise, and the valve "
    "to open.",
    what_to_do="Check the filter before the valve and the gas's dryness, and clean the pilot orifice.",
    remaining="pilot orifice",
    severity=_severity,
    changes={"clogging_ratio": replaced("ratio")},
    with_gas=True,
    tags=(Tag.GAS,),
)
