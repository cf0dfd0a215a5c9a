"""Whether a current is believed, on plants that share no code with the package."""

from __future__ import annotations

from collections.abc import Mapping

import pytest
from plants.common import Plant
from plants.declared import CAMPAIGN_VALVE, DeclaredPlant
from plants.mismatched import BENCH_VALVE, MismatchedPlant
from plants.recording import Recorder, record, train_profile

from benchmarks.campaign.cases import declared_valve
from valve_sim.identification.estimation.problem import Problem
from valve_sim.identification.plants.valve import ValvePlant
from valve_sim.identification.selection.current_check import current_left, current_noise_inflation
from valve_sim.model import Drive
from valve_sim.traces import Signal, Trace

Entries = Mapping[str, float | tuple[float, ...]]


def problem(plant: Plant, declared: Entries, recorder: Recorder) -> Problem:
    made = record(plant, train_profile(), recorder, 3)
    current = None if made.coil_current is None else Signal(made.times, made.coil_current)
    drive = Drive(made.command_times, made.volts)
    trace = Trace("made", drive, made.times, made.pilot_position, coil_current=current)
    return Problem(ValvePlant([trace], declared_valve(declared)))


@pytest.mark.parametrize("jitter", [0.0, 50e-6])
@pytest.mark.parametrize("effects", [{}, {"drive_gain": {"gain": 0.95}, "coil_lag": {"time_constant": 2e-4}}])
def test_a_current_that_effects_explain_is_believed(effects: dict[str, dict[str, float]], jitter: float) -> None:
    recorder = Recorder(with_current=True, command_jitter=jitter)
    made = problem(DeclaredPlant(effects), CAMPAIGN_VALVE, recorder)
    assert current_noise_inflation(made) == 1.0
    assert 0.9 < current_left(made) < 1.1


def test_a_current_of_another_form_is_believed_to_what_is_missed_of_it() -> None:
    made = problem(MismatchedPlant(), BENCH_VALVE, Recorder(with_current=True))
    inflation = current_noise_inflation(made)
    assert inflation > 2.0
    inflated = made.with_inflated_noise("current", inflation)
    assert inflated.noises["current"].innovation == inflation * made.noises["current"].innovation
    assert inflated.noises["position"] == made.noises["position"]


def test_without_a_current_there_is_nothing_to_doubt() -> None:
    made = problem(DeclaredPlant({}), CAMPAIGN_VALVE, Recorder())
    assert current_left(made) == 0.0
    assert current_noise_inflation(made) == 1.0
