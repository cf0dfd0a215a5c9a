"""Replay validation: the declared valve passes, another does not, and what must not matter does not."""

from dataclasses import replace
from xml.etree import ElementTree

import numpy as np
import pytest
from plants.recording import Profile, Recorder, three_strokes

from identification.recordings import recorded
from valve_sim.files.parameter_files import default_valve
from valve_sim.identification.diagnosis.run import diagnose
from valve_sim.identification.reporting.validation_document import validation_document
from valve_sim.identification.validation.replay import Validation, validate
from valve_sim.model import EXACT, Tolerances, ValveError
from valve_sim.recordings import Trace, events_from_sensors

EXACT_VALVE = default_valve().exact()


def measured(seed: int = 3, profile: Profile | None = None, **changes: float) -> Trace:
    """Eight strokes of the independent plant, or others, 10 kHz, 1 µm noise."""
    recorder = Recorder(sample_rate=10e3, **changes)
    return recorded(recorder, profile, seed, pilot_damping=1.0, main_damping=4.0)


@pytest.fixture(scope="module")
def trace() -> Trace:
    return measured()


@pytest.fixture(scope="module")
def good(trace: Trace) -> Validation:
    """Of the valve that is declared."""
    return validate([trace], EXACT_VALVE)


@pytest.fixture(scope="module")
def bad(trace: Trace) -> Validation:
    """Of a valve with a fifth more damping, against two recordings."""
    return validate([trace, trace], EXACT_VALVE.with_values(main_damping=4.8))


def test_declared_valve_passes_at_three_times_the_noise(good: Validation):
    replay = good.replays[0]
    assert good.passed
    assert replay.noise == pytest.approx(1e-6, rel=0.05)
    assert replay.tolerance == pytest.approx(3e-6, rel=0.05)
    assert replay.errors.rmse == pytest.approx(1e-6, rel=0.05)
    assert len(replay.strokes) == 16


@pytest.mark.parametrize("change", [{"main_damping": 3.2}, {"a0": 3.2}, {"stroke": 1.235e-3}])
def test_another_valve_fails(trace: Trace, change: dict[str, float]):
    result = validate([trace], EXACT_VALVE.with_values(**change))
    # The error of each command's stamp, free within its prior, can put most openings right, but not all strokes.
    assert not result.passed


def test_a_long_rest_does_not_hide_a_wrong_motion(trace: Trace):
    rest = trace.times[-1] + np.arange(1, 50_001) / 10e3
    noise = 1e-6 * np.random.default_rng(0).standard_normal((2, len(rest)))
    padded = replace(
        trace,
        times=np.concatenate([trace.times, rest]),
        pilot_position=np.concatenate([trace.pilot_position, noise[0]]),
        main_position=np.concatenate([trace.main_position, noise[1]]),
    )
    result = validate([padded], EXACT_VALVE.with_values(main_damping=4.8))
    last = result.replays[0].strokes[-1]
    assert last.errors.rmse < result.replays[0].tolerance < last.errors.moving_rmse
    assert not result.passed


def test_clock_offset_within_its_prior_is_estimated_and_forgiven():
    result = validate([measured(clock_offset=-60e-6)], EXACT_VALVE)
    assert result.passed
    assert result.replays[0].clock_offset == pytest.approx(60e-6, abs=2e-6)


def test_clock_offset_far_beyond_its_prior_is_not_forgiven():
    assert not validate([measured(profile=three_strokes(), clock_offset=-5e-3)], EXACT_VALVE).passed


def test_errors_of_the_stamps_within_their_prior_are_estimated_and_forgiven():
    result = validate([measured(command_jitter=50e-6)], EXACT_VALVE)
    assert result.passed
    assert result.replays[0].errors.rmse == pytest.approx(1e-6, rel=0.05)


def test_tolerances_widen_the_band_and_move_nothing(trace: Trace, good: Validation):
    spread = replace(EXACT_VALVE, tolerances=Tolerances({"spring_preload": 0.15}))
    exact, wide = good.replays[0], validate([trace], spread).replays[0]
    np.testing.assert_array_equal(wide.predicted, exact.predicted)
    assert wide.errors.tolerance > 1.5 * exact.errors.tolerance
    off = spread.with_values(spring_preload=1.06 * EXACT_VALVE.parameters.spring_preload)
    assert validate([trace], off).passed
    assert not validate([trace], replace(off, tolerances=EXACT)).passed


@pytest.mark.long
def test_the_corrected_valve_has_the_error_that_the_diagnosis_predicts_of_held_out_strokes(trace: Trace):
    other = measured(seed=4, clock_offset=-30e-6, command_jitter=20e-6)
    declared = replace(EXACT_VALVE, tolerances=Tolerances({"spring_preload": 0.05})).with_values(spring_preload=2.56)
    plain = [replace(entry, main_position=None) for entry in (trace, other)]
    found = diagnose(plain[:1], plain[1:], declared)
    replayed = validate(plain[1:], found.valve).replays[0]
    assert replayed.errors.rmse == pytest.approx(found.after.holdout_rmse, rel=0.01)


def test_arrivals_agree_with_the_model_within_their_error(good: Validation):
    arrivals = [arrival for stroke in good.replays[0].strokes for arrival in stroke.arrivals]
    kinds = {arrival.kind for arrival in arrivals}
    assert kinds == {"pilot_reaches_main", "reaches_stop", "main_seats", "reaches_seat"}
    deviations = [(arrival.measured - arrival.model) / arrival.stderr for arrival in arrivals]
    assert np.sqrt(np.mean(np.square(deviations))) < 2.0


def test_an_arrival_is_measured_from_the_data_alone_and_so_is_one_number_whatever_the_valve(trace: Trace):
    seen = [event.after_command for stroke in events_from_sensors(trace, 0.26e-3) for event in stroke.events]
    for valve in (EXACT_VALVE, EXACT_VALVE.with_values(main_damping=5.0)):
        strokes = validate([trace], valve).replays[0].strokes
        assert [arrival.measured for stroke in strokes for arrival in stroke.arrivals] == seen


def test_tolerance_decides(trace: Trace):
    assert validate([trace], EXACT_VALVE, 2e-6).passed
    assert not validate([trace], EXACT_VALVE, 0.5e-6).passed


@pytest.mark.parametrize("tolerance", [0.0, -1e-6, np.nan, np.inf])
def test_tolerance_without_sense_is_refused(trace: Trace, tolerance: float):
    with pytest.raises(ValveError, match="--tolerance-um"):
        validate([trace], EXACT_VALVE, tolerance)


def test_junit_has_a_case_for_each_stroke_and_counts_failures(good: Validation, bad: Validation):
    for result, suites in ((good, 1), (bad, 2)):
        root = ElementTree.fromstring(validation_document(result).to_junit().encode())
        assert [suite.tag for suite in root] == ["testsuite"] * suites
        for suite in root:
            cases = suite.findall("testcase")
            assert len(cases) == int(suite.attrib["tests"]) == 17
            assert cases[0].attrib["name"] == "opening at 0.010 s, 9.0 V"
            assert len(suite.findall("testcase/failure")) == int(suite.attrib["failures"])
        assert (int(root.attrib["failures"]) == 0) == result.passed


def test_report_and_text_say_the_same(bad: Validation):
    report = validation_document(bad).to_json()
    assert report["passed"] is False
    text = validation_document(bad).to_text()
    strokes = [stroke for recording in report["recordings"] for stroke in recording["strokes"]]
    failed = [stroke["passed"] for stroke in strokes].count(False)
    assert failed == text.count("  outside") - 2  # each recording as a whole is outside too
    assert text.endswith("FAILED")
