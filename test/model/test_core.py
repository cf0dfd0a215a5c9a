"""Published times, energy, cuts, analytic cases, sensors, messages: the core against what is known without it."""

from __future__ import annotations

import itertools
import math

import numpy as np
import pytest

from valve_sim.model import (
    CATALOGUE,
    Drive,
    Effect,
    EventKind,
    Parameter,
    Phase,
    Valve,
    simulate,
)  # fmt: skip

from .random_valves import RANGES, TIMES, random_valve
from .reference import reference

STEP = Drive.of([0.0], [9.0])
CALIBRATED = Valve().with_values(a0=3.0336, coil_time_constant=0.9934e-3)
LATE = np.linspace(0.0, 0.03, 301)


def ballistic(**values: float) -> Valve:
    """A valve without any attraction but a constant a0 = 1 N, spring or damping."""
    still = dict.fromkeys(("a1", "a2", "a3", "pilot_damping", "main_damping", "spring_rate", "spring_preload"), 0.0)
    return Valve().with_values(**{**still, "a0": 1.0, **values})


@pytest.mark.parametrize(
    ("valve", "first", "second"),
    [
        (CALIBRATED, 5.300e-3, 9.900e-3),
        (Valve().with_values(a0=1.5), 5.3205e-3, 10.9214e-3),
        (Valve().with_values(a0=1.5, main_damping=0.0), 5.3205e-3, 10.6537e-3),
    ],
)
def test_published_times(valve: Valve, first: float, second: float) -> None:
    response = simulate(valve, STEP, LATE)
    assert response.first(EventKind.PICKED_UP) == pytest.approx(first, abs=1e-6)
    assert response.first(EventKind.REACHED_STOP) == pytest.approx(second, abs=1e-6)


def test_the_valve_as_printed_stays_closed_for_a_second() -> None:
    response = simulate(Valve(), STEP, [0.5, 1.0])
    assert response.events == ()
    assert np.all(response.phase == Phase.CLOSED)


def test_friction_sticks_exactly_up_to_its_force() -> None:
    for force, moves in ((1.0, False), (1.0 + 1e-12, False), (1.0 - 1e-12, True)):
        valve = Valve(ballistic().parameters, {"coulomb_friction": {"force": force}})
        assert bool(simulate(valve, STEP, [1.0]).events) is moves
    held = simulate(Valve(ballistic().parameters, {"coulomb_friction": {"force": 0.4}}),
                    Drive.of([0.0, 5e-3], [9.0, 0.0]), np.linspace(0, 0.5, 100))  # fmt: skip
    assert held.events[-1].kind is EventKind.STUCK
    assert 0 < held.pilot_position[-1] == held.pilot_position[-2]


def test_a_heavy_main_plunger_is_held_at_the_gap() -> None:
    valve = ballistic(spring_preload=2.0, pilot_damping=3000.0)
    response = simulate(valve, Drive.of([0.0, 1.5], [9.0, 0.0]), np.linspace(0, 1.5, 50))
    assert response.events[-1].kind is EventKind.HELD_AT_GAP
    assert response.pilot_position[-1] == valve.parameters.pilot_gap


def differs(valve: Valve, drive: Drive, times: np.ndarray) -> str:
    """How a run differs from that of an independent DOP853, if it does."""
    ours, theirs = simulate(valve, drive, times), reference(valve.declared(), valve.effects, drive, times)
    if [event.kind.name for event in ours.events] != [kind for _, kind in theirs.events]:
        return f"{valve.effects}: other events"
    late = max(
        (abs(event.time - time) for event, (time, _) in zip(ours.events, theirs.events, strict=True)), default=0.0
    )
    away = max(np.abs(ours.pilot_position - theirs.pilot).max(), np.abs(ours.main_position - theirs.main).max())
    return (
        ""
        if late < 1e-11 and away < 1e-11
        else f"{valve.effects}: events off by {late:.1e} s, positions by {away:.1e} m"
    )


@pytest.mark.parametrize("name", RANGES)
def test_an_effect_is_what_dop853_says(name: str) -> None:
    effects = {name: {key: 0.9 * low + 0.1 * high for key, (low, high) in RANGES[name].items()}}
    assert not differs(Valve(CALIBRATED.parameters, effects), Drive.of([1e-3, 16e-3], [9.0, 0.0]), TIMES)


@pytest.mark.parametrize(
    "names", [*itertools.combinations(("coil_heating", "eddy_lag", "magnetic_saturation", "residual_magnetism"), 2)]
)
def test_two_effects_of_the_coil_are_what_dop853_says(names: tuple[str, str]) -> None:
    effects = {name: {key: 0.5 * (low + high) for key, (low, high) in RANGES[name].items()} for name in names}
    drive = Drive.of([1e-3, 16e-3, 20e-3], [9.0, 0.0, 12.0])
    assert not differs(Valve(CALIBRATED.parameters, effects), drive, 2.0 * TIMES)


@pytest.mark.parametrize("seed", [34, 62, 44, 902, *(pytest.param(seed, marks=pytest.mark.long) for seed in range(30))])
def test_a_random_valve_moves_as_dop853_says(seed: int) -> None:
    """`python -m benchmarks.accuracy` compares 1,000. Of these two have residual magnetism, and two bounce."""
    assert not differs(*random_valve(seed), TIMES)


def test_rests_in_mid_gap_and_at_the_gap_are_those_of_dop853() -> None:
    """Friction holds the pilot on its way; half the voltage does not lift a main plunger, and lets it go again."""
    rubbing = Valve(CALIBRATED.with_values(seat_load=0.1).parameters, {"coulomb_friction": {"force": 0.8}})
    assert not differs(rubbing, Drive.of([0.0, 0.0025, 0.03], [9.0, 0.0, 9.0]), 1e-3 + 2.0 * TIMES)
    held = CALIBRATED.with_values(seat_load=0.3, pickup_velocity_ratio=0.5)
    for last in (9.0, 0.0):
        assert not differs(held, Drive.of([0.0, 0.03], [4.5, last]), 2.0 * TIMES)


def test_a_registered_effect_acts_as_the_built_in_one() -> None:
    def pull_up(x: float, v: float, u: float, t: float, newtons: float) -> float:
        return newtons

    CATALOGUE.register(Effect("pull_up", "mine", (Parameter("newtons", "N", "up"),), "test", term=pull_up))
    try:
        mine = Valve(CALIBRATED.parameters, {"pull_up": {"newtons": 0.2}})
        simulated = simulate(mine, STEP, LATE)
    finally:
        CATALOGUE.unregister("pull_up")
    theirs = Valve(CALIBRATED.parameters, {"constant_force": {"force": 0.2}})
    np.testing.assert_allclose(simulated.pilot_position, simulate(theirs, STEP, LATE).pilot_position, atol=1e-11)


@pytest.mark.parametrize("time_constant", [1e-300, 1.9e-8, 2e-8])
def test_a_coil_too_fast_to_integrate_heats_too(time_constant: float) -> None:
    effects = {"coil_heating": {"temperature_rate": 100.0, "cooling_time_constant": 5.0}}
    fast, instant = (
        Valve(CALIBRATED.with_values(coil_time_constant=tau).parameters, effects) for tau in (time_constant, 0.0)
    )
    opened = [simulate(valve, STEP, LATE).first(EventKind.REACHED_STOP) for valve in (fast, instant)]
    assert opened[0] == pytest.approx(opened[1], abs=2.0 * time_constant + 1e-9)


@pytest.mark.parametrize(
    ("time_constant", "spacing"),
    [(0.0, "even"), (1e-7, "rounded stamps"), (0.9934e-3, "jittered"), (5e-2, "twice at one time")],
)
def test_currents_follow_the_exponential_however_samples_are_spaced(time_constant: float, spacing: str) -> None:
    """Each current follows from the one before while intervals are alike, through commands and long rests too."""
    times = np.arange(3000) / 18_000.0
    if spacing == "rounded stamps":
        times = np.round(times, 9)
    elif spacing == "jittered":
        times = np.sort(times + np.random.default_rng(1).uniform(-4e-5, 4e-5, len(times)))
    elif spacing == "twice at one time":
        times = np.repeat(times[::2], 2)
    commands, volts = [2e-3, 40e-3, 60.0001e-3], [9.0, -4.5, 0.0]
    valve = CALIBRATED.with_values(coil_time_constant=time_constant)
    shown = simulate(valve, Drive.of(commands, volts), times, start_time=-1e-3).coil_current / 0.9
    expected, start = np.zeros(len(times)), 0.0
    for begin, end, target in zip(commands, [*commands[1:], np.inf], np.array(volts) / 9.0, strict=True):
        powered = times >= begin
        left = np.exp(-(times[powered] - begin) / time_constant) if time_constant else np.zeros(powered.sum())
        expected[powered] = target + (start - target) * left
        start = target + (start - target) * (math.exp(-(end - begin) / time_constant) if time_constant else 0.0)
    at_command = np.isclose(times[:, None], commands, rtol=0.0, atol=1e-12).any(axis=1)
    assert np.abs(shown - expected)[~at_command].max() < 1e-12
