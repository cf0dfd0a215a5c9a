"""The bootstrap of the search: it knows what noise alone offers, white or not, and what is more than that."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import pytest
from plants.recording import Recorder

from identification.recordings import recorded
from valve_sim.files.parameter_files import default_valve
from valve_sim.identification.diagnosis.calibration import CALIBRATION, calibrated
from valve_sim.identification.estimation.problem import Problem
from valve_sim.identification.plants.valve import ValvePlant
from valve_sim.identification.selection.bootstrap import FalseAlarm, false_alarm
from valve_sim.identification.selection.hypotheses import Search
from valve_sim.identification.selection.table import DECISIVE, Hypothesis

LINEAR = ("coulomb_friction", "constant_force", "drive_gain", "eddy_lag", "gap_offset", "sensor_gain")
"""Effects whose real fits the bootstrap is held against."""


def problem(
    effects: dict[str, dict[str, float]], recorder: Recorder, seed: int, *, take_for_white: bool = False
) -> Problem:
    plant = ValvePlant([recorded(recorder, seed=seed, effects=effects)], default_valve().exact())
    if not take_for_white:
        return Problem(plant)
    noise = Problem(plant).noises["position"]
    return Problem(
        plant, noises={"position": replace(noise, innovation=noise.sigma, coefficients=(), variance_inflation=1.0)}
    )


def alarm_of(given: Problem, found: str | None = None) -> FalseAlarm:
    search = Search(given)
    base = search.fit(Hypothesis(()))
    return false_alarm(base, base if found is None else search.fit(Hypothesis((found,))))


def test_noise_alone_offers_about_as_much_as_the_real_search_finds_in_it() -> None:
    found, usual = [], []
    for seed in range(6):
        search = Search(problem({}, Recorder(), seed))
        base = search.fit(Hypothesis(()))
        found.append(max(base.score - search.score(Hypothesis((name,))) for name in LINEAR))
        usual.append(false_alarm(base, base).usual)
    assert all(gain < most for gain, most in zip(found, usual, strict=True))
    # Each has the price of one parameter, ln of some ten thousand; 99 % of the best of some twenty stay below 15.
    assert max(usual) < DECISIVE + 5.0


def test_an_effect_is_more_than_noise_offers() -> None:
    friction = {"coulomb_friction": {"force": 0.05}}
    alarm = alarm_of(problem(friction, Recorder(), 3), "coulomb_friction")
    assert alarm.gain > 100.0
    assert alarm.probability == pytest.approx(1.0 / (1.0 + alarm.resamples))
    assert alarm.usual < DECISIVE + 5.0


def test_colour_that_whitening_missed_is_seen() -> None:
    """An error of the noise model must not become a name: what is left of coloured noise says how much it offers."""
    given = problem({}, Recorder(colour=0.95), 4, take_for_white=True)
    assert alarm_of(given).usual > 5.0 * DECISIVE


def test_it_repeats() -> None:
    given = problem({}, Recorder(), 5)
    assert alarm_of(given) == alarm_of(given)


@pytest.mark.parametrize("kind", sorted(CALIBRATION))
def test_more_evidence_is_never_worth_less(kind: str) -> None:
    worth = [calibrated(kind, share) for share in np.linspace(0.0, 1.0, 101).tolist()]
    assert worth == sorted(worth)
    assert 0.0 < worth[0] < worth[-1] < 1.0
