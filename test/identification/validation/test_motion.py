"""What a replay keeps of a motion that is simulated in pieces."""

from dataclasses import replace

import numpy as np
import pytest

from identification.recordings import recorded
from valve_sim.files.parameter_files import default_valve
from valve_sim.identification.plants import valve_pieces
from valve_sim.identification.validation import replay
from valve_sim.identification.validation.replay import motion_of
from valve_sim.model import runs, simulate
from valve_sim.recordings import Signal


@pytest.mark.parametrize("judged", ["position", "current"])
def test_pieces_are_to_the_last_digit_what_one_simulation_gives(judged: str, monkeypatch: pytest.MonkeyPatch) -> None:
    trace, valve = recorded(), default_valve()
    times, nothing = trace.times, np.empty(0)
    if judged == "current":
        trace = replace(trace, times=nothing, pilot_position=nothing, coil_current=Signal(times, np.zeros(len(times))))
    whole = simulate(valve, trace.drive, times, start_time=-1e-3)
    monkeypatch.setattr(valve_pieces, "SAMPLES", 2)
    monkeypatch.setattr(runs, "EVENT_ROOM", 1)
    found = motion_of(valve, trace, trace.drive, times, -1e-3, 0.0)
    assert np.array_equal(found.shown, whole.pilot_position if judged == "position" else whole.coil_current)
    assert np.array_equal(found.is_moving, np.abs(whole.pilot_velocity) > replay.STILL_SPEED)
    assert found.is_moving.any()
    assert found.events == whole.events
    assert len(found.events) > len(trace.drive.times)
