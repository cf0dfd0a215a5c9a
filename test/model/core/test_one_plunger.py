"""A valve with one plunger against an independent plant."""

from __future__ import annotations

from collections.abc import Mapping

import numpy as np
import pytest
from plants.single_plunger import SINGLE_VALVE, SinglePlungerPlant

from model.core.test_derivatives import ACCURATE, quotient
from model.test_one_plunger import EFFECTS, KINDS, STROKES, TIMES
from valve_sim.model import Valve, simulate
from valve_sim.model.core.runs import Directions, run_sloped


def one_plunger(effects: Mapping[str, Mapping[str, float]], seat_load: float) -> Valve:
    """The valve of the independent plant."""
    declared = {**SINGLE_VALVE, "pilot_gap": 0.0, "seat_load": seat_load}
    declared["attraction_polynomial"] = np.asarray(declared["attraction_polynomial"]).tolist()
    return Valve.from_mapping({"valve": declared, "effects": effects}, "one_plunger.yaml")


@pytest.mark.parametrize("effects", EFFECTS, ids=lambda effects: "+".join(effects) or "plain")
@pytest.mark.parametrize("seat_load", [0.0, 2.9])
def test_events_and_motion_are_those_of_an_independent_plant(
    effects: Mapping[str, Mapping[str, float]], seat_load: float
) -> None:
    ours = simulate(one_plunger(effects, seat_load), STROKES, TIMES, start_time=0.0)
    truth = SinglePlungerPlant({"seat_load": seat_load}, effects).simulate(STROKES.times, STROKES.volts, TIMES)
    assert ours.has_one_plunger
    assert [event.kind for event in ours.events] == [KINDS[event.kind] for event in truth.events]
    for found, true in zip(ours.events, truth.events, strict=True):
        assert found.time == pytest.approx(true.time, abs=1e-9, rel=0.0)


@pytest.mark.parametrize("name", ["moving_mass", "spring_preload", "seat_load", "pressure_force.equalisation_time"])
def test_derivatives_are_those_of_central_differences(name: str) -> None:
    valve = one_plunger({"pressure_force": {"force": 0.8, "equalisation_time": 2e-3}}, 2.9)
    value = float(valve.numbers()[valve.plan().parameters.index(name)])
    directions = Directions.of(valve, STROKES, [name])
    found = run_sloped(valve, STROKES, TIMES + 1e-5, directions, tolerance=1e-10).of_positions[:, 0]
    expected = quotient(valve, STROKES, TIMES + 1e-5, name, value)
    assert expected is not None
    quotients, doubt = expected[0]
    assert (np.abs(found - quotients) < ACCURATE * np.abs(quotients).max() + doubt).all()
