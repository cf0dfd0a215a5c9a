"""Where fits of effects start."""

import math
from collections.abc import Mapping

import pytest

from valve_sim.identification.plants.protocol import EffectChoice
from valve_sim.identification.selection.starts import all_near_off
from valve_sim.model import Parameter


def effect(name: str) -> EffectChoice:
    return EffectChoice(name, (Parameter("size", "N", name, 0.0, math.inf, 1.0, 0.0),))


@pytest.mark.parametrize("best", [0.1, 1e-3, 1e-4])
def test_all_effects_start_where_together_they_make_nothing_much_worse(best: float) -> None:
    """Two effects that do the same, of which the data want a certain sum."""

    def cost(values: Mapping[str, float]) -> float:
        return abs(values.get("a.size", 0.0) + values.get("b.size", 0.0) - best)

    start = all_near_off(cost, [effect("a"), effect("b")], {"mass": 2.0})
    assert start is not None
    assert start["mass"] == 2.0
    assert 0.0 < start["a.size"] + start["b.size"] <= 3.0 * best
