"""Level, colour and quantisation of noise, from windows at rest."""

from __future__ import annotations

import math
from dataclasses import replace

import numpy as np
import pytest
from plants.recording import Recorder

from identification.recordings import FINE, recorded, still
from valve_sim.files.parameter_files import default_valve
from valve_sim.identification.fit.noise import (
    estimate_noise,
    quiet_windows,
)
from valve_sim.identification.plants.protocol import Channel
from valve_sim.identification.plants.valve import ValvePlant


def coloured(sigma: float, colour: float, count: int = 40_000, seed: int = 1) -> np.ndarray:
    random = np.random.default_rng(seed)
    values = np.empty(count)
    values[0] = random.standard_normal()
    for index, step in enumerate(random.standard_normal(count - 1), start=1):
        values[index] = colour * values[index - 1] + np.sqrt(1.0 - colour**2) * step
    return sigma * values


@pytest.mark.parametrize("sigma", [0.2e-6, 1e-6, 30e-6])
def test_the_level_of_white_noise_is_found(sigma: float) -> None:
    noise = estimate_noise([still(coloured(sigma, 0.0))])
    assert noise.sigma == pytest.approx(sigma, rel=0.03)
    assert noise.innovation == pytest.approx(sigma, rel=0.03)
    assert noise.coefficients == ()
    assert noise.step == 0.0
    assert noise.samples == 40_000


@pytest.mark.parametrize("colour", [0.7, -0.4, 0.95])
def test_the_colour_is_found_and_taken_out(colour: float) -> None:
    values = coloured(1e-6, colour)
    noise = estimate_noise([still(values)])
    assert noise.coefficients[0] == pytest.approx(colour, abs=0.02)
    assert noise.sigma == pytest.approx(1e-6, rel=0.1)
    white = noise.whiten(values)
    assert np.std(white) == pytest.approx(1.0, rel=0.02)
    assert abs(np.corrcoef(white[1:], white[:-1])[0, 1]) < 0.02


def test_noise_slower_than_the_autoregression_makes_the_innovation_larger() -> None:
    random = np.random.default_rng(5)
    drift = np.repeat(random.standard_normal(100), 400) * 0.5
    steady = estimate_noise([still(1e-6 * random.standard_normal(40_000))])
    drifting = estimate_noise([still(1e-6 * (random.standard_normal(40_000) + drift))])
    assert steady.innovation == pytest.approx(1e-6, rel=0.02)
    # Of means over blocks, which the slow part makes scatter, not of samples.
    assert drifting.innovation > math.sqrt(2.0) * 1e-6
    assert drifting.sigma == pytest.approx(1e-6 * math.hypot(1.0, 0.5), rel=0.1)


def test_a_motion_that_bends_between_samples_is_no_noise_of_a_coarse_sensor() -> None:
    """At 2 kHz a plunger moves by tens of micrometres from one sample to the next, and its velocity changes."""
    random, times = np.random.default_rng(7), np.arange(4000) / 2e3
    moves = (times % 0.1) < 0.03
    position = np.where(moves, 4e-4 * (1.0 - np.cos(2.0 * np.pi * (times % 0.1) / 0.03)), 0.0)
    step, sigma = 3e-6, 1e-6
    readings = step * np.round((position + sigma * random.standard_normal(len(times))) / step)
    channel = replace(still(readings), times=times, quiet=~moves)
    noise = estimate_noise([channel])
    assert noise.step == pytest.approx(step)
    assert 1.0 < noise.sigma / math.hypot(sigma, step / math.sqrt(12.0)) < 1.3


def rests(values: np.ndarray, name: str = "pilot") -> list[Channel]:
    """A channel that is still for 25 ms at 20 kHz in each of eight strokes of 50 ms."""
    times = np.arange(8000) / 20e3
    data, quiet = np.linspace(0.0, 1e-3, len(times)), np.arange(len(times)) % 1000 < 500
    data[quiet] = values
    return [replace(still(data, "position"), name=name, times=times, quiet=quiet, drifts=True)]


RESTS = np.concatenate([0.05 * stroke + np.arange(500) / 20e3 for stroke in range(8)])
"""s."""


@pytest.mark.parametrize("colour", [0.0, 0.7, 0.95])
def test_hum_that_is_estimated_along_is_no_noise(colour: float) -> None:
    values = coloured(1e-6, colour, len(RESTS))
    hum = 3e-6 * np.sin(2.0 * np.pi * 50.0 * RESTS + 0.4) + 1e-6 * np.sin(2.0 * np.pi * 150.0 * RESTS)
    alone, beside = (estimate_noise(rests(own), may_hum=True) for own in (values, values + hum))
    assert beside.sigma == pytest.approx(alone.sigma, rel=0.05)
    assert beside.innovation == pytest.approx(alone.innovation, rel=0.05)
    # Where no fit estimates it, it is noise.
    assert estimate_noise(rests(values + hum)).sigma > 1.05 * beside.sigma


def test_the_tail_of_a_current_that_settles_is_no_noise() -> None:
    """As in a shorted coil: five to eight time constants after a change of 1 A, its tail is as large as the noise."""
    random, after = np.random.default_rng(6), np.linspace(5.0, 8.0, 250)
    windows = [np.exp(-after) + 1e-3 * random.standard_normal(250) for _ in range(16)]
    noise = estimate_noise([replace(still(window, "current"), drifts=True) for window in windows])
    assert noise.sigma == pytest.approx(1e-3, rel=0.05)
    assert noise.coefficients == ()


def test_a_coarse_sensor_is_no_better_than_its_step() -> None:
    trace = recorded(Recorder(quantisation=5e-6))
    channels = ValvePlant([trace], default_valve().exact()).channels
    noise = estimate_noise(channels)
    assert noise.step == pytest.approx(5e-6)
    assert noise.is_coarse
    # 1 µm of noise and rounding, which is even over a step: its variance is step²/12.
    assert noise.sigma == pytest.approx(np.hypot(1e-6, 5e-6 / np.sqrt(12.0)), rel=0.1)


def test_a_recording_shows_its_noise_at_rest() -> None:
    for recorder, colour in ((FINE, 0.0), (Recorder(quantisation=0.1e-6, colour=0.7), 0.7)):
        channel = ValvePlant([recorded(recorder)], default_valve().exact()).channels[0]
        noise = estimate_noise([channel])
        assert noise.sigma == pytest.approx(1e-6, rel=0.1)
        assert (noise.coefficients or (0.0,))[0] == pytest.approx(colour, abs=0.06)
        assert len(quiet_windows(channel)) >= 8


def test_a_noise_free_signal_still_has_a_level() -> None:
    noise = estimate_noise([still(np.full(500, 1e-3))])
    assert 0.0 < noise.sigma < 1e-12
