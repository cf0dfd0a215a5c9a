"""Motion in series: it solves the equations of the page, and is the motion that small steps give."""

from __future__ import annotations

from functools import partial

import numba
import numpy as np
import pytest

from valve_sim.model import Drive, EventKind, Valve, simulate
from valve_sim.model.core_types import MAIN, PILOT
from valve_sim.model.dormand_prince import WORK_RECORD
from valve_sim.model.equations import acceleration_at
from valve_sim.model.simulation import Control, new_states, response_of, run_record
from valve_sim.model.taylor_series import (
    acceleration_after,
    expand,
    has_effects,
    is_series,
    position_after,
    velocity_after,
)

from . import taylor_source
from .random_valves import RANGES, TIMES, random_valve

PLAIN = range(0, 90, 3)
"""Seeds of random valves without effects."""
IN_SERIES = {
    "coulomb_friction", "drive_gain", "coil_lag", "eddy_lag", "stop_bounce", "pickup_impact", "stroke_offset",
    "gap_offset", "rest_attraction", "sensor_delay", "sensor_gain",
}  # fmt: skip
"""Effects that leave (3) and (4) polynomials under a sum of two exponentials, and the sensor unfiltered."""
WITH_A_FORM = {
    "asymmetric_friction", "constant_force", "magnetic_saturation", "pressure_force", "quadratic_drag",
    "spring_hardening",
}  # fmt: skip
"""Effects with forces, or a pull, that the series knows."""


def of_effects(seed: int, *names: str) -> Valve:
    """A random valve with these effects."""
    random = np.random.default_rng(seed)
    effects = {name: {key: random.uniform(*limits) for key, limits in RANGES[name].items()} for name in names}
    return Valve(random_valve(3 * seed)[0].parameters, effects)


def test_the_coefficients_are_those_that_the_rules_write() -> None:
    for module, source in taylor_source.sources().items():
        assert module.read_text(encoding="utf-8") == source


@numba.njit
def moves_in_series(records):
    return is_series(records[0])


@numba.njit
def residual(records, states, works, time):
    """What is left of v' = f at a time after the state, m/s²: v' by the series, f by `equations`."""
    p, s, work = records[0], states[0], works[0]
    work.has_effects = has_effects(p)
    expand(p, s, work)
    x, v = position_after(work, time), velocity_after(work, time)
    return acceleration_after(work, time) - acceleration_at(p, s, s.time + time, x, v)


def in_motion(valve: Valve, seed: int, volts: float):
    """A state in one of the phases, fast enough not to turn soon, its record, and scratch paper."""
    random = np.random.default_rng(seed)
    record = valve.record()
    state = new_states(record, 0.0)
    state["seen"] = state["volts"] = volts
    state["segment_u"] = state["segment_w"] = random.uniform(-0.5, 1.0)
    if "eddy_lag" in valve.effects:
        state["segment_w"] = random.uniform(-0.5, 1.0)
    state["unseated_time"], state["time"] = -random.uniform(0.0, 2e-3), random.uniform(0.0, 5e-3)
    state["moving"], state["direction"], state["mode"] = 1, random.choice([-1, 1]), random.choice([PILOT, MAIN])
    work = np.zeros(1, WORK_RECORD)
    work["y"][0, :2] = random.uniform(0.0, 1.2e-3), state["direction"][0] * random.uniform(0.2, 0.4)
    return record, state, work


@pytest.mark.parametrize("seed", PLAIN)
@pytest.mark.parametrize("effects", [{}, {"eddy_lag": {"time_constant": 3e-4}}, {"coulomb_friction": {"force": 0.3}}])
def test_the_series_solves_the_equations_of_the_page(seed: int, effects: dict) -> None:
    check_what_is_left(Valve(random_valve(seed)[0].parameters, effects), seed, 8e-4)


@pytest.mark.parametrize("seed", range(12))
@pytest.mark.parametrize("names", [*((name,) for name in sorted(WITH_A_FORM)), tuple(sorted(WITH_A_FORM))])
def test_the_series_solves_the_equations_with_forces_of_effects(seed: int, names: tuple[str, ...]) -> None:
    check_what_is_left(of_effects(seed, *names), seed, 4e-4)


def check_what_is_left(valve: Valve, seed: int, longest: float) -> None:
    record, state, work = in_motion(valve, seed, 9.0 if seed % 2 else 0.0)
    assert moves_in_series(record)
    assert abs(residual(record, state, work, 0.0)) < 1e-10
    coarse, fine = (abs(residual(record, state, work, time)) for time in (longest, 0.25 * longest))
    # What is left grows with the 13th power of time, as of a series of order 14, but for rounding of some 10 m/s².
    assert fine < coarse * 4.0**-11 + 1e-10


@pytest.mark.parametrize("name", sorted(set(RANGES) - {"coil_heating"}))
def test_an_effect_that_the_series_lacks_is_left_to_the_other_integrator(name: str) -> None:
    valve = Valve(Valve().parameters, {name: {key: limits[1] for key, limits in RANGES[name].items()}})
    assert moves_in_series(valve.record()) == (name in IN_SERIES | WITH_A_FORM)


@pytest.mark.parametrize("seed", range(20))
def test_motion_in_series_is_that_of_small_steps(seed: int) -> None:
    check_motion(random_valve(3 * seed)[0], seed)


@pytest.mark.parametrize("seed", range(6))
@pytest.mark.parametrize("names", [*((name,) for name in sorted(WITH_A_FORM)), tuple(sorted(WITH_A_FORM))])
def test_motion_in_series_with_forces_of_effects_is_that_of_small_steps(seed: int, names: tuple[str, ...]) -> None:
    check_motion(of_effects(seed, *names), seed)


def check_motion(valve: Valve, seed: int) -> None:
    drive = random_valve(3 * seed)[1]
    assert moves_in_series(valve.record())
    found = simulate(valve, drive, TIMES)
    by_the_pair = partial(run_record, drive=drive, control=Control(1e-13, in_series=False))
    known = response_of(valve.record(), TIMES, float(TIMES[0]), by_the_pair)
    assert [event.kind for event in found.events] == [event.kind for event in known.events]
    assert [event.time for event in found.events] == pytest.approx([event.time for event in known.events], abs=2e-11)
    np.testing.assert_allclose(found.pilot_position, known.pilot_position, atol=1e-11)


def test_a_fast_eddy_pole_delays_the_pick_up_by_its_time_constant() -> None:
    valve = Valve().with_values(a0=3.0336, coil_time_constant=0.9934e-3)
    fast = Valve(valve.parameters, {"eddy_lag": {"time_constant": 1e-7}})
    found, without = (simulate(one, Drive.of([0.0], [9.0]), TIMES) for one in (fast, valve))
    late = found.first(EventKind.PICKED_UP) - without.first(EventKind.PICKED_UP)
    assert late == pytest.approx(1e-7, rel=0.2)
