"""What may be set on a valve that runs: what was refitted, is determined by the data, and predicts no worse."""

from __future__ import annotations

import numpy as np
import pytest

from identification.recordings import TRUTH, one_opening, shortened
from valve_sim.files.parameter_files import default_valve
from valve_sim.identification.diagnosis.handing_on import HandedOn, handed_on
from valve_sim.identification.diagnosis.identify import identify
from valve_sim.model import Drive
from valve_sim.recordings import Trace

EXACT_VALVE = default_valve().exact()


def found(trace: Trace, free: tuple[str, ...] = ("pilot_damping", "main_damping")) -> HandedOn:
    result = identify([trace], EXACT_VALVE, free)
    return handed_on(result.fit, result.intervals)


def test_what_the_recording_determines_is_set() -> None:
    whole = found(one_opening())
    assert (whole.objection, whole.held) == ("", ())
    assert whole.valve.declared()["main_damping"] == pytest.approx(TRUTH["main_damping"], rel=0.1)


def still() -> Trace:
    times = np.arange(0.0, 0.2, 1e-4)
    noise = np.random.default_rng(1).normal(0.0, 1e-6, len(times))
    return Trace("still", Drive.of([0.05, 0.1], [0.5, 0.0]), times, noise)


@pytest.mark.parametrize("trace", [still(), shortened(one_opening(), 0.0145)], ids=["never moves", "cut in Phase 1"])
def test_of_a_recording_that_determines_neither_damping_nothing_is_set(trace: Trace) -> None:
    handed = found(trace)
    assert handed.objection == "the recording does not determine pilot_damping, main_damping"
    assert handed.valve == EXACT_VALVE


def test_an_effect_that_may_as_well_be_absent_is_not_set_and_what_is_beside_it_is() -> None:
    handed = found(one_opening(pilot_damping=1.0, main_damping=3.0), ("main_damping", "coulomb_friction.force"))
    assert (handed.objection, handed.held) == ("", ("coulomb_friction.force",))
    assert not handed.valve.effects
    assert handed.valve.declared()["main_damping"] == pytest.approx(3.0, rel=0.1)


def test_a_damping_that_predicts_worse_than_the_declared_one_without_a_force_that_is_held_back_is_not_set() -> None:
    handed = found(one_opening(3, pilot_damping=1.0, main_damping=4.0), ("main_damping", "constant_force.force"))
    assert handed.held == ("constant_force.force",)
    assert handed.objection
