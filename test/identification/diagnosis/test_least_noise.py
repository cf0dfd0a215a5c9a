"""Noise that a diagnosis is told: the least that counts, and what is known of it where rests are short."""

from __future__ import annotations

import pytest
from plants.recording import Recorder

from identification.recordings import recorded
from valve_sim.files.parameter_files import default_valve
from valve_sim.identification.diagnosis.run import begin
from valve_sim.identification.fit.noise import Noise
from valve_sim.identification.plants.valve import ValvePlant


@pytest.mark.parametrize(("least", "expected"), [(5e-6, 5e-6), (1e-8, 1e-6)])
def test_noise_that_is_declared_counts_where_the_data_show_less(least: float, expected: float) -> None:
    plant = ValvePlant([recorded(Recorder(), seed=1)], default_valve().exact())
    noise = begin(plant, least={"position": least}).declared.problem.noises["position"]
    assert noise.sigma == pytest.approx(expected, rel=0.1)


@pytest.mark.parametrize(("rate", "expected"), [(500.0, 3e-6), (20e3, 1e-6)])
def test_noise_that_is_known_counts_where_the_rests_are_too_short_to_show_it(rate: float, expected: float) -> None:
    plant = ValvePlant([recorded(Recorder(sample_rate=rate), seed=1)], default_valve().exact())
    known = {"position": Noise(3e-6, 3e-6, (), 0.0, 1000)}
    noise = begin(plant, known=known).declared.problem.noises["position"]
    assert noise.sigma == pytest.approx(expected, rel=0.1)
