"""Commands out of a measured voltage, against steps that are known."""

from __future__ import annotations

import itertools

import numpy as np
import pytest

from valve_sim.traces import TraceError
from valve_sim.traces.voltage_steps import find_steps

RATE = 20_000.0
TRUTH = ((0.0, 0.0), (0.0101, 12.0), (0.0202, 6.0), (0.0413, 0.0), (0.0604, 9.0), (0.0805, 0.0))
"""Peak and hold, and an opening; s, V."""


def voltage(
    rise: float = 0.0, noise: float = 0.0, step: float = 0.0, probe: float = 0.0
) -> tuple[np.ndarray, np.ndarray]:
    """What a probe shows of TRUTH: edges that take `rise` s, white noise, a quantisation step, an offset."""
    times = np.arange(2000) / RATE
    volts = np.zeros(len(times))
    for (_, before), (start, after) in itertools.pairwise(TRUTH):
        share = np.clip((times - start) / rise, 0.0, 1.0) if rise else (times >= start).astype(float)
        volts += (after - before) * share
    volts += noise * np.random.default_rng(4).standard_normal(len(times)) + probe
    return times, np.round(volts / step) * step if step else volts


@pytest.mark.parametrize(
    ("settings", "tolerance"),
    [
        ({}, 26e-6),
        ({"noise": 0.02}, 26e-6),
        ({"noise": 0.1}, 30e-6),
        ({"step": 0.1}, 26e-6),
        ({"probe": 0.05, "noise": 0.01}, 26e-6),
        ({"rise": 150e-6, "noise": 0.02}, 110e-6),
        ({"rise": 1e-3, "noise": 0.02}, 560e-6),
    ],
)
def test_steps_are_found(settings: dict[str, float], tolerance: float) -> None:
    times, levels = find_steps(*voltage(**settings), "made")
    expected = np.array(TRUTH)
    assert len(times) == len(TRUTH)
    np.testing.assert_allclose(times, expected[:, 0], atol=tolerance)
    np.testing.assert_allclose(levels, expected[:, 1], atol=0.1)
    assert (levels[[0, 3, 5]] == 0.0).all()


def test_a_slow_edge_is_dated_in_its_middle() -> None:
    times, _ = find_steps(*voltage(rise=1e-3), "made")
    np.testing.assert_allclose(times[1:], np.array(TRUTH)[1:, 0] + 0.5e-3, atol=30e-6)


@pytest.mark.parametrize("level", [0.0, 9.0])
def test_a_voltage_without_steps_is_refused(level: float) -> None:
    times = np.arange(500) / RATE
    volts = level + 0.01 * np.random.default_rng(1).standard_normal(500)
    with pytest.raises(TraceError, match="no step in it, so no command"):
        find_steps(times, volts, "made")
