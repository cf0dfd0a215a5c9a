"""Motion in series: it solves the equations of the page, and is the motion that small steps give."""

from __future__ import annotations

from pathlib import Path

import numba
import numpy as np
import pytest

from valve_sim.model import Drive, EventKind, Valve, simulate, taylor_coefficients
from valve_sim.model.core_types import MAIN, PILOT
from valve_sim.model.dormand_prince import WORK_RECORD
from valve_sim.model.equations import acceleration_at
from valve_sim.model.simulation import new_states
from valve_sim.model.taylor_series import acceleration_after, expand, is_series, position_after, velocity_after

from . import taylor_source
from .random_valves import RANGES, TIMES, random_valve

PLAIN = [seed for seed in range(0, 90, 3)]
"""Seeds of random valves without effects."""
IN_SERIES = {
    "coulomb_friction", "drive_gain", "coil_lag", "eddy_lag", "stop_bounce", "pickup_impact", "stroke_offset",
    "gap_offset", "rest_attraction", "sensor_delay", "sensor_gain",
}  # fmt: skip
"""Effects that leave (3) and (4) polynomials under a sum of two exponentials, and the sensor unfiltered."""


def test_the_coefficients_are_those_that_the_rules_write() -> None:
    assert Path(taylor_coefficients.__file__).read_text(encoding="utf-8") == taylor_source.source()


@numba.njit
def moves_in_series(records):
    return is_series(records[0])


@numba.njit
def residual(records, states, works, time):
    """What is left of v' = f at a time after the state, m/s²: v' by the series, f by `equations`."""
    p, s, work = records[0], states[0], works[0]
    expand(p, s, work)
    x, v = position_after(work, time), velocity_after(work, time)
    return acceleration_after(work, time) - acceleration_at(p, s, s.time + time, x, v)


def in_motion(valve: Valve, seed: int, volts: float):
    """A state in one of the phases, its record, and scratch paper."""
    random = np.random.default_rng(seed)
    record = valve.record()
    state = new_states(record, 0.0)
    state["seen"] = state["volts"] = volts
    state["segment_u"] = state["segment_w"] = random.uniform(-0.5, 1.0)
    if "eddy_lag" in valve.effects:
        state["segment_w"] = random.uniform(-0.5, 1.0)
    state["time"] = random.uniform(0.0, 5e-3)
    state["moving"], state["direction"], state["mode"] = 1, random.choice([-1, 1]), random.choice([PILOT, MAIN])
    work = np.zeros(1, WORK_RECORD)
    work["y"][0, :2] = random.uniform(0.0, 1.2e-3), random.uniform(-0.4, 0.4)
    return record, state, work


@pytest.mark.parametrize("seed", PLAIN)
@pytest.mark.parametrize("effects", [{}, {"eddy_lag": {"time_constant": 3e-4}}, {"coulomb_friction": {"force": 0.3}}])
def test_the_series_solves_the_equations_of_the_page(seed: int, effects: dict) -> None:
    valve = Valve(random_valve(seed)[0].parameters, effects)
    record, state, work = in_motion(valve, seed, 9.0 if seed % 2 else 0.0)
    assert moves_in_series(record)
    assert abs(residual(record, state, work, 0.0)) < 1e-10
    coarse, fine = (abs(residual(record, state, work, time)) for time in (8e-4, 2e-4))
    # What is left grows with the 13th power of time, as of a series of order 14, but for rounding of some 10 m/s².
    assert fine < coarse * 4.0**-11 + 1e-10


@pytest.mark.parametrize("name", sorted(set(RANGES) - {"coil_heating"}))
def test_an_effect_that_the_series_lacks_is_left_to_the_other_integrator(name: str) -> None:
    valve = Valve(Valve().parameters, {name: {key: limits[1] for key, limits in RANGES[name].items()}})
    assert moves_in_series(valve.record()) == (name in IN_SERIES)


@pytest.mark.parametrize("seed", [seed for seed in range(0, 60, 3)])
def test_motion_in_series_is_that_of_small_steps(seed: int) -> None:
    valve, drive = random_valve(seed)
    found = simulate(valve, drive, TIMES)
    # A drag that no number can show leaves the same valve to the Dormand–Prince pair.
    slow = Valve(valve.parameters, {"quadratic_drag": {"coefficient": 1e-12}})
    assert moves_in_series(valve.record()) and not moves_in_series(slow.record())
    known = simulate(slow, drive, TIMES, tolerance=1e-13)
    assert [event.kind for event in found.events] == [event.kind for event in known.events]
    assert [event.time for event in found.events] == pytest.approx([event.time for event in known.events], abs=2e-11)
    np.testing.assert_allclose(found.pilot_position, known.pilot_position, atol=1e-11)


def test_a_fast_eddy_pole_delays_the_pick_up_by_its_time_constant() -> None:
    valve = Valve().with_values(a0=3.0336, coil_time_constant=0.9934e-3)
    fast = Valve(valve.parameters, {"eddy_lag": {"time_constant": 1e-7}})
    found, without = (simulate(one, Drive.of([0.0], [9.0]), TIMES) for one in (fast, valve))
    late = found.first(EventKind.PICKED_UP) - without.first(EventKind.PICKED_UP)
    assert late == pytest.approx(1e-7, rel=0.2)
