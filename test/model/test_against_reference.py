"""The compiled core against an independent DOP853: positions within 1 nm, events within 1 ns.

In test/: `python -m model.test_against_reference 1000` runs as many sets and prints the figures.
"""

from __future__ import annotations

import sys

import numpy as np
import pytest

from valve_sim.files.parameter_files import default_valve
from valve_sim.model import Drive, Valve, simulate

from .random_valves import TIMES, random_valve
from .reference import reference


def differences(valve: Valve, drive: Drive) -> tuple[float, float, bool]:
    """Largest position difference, m; largest event time difference, s; whether the events are the same ones."""
    ours = simulate(valve, drive, TIMES)
    theirs = reference(valve.declared(), valve.effects, drive, TIMES)
    position = max(np.abs(ours.pilot_position - theirs.pilot).max(), np.abs(ours.main_position - theirs.main).max())
    kinds = [event.kind.name for event in ours.events] == [kind for _, kind in theirs.events]
    pairs = zip(ours.events, theirs.events, strict=False)
    return position, max((abs(event.time - when) for event, (when, _) in pairs), default=0.0), kinds


@pytest.mark.parametrize("seed", [*range(30), 34, 62])  # the last two with residual magnetism
def test_agrees_with_dop853(seed: int) -> None:
    position, moment, same = differences(*random_valve(seed))
    assert same
    assert position < 1e-9
    assert moment < 1e-9


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
    assert position < 1e-9
    assert moment < 1e-9


if __name__ == "__main__":
    figures = [(*differences(*random_valve(seed)), seed) for seed in range(int(sys.argv[1]))]
    bad = [figure for figure in figures if not figure[2] or max(figure[:2]) >= 1e-9]
    good = [figure for figure in figures if figure[2]]
    print(f"{len(figures)} sets, {len(bad)} beyond 1 nm / 1 ns or with other events: {bad[:12]}")
    print(f"largest: {max(f[0] for f in good):.3g} m, {max(f[1] for f in good):.3g} s")
