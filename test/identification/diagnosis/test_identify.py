"""What `identify` says: values, intervals, and what the data do not determine."""

from __future__ import annotations

import json
import re
from dataclasses import replace
from pathlib import Path
from typing import NamedTuple

import numpy as np
import pytest
from plants.recording import Recorder

from benchmarks.coverage import measure
from identification.recordings import TRUTH, one_opening, recorded, shortened
from valve_sim.files.parameter_files import default_valve
from valve_sim.identification.diagnosis.identify import Identification, check_free, identify
from valve_sim.identification.fit.findings import (
    Correlated,
    ExplainedByErrors,
    LacksSomething,
    LooselyDetermined,
    NotIdentifiable,
    OnBound,
    StampErrors,
)
from valve_sim.identification.fit.intervals import Unbounded
from valve_sim.identification.reporting.identification_document import identification_document
from valve_sim.model import ParameterError, Valve

EXACT_VALVE = default_valve().exact()


class Opening(NamedTuple):
    """What was identified of one opening, and the fractions that were told meanwhile."""

    result: Identification
    told: list[float]


@pytest.fixture(scope="module")
def opening() -> Opening:
    """One opening, and the progress that was told while it was identified."""
    told: list[tuple[str, float]] = []
    result = identify([one_opening()], EXACT_VALVE, progress=lambda what, done: told.append((what, done)))
    return Opening(result, [done for _, done in told])


@pytest.mark.parametrize(
    "recorder",
    [
        pytest.param(Recorder(quantisation=0.1e-6), id="white"),
        pytest.param(Recorder(quantisation=0.1e-6, colour=0.7), id="coloured", marks=pytest.mark.long),
        pytest.param(Recorder(quantisation=5e-6), id="coarse", marks=pytest.mark.long),
    ],
)
def test_both_dampings_come_out(recorder: Recorder) -> None:
    result = identify([recorded(recorder)], EXACT_VALVE)
    for name, truth in TRUTH.items():
        interval = result.intervals[name]
        assert abs(interval.value - truth) < 4.0 * interval.stderr
        assert interval.high - interval.low < 0.1 * truth
        assert result.valve.declared()[name] == interval.value
    assert result.rmse_after < result.rmse_before
    assert result.findings == ()


def test_the_reference_names_what_the_report_has(opening: Opening) -> None:
    report = identification_document(opening.result).to_json()
    page = (Path(__file__).parents[3] / "docs" / "reference" / "report_json.md").read_text(encoding="utf-8")
    of_identify = page.split("## The report of identify")[1].split("\n## ")[0]
    named = set(re.findall(r"`(\w+)`", of_identify))
    assert set(report) <= named
    assert set(re.findall(r"^\| `(\w+)`", of_identify, re.MULTILINE)) <= set(report)


@pytest.mark.long
def test_a_small_slice_of_the_coverage_benchmark_is_good() -> None:
    rows = measure(12)
    assert len(rows) == 6
    assert [row for row in rows if not row.is_good] == []


def test_one_opening_holds_the_main_damping_and_not_the_pilots(opening: Opening) -> None:
    result = opening.result
    main, pilot = result.intervals["main_damping"], result.intervals["pilot_damping"]
    assert main.low < TRUTH["main_damping"] < main.high
    assert pilot.low < TRUTH["pilot_damping"] < pilot.high
    assert main.high - main.low < 0.15 * TRUTH["main_damping"]
    assert pilot.high - pilot.low > 3.0 * (main.high - main.low) / TRUTH["main_damping"] * TRUTH["pilot_damping"]
    assert result.findings == (LooselyDetermined("pilot_damping", pilot.low, pilot.high, "N·s/m"),)
    profile = identification_document(result).to_json()["profiles"]["pilot_damping"]
    assert max(point["rise"] for point in profile) > 3.8
    assert profile[-1]["value"] - profile[0]["value"] > pilot.high - pilot.low - 0.05


def test_a_damping_of_a_phase_that_never_comes_is_not_identifiable() -> None:
    """Cut off in Phase 1, before the main plunger moves."""
    result = identify([shortened(one_opening(), 0.0145)], EXACT_VALVE)
    unbounded = [finding for finding in result.findings if isinstance(finding, NotIdentifiable)]
    assert unbounded == [NotIdentifiable("main_damping", Unbounded.FLAT_PROFILE)]


def test_two_parameters_that_do_the_same_are_named_together() -> None:
    """Of a lag and a time constant the data tell the sum alone; so their priors are all that tells them apart."""
    valve = EXACT_VALVE.with_values(**TRUTH)
    result = identify([one_opening()], valve, ("coil_time_constant", "coil_lag.time_constant"))
    (pair,) = (finding for finding in result.findings if isinstance(finding, Correlated))
    assert {pair.name, pair.other} == {"coil_time_constant", "coil_lag.time_constant"}
    assert pair.correlation > 0.95


def test_a_parameter_on_its_bound_is_said_to_be_there() -> None:
    weak = EXACT_VALVE.with_values(**TRUTH, a0=2.95)
    result = identify([recorded()], weak, ("coulomb_friction.force",))
    assert OnBound("coulomb_friction.force", "lower") in result.findings
    interval = result.intervals["coulomb_friction.force"]
    assert result.fit.values["coulomb_friction.force"] == interval.low == 0.0 < interval.high


def test_several_bags_make_one_fit() -> None:
    traces = [recorded(seed=seed) for seed in (1, 2)]
    alone, together = identify(traces[:1], EXACT_VALVE), identify(traces, EXACT_VALVE)
    assert len(identification_document(together).to_json()["clock_offsets_us"]) == 2
    assert together.sources == ("seed 1", "seed 2")
    for name, truth in TRUTH.items():
        assert together.intervals[name].stderr == pytest.approx(alone.intervals[name].stderr / 2.0**0.5, rel=0.1)
        assert abs(together.intervals[name].value - truth) < 4.0 * together.intervals[name].stderr


@pytest.mark.long
def test_several_starts_leave_a_local_minimum() -> None:
    far = EXACT_VALVE.with_values(pilot_damping=40.0, main_damping=0.05)
    result = identify([recorded()], far)
    for name, truth in TRUTH.items():
        assert abs(result.intervals[name].value - truth) < 4.0 * result.intervals[name].stderr


@pytest.mark.long
def test_an_effect_that_is_declared_stays_on() -> None:
    valve = Valve(EXACT_VALVE.parameters, {"coulomb_friction": {"force": 0.2}})
    result = identify([recorded(effects={"coulomb_friction": {"force": 0.2}})], valve)
    assert result.valve.effects == {"coulomb_friction": {"force": 0.2}}
    for name, truth in TRUTH.items():
        assert abs(result.intervals[name].value - truth) < 4.0 * result.intervals[name].stderr


@pytest.mark.parametrize(
    ("name", "meant"), [("pilot_dampin", "pilot_damping"), ("coulomb_friction.forc", "coulomb_friction.force")]
)
def test_a_misspelt_name_is_refused_with_the_nearest(name: str, meant: str) -> None:
    with pytest.raises(ParameterError, match=f"did you mean {meant}"):
        check_free([name])


def test_progress_is_told_and_the_report_is_json(opening: Opening) -> None:
    result, fractions = opening
    assert fractions == sorted(fractions)
    assert fractions[0] == 0.0
    assert fractions[-1] == 1.0
    assert (
        json.loads(json.dumps(identification_document(result).to_json(), allow_nan=False))["schema"]
        == "valve_sim/identification/1"
    )
    assert "pilot_damping" in identification_document(result).to_text()


def test_stamps_of_commands_that_scatter_are_estimated_along() -> None:
    """A recorder hears commands late; whoever believes it gets a wrong damping."""
    trace = recorded(Recorder(quantisation=0.1e-6, command_jitter=50e-6))
    result = identify([trace], EXACT_VALVE)
    for name, truth in TRUTH.items():
        assert abs(result.intervals[name].value - truth) < 4.0 * result.intervals[name].stderr
    (stamps,) = (finding for finding in result.findings if isinstance(finding, StampErrors))
    assert 20e-6 < stamps.largest < 200e-6


@pytest.mark.parametrize("force", [0.02, 0.2])
def test_what_a_model_lacks_is_said_or_that_errors_of_the_recording_may_be_that(force: float) -> None:
    result = identify([recorded(effects={"coulomb_friction": {"force": force}})], EXACT_VALVE)
    (said,) = (own for own in result.findings if isinstance(own, (LacksSomething, ExplainedByErrors)))
    assert "`diagnose`" in identification_document(result).to_text()
    # What the model lacks is not told as the state of a recording.
    assert isinstance(said, ExplainedByErrors) == bool(result.recording)


def test_errors_of_a_recording_are_estimated_along() -> None:
    """A sensor that shows 0.5 % too much reads as nothing else; the dampings hold beside it."""
    trace = recorded(Recorder(quantisation=0.1e-6))
    table = replace(trace, pilot_position=1.005 * trace.pilot_position, clock="time column")
    result = identify([table], EXACT_VALVE)
    (clock,) = (own for own in result.recording[trace.source] if own.error == "clock_offset")
    assert "share one clock" in clock.what_to_do, "a table has no two clocks that could be synchronised"
    (scale,) = (own for own in result.recording[trace.source] if own.error == "scale")
    assert abs(scale.size - 0.005) < 3.0 * scale.stderr
    assert scale.stderr < 0.001
    for name, truth in TRUTH.items():
        assert result.intervals[name].low < truth < result.intervals[name].high
    assert "gain of the sensor" in identification_document(result).to_text()
    (entry,) = (
        own for own in identification_document(result).to_json()["recording"][trace.source] if own["error"] == "scale"
    )
    assert entry["size"] == pytest.approx(100.0 * scale.size)


@pytest.mark.long
def test_a_bandwidth_freed_on_positions_without_a_filter_is_out_of_reach() -> None:
    trace, name = recorded(), "sensor_bandwidth.cutoff_frequency"
    interval = identify([trace], EXACT_VALVE.with_values(**TRUTH), [name]).intervals[name]
    # The delay of such a filter is at most half of what is between two samples.
    assert 1.0 / (2.0 * np.pi * interval.low) < 0.5 * np.median(np.diff(trace.times))
    assert interval.high == np.inf
