"""Statistics of long columns, which need no more memory beside them than one column, where NumPy's would take several.

What is worked out sample by sample is worked out a block at a time, and is to the last digit what it is all at once.
"""

from __future__ import annotations

from collections.abc import Callable, Iterator, Sequence
from typing import Final

import numpy as np
from numpy.typing import NDArray

BLOCK: Final = 2**16
"""Samples: what is worked out of them stays near the processor."""

MERGED: Final = 16
"""Parts of which levels are merged at most: each takes the time of sorting all that were found."""

Array = NDArray[np.float64]
Part = Callable[[slice], Array]
Test = Callable[[slice], NDArray[np.bool_]]


def blocks(count: int, size: int = BLOCK) -> Iterator[slice]:
    """Return the parts of so many samples, in order, each of a size but for the last."""
    return (slice(start, min(start + size, count)) for start in range(0, count, size))


def filled(count: int, part: Part) -> Array:
    """Return a column of so many values, of which a function returns each part."""
    found = np.empty(count)
    for own in blocks(count):
        found[own] = part(own)
    return found


def median_of(values: Array) -> float:
    """Return the median of values that are not needed afterwards: they change places."""
    return float(np.median(values, overwrite_input=True))


def any_in(count: int, test: Test) -> bool:
    """Return whether a test is true of any of so many samples."""
    return any(bool(test(own).any()) for own in blocks(count))


def places_in(count: int, test: Test) -> NDArray[np.intp]:
    """Return of which samples a test is true."""
    found = [own.start + np.flatnonzero(test(own)) for own in blocks(count)]
    return np.concatenate(found) if found else np.empty(0, dtype=np.intp)


def extent(count: int, part: Part) -> tuple[float, float]:
    """Return the lowest and the highest of so many values, n > 0, of which a function returns each part."""
    ends = [(float(found.min()), float(found.max())) for found in map(part, blocks(count))]
    return min(low for low, _ in ends), max(high for _, high in ends)


def largest_size(values: Array) -> float:
    """Return the largest absolute value, 0 of none."""
    return float(max(abs(values.min()), abs(values.max()))) if len(values) else 0.0


def repeated_levels(columns: Sequence[Array]) -> Array:
    """Return the different values, ascending, rounded to 12 digits behind the point; none where few values repeat.

    Those are more than half as many as there are values.
    """
    total, levels = sum(map(len, columns)), np.empty(0)
    for column in columns:
        for own in blocks(len(column), max(BLOCK, total // MERGED)):
            levels = np.union1d(levels, np.round(column[own], 12))
            if len(levels) > total / MERGED:  # no coarse sensor's: all at once take less than merging so many
                return _sorted_levels(columns, total)
    return levels


def _sorted_levels(columns: Sequence[Array], total: int) -> Array:
    """Return the same of all values at once."""
    values, start = np.empty(total), 0
    for column in columns:
        np.round(column, 12, out=values[start : start + len(column)])
        start += len(column)
    values.sort()

    def is_new(own: slice) -> NDArray[np.bool_]:
        return np.not_equal(values[own.start + 1 : own.stop + 1], values[own])

    count = 1 + sum(int(np.count_nonzero(is_new(own))) for own in blocks(total - 1))
    if count > 0.5 * total:
        return np.empty(0)
    return np.take(values, np.concatenate([[0], places_in(total - 1, is_new) + 1]))
