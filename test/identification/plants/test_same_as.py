"""A declared value and the effect that is the same thing: one tolerance, each in its own unit."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import pytest

from valve_sim.identification.plants.protocol import Nuisance
from valve_sim.identification.plants.tolerances import SAME_AS
from valve_sim.identification.plants.valve import ValvePlant
from valve_sim.model import Tolerances

from ..diagnosis.test_run import DECLARED
from ..recordings import recorded

VALVE = DECLARED.with_values(pickup_velocity_ratio=0.9)
RELATIVE = 1e-4
"""Tolerance over the declared value: so small that it changes nothing but to first order."""


def plant_of(name: str) -> tuple[ValvePlant, Nuisance]:
    """A plant in which one value has a tolerance, and the nuisance."""
    tolerances = Tolerances({name: RELATIVE * VALVE.declared()[name]}, None, {})
    plant = ValvePlant([recorded()], replace(VALVE, tolerances=tolerances))
    (own,) = (nuisance for nuisance in plant.nuisances if nuisance.name == name)
    return plant, own


@pytest.mark.parametrize("name", SAME_AS)
def test_a_tolerance_of_the_effect_moves_the_prediction_as_one_of_the_declared_value_does(name: str) -> None:
    plant, own = plant_of(name)
    assert own.same_as == SAME_AS[name]
    off = plant.parameter(own.same_as).off
    assert off is not None
    # Where the effect takes the place of the value it changes nothing at the declared one.
    neutral = VALVE.declared()[name] if name == "pickup_velocity_ratio" else off
    (there,), (as_declared,) = plant.predict({name: own.mean - own.sigma}), plant.predict({})
    (as_effect,) = plant.predict({own.same_as: neutral - own.same_slope * own.sigma})
    moved = np.linalg.norm(there - as_declared)
    assert moved > 0.0
    assert np.linalg.norm(there - as_effect) < 0.01 * moved
