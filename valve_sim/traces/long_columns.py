"""Statistics of long columns, which need no more memory beside them than one column, where NumPy's would take several.

What is worked out sample by sample is worked out a block at a time, and is to the last digit what it is all at once.
"""

from __future__ import annotations

from collections.abc import Callable, Iterator
from typing import Final

import numpy as np
from numpy.typing import NDArray

BLOCK: Final = 2**16
"""Samples: what is worked out of them stays near the processor."""

Array = NDArray[np.float64]
Part = Callable[[slice], Array]
Test = Callable[[slice], NDArray[np.bool_]]


def blocks(count: int) -> Iterator[slice]:
    """Return the parts of so many samples, in order."""
    return (slice(start, min(start + BLOCK, count)) for start in range(0, count, BLOCK))


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
