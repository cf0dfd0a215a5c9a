"""Statements that a review saw fail, by its numbers (T 1 to T 5, T 10), on the recordings that it left.

Each is what is right. Whoever makes one pass that is marked to fail takes its mark off.
"""

from __future__ import annotations

import re
from collections.abc import Sequence
from pathlib import Path

import numpy as np
import pytest

import valve_sim as vs
from identification.live_strokes import LiveValve
from valve_sim.files.parameter_files import load_valve
from valve_sim.identification.diagnosis.recording_state import state_of_recording
from valve_sim.model import Drive
from valve_sim.recordings import Trace
from valve_sim.recordings.synthetic import Sensor, record

pytestmark = pytest.mark.long

ROOT = Path(__file__).parents[2]
INPUTS = ROOT.parent / "shared" / "inputs"
SECONDS = 120.0
CLAIMED = ("effects", "partly")
"""Verdicts whose names are claimed."""
needs_inputs = pytest.mark.skipif(not INPUTS.is_dir(), reason="the recordings of the review are not here")


def own_machine(folder: str, plant: str, *logs: str, holdout: str = "") -> vs.Diagnosis:
    at = INPUTS / folder
    machine = vs.load_plant(at / plant)
    read = [vs.read(at / log, at / "map.yaml", machine) for log in (*logs, *([holdout] if holdout else []))]
    return vs.diagnose(read[: len(logs)], machine, read[len(logs) :], budget=vs.Budget.of_seconds(SECONDS))


@needs_inputs
def test_a_missing_voltage_drop_is_seen_where_the_input_never_stands() -> None:
    """T 1: 131 mA of noise were read where 1 mA is true."""
    found = own_machine("noise_of_excited_input", "coil.yaml", "drop_a.csv", "drop_b.csv", holdout="drop_b.csv")
    assert found.before.fit.problem.noise.sigma < 5e-3
    assert found.verdict.kind != "none"


@needs_inputs
def test_a_sensor_with_uneven_steps_is_no_broken_machine() -> None:
    """T 2: 5e-5 K of noise were read where steps are 0.08 to 0.23 K."""
    found = own_machine("noise_of_uneven_steps_ntc", "heat.yaml", "ntc_a.csv")
    assert 0.01 < found.before.fit.problem.noise.sigma < 0.1
    assert found.verdict.kind == "none"


def own_valve(folder: str) -> vs.Diagnosis:
    at = INPUTS / "own_valve"
    train, other = (vs.read(at / folder / f"{name}.csv", at / "map.yaml") for name in ("long", "day2"))
    return vs.diagnose(train, load_valve(at / "valve.yaml"), other, budget=vs.Budget.of_seconds(SECONDS))


@needs_inputs
def test_hum_on_the_current_does_not_void_the_friction() -> None:
    """T 3."""
    found = own_valve("hard_stop_hum")
    assert found.verdict.kind in CLAIMED and "coulomb_friction" in found.verdict.effects
    friction = found.after.intervals["coulomb_friction.force"]
    assert friction.value == pytest.approx(0.12, abs=max(0.03, 3.0 * friction.stderr))
    assert found.after.holdout_rmse < 2.4e-6


@needs_inputs
def test_what_predicts_unseen_strokes_is_in_the_corrected_valve() -> None:
    """T 4: a stop that gives, beside friction and a bounce."""
    found = own_valve("soft_stop")
    assert found.after.holdout_rmse < 2.6e-6
    assert "coulomb_friction" in found.valve.effects


def test_what_is_twice_the_detection_limit_by_the_current_alone_is_named() -> None:
    """T 5."""
    valve = load_valve(ROOT / "config" / "energy_consistent.yaml")
    drive = Drive.of([0.01, 0.04, 0.07, 0.10], [9.0, 0.0, 12.0, 0.0])

    def by_the_current(friction: float) -> Trace:
        rubs = {**valve.effects, **({"coulomb_friction": {"force": friction}} if friction else {})}
        made = record(vs.Valve(valve.parameters, rubs), drive, 0.14, 20e3, Sensor(current_noise=1e-3)).trace
        return Trace("coil", drive, made.times[:0], made.times[:0], coil_current=made.coil_current)

    limit = state_of_recording(by_the_current(0.0), valve).limits["coulomb_friction"]["force"]
    found = vs.diagnose(by_the_current(2.0 * limit), valve, budget=vs.Budget.of_seconds(SECONDS))
    assert found.verdict.kind in CLAIMED and "coulomb_friction" in found.verdict.effects


@pytest.mark.parametrize(
    ("seed", "forces", "words"),
    [
        (3, np.linspace(0.0, 0.3, 8), r"Coulomb friction grows over the strokes (by \d+ %|from nothing)"),
        (11, np.linspace(0.3, 0.1, 8), r"Coulomb friction falls over the strokes by (5\d|6\d|7\d) %"),
        (5, [0.0] * 4 + [0.2] * 4, "Coulomb friction begins with stroke 5"),
        (17, [0.0, 0.2, 0.0, 0.0, 0.2, 0.2, 0.0, 0.2], "Coulomb friction acts in strokes 2, 5, 6, 8, and not in 3, 4"),
        (7, [0.15] * 8, ""),
    ],
    ids=["grows", "falls", "begins", "comes and goes", "stays"],
)
def test_friction_that_changes_over_the_strokes_is_named_as_what_it_is(
    seed: int, forces: Sequence[float], words: str
) -> None:
    """T 10: a change of an effect over the strokes is a kind of its own."""
    valve, strokes = LiveValve(seed, {"pilot_damping": 1.3, "main_damping": 3.5}, rate=10e3, jitter=0.0), []
    for force in forces:
        strokes += valve.row(1, {"coulomb_friction": {"force": float(force)}})
    times, position = (np.concatenate([getattr(own, name) for own in strokes]) for name in ("times", "position"))
    commands, volts = (np.concatenate([getattr(own, name) for own in strokes]) for name in ("command_times", "volts"))
    trace = Trace("it wears", Drive(commands, volts), times, position)
    found = vs.diagnose(trace, vs.default_valve().exact(), budget=vs.Budget.of_seconds(SECONDS))
    assert found.verdict.kind == "effects"
    assert found.verdict.effects == ("coulomb_friction",)
    assert re.search(words, str(found))
    assert bool(words) == any(one in str(found) for one in ("over the strokes", "begins with", "acts in strokes"))
