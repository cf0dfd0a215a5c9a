"""Diagnoses of data with an undeclared effect in them, from plants that share no code with the package."""

import json
import os
from collections.abc import Mapping
from dataclasses import replace

import pytest
from plants.recording import Profile, Recorder, holdout_profile, single_opening, train_profile

from identification.recordings import recorded
from valve_sim.identification.diagnosis.run import Diagnosis, diagnose
from valve_sim.identification.fit.intervals import Unbounded
from valve_sim.identification.reporting.claims import recording_advice
from valve_sim.identification.reporting.diagnosis_document import diagnosis_document
from valve_sim.identification.reporting.recording_document import UNTOLD
from valve_sim.model import CATALOGUE, Tolerances, Valve
from valve_sim.model.tolerances import SensorTolerances
from valve_sim.recordings import Trace

DECLARED = replace(
    Valve().with_values(a0=3.0336, coil_time_constant=0.9934e-3, coil_resistance=10.0),
    tolerances=Tolerances(sensor=SensorTolerances(gain=0.0, linearity=0.0)),
)
"""All of it exact, the sensor too."""
TRUE_DAMPING = {"pilot_damping": 1.3, "main_damping": 4.4}
Effects = Mapping[str, Mapping[str, float]]


def measured(effects: Effects, profile: Profile, recorder: Recorder, seed: int) -> Trace:
    """Eight strokes, or others, of a valve with these effects and dampings that nobody declared."""
    return recorded(recorder, profile, seed, effects, **TRUE_DAMPING)


def diagnosed(effects: Effects, seed: int, recorder: Recorder = Recorder()) -> Diagnosis:  # noqa: B008 - frozen
    train = measured(effects, train_profile(), recorder, seed)
    return diagnose([train], [measured(effects, holdout_profile(), recorder, seed + 5000)], DECLARED)


@pytest.mark.parametrize(
    "recorder",
    [
        pytest.param(Recorder(), id="white"),
        pytest.param(Recorder(colour=0.7), id="coloured", marks=pytest.mark.long),
        pytest.param(Recorder(quantisation=5e-6), id="coarse", marks=pytest.mark.long),
        pytest.param(Recorder(command_jitter=50e-6), id="jitter", marks=pytest.mark.long),
        pytest.param(Recorder(clock_offset=60e-6, with_current=True), id="clock and current", marks=pytest.mark.long),
    ],
)
def test_nothing_is_claimed_where_nothing_is_missing(recorder: Recorder) -> None:
    verdict = diagnosed({}, 1, recorder).verdict
    assert (verdict.kind, verdict.effects) == ("none", ())


@pytest.mark.long
@pytest.mark.parametrize(
    ("name", "parameters"),
    [
        ("coulomb_friction", {"force": 0.05}),
        ("constant_force", {"force": 0.1}),
        ("drive_gain", {"gain": 0.99}),
        ("eddy_lag", {"time_constant": 3e-4}),
        ("pressure_force", {"force": 0.5, "equalisation_time": 6e-3}),
        ("stop_bounce", {"restitution_stop": 0.3, "restitution_seat": 0.2}),
        ("stroke_offset", {"offset": 2e-6}),
    ],
)
def test_the_missing_effect_is_named_and_removes_the_residual(name: str, parameters: Mapping[str, float]) -> None:
    diagnosis = diagnosed({name: parameters}, 10)
    assert diagnosis.verdict.kind == "effects"
    assert diagnosis.verdict.effects == (name,)
    assert diagnosis.verdict.probability > 0.9
    assert diagnosis.after.holdout_rmse < 1.1e-6
    assert diagnosis.before.train_rmse > 1.005 * diagnosis.after.train_rmse  # a gain of the sensor follows an offset
    for parameter, truth in parameters.items():
        interval = diagnosis.after.intervals[f"{name}.{parameter}"]
        assert abs(interval.value - truth) < 4.0 * interval.stderr
    report = diagnosis_document(diagnosis).to_json()
    assert json.loads(json.dumps(report, allow_nan=False))["verdict"]["effects"] == [name]
    assert dict(diagnosis.valve.effects) == {
        name: {key: diagnosis.after.fit.values[f"{name}.{key}"] for key in parameters}
    }


@pytest.mark.long
def test_a_coil_that_cools_too_slowly_to_be_seen_is_named() -> None:
    diagnosis = diagnosed({"coil_heating": {"temperature_rate": 4.0, "cooling_time_constant": 60.0}}, 42)
    assert (diagnosis.verdict.kind, diagnosis.verdict.effects) == ("effects", ("coil_heating",))
    cooling = diagnosis.after.intervals["coil_heating.cooling_time_constant"]
    assert cooling.low < 60.0 < cooling.high == CATALOGUE["coil_heating"].parameter("cooling_time_constant").upper
    assert cooling.unbounded is Unbounded.MAY_BE_INFINITE


@pytest.mark.long
def test_small_stiction_is_in_the_class_of_what_is_named() -> None:
    verdict = diagnosed({"stiction": {"force": 0.0042, "breakaway": 0.0056, "stribeck_velocity": 0.03}}, 62).verdict
    (name,) = verdict.effects
    assert "stiction" in {name, *verdict.confusable_with[name]}


@pytest.mark.long
def test_two_missing_effects_are_both_named() -> None:
    effects = {"coulomb_friction": {"force": 0.1}, "gap_offset": {"offset": 5e-6}}
    diagnosis = diagnosed(effects, 11)
    assert diagnosis.verdict.effects == ("coulomb_friction", "gap_offset")
    assert diagnosis.after.holdout_rmse < 1.1e-6


@pytest.mark.long
def test_the_outcome_does_not_depend_on_the_number_of_threads(monkeypatch: pytest.MonkeyPatch) -> None:
    film = {"squeeze_film": {"coefficient": 5.0, "film_thickness": 3e-5}}
    monkeypatch.setattr(os, "cpu_count", lambda: 4)
    with_four = diagnosis_document(diagnosed(film, 12)).to_json()
    monkeypatch.setattr(os, "cpu_count", lambda: 1)
    assert diagnosis_document(diagnosed(film, 12)).to_json() == with_four


@pytest.mark.long
def test_what_has_no_name_gets_none() -> None:
    diagnosis = diagnosed({"damping_bump": {"amplitude": 4.0, "centre": 0.8e-3, "width": 0.1e-3}}, 200)
    assert diagnosis.verdict.kind == "unknown"
    assert diagnosis.verdict.probability == diagnosis.verdict.unnamed > 0.99
    assert diagnosis.unexplained is not None
    assert diagnosis_document(diagnosis).to_json()["unexplained"]["force_rms_n"] > 0.0


@pytest.mark.long
def test_what_shows_in_held_out_data_alone_is_not_nothing() -> None:
    recorder = Recorder(sample_rate=5e3)
    train = measured({}, train_profile(), recorder, 80)
    held_out = measured({"coulomb_friction": {"force": 0.1}}, holdout_profile(), recorder, 81)
    diagnosis = diagnose([train], [held_out], DECLARED)
    assert diagnosis.verdict.kind == "unknown"
    assert diagnosis.unexplained is not None
    # What has no name would be told as the state of the recording.
    assert UNTOLD in diagnosis_document(diagnosis).to_text()
    opening = measured({}, single_opening(), recorder, 82)
    assert diagnose([opening], [held_out], DECLARED).verdict.kind == "unknown"


@pytest.mark.long
@pytest.mark.xfail(
    strict=True,
    raises=AssertionError,
    reason="a ripple at the seat is taken for a constant force at 0.99999; forces at one place do not compete",
)
def test_a_force_that_shows_at_the_seat_alone_gets_no_sure_name() -> None:
    # Half a millinewton lifts the pilot plunger off its seat, as a constant force would; elsewhere it does not show.
    ripple = {"force_ripple": {"amplitude": 0.457e-3, "wavelength": 0.2376e-3, "phase": 1.3617}}
    diagnosis = diagnosed(ripple, 30)
    assert diagnosis.verdict.probability < 0.9


@pytest.mark.long
def test_dampings_that_an_effect_can_take_over_have_intervals_that_say_so() -> None:
    friction = {"force_opening": 0.05, "force_closing": 0.09, "damping_opening": 0.6, "damping_closing": 0.3}
    diagnosis = diagnosed({"asymmetric_friction": friction}, 40)
    assert diagnosis.verdict.effects == ("asymmetric_friction",)
    assert diagnosis.after.fit.is_collinear("pilot_damping")
    for name, truth in TRUE_DAMPING.items():
        interval = diagnosis.after.intervals[name]
        assert interval.low <= truth <= interval.high
        # What both directions have in common may be the valve's damping or the friction's.
        assert interval.high - interval.low > 0.3


@pytest.mark.long
@pytest.mark.xfail(
    strict=True,
    raises=AssertionError,
    reason="of one opening nothing is said to be missing: dampings take the friction up",
)
def test_one_opening_is_not_enough() -> None:
    trace = measured({"coulomb_friction": {"force": 0.05}}, single_opening(), Recorder(), 2)
    diagnosis = diagnose([trace], [], DECLARED)
    assert diagnosis.verdict.kind == "insufficient"
    assert "7.5 to 14 V" in recording_advice(diagnosis)
    assert diagnosis_document(diagnosis).to_json()["after"]["rmse_um"]["holdout"] is None
