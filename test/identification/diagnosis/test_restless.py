"""Sensors of which no rest shows the noise: what looks still moves, or steps are uneven; the truth is NumPy's."""

from __future__ import annotations

from pathlib import Path

import numpy as np
import pytest

from valve_sim.files.plant_files import load_plant
from valve_sim.identification.diagnosis.run import begin
from valve_sim.identification.plants.own import OwnPlant
from valve_sim.recordings.columns import read
from valve_sim.recordings.resting_noise import step_of

COIL = """
plant: coil
parameters:
  resistance: {value: 10, unit: Ohm, tolerance: 0.2}
  inductance: {value: 10, unit: mH}
states: {i: {unit: A, start: free}}
"""
MAP = {
    "time": {"column": "t", "unit": "s"},
    "voltage": {"column": "V", "unit": "V", "between": "held"},
    "current": {"column": "A", "unit": "A"},
}
NOISE = 1e-3


@pytest.mark.parametrize("pulse", [0.0, 40.0], ids=["all of it", "a part of its range"])
def test_a_voltage_that_changes_at_each_sample_never_stands(tmp_path: Path, pulse: float) -> None:
    """Steps of ±2 V, alone or beside a pulse of 20 times as much: the current follows, and is no noise."""
    rng, times = np.random.default_rng(5), 1e-3 * np.arange(2000)
    volts = rng.choice([-2.0, 2.0], len(times))
    volts[1500:1510] += pulse
    decay, current = np.exp(-1.0), [0.0]
    for own in volts[:-1]:
        current.append(decay * current[-1] + (1.0 - decay) * own / 10.0)
    log = np.c_[times, volts, np.array(current) + rng.normal(0.0, NOISE, len(times))]
    np.savetxt(tmp_path / "log.csv", log, delimiter=",", header="t,V,A", comments="", fmt="%.8g")
    (tmp_path / "coil.yaml").write_text(COIL)
    plant = OwnPlant(load_plant(tmp_path / "coil.yaml"), [read(tmp_path / "log.csv", MAP)])
    noise = begin(plant).declared.problem.noise
    assert noise.sigma == pytest.approx(NOISE, rel=0.1)
    assert noise.samples == 0


def test_uneven_steps_are_seen_where_levels_are_read_again() -> None:
    """A thermistor behind a converter of 10 bits: about 0.09 K at 25 °C, twice that at 75 °C."""
    rng = np.random.default_rng(3)
    kelvin = 298.0 + 50.0 * np.sin(np.linspace(0.0, 3.0, 6000)) + rng.normal(0.0, 0.02, 6000)
    counts = np.round(1023.0 / (1.0 + np.exp(3950.0 * (1.0 / kelvin - 1.0 / 298.15))))
    read_back = 1.0 / (1.0 / 298.15 + np.log(1023.0 / counts - 1.0) / 3950.0)
    assert 0.05 < step_of(read_back) < 0.3


def test_a_motion_without_noise_has_no_steps() -> None:
    """It repeats where it rests, and nowhere else."""
    motion = np.concatenate([np.zeros(3000), 1e-3 * np.linspace(0.0, 1.0, 1000) ** 2, np.full(3000, 1e-3)])
    assert step_of(motion) == 0.0


@pytest.mark.parametrize("bits", [8, 12, 16])
def test_steps_of_a_converter_are_seen_beside_spikes(bits: int) -> None:
    rng, step = np.random.default_rng(bits), 1.25e-3 / 2**bits
    motion = 0.6e-3 * (1.0 + np.sin(np.linspace(0.0, 60.0, 8000))) + rng.normal(0.0, 1e-6, 8000)
    readings = step * np.round(motion / step)
    readings[::500] += rng.normal(0.0, 1e-3, 16)
    assert step_of(readings) == pytest.approx(step, rel=1e-9)
