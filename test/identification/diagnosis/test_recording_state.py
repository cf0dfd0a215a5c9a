"""Recordings as laboratories make them: nothing is named that is the laboratory's, and its errors come out."""

from __future__ import annotations

import json
import re
from dataclasses import replace
from pathlib import Path
from types import SimpleNamespace
from typing import cast

import pytest
from plants.laboratory import Laboratory, measure, true_sizes
from plants.recording import holdout_profile, train_profile
from plants.tolerances import SHEET_VALVE, declared_tolerances

from benchmarks.campaign.cases import draw_case
from benchmarks.campaign.declared import as_trace, declared_valve
from identification.recordings import Short
from valve_sim.files.json_text import plain
from valve_sim.identification.diagnosis import recording_state
from valve_sim.identification.diagnosis.recording_state import state_of_recording
from valve_sim.identification.diagnosis.run import Diagnosis, diagnose, diagnose_plant
from valve_sim.identification.plants.valve import ValvePlant
from valve_sim.identification.reporting.diagnosis_document import diagnosis_document
from valve_sim.identification.reporting.page import write_page
from valve_sim.identification.reporting.recording_document import recording_document
from valve_sim.model import ParameterError
from valve_sim.recordings import Trace

LABORATORIES = {
    "hum and a soft supply": (Laboratory(hum=1e-6, supply_resistance=0.5), ("hum", "supply")),
    "drift and a mount that rings": (
        Laboratory(drift=4e-6, ringing=3e-6, ringing_frequency=800.0),
        ("drift", "ringing"),
    ),
    "strokes that vary": (Laboratory(stroke_variation=0.15), ("stroke_variation",)),
}
"""What is wrong in each, and the errors that are to come out."""


@pytest.fixture(
    scope="module",
    params=[pytest.param(name, marks=pytest.mark.long) for name in LABORATORIES],
)
def laboratory(request: pytest.FixtureRequest) -> str:
    return str(request.param)


DECLARED = declared_valve(SHEET_VALVE, declared_tolerances(SHEET_VALVE))


def measured(laboratory: Laboratory, name: str, **effects: dict[str, float]) -> Trace:
    """Eight strokes, or four others, of a valve that is as declared but for these effects."""
    seed, profile = {"train": (5, train_profile()), "other": (6, holdout_profile())}[name]
    return as_trace(measure(SHEET_VALVE, effects, profile, laboratory, seed), f"{name}.mcap")


@pytest.fixture(scope="module")
def found(laboratory: str) -> Diagnosis:
    made = LABORATORIES[laboratory][0]
    return diagnose([measured(made, "train")], [measured(made, "other")], DECLARED)


def test_nothing_is_missing(found: Diagnosis) -> None:
    assert (found.verdict.kind, found.verdict.effects) == ("none", ())


def test_held_out_strokes_are_predicted_to_the_noise(found: Diagnosis) -> None:
    noise = found.before.fit.problem.noise.sigma
    assert found.after.holdout_rmse < 1.2 * noise


@pytest.mark.long
def test_what_changes_over_the_strokes_is_said_although_something_has_no_name() -> None:
    """Both dampings grow within the strokes, too, which none of the errors of a recording does."""
    case = draw_case("uncatalogued", 4763)
    traces = [as_trace(own, f"bag {number}") for number, own in enumerate(case.recordings(), 1)]
    few = ("pressure_force", "quadratic_drag")
    found = diagnose_plant(*(Short([trace], case.declared, few) for trace in traces))
    assert found.verdict.kind == "unknown"
    (words,) = re.findall(
        r"State of the recording bag 1\n.*\n *Pilot damping grows over the strokes by (\d+) %; "
        r"main damping grows over the strokes by (\d+) %\. This may be the unmodelled effect",
        str(diagnosis_document(found).to_text()),
    )
    # From stroke to stroke 60 ms pass.
    [rise] = [8 * 0.060 * own["rate"] for own in case.effects.values()]
    truth = [rise / case.dampings[name] for name in ("pilot_damping", "main_damping")]
    assert [float(word) / 100.0 for word in words] == pytest.approx(truth, rel=0.3)


@pytest.mark.long
@pytest.mark.parametrize(("seed", "trend"), [(7, 0.4), (11, -0.3), (9, 0.0)])
def test_a_damping_that_changes_steadily_is_told_as_a_trend(seed: int, trend: float) -> None:
    """What is drawn anew for each stroke is none."""
    made = Laboratory(trend=trend) if trend else Laboratory(stroke_variation=0.1)
    trace = as_trace(measure(SHEET_VALVE, {}, train_profile(), made, seed), "train.mcap")
    (entries,) = diagnose([trace], [], DECLARED).recording.values()
    (told,) = (own for own in entries if own.error == "stroke_variation" and own.detail.startswith("damping"))
    assert told.is_likely
    if not trend:
        assert told.detail == "damping"
        return
    (words,) = re.findall(r"; main damping (grows|falls) over the strokes by (\d+) %$", told.detail)
    assert words[0] == ("grows" if trend > 0.0 else "falls")
    assert float(words[1]) == pytest.approx(100.0 * abs(trend), abs=8.0)


def test_each_error_comes_out_with_its_size(laboratory: str, found: Diagnosis) -> None:
    made, names = LABORATORIES[laboratory]
    there = {entry.error: entry for entry in reversed(found.recording["train.mcap"])}
    for name in names:
        assert there[name].probability > 0.9
        # Of eight strokes, or of sixteen ramps, a standard deviation is known to a quarter.
        assert true_sizes(made)[name] / 1.8 < there[name].size < 1.8 * true_sizes(made)[name]
        assert there[name].low < there[name].size < there[name].high


def test_reports_say_the_state_of_the_recording(laboratory: str, found: Diagnosis, tmp_path: Path) -> None:
    entries = json.loads(json.dumps(diagnosis_document(found).to_json(), allow_nan=False))["recording"]
    assert set(entries) == {"train.mcap", "other.mcap"}
    names = [entry["error"] for entry in entries["train.mcap"]]
    assert {"clock_offset", "clock_rate", "drift", "hum", "scale", "bend", "supply", "stroke_variation"} <= set(names)
    for entry in entries["train.mcap"]:
        assert entry["unit"] in ("um", "us", "ppm", "%", "ohm")
        assert 0.0 <= entry["probability"] <= 1.0
        assert entry["what_to_do"]
        assert len(entry["ci95"]) == 2
    document = diagnosis_document(found)
    words = document.to_text()
    assert "State of the recording train.mcap" in words
    write_page(document, tmp_path / "report.html")
    page = (tmp_path / "report.html").read_text(encoding="utf-8")
    for name in LABORATORIES[laboratory][1]:
        assert f'<code class="code">{name}</code>' in page


@pytest.mark.long
def test_a_declared_average_of_readings_is_no_effect_of_the_valve() -> None:
    recordings = [
        measure(SHEET_VALVE, {}, profile, Laboratory(averaging=8), seed)
        for seed, profile in ((5, train_profile()), (6, holdout_profile()))
    ]
    train, other = (replace(as_trace(recording, "x"), averaging=8) for recording in recordings)
    found = diagnose([train], [other], declared_valve(SHEET_VALVE, declared_tolerances(SHEET_VALVE)))
    assert (found.verdict.kind, found.verdict.effects) == ("none", ())
    for name in ("pilot_damping", "main_damping"):
        assert found.after.intervals[name].low < SHEET_VALVE[name] < found.after.intervals[name].high


@pytest.mark.long
def test_a_declared_bandwidth_of_the_sensor_is_no_effect_of_the_valve() -> None:
    recording = measure(
        SHEET_VALVE, {"sensor_bandwidth": {"cutoff_frequency": 500.0}}, train_profile(), Laboratory(), 7
    )
    valve = declared_valve(SHEET_VALVE, declared_tolerances(SHEET_VALVE))
    found = diagnose([replace(as_trace(recording, "x"), bandwidth=500.0)], [], valve)
    assert (found.verdict.kind, found.verdict.effects) == ("none", ())
    assert found.valve.effects == {"sensor_bandwidth": {"cutoff_frequency": 500.0}}


def test_a_sensor_has_one_bandwidth() -> None:
    trace = as_trace(measure(SHEET_VALVE, {}, train_profile(), Laboratory(), 8), "first")
    valve = declared_valve(SHEET_VALVE, {})
    with pytest.raises(ParameterError, match="second: its sensor has not the 500 Hz of the other recordings"):
        ValvePlant([replace(trace, bandwidth=500.0), replace(trace, source="second")], valve)
    slow = replace(valve, effects={"sensor_bandwidth": {"cutoff_frequency": 800.0}})
    with pytest.raises(ParameterError, match=r"declares sensor\.bandwidth 500 Hz, and the valve .* 800 Hz"):
        ValvePlant([replace(trace, bandwidth=500.0)], slow)


def test_a_state_says_what_errors_cost_and_what_to_do() -> None:
    state = state_of_recording(measured(Laboratory(hum=3e-6, stroke_variation=0.15), "train"), DECLARED)
    there = {entry.error for entry in state.errors if entry.is_likely}
    assert {"hum", "stroke_variation"} <= there
    assert state.limits["coulomb_friction"]["force"] > 1.1 * state.without_errors["coulomb_friction"]["force"]
    words = recording_document(state).to_text()
    assert "hum of the mains" in words
    assert "Ground the sensor at one point" in words
    assert "Record more strokes" in words
    entries = json.loads(json.dumps(plain(recording_document(state).to_json()), allow_nan=False))
    assert {"drift", "hum", "stroke_variation"} <= {entry["error"] for entry in entries["recording"]}


@pytest.mark.parametrize(("is_long", "recording"), [(True, {"first": ()}), (False, {})])
def test_of_a_long_recording_or_one_without_errors_no_limits_are_sought(
    is_long: bool, recording: dict[str, tuple[()]], monkeypatch: pytest.MonkeyPatch
) -> None:
    found = SimpleNamespace(fit=SimpleNamespace(problem=SimpleNamespace(is_long=is_long)), recording=recording)
    monkeypatch.setattr(recording_state, "identify", lambda *_, **__: found)
    state = state_of_recording(cast("Trace", None), DECLARED)
    assert (state.limits, state.without_errors) == ({}, {})


@pytest.mark.long
def test_no_state_is_told_beside_a_model_that_lacks_something() -> None:
    trace = measured(Laboratory(), "train", coulomb_friction={"force": 0.3})
    state = state_of_recording(trace, DECLARED)
    assert not state.errors
    _, second, *_ = recording_document(state).to_text().splitlines()
    assert "that cannot be told from errors of the recording" in second
