"""A valve that obeys late, as on a busy machine, is waited for as long as it was ever late; one that sticks is not."""

from __future__ import annotations

import numpy as np
import pytest

from valve_sim.files.parameter_files import default_valve
from valve_sim.identification.monitoring.findings import DidNotClose
from valve_sim.identification.monitoring.segmenter import StrokeSegmenter
from valve_sim.identification.monitoring.settings import MonitorSettings
from valve_sim.model import Drive, simulate

PERIOD = 2.0
"""s from stroke to stroke."""
OPEN = 0.05
"""s, as commanded."""


def faults(*late: float) -> list[float | None]:
    """When in each stroke the valve was said not to close, s after the command, or None.

    The valve closes so much later than the command was heard here, s; inf: not before the next stroke.
    """
    valve, times = default_valve(), np.arange(1, round(PERIOD * 500)) / 500
    segmenter, said = StrokeSegmenter(valve, MonitorSettings()), list[float | None]()
    for number, delay in enumerate(late):
        begin, closes = number * PERIOD, min(0.1 + OPEN + delay, PERIOD)
        positions = simulate(valve, Drive.of([0.1, closes], [9.0, 0.0]), times, start_time=0.0).pilot_position
        segmenter.command(begin + 0.1, 9.0)
        seen, before = None, segmenter.fault  # which stays until a stroke without one
        for time, position in zip(times.tolist(), positions.tolist(), strict=True):
            if time >= 0.1 + OPEN and time - 0.002 < 0.1 + OPEN:
                segmenter.command(begin + 0.1 + OPEN, 0.0)
            segmenter.measure(begin + time, position)
            if seen is None and segmenter.fault is not before and isinstance(segmenter.fault, DidNotClose):
                seen = time - 0.1 - OPEN
        said.append(seen)
    return said


def test_a_valve_is_waited_for_as_long_as_it_was_ever_late() -> None:
    assert faults(0.0, 0.08, 0.25, 0.5) == [None] * 4
    first, later = faults(0.25, 0.25)
    assert first == pytest.approx(0.1, abs=0.06), "of the first one nothing is known yet"
    assert later is None


def test_a_valve_that_does_not_close_is_said_all_the_same() -> None:
    healthy, late, stuck = faults(0.0, 0.08, np.inf)
    assert (healthy, late) == (None, None)
    assert stuck is not None
    assert 0.1 < stuck < 0.1 + 4 * 0.08
