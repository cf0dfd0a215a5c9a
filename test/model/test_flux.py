"""The coil by its flux linkage: against an independent DOP853, its energy balance, its limits, its release."""

from __future__ import annotations

import math
from dataclasses import replace

import numpy as np
import pytest

from valve_sim.files.parameter_files import load_valve
from valve_sim.files.resources import config_path
from valve_sim.model import (
    Drive,
    EventKind,
    ParameterError,
    Response,
    SimulationError,
    Stepper,
    Valve,
    published_times,
    simulate,
)
from valve_sim.model.drives import peak_and_hold, pulse_width_mean, pulse_width_modulated, step

from .flux_cases import TIMES, differences, random_case, random_release

CLOSED = Valve().with_values(coil_time_constant=2e-3)
"""As printed, with a coil: it never opens."""
LIVELY = Valve().with_values(a0=4.5419, coil_time_constant=1.6e-3, coil_resistance=4.05)
ON = {"motional_emf": {"share": 1.0}}
MOVING = replace(LIVELY, effects=ON)
PULSE = Drive.of([1e-3, 21e-3], [9.0, 0.0])


def with_effects(valve: Valve, **effects: dict[str, float]) -> Valve:
    return replace(valve, effects={**valve.effects, **effects})


def normalised(valve: Valve, response: Response) -> np.ndarray:
    resistance, voltage = valve.after_effects("coil_resistance", "reference_voltage")
    return np.asarray(response.coil_current * resistance / voltage)


@pytest.mark.parametrize(
    "seed", [0, 1, 153, 198, *(pytest.param(seed, marks=pytest.mark.long) for seed in (*range(2, 20), 166))]
)
def test_agrees_with_dop853(seed: int) -> None:
    position, moment, current, same = differences(seed, 1e-12)
    assert same
    assert position < 1e-12
    assert moment < 1e-11
    assert current < 1e-9


@pytest.mark.parametrize(
    "seed", [0, 3, 17, *(pytest.param(s, marks=pytest.mark.long) for s in (*range(4, 12), *range(21, 25)))]
)
def test_a_release_by_a_freewheeling_current_agrees_with_dop853(seed: int) -> None:
    """`python -m benchmarks.accuracy` compares 1,200; in 3 and 17 the plungers leave before the current ends."""
    position, moment, _, same = differences(seed, 1e-12, random_release)
    assert same
    assert position < 1e-11
    assert moment < 1e-11


@pytest.mark.parametrize("release", [0.0, 12.0])
def test_a_reversed_voltage_lets_go_for_an_instant(release: float) -> None:
    """The pull passes through 0 between two looks ahead, and the plungers leave where it no longer holds them."""
    valve = LIVELY.with_values(coil_time_constant=5e-5, release_voltage=release)
    held = valve.parameters.spring_preload + valve.parameters.spring_rate * valve.parameters.stroke
    pull = sum(a * valve.parameters.stroke**i for i, a in enumerate(valve.parameters.attraction_polynomial))
    response = simulate(valve, Drive.of([0.0, 0.03], [9.0, -9.0]), TIMES)
    expected = 0.03 + 5e-5 * math.log(2.0 / (1.0 + math.sqrt(held / pull)))
    assert response.first(EventKind.RELEASED) == pytest.approx(expected, abs=1e-11)


def test_a_share_of_0_without_eddy_currents_is_equation_1() -> None:
    none = simulate(with_effects(LIVELY, motional_emf={"share": 0.0}), PULSE, TIMES)
    plain = simulate(LIVELY, PULSE, TIMES)
    np.testing.assert_allclose(none.pilot_position, plain.pilot_position, rtol=0.0, atol=1e-14)
    np.testing.assert_allclose(none.coil_current, plain.coil_current, rtol=0.0, atol=1e-10)


def test_eddy_currents_beside_the_flux_let_the_current_jump() -> None:
    """At rest: u = 1 − (τ/(τ + τ_e)) e^(−t/(τ + τ_e)), which begins at τ_e/(τ + τ_e)."""
    tau, eddy = 2e-3, 5e-4
    valve = with_effects(CLOSED, motional_emf={"share": 0.0}, eddy_lag={"time_constant": eddy})
    times = np.linspace(1e-9, 20e-3, 300)
    shown = normalised(valve, simulate(valve, step(9.0), times))
    expected = 1.0 - tau / (tau + eddy) * np.exp(-times / (tau + eddy))
    np.testing.assert_allclose(shown, expected, atol=1e-12)
    series = with_effects(CLOSED, eddy_lag={"time_constant": eddy})
    assert normalised(series, simulate(series, step(9.0), times))[0] < 1e-6


@pytest.mark.parametrize(("effects", "release"), [({}, 0.7), (ON, 9.0), ({"motional_emf": {"share": 0.0}}, 40.0)])
def test_a_freewheeling_current_ends(effects: dict[str, dict[str, float]], release: float) -> None:
    """At rest: after τ ln(1 + V_ref/V_r), where it stays."""
    valve = replace(CLOSED.with_values(release_voltage=release), effects=effects)
    off, settled = 0.06, 1.0 - math.exp(-0.06 / 2e-3)
    times = np.linspace(off, off + 20e-3, 400)
    response = simulate(valve, step(9.0, 0.0, off), times)
    over = 9.0 / release
    gone = off + 2e-3 * math.log(1.0 + over * settled)
    assert response.first(EventKind.CURRENT_GONE) == pytest.approx(gone, abs=1e-13)
    expected = np.where(times < gone, (settled + 1.0 / over) * np.exp(-(times - off) / 2e-3) - 1.0 / over, 0.0)
    np.testing.assert_allclose(normalised(valve, response), expected, atol=1e-12)
    assert not response.coil_current[times > gone].any()


def test_eddy_currents_pull_on_when_the_diode_blocks() -> None:
    """At rest: the terminals' current ends at w = V_r τ_e/(V_ref τ), and w falls with τ_e from there."""
    tau, eddy, off = 2e-3, 1e-3, 0.06
    valve = replace(
        CLOSED.with_values(release_voltage=4.5, seat_load=100.0, a0=1.0),
        effects={**ON, "eddy_lag": {"time_constant": eddy}},
    )
    times = np.linspace(off, off + 8e-3, 100)
    response = simulate(valve, step(9.0, 0.0, off), times)
    last = 0.5 * eddy / tau
    gone = off + (tau + eddy) * math.log(1.5 / (last + 0.5))
    assert response.first(EventKind.CURRENT_GONE) == pytest.approx(gone, abs=1e-9)
    after = times > gone
    assert after.sum() > 50
    assert not response.coil_current[after].any()
    np.testing.assert_allclose(
        np.sqrt(response.attraction[after]), last * np.exp((gone - times[after]) / eddy), rtol=1e-8
    )


@pytest.mark.parametrize("seed", [0, 8])
def test_all_signs_mirror(seed: int) -> None:
    valve, drive = random_case(seed)
    one, other = (simulate(valve, Drive(drive.times, sign * drive.volts), TIMES) for sign in (1.0, -1.0))
    np.testing.assert_array_equal(one.pilot_position, other.pilot_position)
    np.testing.assert_array_equal(one.coil_current, -other.coil_current)
    assert one.events == other.events


def test_a_new_valve_takes_over_the_current() -> None:
    stepper = Stepper(LIVELY)
    stepper.command(0.0, 9.0)
    before = stepper.advance(8e-3)
    stepper.set_valve(MOVING, 8e-3)
    assert stepper.advance(8e-3).coil_current == pytest.approx(before.coil_current, rel=1e-12)
    stepper.command(20e-3, 0.0)
    current = stepper.advance(20.5e-3).coil_current
    stepper.set_valve(replace(MOVING.with_values(release_voltage=40.0), effects=ON), 20.5e-3)
    assert stepper.advance(20.5e-3).coil_current == pytest.approx(current, rel=1e-12)
    assert EventKind.CURRENT_GONE in [event.kind for event in stepper.advance(25e-3).events]


# --- refusals -----------------------------------------------------------------------------------------------------


def test_a_coil_without_inductance_is_refused_with_the_reason() -> None:
    instant = replace(LIVELY.with_values(coil_time_constant=0.0), effects=ON)
    with pytest.raises(
        ParameterError, match=r"mine\.yaml: effects\.motional_emf: found a coil time constant of 0 s.*L/R"
    ):
        Valve.from_mapping(instant.to_mapping(), "mine.yaml")
    for run in (lambda: simulate(instant, PULSE, TIMES), lambda: Stepper(instant)):
        with pytest.raises(SimulationError, match="motional_emf"):
            run()


def test_a_flux_that_folds_is_refused_and_the_bound_said() -> None:
    """τ must exceed σ W(stroke)/(2P) (1 + 1/u_s²): just above it runs, just below it does not."""
    knee, rated = 1.5, 9.0**2 / 4.05
    d = LIVELY.declared()
    work = sum(d[f"a{power}"] * d["stroke"] ** (power + 1) / (power + 1) for power in range(4))
    bound = work / (2.0 * rated) * (1.0 + knee**-2)
    folding = with_effects(MOVING, magnetic_saturation={"current": knee})
    below, above = (folding.with_values(coil_time_constant=factor * bound) for factor in (0.999, 1.001))
    with pytest.raises(ParameterError, match=rf"expected above {bound:.6g} s"):
        Valve.from_mapping(below.to_mapping(), "mine.yaml")
    with pytest.raises(SimulationError, match="flux"):
        Stepper(below)
    Valve.from_mapping(above.to_mapping(), "mine.yaml")
    simulate(above, PULSE, TIMES)


def test_the_shipped_valve_that_conserves_energy_meets_the_published_times() -> None:
    valve = load_valve(config_path("energy_consistent.yaml"))
    assert valve.effects == ON
    assert published_times(simulate(valve, step(9.0), [0.02])) == pytest.approx((5.3e-3, 9.9e-3), abs=2e-7)


# --- drives -------------------------------------------------------------------------------------------------------


def test_drives_are_what_their_names_say() -> None:
    assert step(9.0).volts.tolist() == [9.0]
    both = peak_and_hold((24.0, 4.0), 1e-3, (5e-3, 2e-3))
    np.testing.assert_allclose(both.times, [1e-3, 6e-3, 8e-3])
    assert both.volts.tolist() == [24.0, 4.0, 0.0]
    edges = pulse_width_modulated(24.0, 0.25, 1000.0, 0.0, 2.1e-3, -0.7)
    np.testing.assert_allclose(edges.times, [0.0, 0.25e-3, 1e-3, 1.25e-3, 2e-3, 2.1e-3])
    assert edges.volts.tolist() == [24.0, -0.7, 24.0, -0.7, 24.0, 0.0]
    assert pulse_width_mean(24.0, 0.25, 0.0, 1.0, -0.7).volts.tolist() == [24.0 * 0.25 - 0.7 * 0.75, 0.0]
    for wrong in (
        lambda: step(9.0, 1.0, 0.5), lambda: peak_and_hold((9.0, 3.0), 0.0, (-1.0, 1.0)),
        lambda: pulse_width_mean(24.0, 1.2, 0.0, 1.0), lambda: pulse_width_modulated(24.0, 0.5, 0.0, 0.0, 1.0),
    ):  # fmt: skip
        with pytest.raises(ParameterError):
            wrong()
