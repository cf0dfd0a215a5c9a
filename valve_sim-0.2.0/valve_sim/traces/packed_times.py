"""Times of messages while a bag is read: whole nanoseconds, kept as what they deviate from even steps.

Stamps of a sensor deviate by microseconds, and need four bytes in place of eight; those of a simulation not at all.
"""

from __future__ import annotations

from typing import TYPE_CHECKING, Final, NamedTuple

import numpy as np

if TYPE_CHECKING:
    from numpy.typing import NDArray

NARROW: Final = (np.int16, np.int32)
"""What whole numbers are kept in: the first that holds them, or else int64."""
LARGEST_STEP: Final = 2**62
"""ns: of stamps that mean nothing; a larger one would not be an int64."""


class _Row(NamedTuple):
    """Times `first` + k `step`, ns, k from 0 on, and (size,) how far these are from that; None: they are there."""

    size: int
    first: int
    step: int
    deviations: NDArray[np.integer] | None


class PackedTimes:
    """Times to which more are added, int64 ns; what comes out is what was put in."""

    def __init__(self) -> None:
        self._rows: list[_Row] = []
        self._last: int | None = None
        self.is_ascending = True
        self._count = 0

    def __len__(self) -> int:
        """How many there are."""
        return self._count

    def extend(self, times: NDArray[np.int64]) -> None:
        """Add (n,) times."""
        if not len(times):
            return
        first, last, count = int(times[0]), int(times[-1]), len(times)
        step = (last - first) // (count - 1) if count > 1 else 0
        if abs(step) >= LARGEST_STEP:
            step = 0
        # Of nonsense these wrap around, and wrap back where the times are asked for.
        deviations = times - (first + step * np.arange(count))
        kept = narrowed(deviations)
        self._rows.append(_Row(count, first, step, kept if kept.any() else None))
        in_row = self.is_ascending and bool((times[1:] >= times[:-1]).all())
        self.is_ascending = in_row and (self._last is None or self._last <= first)
        self._last, self._count = last, self._count + count

    def absorb(self, later: PackedTimes) -> None:
        """Add those of another after these."""
        if later._last is None:
            return
        is_after = self._last is None or self._last <= later._rows[0].first
        self.is_ascending = self.is_ascending and later.is_ascending and is_after
        self._rows += later._rows
        self._last, self._count = later._last, self._count + len(later)

    def array(self) -> NDArray[np.int64]:
        """Return all of them, (n,) ns, in an array of their own."""
        found, start = np.empty(self._count, dtype=np.int64), 0
        for size, first, step, deviations in self._rows:
            own = found[start : start + size]
            own[:] = first + step * np.arange(size)
            if deviations is not None:
                own += deviations
            start += size
        return found


def narrowed(values: NDArray[np.int64]) -> NDArray[np.integer]:
    """Return the same whole numbers, (n,), n > 0, in as few bytes as hold them and the difference of any two."""
    low, high = int(values.min()), int(values.max())
    if low == high:
        return np.broadcast_to(values[:1].copy(), len(values))
    fits = (kind for kind in NARROW if 2 * max(abs(low), abs(high)) <= np.iinfo(kind).max)
    return values.astype(next(fits, np.int64), copy=False)
