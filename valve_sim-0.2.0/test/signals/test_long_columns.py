"""Statistics of long columns are those of NumPy, whatever blocks they are worked out in."""

import numpy as np
import pytest

from valve_sim.signals.long_columns import BLOCK, largest_size, repeated_levels
from valve_sim.signals.motion import largest_travel, medians_of_three, sample_noise
from valve_sim.signals.resting_noise import MAD_TO_SIGMA
from valve_sim.traces.clocks import find_gaps, seconds_since, usual_interval

LENGTHS = [3, 4, BLOCK - 1, BLOCK, BLOCK + 1, BLOCK + 2, BLOCK + 3, 2 * BLOCK + 5]


@pytest.mark.parametrize("count", LENGTHS)
def test_what_spans_blocks_is_seen(count: int) -> None:
    random = np.random.default_rng(count)
    values = random.normal(size=count)
    assert largest_travel(values) == np.ptp(medians_of_three(values))
    assert largest_size(values) == np.abs(values).max()
    if count > 3:
        assert sample_noise(values) == MAD_TO_SIGMA * np.median(np.abs(np.diff(values, 2))) / np.sqrt(6.0)
    times = np.cumsum(random.exponential(size=count))
    assert usual_interval(times) == np.median(np.diff(times))
    assert find_gaps(times).tolist() == np.flatnonzero(np.diff(times) > 3.0 * np.median(np.diff(times))).tolist()
    stamps = np.sort(random.integers(0, 10**12, count))
    expected = (stamps - 17) / 1_000_000_000
    assert np.array_equal(seconds_since(17, stamps), expected)


@pytest.mark.parametrize("count", LENGTHS[2:])
def test_levels_are_those_of_all_columns(count: int) -> None:
    random = np.random.default_rng(count)
    for levels in (1000, count // 3):
        columns = [0.3e-6 * random.integers(0, levels, size) for size in (count, 5)]
        assert np.array_equal(repeated_levels(columns), np.unique(np.round(np.concatenate(columns), 12)))
    assert len(repeated_levels([random.normal(size=count)])) == 0
