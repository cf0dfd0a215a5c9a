"""The laboratories: each imperfection is as large as it says, and touches nothing else."""

from collections.abc import Mapping
from dataclasses import fields, replace
from functools import cache
from typing import Any

import numpy as np
import pytest

from .common import FloatArray
from .declared import DeclaredPlant
from .laboratory import (
    DROPOUT_CODE,
    IMPACT,
    IMPERFECTIONS,
    LABORATORIES,
    Laboratory,
    measure,
)
from .recording import Profile, Recorder, Recording, holdout_profile, record, single_opening, train_profile
from .tolerances import SHEET_VALVE

pytestmark = pytest.mark.long

SEED = 7
SILENT = Laboratory(position_noise=0.0)
OF_THE_VALVE = ("supply", "stroke_variation")
"""What changes the voltage or the valve itself, and with it the truth."""


@cache
def of_eight_strokes(laboratory: Laboratory, seed: int) -> Recording:
    return measure(SHEET_VALVE, {}, train_profile(), laboratory, seed)


def recorded(laboratory: Laboratory, profile: Profile | None = None, seed: int = SEED) -> Recording:
    """Eight strokes, which are made once, or what a profile asks for."""
    if profile is None:
        return of_eight_strokes(laboratory, seed)
    return measure(SHEET_VALVE, {}, profile, laboratory, seed)


def error(laboratory: Laboratory, profile: Profile | None = None, seed: int = SEED) -> FloatArray:
    """What a laboratory adds to the pilot's true position, m."""
    made = recorded(laboratory, profile, seed)
    return made.pilot_position - made.truth.pilot_position


def changed(laboratory: Laboratory, values: Mapping[str, Any]) -> Laboratory:
    return replace(laboratory, **values)


def resting(seconds: float) -> Profile:
    """A closed valve: nothing but the sensor's own errors."""
    return Profile(np.array([0.0]), np.array([0.0]), seconds)


def both_errors(
    laboratory: Laboratory, profile: Profile | None = None, seed: int = SEED
) -> tuple[FloatArray, FloatArray]:
    """What a laboratory adds to the true position of the pilot and of the main plunger, m."""
    made = recorded(laboratory, profile, seed)
    return made.pilot_position - made.truth.pilot_position, made.main_position - made.truth.main_position


def correlation(first: FloatArray, second: FloatArray) -> float:
    return float(np.asarray(np.corrcoef(first, second))[0, 1])


# --- nothing on ------------------------------------------------------------------------------------------------------


def test_a_laboratory_with_nothing_on_is_a_recorder_with_white_noise() -> None:
    made = recorded(Laboratory(with_current=True))
    plain = record(DeclaredPlant(parameters=SHEET_VALVE), train_profile(), Recorder(with_current=True), SEED)
    np.testing.assert_array_equal(made.truth.pilot_position, plain.truth.pilot_position)
    np.testing.assert_array_equal(made.truth.coil_current, plain.truth.coil_current)
    np.testing.assert_array_equal(made.command_times, plain.command_times)
    np.testing.assert_array_equal(made.times, plain.times)
    assert made.truth.events == plain.truth.events
    noises = both_errors(Laboratory())
    for noise in noises:
        assert noise.std() == pytest.approx(1e-6, rel=0.03)
        assert abs(correlation(noise[1:], noise[:-1])) < 0.04
    assert abs(correlation(noises[0], noises[1])) < 0.04
    assert made.coil_current is not None
    assert (made.coil_current - made.truth.coil_current).std() == pytest.approx(1e-3, rel=0.03)
    np.testing.assert_array_equal(error(SILENT), 0.0)
    assert recorded(Laboratory()).coil_current is None


@pytest.mark.parametrize("name", LABORATORIES)
def test_a_seed_determines_a_recording(name: str) -> None:
    laboratory = LABORATORIES[name]
    made, again, other = (recorded(laboratory, train_profile(), seed) for seed in (SEED, SEED, SEED + 1))
    for one in ("pilot_position", "main_position", "command_times"):
        np.testing.assert_array_equal(getattr(made, one), getattr(again, one))
    assert np.abs(made.pilot_position - other.pilot_position).max() > 0.5e-6


@pytest.mark.parametrize("name", [name for name in IMPERFECTIONS if name not in OF_THE_VALVE])
def test_an_error_of_measuring_leaves_the_truth_alone(name: str) -> None:
    made, plain = recorded(IMPERFECTIONS[name][2]), recorded(Laboratory())
    np.testing.assert_array_equal(made.truth.pilot_position, plain.truth.pilot_position)
    np.testing.assert_array_equal(made.true_command_times, plain.true_command_times)
    changes = (made.pilot_position - plain.pilot_position, made.main_position - plain.main_position)
    differs = np.abs(changes).max() > 0.1e-6
    assert differs == (name not in ("clock_rate", "command_stamps"))
    assert np.array_equal(made.command_times, plain.command_times) == differs


def test_switching_one_error_on_leaves_the_draws_of_all_others_alone() -> None:
    everything = replace(
        LABORATORIES["old laser"], hum=1e-6, ringing=2e-6, ringing_scatter=0.4, command_jitter=1e-4, held=0.0,
        outliers=0.0, dropouts=0.0, scale=0.0, bend=0.0,
    )  # fmt: skip
    whole = recorded(everything)
    for off in ("hum", "ringing", "flicker", "drift", "position_noise"):
        less = recorded(changed(everything, {off: 0.0}))
        shape = {one.name: getattr(everything, one.name) for one in fields(Laboratory) if one.name.startswith(off)}
        alone = error(changed(SILENT, shape))
        np.testing.assert_allclose(whole.pilot_position - less.pilot_position, alone, rtol=0.0, atol=1e-15)
        np.testing.assert_array_equal(whole.command_times, less.command_times)


# --- noise -----------------------------------------------------------------------------------------------------------


# --- the zero --------------------------------------------------------------------------------------------------------


# --- the mount -------------------------------------------------------------------------------------------------------


def test_the_mount_rings_after_each_contact_by_the_momentum_that_was_lost() -> None:
    laboratory = replace(SILENT, ringing=3e-6, ringing_frequency=800.0, ringing_damping=0.1, sample_rate=200e3)
    made = recorded(laboratory, single_opening())
    ring = made.pilot_position - made.truth.pilot_position
    [stop] = [event for event in made.truth.events if event.kind == "opened"]
    np.testing.assert_array_equal(ring[made.times < stop.time], 0.0)
    since = made.times - stop.time
    free = 2.0 * np.pi * 800.0
    wanted = np.exp(-0.1 * free * since) * np.sin(np.sqrt(0.99) * free * since)
    # The body is kicked upwards, and the sensor with it, which comes nearer.
    wanted *= -3e-6 * stop.velocity / IMPACT
    after = since > 0.0
    np.testing.assert_allclose(ring[after], wanted[after], atol=1e-12)
    np.testing.assert_allclose(made.main_position - made.truth.main_position, ring, atol=1e-15)


# --- linearity -------------------------------------------------------------------------------------------------------


# --- electronics -----------------------------------------------------------------------------------------------------


def test_spikes_and_dropouts_are_as_many_as_asked_and_stand_alone() -> None:
    laboratory = replace(SILENT, outliers=20.0, outlier_size=50e-6, dropouts=4.0)
    readings = np.concatenate([one for seed in range(4) for one in both_errors(laboratory, resting(2.5), seed)])
    lost = readings == DROPOUT_CODE
    spikes = readings[(readings != 0.0) & ~lost]
    assert lost.sum() == pytest.approx(4.0 * 20.0, abs=3.0 * np.sqrt(80.0))
    assert spikes.size == pytest.approx(20.0 * 20.0, abs=3.0 * np.sqrt(400.0))
    assert 25e-6 <= np.abs(spikes).min() < np.abs(spikes).max() <= 75e-6
    assert 0.4 < np.mean(spikes > 0.0) < 0.6


def test_a_moving_average_is_late_and_calms_the_noise() -> None:
    made, plain = recorded(Laboratory(averaging=4)), recorded(Laboratory())
    wanted = np.convolve(plain.pilot_position, np.full(4, 0.25))[3 : plain.times.size]
    np.testing.assert_allclose(made.pilot_position[3:], wanted, atol=1e-15)
    assert made.pilot_position[0] == pytest.approx(plain.pilot_position[0])
    assert error(Laboratory(averaging=4), resting(0.5)).std() == pytest.approx(0.5e-6, rel=0.05)


# --- clocks ----------------------------------------------------------------------------------------------------------


# --- the source and the strokes --------------------------------------------------------------------------------------


def test_the_drop_is_by_the_current_of_a_warm_coil_at_the_driver_s_gain() -> None:
    effects = {
        "drive_gain": {"gain": 1.05},
        "coil_heating": {"temperature_rate": 400.0, "cooling_time_constant": 0.5},
        "coil_lag": {"time_constant": 0.2e-3},
    }
    held = Profile(np.array([0.0]), np.array([9.0]), 2.0)
    made = measure(SHEET_VALVE, effects, held, replace(SILENT, supply_resistance=0.5), SEED)
    # At rest in the end: u = gain/(r + R_s/R), r = 1 + α ΔT, ΔT = rate · time constant · u².
    u = made.truth.coil_current[-1] / 0.9
    settled = 1.0 - np.exp(-2.0 / 0.5)
    load = 1.0 + 0.00393 * 400.0 * 0.5 * u**2 * settled + 0.05
    assert u == pytest.approx(1.05 / load, rel=5e-3)


def test_strokes_join_at_rest() -> None:
    made = recorded(replace(SILENT, stroke_variation=0.15), holdout_profile())
    starts = holdout_profile().times[[2, 5, 7, 9, 11]]
    for start in starts:
        around = np.abs(made.times - start) < 0.2e-3
        np.testing.assert_allclose(made.truth.pilot_position[around], 0.0, atol=1e-9)
    assert np.all(np.diff([event.time for event in made.truth.events]) >= 0.0)
    assert np.abs(np.diff(made.truth.pilot_position)).max() < 50e-6


# --- whole laboratories ----------------------------------------------------------------------------------------------
