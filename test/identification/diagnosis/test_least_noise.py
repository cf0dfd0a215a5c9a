"""The noise that a diagnosis counts at least: what a simulated sensor shows is rounding."""

from __future__ import annotations

import pytest
from plants.recording import Recorder

from identification.recordings import recorded
from valve_sim.files.parameter_files import default_valve
from valve_sim.identification.diagnosis.run import begin
from valve_sim.identification.plants.valve import ValvePlant


@pytest.mark.parametrize(("least", "expected"), [(5e-6, 5e-6), (1e-8, 1e-6)])
def test_noise_that_is_declared_counts_where_the_data_show_less(least: float, expected: float) -> None:
    plant = ValvePlant([recorded(Recorder(), seed=1)], default_valve().exact())
    noise = begin(plant, least={"position": least}).declared.problem.noises["position"]
    assert noise.sigma == pytest.approx(expected, rel=0.1)
