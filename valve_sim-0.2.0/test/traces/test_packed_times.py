"""Times are kept in fewer bytes than they have, and come back as they were."""

import numpy as np
from hypothesis import given
from hypothesis import strategies as st

from valve_sim.traces.packed_times import PackedTimes, narrowed

ANY = st.integers(-(2**63), 2**63 - 1)
USUAL = st.integers(0, 2**40)


def packed(rows: list[list[int]]) -> PackedTimes:
    found = PackedTimes()
    for row in rows:
        found.extend(np.array(row, dtype=np.int64))
    return found


@given(st.lists(st.lists(st.one_of(ANY, USUAL), max_size=6), max_size=5), st.integers(0, 5))
def test_what_was_put_in_comes_out(rows: list[list[int]], cut: int) -> None:
    everything = [time for row in rows for time in row]
    found = packed(rows[:cut])
    found.absorb(packed(rows[cut:]))
    assert found.array().tolist() == everything
    assert len(found) == len(everything)
    assert found.is_ascending == (everything == sorted(everything))


@given(st.lists(ANY, min_size=1, max_size=6))
def test_narrow_numbers_are_the_same_and_so_are_their_differences(values: list[int]) -> None:
    wide = np.array(values, dtype=np.int64)
    found = narrowed(wide)
    assert found.tolist() == values
    if found.dtype != np.int64:
        assert np.diff(found).tolist() == np.diff(wide).tolist()
