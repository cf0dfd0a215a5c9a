"""Commands out of a measured voltage, against steps that are known."""

from __future__ import annotations

import itertools

import numpy as np
import pytest

from valve_sim.recordings.voltage_steps import NoStepError, find_steps, held_steps

RATE = 20_000.0
TRUTH = ((0.0, 0.0), (0.0101, 12.0), (0.0202, 6.0), (0.0413, 0.0), (0.0604, 9.0), (0.0805, 0.0))
"""Peak and hold, and an opening; s, V."""


def voltage(
    rise: float = 0.0, noise: float = 0.0, step: float = 0.0, probe: float = 0.0, seed: int = 4
) -> tuple[np.ndarray, np.ndarray]:
    """What a probe shows of TRUTH: edges that take `rise` s, white noise, a quantisation step, an offset."""
    times = np.arange(2000) / RATE
    volts = np.zeros(len(times))
    for (_, before), (start, after) in itertools.pairwise(TRUTH):
        share = np.clip((times - start) / rise, 0.0, 1.0) if rise else (times >= start).astype(float)
        volts += (after - before) * share
    volts += noise * np.random.default_rng(seed).standard_normal(len(times)) + probe
    return times, np.round(volts / step) * step if step else volts


@pytest.mark.parametrize(
    ("settings", "tolerance"),
    [
        ({}, 26e-6),
        ({"noise": 0.02}, 26e-6),
        ({"noise": 0.1}, 30e-6),
        ({"step": 0.1}, 26e-6),
        ({"probe": 0.05, "noise": 0.01}, 26e-6),
        ({"rise": 150e-6, "noise": 0.02}, 110e-6),
        ({"rise": 1e-3, "noise": 0.02}, 560e-6),
    ],
)
def test_steps_are_found(settings: dict[str, float], tolerance: float) -> None:
    steps = find_steps(*voltage(**settings))
    times, levels = steps.times, steps.volts
    expected = np.array(TRUTH)
    assert len(times) == len(TRUTH)
    np.testing.assert_allclose(times, expected[:, 0], atol=tolerance)
    np.testing.assert_allclose(levels, expected[:, 1], atol=0.1)
    assert (levels[[0, 3, 5]] == 0.0).all()


def test_a_slow_edge_is_dated_in_its_middle() -> None:
    steps = find_steps(*voltage(rise=1e-3))
    np.testing.assert_allclose(steps.times[1:], np.array(TRUTH)[1:, 0] + 0.5e-3, atol=30e-6)
    np.testing.assert_allclose(steps.time_errors[1:], 1e-3 / np.sqrt(12.0), rtol=0.1)


def test_a_step_between_two_samples_is_dated_in_their_middle_and_as_well_as_that() -> None:
    steps = find_steps(*voltage())
    inside = np.floor(np.array(TRUTH)[1:, 0] * RATE - 1e-6) + 0.5
    np.testing.assert_allclose(steps.times[1:], inside / RATE, atol=1e-12)
    np.testing.assert_allclose(steps.time_errors, [0.0, *[1.0 / RATE / np.sqrt(12.0)] * 5], rtol=1e-9)


@pytest.mark.parametrize("settings", [{"noise": 0.02}, {"noise": 0.03, "step": 0.06}, {"noise": 0.001, "step": 0.07}])
def test_levels_are_as_far_off_as_their_errors_say(settings: dict[str, float]) -> None:
    found = [find_steps(*voltage(**settings, seed=seed)) for seed in range(40)]
    on = np.array(TRUTH)[:, 1] > 0.0
    off_by = np.array([(steps.volts - np.array(TRUTH)[:, 1])[on] / steps.volt_errors[on] for steps in found])
    assert 0.4 < np.sqrt(np.mean(np.square(off_by))) < 1.3
    assert (found[0].volt_errors[~on] == 0.0).all()


def test_slow_noise_does_not_average_out() -> None:
    times, volts = voltage(noise=0.02)
    hum = 0.05 * np.sin(2.0 * np.pi * 90.0 * times)
    quiet, humming = find_steps(times, volts), find_steps(times, volts + hum * (volts > 1.0))
    assert (humming.volt_errors[[1, 2, 4]] > 3.0 * quiet.volt_errors[[1, 2, 4]]).all()


def test_levels_that_differ_by_little_are_not_made_one() -> None:
    times = np.arange(2000) / RATE
    volts = np.where(times % 0.05 < 0.025, np.where(times < 0.05, 10.0, 10.1), 0.0)
    volts += 0.02 * np.random.default_rng(2).standard_normal(2000)
    steps = find_steps(times, volts)
    np.testing.assert_allclose(steps.volts, [10.0, 0.0, 10.1, 0.0], atol=5e-3)


def test_what_a_probe_shows_of_0_v_is_taken_off_all_levels() -> None:
    steps = find_steps(*voltage(probe=0.05, noise=0.01))
    np.testing.assert_allclose(steps.volts, np.array(TRUTH)[:, 1], atol=4e-3)
    assert steps.offset == pytest.approx(0.05, abs=2e-3)
    assert any("V at rest were taken for the probe's offset" in words for words in steps.findings("CH1"))
    assert find_steps(*voltage(noise=0.01)).offset == 0.0


@pytest.mark.parametrize("drop", [-0.7, -1.2])
def test_the_voltage_of_a_freewheeling_diode_is_no_command(drop: float) -> None:
    times, volts = voltage(noise=0.01)
    freewheels = (times > 0.0805) & (times < 0.0835)
    steps = find_steps(times, np.where(freewheels, drop, volts))
    np.testing.assert_allclose(steps.times, np.array(TRUTH)[:, 0], atol=26e-6)
    np.testing.assert_allclose(steps.volts, np.array(TRUTH)[:, 1], atol=5e-3)
    assert steps.freewheeled == 1
    # A coil that is driven the other way, to let go at once, is commanded to be.
    reversed_volts = find_steps(times, np.where(freewheels, -3.0, volts)).volts
    np.testing.assert_allclose(reversed_volts[-2:], [-3.0, 0.0], atol=5e-3)


def test_rows_that_hold_the_command_date_it_between_two_of_them() -> None:
    steps = held_steps(np.array([0.0, 1.0, 2.0, 4.0, 5.0]), np.array([0.0, 0.0, 9.0, 9.0, 0.0]))
    np.testing.assert_array_equal(steps.times, [0.0, 1.5, 4.5])
    np.testing.assert_array_equal(steps.volts, [0.0, 9.0, 0.0])
    np.testing.assert_allclose(steps.time_errors, [0.0, 1.0 / np.sqrt(12.0), 1.0 / np.sqrt(12.0)])
    assert not steps.volt_errors.any()


@pytest.mark.parametrize("level", [0.0, 9.0])
def test_a_voltage_without_steps_is_refused(level: float) -> None:
    times = np.arange(500) / RATE
    volts = level + 0.01 * np.random.default_rng(1).standard_normal(500)
    with pytest.raises(NoStepError, match="no step in it, so no command"):
        find_steps(times, volts)
