"""A coil time constant that is off its declared value, to either side: the truth is the independent plant's."""

from __future__ import annotations

import pytest
from plants.declared import CAMPAIGN_VALVE
from plants.recording import Recorder

from benchmarks.campaign.declared import declared_valve
from identification.recordings import Short, recorded
from valve_sim.identification.diagnosis.outcome import Verdict
from valve_sim.identification.diagnosis.run import begin
from valve_sim.recordings import Trace

DECLARED = float(CAMPAIGN_VALVE["coil_time_constant"])  # type: ignore[arg-type]
SIGMA = 0.02 * DECLARED
LAG, WRONG = "coil_lag", "valve.coil_time_constant"


WITHIN = declared_valve(CAMPAIGN_VALVE, {"coil_time_constant": SIGMA})


def shown(**parameters: float) -> Trace:
    return recorded(Recorder(sample_rate=5e3), seed=5, pilot_damping=1.0, main_damping=4.0, **parameters)


def verdict(tolerances_off: float) -> Verdict:
    """Of few effects and all declared values."""
    trace = shown(coil_time_constant=DECLARED + tolerances_off * SIGMA)
    return begin(Short([trace], WITHIN, [LAG, "drive_gain"])).name().verdict


def named(found: Verdict) -> set[str]:
    return {*found.effects, *(other for others in found.confusable_with.values() for other in others)}


@pytest.mark.long
def test_a_coil_that_is_later_is_a_lag_and_one_that_is_earlier_has_a_wrong_value() -> None:
    """A larger time constant is a lag, and bears its name; no lag is negative."""
    later, earlier = verdict(8.0), verdict(-8.0)
    assert later.kind == earlier.kind == "effects"
    assert named(later) == {LAG}
    assert named(earlier) == {WRONG}


@pytest.mark.parametrize("tolerances_off", [-1.5, 1.5])
def test_a_value_within_its_tolerance_is_not_named(tolerances_off: float) -> None:
    assert verdict(tolerances_off).kind == "none"
