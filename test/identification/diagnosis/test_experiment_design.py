"""Advice on what to record next: it must separate what the data could not, on a plant that is not the package's."""

from pathlib import Path

import numpy as np
import pytest
from plants.recording import Profile, Recorder, single_opening

from identification.freed import fit
from identification.recordings import recorded
from valve_sim.identification.diagnosis.experiment_design import (
    FEWEST_REPEATS,
    MOST_REPEATS,
    TELLS_APART,
    Recommendation,
    recommend,
)
from valve_sim.identification.fit.problem import Problem
from valve_sim.identification.fit.result import Fit
from valve_sim.identification.plants.protocol import Experiment
from valve_sim.identification.plants.valve import STROKE_LEVELS, ValvePlant, volts_at
from valve_sim.identification.reporting.record_next import duration_of, profile_to_record, write_profile
from valve_sim.model import EventKind, Valve, simulate
from valve_sim.recordings import Trace
from valve_sim.recordings.synthetic import read_profile

DECLARED = Valve().with_values(a0=3.0336, coil_time_constant=0.9934e-3, coil_resistance=10.0)
START = {"coulomb_friction.force": 0.02, "drive_gain.gain": 0.99}
FRICTION = {"coulomb_friction": {"force": 0.05}}


def measured(profile: Profile, seed: int) -> Trace:
    return recorded(Recorder(), profile, seed, FRICTION, pilot_damping=1.0, main_damping=4.0)


def fitted(plant: ValvePlant, *effects: str) -> Fit:
    names = [f"{effect}.{parameter.name}" for effect in effects for parameter in plant.effects[effect].parameters]
    return fit(Problem(plant), (*plant.base, *names), START, nuisances=plant.nuisances)


@pytest.fixture(scope="module")
def recommendation() -> Recommendation:
    plant = ValvePlant([measured(single_opening(), 3)], DECLARED)
    found = recommend(
        {"coulomb_friction": fitted(plant, "coulomb_friction"), "drive_gain": fitted(plant, "drive_gain")},
        plant.experiments,
    )
    assert found is not None
    return found


def test_the_advised_pulse_is_worth_what_it_promises(recommendation: Recommendation) -> None:
    """Recorded for real, the advised pulse rejects the wrong one of the pair by the promised separation, or more."""
    volts, _, _, duration, _ = recommendation.experiment.words.split()
    stop = 0.005 + 1e-3 * float(duration)
    trace = measured(Profile(np.array([0.005, stop]), np.array([float(volts), 0.0]), 0.07), 4)
    opening = measured(single_opening(), 3)
    both = ValvePlant([opening, trace], DECLARED)
    alone = ValvePlant([opening], DECLARED)
    undecided = fitted(alone, "drive_gain").chi2 - fitted(alone, "coulomb_friction").chi2
    decided = fitted(both, "drive_gain").chi2 - fitted(both, "coulomb_friction").chi2
    assert abs(undecided) < 10.0
    assert 0.5 * recommendation.separation**2 < decided < 10.0 * recommendation.separation**2


def test_the_file_to_record_next_is_worth_what_it_promises(recommendation: Recommendation, tmp_path: Path) -> None:
    """Recorded for real as the file says it, pulses and strokes reject the wrong one by what was promised, or more."""
    profile = profile_to_record(recommendation, volts_at(DECLARED, STROKE_LEVELS))
    write_profile(tmp_path / "record_next.yaml", profile, recommendation, "by a test")
    drive = read_profile(tmp_path / "record_next.yaml")
    assert len(drive.times) == 2 * (recommendation.repeats + len(STROKE_LEVELS))
    promised = recommendation.together[0][1]
    trace = measured(Profile(drive.times, drive.volts, duration_of(drive)), 5)
    plant = ValvePlant([measured(single_opening(), 3), trace], DECLARED)
    assert fitted(plant, "drive_gain").chi2 - fitted(plant, "coulomb_friction").chi2 > 0.5 * promised**2


def test_a_weak_pulse_is_repeated_until_it_tells_and_a_hopeless_one_is_not_advised() -> None:
    def separating(by: float) -> Recommendation:
        return Recommendation(Experiment("a pulse", lambda values: pytest.fail()), {("one", "other"): by})

    assert separating(20.0).repeats == FEWEST_REPEATS
    assert separating(1.25).repeats == 16
    assert separating(1.25).together[0][1] == pytest.approx(TELLS_APART)
    assert separating(0.9).repeats > MOST_REPEATS
    assert separating(0.0).repeats > MOST_REPEATS


@pytest.mark.parametrize(("reference", "lowest", "highest"), [(9.0, 7.5, 14.0), (24.0, 20.0, 37.33)])
def test_without_a_telling_pulse_the_file_has_full_strokes_that_can_be_simulated(
    tmp_path: Path, reference: float, lowest: float, highest: float
) -> None:
    """A 24 V coil never opens at what opens one of 9 V."""
    valve = DECLARED.with_values(reference_voltage=reference)
    write_profile(
        tmp_path / "record_next.yaml", profile_to_record(None, volts_at(valve, STROKE_LEVELS)), None, "by a test"
    )
    drive = read_profile(tmp_path / "record_next.yaml")
    assert tuple(drive.volts[::2]) == volts_at(valve, STROKE_LEVELS)
    assert (min(drive.volts[::2]), max(drive.volts)) == (lowest, highest)
    response = simulate(valve, drive, np.linspace(0.0, duration_of(drive), 2000))
    assert [event.kind for event in response.events].count(EventKind.REACHED_STOP) == len(STROKE_LEVELS)
    assert response.pilot_position[-1] < 1e-9


@pytest.mark.parametrize(
    ("reference", "driven", "highest"), [(24.0, 12.0, 12.0), (9.0, 9.0, 14.0), (9.0, 12.0, 14.0), (24.0, 24.0, 37.33)]
)
def test_no_profile_drives_a_coil_beyond_what_it_was_driven_with_below_its_reference(
    tmp_path: Path, reference: float, driven: float, highest: float
) -> None:
    """37 V for a coil that was driven with 12 V would burn it; what command_profile refuses by default is allowed."""
    valve = DECLARED.with_values(reference_voltage=reference)
    write_profile(
        tmp_path / "record_next.yaml",
        profile_to_record(None, volts_at(valve, STROKE_LEVELS, driven)),
        None,
        "by a test",
    )
    volts = read_profile(tmp_path / "record_next.yaml").volts
    assert max(volts) == highest
    assert (" -p max_voltage:=38.0" in (tmp_path / "record_next.yaml").read_text()) == (highest > 30.0)


def test_experiments_and_advice_follow_the_reference_voltage() -> None:
    plant = ValvePlant([measured(single_opening(), 3)], DECLARED.with_values(reference_voltage=24.0))
    pulses = {experiment.words.partition(" V")[0] for experiment in plant.experiments}
    assert pulses == {"7.5", "7.85", "8.31", "9"}, "it was driven with 9 V alone"
    assert "at 7.5 to 9 V" in plant.advice.first
    pulses = {experiment.words.partition(" V")[0] for experiment in ValvePlant(plant.traces, DECLARED).experiments}
    assert pulses == {"7.5", "9", "11", "14"}


def test_there_is_no_advice_without_rivals() -> None:
    plant = ValvePlant([measured(single_opening(), 3)], DECLARED)
    same = fitted(plant, "coulomb_friction")
    assert recommend({"coulomb_friction": same}, plant.experiments) is None
    assert recommend({"one": same, "its twin": same}, plant.experiments) is None
