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
    STROKE_PERIOD,
    Laboratory,
    measure,
    true_sizes,
)
from .recording import Profile, Recorder, Recording, holdout_profile, record, single_opening, train_profile
from .tolerances import SHEET_VALVE

SEED = 7
SILENT = Laboratory(position_noise=0.0)
STROKE = 1.23e-3
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


def times_of(run: Recording, kind: str) -> FloatArray:
    return np.array([event.time for event in run.truth.events if event.kind == kind])


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


@pytest.mark.parametrize("colour", [0.5, 0.9])
def test_coloured_noise_keeps_its_standard_deviation(colour: float) -> None:
    noise = error(replace(SILENT, position_noise=1e-6, colour=colour), resting(5.0))
    assert noise.std() == pytest.approx(1e-6, rel=0.05)
    assert correlation(noise[1:], noise[:-1]) == pytest.approx(colour, abs=0.01)
    assert correlation(noise[3:], noise[:-3]) == pytest.approx(colour**3, abs=0.03)


@pytest.mark.long
def test_flicker_has_as_much_power_in_every_octave() -> None:
    pieces = [error(replace(SILENT, flicker=1e-6), resting(0.5), seed) for seed in range(40)]
    power = np.mean([np.square(np.abs(np.fft.rfft(piece - piece.mean()))) for piece in pieces], axis=0)
    octaves = [power[16 * 2**octave : 32 * 2**octave].sum() for octave in range(8)]
    np.testing.assert_allclose(octaves, np.mean(octaves), rtol=0.25)
    assert np.sqrt(np.mean(np.square(pieces))) == pytest.approx(1e-6, rel=0.05)


def test_readings_come_in_steps() -> None:
    made = recorded(IMPERFECTIONS["quantisation"][1])
    steps = made.pilot_position / 3e-6
    np.testing.assert_allclose(steps, np.round(steps), atol=1e-9)
    step = error(replace(SILENT, quantisation=3e-6))
    assert np.abs(step).max() <= 1.5e-6 + 1e-12


# --- the zero --------------------------------------------------------------------------------------------------------


@pytest.mark.long
def test_the_zero_drifts_by_as_much_from_stroke_to_stroke_and_along_a_ramp_within_one() -> None:
    rate = 2000.0
    apart = round(STROKE_PERIOD * rate)
    laboratory = replace(SILENT, drift=4e-6, sample_rate=rate)
    drifts = np.array([one for seed in range(60) for one in both_errors(laboratory, resting(0.5), seed)])
    np.testing.assert_array_equal(drifts[:, 0], 0.0)
    changes = drifts[:, [apart, 500, 900]] - drifts[:, [0, 500 - apart, 900 - apart]]
    np.testing.assert_allclose(np.sqrt(np.mean(np.square(changes), axis=0)), 4e-6, rtol=0.15)
    # A random walk would move by a tenth of that in 0.6 ms; a ramp moves by a hundredth.
    assert np.diff(drifts).std() * np.sqrt(2.0) < 0.1e-6


@pytest.mark.parametrize("frequency", [50.0, 60.0])
def test_hum_is_of_the_mains_and_odd_harmonics(frequency: float) -> None:
    laboratory = replace(SILENT, hum=1e-6, hum_frequency=frequency)
    hum = error(laboratory, resting(0.5))
    times = np.arange(hum.size) / laboratory.sample_rate
    amplitudes = [2.0 * abs(np.mean(hum * np.exp(-2j * np.pi * order * frequency * times))) for order in range(1, 7)]
    np.testing.assert_allclose(amplitudes, [1e-6, 0.0, 0.4e-6, 0.0, 0.2e-6, 0.0], atol=1e-12)
    assert true_sizes(laboratory)["hum"] == pytest.approx(np.sqrt(2.0) * hum.std())


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


def test_the_seats_are_kicked_downwards_and_by_lighter_bodies() -> None:
    laboratory = replace(SILENT, ringing=3e-6, ringing_damping=0.3, sample_rate=200e3)
    made = recorded(laboratory)
    ring = made.pilot_position - made.truth.pilot_position
    slopes = {}
    for kind in ("opened", "main_seated", "seated"):
        event = next(event for event in made.truth.events if event.kind == kind)
        before = np.searchsorted(made.times, event.time)
        # What the contact before has left is nearly even over a sample.
        kick = np.diff(ring[before : before + 2]) - np.diff(ring[before - 2 : before])
        slopes[kind] = kick[0] / event.velocity
    masses = {"opened": 0.134, "main_seated": 0.025, "seated": 0.109}
    for kind, mass in masses.items():
        assert slopes[kind] / slopes["opened"] == pytest.approx(mass / 0.134, rel=0.1)


def test_a_rebound_kicks_by_what_goes_back_too() -> None:
    laboratory = replace(SILENT, ringing=3e-6, sample_rate=200e3)
    bounce = {"stop_bounce": {"restitution_stop": 0.4, "restitution_seat": 0.0}}
    first = []
    for effects in ({}, bounce):
        made = measure(SHEET_VALVE, effects, single_opening(), laboratory, SEED)
        ring = made.pilot_position - made.truth.pilot_position
        contact = next(event for event in made.truth.events if event.kind in ("opened", "stop_rebound"))
        first.append(ring[np.searchsorted(made.times, contact.time + 50e-6)])
    assert first[1] / first[0] == pytest.approx(1.4, rel=0.01)


@pytest.mark.long
def test_impulses_scatter_as_asked() -> None:
    laboratory = replace(SILENT, ringing=3e-6, ringing_damping=0.3, sample_rate=40e3)
    factors: list[float] = []
    for seed in range(12):
        even = error(laboratory, seed=seed)
        made = recorded(replace(laboratory, ringing_scatter=0.4), seed=seed)
        uneven = made.pilot_position - made.truth.pilot_position
        for time in times_of(made, "opened"):
            first = np.searchsorted(made.times, time)
            part = slice(first, first + 40)
            factors.append(float(uneven[part] @ even[part] / (even[part] @ even[part])))
    assert np.mean(factors) == pytest.approx(1.0, abs=0.1)
    assert np.std(factors) == pytest.approx(0.4, abs=0.1)


# --- linearity -------------------------------------------------------------------------------------------------------


def test_the_scale_is_a_share_of_the_position() -> None:
    made = recorded(replace(SILENT, scale=-2e-3))
    np.testing.assert_allclose(made.pilot_position, 0.998 * made.truth.pilot_position, rtol=1e-12)


@pytest.mark.parametrize(("shape", "crossings"), [("bow", 0), ("s", 1)])
def test_a_bend_has_its_peak_within_and_leaves_the_ends_in_place(shape: str, crossings: int) -> None:
    laboratory = changed(SILENT, {"bend": 3e-6, "bend_shape": shape, "sample_rate": 100e3})
    for joint, end in (("pilot_position", STROKE), ("main_position", STROKE - 0.26e-3)):
        made = recorded(laboratory, single_opening())
        true = getattr(made.truth, joint)
        bent = getattr(made, joint) - true
        assert np.abs(bent).max() == pytest.approx(3e-6, rel=0.01)
        np.testing.assert_allclose(bent[(true == 0.0) | (true == end)], 0.0, atol=1e-12)
        moving = bent[(true > 0.05 * end) & (true < 0.95 * end)]
        assert np.count_nonzero(np.diff(np.sign(moving)) != 0) == crossings


def test_an_interpolation_error_repeats_with_its_period() -> None:
    made = recorded(replace(SILENT, cyclic=0.5e-6, cyclic_period=20e-6), single_opening())
    x, cyclic = made.truth.pilot_position, made.pilot_position - made.truth.pilot_position
    waves = np.column_stack([np.sin(2.0 * np.pi * x / 20e-6), np.cos(2.0 * np.pi * x / 20e-6), np.ones(x.size)])
    found, *_ = np.linalg.lstsq(waves, cyclic, rcond=None)
    np.testing.assert_allclose(waves @ found, cyclic, atol=1e-12)
    assert np.hypot(*found[:2]) == pytest.approx(0.5e-6)
    assert cyclic[0] == 0.0


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


def test_held_values_repeat_the_one_before() -> None:
    made = recorded(Laboratory(held=0.01))
    plain = recorded(Laboratory())
    held = np.flatnonzero(np.diff(made.pilot_position) == 0.0) + 1
    assert held.size == pytest.approx(100, abs=30)
    others = np.setdiff1d(np.arange(made.times.size), held)
    np.testing.assert_array_equal(made.pilot_position[others], plain.pilot_position[others])


def test_readings_stand_at_the_end_of_the_range() -> None:
    clipped, plain = recorded(Laboratory(clipping=5e-6)), recorded(Laboratory())
    top = STROKE - 5e-6
    beyond = plain.pilot_position > top
    assert beyond.sum() > 2000
    np.testing.assert_allclose(clipped.pilot_position[beyond], top, rtol=1e-12)
    np.testing.assert_array_equal(clipped.pilot_position[~beyond], plain.pilot_position[~beyond])
    assert clipped.main_position.max() == pytest.approx(top - 0.26e-3)
    longer = measure(SHEET_VALVE, {"stroke_offset": {"offset": 8e-6}}, train_profile(), Laboratory(clipping=5e-6), SEED)
    assert longer.pilot_position.max() == pytest.approx(top + 8e-6)


def test_a_moving_average_is_late_and_calms_the_noise() -> None:
    made, plain = recorded(Laboratory(averaging=4)), recorded(Laboratory())
    wanted = np.convolve(plain.pilot_position, np.full(4, 0.25))[3 : plain.times.size]
    np.testing.assert_allclose(made.pilot_position[3:], wanted, atol=1e-15)
    assert made.pilot_position[0] == pytest.approx(plain.pilot_position[0])
    assert error(Laboratory(averaging=4), resting(0.5)).std() == pytest.approx(0.5e-6, rel=0.05)


# --- clocks ----------------------------------------------------------------------------------------------------------


@pytest.mark.long
def test_stamps_are_late_as_the_clocks_make_them() -> None:
    made = recorded(Laboratory(clock_rate=200e-6, clock_offset=1e-3))
    np.testing.assert_allclose(made.command_times - made.true_command_times, 1e-3 + 200e-6 * made.true_command_times)
    late = np.concatenate(
        [recorded(Laboratory(command_jitter=100e-6), seed=seed).command_times for seed in range(20)]
    ) - np.tile(train_profile().times, 20)
    assert late.std() == pytest.approx(100e-6, rel=0.12)
    assert abs(late.mean()) < 20e-6


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


@pytest.mark.long
def test_every_stroke_has_dampings_of_its_own() -> None:
    laboratory = replace(SILENT, stroke_variation=0.08)
    even = times_of(recorded(SILENT), "opened")
    changes = np.array([times_of(recorded(laboratory, seed=seed), "opened") - even for seed in range(6)])
    assert changes.shape == (6, 8)
    # The change of the opening's time for one standard deviation of each value, added up in squares.
    wanted = np.zeros(8)
    for name, share in (("pilot_damping", 1.0), ("main_damping", 1.0), ("seat_load", 1 / 3), ("spring_preload", 1 / 3)):
        entries = {**SHEET_VALVE, name: float(np.asarray(SHEET_VALVE[name])) * (1.0 + 0.08 * share)}
        shifted = measure(entries, {}, train_profile(), SILENT, SEED)
        wanted += np.square(times_of(shifted, "opened") - even)
    assert np.sqrt(np.mean(np.square(changes))) == pytest.approx(np.sqrt(np.mean(wanted)), rel=0.2)
    assert abs(correlation(changes[:, :4].ravel(), changes[:, 4:].ravel())) < 0.5


def test_strokes_join_at_rest() -> None:
    made = recorded(replace(SILENT, stroke_variation=0.15), holdout_profile())
    starts = holdout_profile().times[[2, 5, 7, 9, 11]]
    for start in starts:
        around = np.abs(made.times - start) < 0.2e-3
        np.testing.assert_allclose(made.truth.pilot_position[around], 0.0, atol=1e-9)
    assert np.all(np.diff([event.time for event in made.truth.events]) >= 0.0)
    assert np.abs(np.diff(made.truth.pilot_position)).max() < 50e-6


def test_a_trend_slows_the_strokes_one_by_one_about_their_mean() -> None:
    later = times_of(recorded(replace(SILENT, trend=0.2)), "opened") - times_of(recorded(SILENT), "opened")
    assert np.all(later[:4] < 0.0)
    assert np.all(later[4:] > 0.0)
    entries = {**SHEET_VALVE, "main_damping": 4.4}
    last = measure(entries, {}, train_profile(), SILENT, SEED)
    assert times_of(last, "opened")[-1] == pytest.approx(
        times_of(recorded(SILENT), "opened")[-1] + later[-1], abs=1e-12
    )


def test_a_coil_stays_warm_from_stroke_to_stroke_whatever_their_dampings_are() -> None:
    effects = {"coil_heating": {"temperature_rate": 400.0, "cooling_time_constant": 0.5}}
    varied, even = (
        measure(SHEET_VALVE, effects, train_profile(), replace(SILENT, stroke_variation=variation), SEED)
        for variation in (0.15, 0.0)
    )
    np.testing.assert_allclose(varied.truth.coil_current, even.truth.coil_current, atol=1e-12)


# --- whole laboratories ----------------------------------------------------------------------------------------------


@pytest.mark.parametrize("name", LABORATORIES)
def test_a_whole_laboratory_records_every_stroke(name: str) -> None:
    laboratory = LABORATORIES[name]
    made = recorded(laboratory)
    assert made.times.size == 0.5 * laboratory.sample_rate
    assert np.isfinite(made.pilot_position).all()
    assert times_of(made, "opened").size == 8
    sane = made.pilot_position[made.pilot_position < 2.0 * STROKE]
    assert sane.size > 0.99 * made.times.size
    assert sane.max() == pytest.approx(STROKE, abs=0.1e-3)
    assert sum(map(bool, true_sizes(laboratory).values())) >= 2
