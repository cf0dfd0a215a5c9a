"""A user's plant, or a recording that was put together in Python, is checked before anything is fitted to it."""

from __future__ import annotations

import os
import re
import signal
import subprocess
import sys
from collections.abc import Mapping
from dataclasses import replace
from pathlib import Path
from typing import Any

import numpy as np
import pytest

from benchmarks.fuzz.slips import Heater, sound_trace, try_plant, try_recording
from valve_sim.identification.diagnosis.run import diagnose, diagnose_plant
from valve_sim.identification.plants.check import PlantError, check_plant, checked_prediction
from valve_sim.identification.plants.protocol import Nuisance
from valve_sim.identification.plants.valve import ValvePlant
from valve_sim.model import SimulationError, Valve
from valve_sim.traces import TraceError


class NanBeyond(Heater):
    """Not a number where the gain is above 2.5: a search may come there."""

    def predict(self, values: Mapping[str, float]) -> Any:
        (shown,) = super().predict(values)
        return [np.full_like(shown, np.nan)] if values.get("gain", 1.0) > 2.5 else [shown]


class OneTooFew(Heater):
    def predict(self, values: Mapping[str, float]) -> Any:
        return [super().predict(values)[0][1:]]


class Raises(Heater):
    def predict(self, values: Mapping[str, float]) -> Any:
        if "drift.rate" in values:
            raise ValueError("math domain\nerror")
        return super().predict(values)


def with_members(**members: Any) -> Heater:
    plant = Heater()
    for name, value in members.items():
        setattr(plant, name, value)
    return plant


def with_hole(column: str) -> Heater:
    plant = Heater()
    values = np.copy(getattr(plant.channels[0], column))
    values[[7, 9]] = np.nan
    return with_members(channels=[replace(plant.channels[0], **{column: values})])


@pytest.mark.parametrize(
    ("plant", "words"),
    [
        (with_hole("data"), r"Heater.channels[0].data: found nan at index 7 (2 in all), expected finite numbers"),
        (OneTooFew(), r"OneTooFew.predict({})[0]: found shape (399,), expected (400,)"),
        (with_members(base=("gian",)), r"Heater.base: found 'gian', which Heater.parameter does not know"),
        (Raises(), r"Raises.predict({drift.rate=5e-05}) raised ValueError: math domain error"),
        (with_members(experiments=None, predict=None), r"Heater: has no predict, which every plant has"),
        (
            with_members(nuisances=(Nuisance("dead_band", 0.1, "A", same_as="drift.rate"),)),
            r"Heater.nuisances[0] (dead_band): found same_as 'drift.rate' in 'K/s', but 'A' itself; same_slope says",
        ),
    ],
    ids=["NaN", "one sample too few", "typo in base", "raises", "no member", "units of the same thing"],
)
def test_a_slip_is_said_in_one_line_before_the_search(plant: Heater, words: str) -> None:
    with pytest.raises(PlantError, match=re.escape(words)) as caught:
        diagnose_plant(plant, None)
    assert "\n" not in str(caught.value)


def test_a_held_out_plant_is_checked_too() -> None:
    with pytest.raises(PlantError, match="OneTooFew"):
        diagnose_plant(Heater(), OneTooFew())


def test_a_sound_plant_passes_and_may_have_no_result_far_from_what_is_declared() -> None:
    looks: list[None] = []
    check_plant(Heater(), lambda: looks.append(None))
    assert len(looks) == 2  # at the clock, however many effects there are
    found = diagnose_plant(NanBeyond(), None)
    assert found.verdict.kind == "none"
    assert repr(found).startswith("Diagnosis(none, probability ")
    with pytest.raises(SimulationError, match=r"NanBeyond.predict\({gain=3}\)\[0\]: found nan"):
        checked_prediction(NanBeyond(), {"gain": 3.0})


def test_a_valve_passes_and_its_recording_is_checked_by_column() -> None:
    trace = sound_trace()
    check_plant(ValvePlant([trace], Valve()))
    assert repr(trace) == "Trace('made.mcap', 8 commands, 1200 samples of the position)"
    late = np.copy(trace.times)
    late[40] = late[39]
    for spoilt, words in (
        (replace(trace, times=late), "made.mcap: times: found 0.0078 s after 0.0078 s at index 40, expected strictly"),
        (replace(trace, pilot_position=trace.pilot_position[1:]), "pilot_position: found 1199 values, expected 1200"),
    ):
        with pytest.raises(TraceError, match=words):
            diagnose([trace], [spoilt], Valve())


@pytest.mark.parametrize("number", range(35))
def test_slips_drawn_at_random_are_typed_errors_of_one_line(number: int) -> None:
    assert try_plant(number) == "refused"


@pytest.mark.parametrize("number", range(15))
def test_defects_of_recordings_drawn_at_random_are_typed_errors_of_one_line(number: int) -> None:
    assert try_recording(number) == "refused"


NEVER = """
import signal, time
# A job that a shell runs in the background ignores it, and so would this one.
signal.signal(signal.SIGINT, signal.default_int_handler)
from benchmarks.fuzz.slips import Heater
from valve_sim.identification.diagnosis.run import diagnose_plant

class Endless(Heater):
    def predict(self, values):
        if "{given}" in values or not "{given}":
            print("begun", flush=True)
            while True:
                time.sleep(0.01)
        return super().predict(values)

diagnose_plant(Endless(), None)
"""
ROOT = Path(__file__).parents[3]


# The check gives no zero of the sensor, fits do.
@pytest.mark.parametrize("given", ["", "zero"], ids=["when checked", "in the search"])
def test_a_plant_that_never_returns_ends_at_an_interrupt_with_its_name(given: str) -> None:
    environment = {**os.environ, "PYTHONPATH": os.pathsep.join([str(ROOT), os.environ.get("PYTHONPATH", "")])}
    command = [sys.executable, "-c", NEVER.format(given=given)]
    pipe = subprocess.PIPE
    with subprocess.Popen(command, cwd=ROOT, env=environment, stdout=pipe, stderr=pipe, text=True) as process:
        assert process.stdout is not None
        process.stdout.readline()
        process.send_signal(signal.SIGINT)
        try:
            _, errors = process.communicate(timeout=60.0)
        except subprocess.TimeoutExpired:
            process.kill()
            raise
    assert errors.strip().splitlines()[-1] == (
        "KeyboardInterrupt: Endless: interrupted while it was asked for predictions"
    )
