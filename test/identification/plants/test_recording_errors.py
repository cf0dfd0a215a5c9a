"""What a recording leaves open, of a measured voltage and of a sensor's zero, widens intervals as it must."""

from __future__ import annotations

from pathlib import Path

import numpy as np
import pytest
from plants.declared import CAMPAIGN_VALVE, DeclaredPlant
from plants.recording import Profile, Recorder, record

from benchmarks.campaign.declared import as_trace
from valve_sim.files.parameter_files import default_valve
from valve_sim.files.recording_map import load_map
from valve_sim.identification.diagnosis.identify import identify
from valve_sim.identification.plants.recording_errors import ErringRecording
from valve_sim.identification.plants.valve import ValvePlant
from valve_sim.model import Drive
from valve_sim.recordings import DriveErrors, Trace, read_trace

RECORDINGS = 40
TRUTH = {"pilot_damping": 1.0, "main_damping": 4.0}
PLANT = DeclaredPlant({}, CAMPAIGN_VALVE)
LEVELS = np.array([10.0, 0.0, 12.0, 0.0])


def bench(folder: Path, seed: int, quantity: str, *, noise: float, step: float, current: bool) -> Trace:
    """Two strokes as an oscilloscope shows them, commanded between its samples, its sensor's zero some µm off."""
    random = np.random.default_rng([seed, 99])
    commanded = np.array([0.01, 0.04, 0.07, 0.1]) + random.uniform(0.0, 50e-6, 4)
    made = record(PLANT, Profile(commanded, LEVELS, 0.13), Recorder(with_current=True), seed)
    volts = np.concatenate([[0.0], LEVELS])[np.searchsorted(commanded, made.times, side="right")]
    volts += random.normal(0.0, noise, len(volts))
    volts = step * np.round(volts / step) if step else volts
    assert made.coil_current is not None
    position = 1e3 * made.pilot_position + random.normal(0.0, 2e-3)
    table, lab = folder / "scope.csv", folder / "scope.yaml"
    np.savetxt(
        table, np.column_stack([made.times, volts, position, made.coil_current]), delimiter=",", header="t,U,x,i"
    )
    channels = f"time: t\n{quantity}: U\nposition: {{column: x, unit: mm}}\n{'current: i' if current else ''}\n"
    lab.write_text(channels)
    return read_trace(table, None, load_map(lab))


@pytest.mark.long
@pytest.mark.parametrize(
    ("quantity", "noise", "step", "current"),
    [
        ("voltage", 0.02, 0.0, True),
        ("voltage", 0.005, 0.0613, True),
        ("command", 0.0, 0.0, False),
    ],
)
def test_95_percent_intervals_hold_the_truth_as_often_as_they_say(
    quantity: str, noise: float, step: float, current: bool, tmp_path: Path
) -> None:
    errors, held, stderrs = [], [], []
    for seed in range(1000, 1000 + RECORDINGS):
        trace = bench(tmp_path, seed, quantity, noise=noise, step=step, current=current)
        intervals = identify([trace], default_valve().exact()).intervals
        errors.append([intervals[name].value - truth for name, truth in TRUTH.items()])
        stderrs.append([intervals[name].stderr for name in TRUTH])
        held.append([intervals[name].low <= truth <= intervals[name].high for name, truth in TRUTH.items()])
    share, off_by = np.mean(held, axis=0), np.array(errors)
    assert (share >= 0.9).all(), share
    # What errors these recordings might have, and have not, widens the intervals: to less than twice.
    assert (np.sqrt(np.mean((off_by / stderrs) ** 2, axis=0)) > 0.5).all()
    bias = off_by.mean(axis=0) / (off_by.std(axis=0, ddof=1) / np.sqrt(RECORDINGS))
    assert (np.abs(bias) < 2.0).all(), bias


def test_commands_of_one_reading_share_its_error_and_others_have_their_own() -> None:
    volts, times = np.array([0.0, 9.0, 0.0, 9.0, 0.0, 12.0]), np.linspace(0.0, 0.1, 6)
    errors = DriveErrors(np.array([0.0, 1e-5, 1e-5, 1e-5, 1e-5, 1e-5]), 1e-3 * (volts > 0.0))
    samples = np.linspace(0.0, 0.12, 200)
    trace = Trace("made", Drive(times, volts), samples, np.zeros(200), drive_errors=errors, zero_error=1e-5)
    plant = ValvePlant([trace], default_valve().exact())
    names = [nuisance.name for nuisance in plant.nuisances]
    dates = [f"command_error[0,{command}]" for command in range(1, 6)]
    assert names == [
        "clock_offset[0]",
        "clock_rate[0]",
        "position_zero[0]",
        *dates,
        "voltage_error[0,1]",
        "voltage_error[0,5]",
    ]
    assert plant.timing_errors == ()
    moved = ErringRecording(trace, 0, plant.valve).drive({"voltage_error[0,1]": 0.1, "command_error[0,5]": 2e-5})
    np.testing.assert_allclose(moved.volts, [0.0, 9.1, 0.0, 9.1, 0.0, 12.0])
    np.testing.assert_allclose(moved.times - times, [0.0, 0.0, 0.0, 0.0, 0.0, 2e-5], atol=1e-12)
    assert [(own.number, own.part) for own in plant.nuisances[-2:]] == [("voltage_error", 1), ("voltage_error", 5)]
    (still,), (shifted,) = plant.predict({}), plant.predict({"position_zero[0]": 3e-6})
    np.testing.assert_allclose(shifted - still, 3e-6, atol=1e-15)


def test_a_nuisance_says_which_number_it_moves_in_which_stroke_of_which_recording() -> None:
    profile = Profile(np.array([0.01, 0.04, 0.07, 0.1]), LEVELS, 0.13)
    traces = [as_trace(record(PLANT, profile, Recorder(with_current=False), seed), "x") for seed in (1, 2)]
    plant = ValvePlant(traces, default_valve())
    assert {own.number for own in plant.varying} == {
        "pilot_damping", "main_damping", "spring_preload", "supply",
    }  # fmt: skip
    of_friction = plant.changing("coulomb_friction")
    assert [(own.number, own.recording, own.part) for own in of_friction] == [
        ("coulomb_friction.force", recording, stroke) for recording in (0, 1) for stroke in (0, 1)
    ]  # fmt: skip
    for own in (*plant.nuisances, *plant.timing_errors, *plant.varying, *of_friction):
        assert own.number
        assert own.is_of_machine == (own.recording < 0)
        assert plant.model.has(own.name) == own.is_of_machine
        assert {plant.channels[index].recording for index in own.channels} <= {own.recording}
