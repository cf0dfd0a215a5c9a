"""The compiled core against an independent DOP853: positions within 0.1 nm, events within 10 ps.

`python -m benchmarks.accuracy` compares the events of a thousand valves.
"""

from __future__ import annotations

import numpy as np
import pytest

from valve_sim.files.parameter_files import default_valve
from valve_sim.model import Drive, Valve, simulate

from .random_valves import TIMES, random_valve
from .reference import reference

POSITION, EVENT = 1e-10, 1e-11
"""m and s, that a position and an event may be off."""


def differences(valve: Valve, drive: Drive) -> tuple[float, float, bool]:
    """Largest position difference, m; largest event time difference, s; whether the events are the same ones."""
    ours = simulate(valve, drive, TIMES)
    theirs = reference(valve.declared(), valve.effects, drive, TIMES)
    position = max(np.abs(ours.pilot_position - theirs.pilot).max(), np.abs(ours.main_position - theirs.main).max())
    kinds = [event.kind.name for event in ours.events] == [kind for _, kind in theirs.events]
    pairs = zip(ours.events, theirs.events, strict=False)
    return position, max((abs(event.time - when) for event, (when, _) in pairs), default=0.0), kinds


@pytest.mark.parametrize("seed", [*range(20), 34, 62, 44, 902])  # two with residual magnetism, two that bounce
def test_agrees_with_dop853(seed: int) -> None:
    position, moment, same = differences(*random_valve(seed))
    assert same
    assert position < POSITION
    assert moment < EVENT


@pytest.mark.parametrize("equalisation_time", [1e-3, 3e-3])
def test_a_force_of_time_agrees_where_the_coil_heats(equalisation_time: float) -> None:
    """A heating coil is integrated with the motion, in stages whose times only a force of time shows."""
    effects = {
        "coil_heating": {"temperature_rate": 300.0, "cooling_time_constant": 1.0},
        "pressure_force": {"force": 3.0, "equalisation_time": equalisation_time},
    }
    valve = Valve(default_valve().parameters, effects)
    position, moment, same = differences(valve, Drive.of([0.0, 0.02], [12.0, 0.0]))
    assert same
    assert position < POSITION
    assert moment < EVENT
