"""Readings that are no measurements of a position, found before anything is fitted: codes, repeats, spikes, clipping.

A contact, a rebound or a lift that was left out would cost a fit the very samples by which effects are told apart. So
nothing is left out for being unlikely under a model of the valve, and what moves is given the benefit of the doubt: a
spike within what neighbouring samples move by is left to the weights of the fit, which knows the motion.
"""

from __future__ import annotations

from dataclasses import dataclass, fields
from functools import cached_property
from typing import TYPE_CHECKING, Final

import numpy as np

from valve_sim.recordings.resting_noise import SMALLEST, RestingNoise, resting_noise, step_of

if TYPE_CHECKING:
    from numpy.typing import NDArray

    Array = NDArray[np.float64]
    Mask = NDArray[np.bool_]
    Places = NDArray[np.intp]

SPIKE: Final = 6.0
"""Standard deviations off the running median, beyond which a reading is a spike."""
BESIDE: Final = 5
"""Readings on either side of one, of which the running median is; more in a row are no spike."""
FEWEST: Final = 40
"""Readings, of fewer of which nothing is said."""
FASTEST: Final = 10.0
"""m/s; no plunger is so fast (those of the paper reach 0.5): a reading that comes and goes faster is no position."""
LARGEST_ACCELERATION: Final = 1e4
"""m/s² of a plunger; 14 V make 400 of the paper's valve, and springs make 20."""
FARTHEST: Final = 1.6
"""Travels from the median reading, beyond which what is left out is called a code: a plunger is within one of it."""
FEWEST_REPEATED: Final = 3
"""Equal readings in a row from which they may be repeats; two are often equal by chance."""
HABIT: Final = 0.2
"""Share of the readings that repeat, or of moves that follow repeats, above which the sensor works so."""
FEWEST_CLIPPED: Final = 20
"""Readings at one value, and times that it is come to, from which it may be the end of the range."""
CLIPPED: Final = 0.05
"""Share of the readings near the end of the range that are at it, and over these of readings beyond it, by spikes."""
BIASED: Final = 16.0
"""Resting noise from an end of the range, within which noise is cut off: four standard deviations of what has a
correlation of 0.9, of which resting noise is a quarter."""
USUAL: Final = (0.9, 1.645)
"""Share of the readings that are no farther from the running median than noise is, and that in standard deviations."""
AT_ONCE: Final = 16_384
"""Medians that are worked out together, so that they stay in the processor's cache."""
SORTED: Final = (
    (0, 1), (2, 3), (4, 5), (6, 7), (8, 9), (1, 3), (5, 7), (0, 2), (4, 6), (8, 10), (1, 2), (5, 6), (9, 10), (0, 4),
    (3, 7), (1, 5), (6, 10), (4, 8), (5, 9), (2, 6), (0, 4), (3, 8), (1, 5), (6, 10), (2, 3), (8, 9), (1, 4), (7, 10),
    (3, 5), (6, 8), (2, 4), (7, 9), (5, 6), (3, 4), (7, 8),
)  # fmt: skip
"""Exchanges by which eleven columns are sorted (Knuth, The Art of Computer Programming 3, section 5.3.4): a quarter of
the time that sorting each row takes."""
WORDS: Final = {
    "spikes": ("spike", "spikes"),
    "repeated": ("repeated reading", "repeated readings"),
    "codes": ("code", "codes"),
    "clipped": ("clipped reading", "clipped readings"),
}
"""Reasons in the order in which they are said, and what one and several such readings are called."""


@dataclass(frozen=True, eq=False)
class LeftOut:
    """Which of n readings are no measurements, by reason; a reading has one reason at most.

    Attributes:
        codes: (n,) left out for any reason but clipping, and far from where the plunger ever is.
        repeated: (n,) equal to the reading before, in a row of at least three, where noise or motion excludes that.
        spikes: (n,) off the running median, or come to and left faster than any plunger moves.
        clipped: (n,) at one end of the range, where many are one value although there is noise, or beside it.
    """

    codes: Mask
    repeated: Mask
    spikes: Mask
    clipped: Mask

    @cached_property
    def any(self) -> Mask:
        """(n,) True where a reading is left out, for any reason."""
        return self.codes | self.repeated | self.spikes | self.clipped

    @cached_property
    def counts(self) -> dict[str, int]:
        """How many readings are left out, by reason."""
        return {reason.name: int(np.count_nonzero(getattr(self, reason.name))) for reason in fields(self)}


def words_of(counts: dict[str, int]) -> str:
    """Return what is left out in words: "37 spikes, 4 codes"; empty where nothing is."""
    return ", ".join(f"{counts[reason]} {WORDS[reason][counts[reason] != 1]}" for reason in WORDS if counts.get(reason))


def bridged(times: Array, values: Array, left_out: Mask) -> Array:
    """Return values, shape (n,), with those that are left out on straight lines between their neighbours."""
    if not left_out.any() or left_out.all():
        return values
    kept = ~left_out
    found = np.array(values)
    found[left_out] = np.interp(times[left_out], times[kept], values[kept])
    return found


def running_median(values: Array) -> Array:
    """(n,) the median of each value and of those beside it; the first and the last go on beyond the ends."""
    padded, found = np.pad(values, BESIDE, mode="edge"), np.empty(len(values))
    for start in range(0, len(values), AT_ONCE):
        stop = min(start + AT_ONCE, len(values))
        columns = [padded[start + shift : stop + shift] for shift in range(2 * BESIDE + 1)]
        for low, high in SORTED:
            columns[low], columns[high] = (
                np.minimum(columns[low], columns[high]),
                np.maximum(columns[low], columns[high]),
            )
        found[start:stop] = columns[BESIDE]
    return found


def largest_beside(values: Array, reach: int = BESIDE) -> Array:
    """(n,) the largest of each value and of so many on either side."""
    padded, count = np.pad(values, reach, mode="edge"), len(values)
    found = padded[:count].copy()
    for shift in range(1, 2 * reach + 1):
        np.maximum(found, padded[shift : shift + count], out=found)
    return found


def find_left_out(times: Array, positions: Array) -> LeftOut:
    """Find the readings of a position that are no measurements.

    Args:
        times: Ascending, s, shape (n,).
        positions: m, shape (n,), finite.
    """
    count = len(positions)
    none = np.broadcast_to(np.False_, count)
    if count < FEWEST:
        return LeftOut(none, none, none, none)
    times, positions = np.asarray(times, dtype=np.float64), np.asarray(positions, dtype=np.float64)
    with np.errstate(all="ignore"):
        times = _at_its_pace(times, positions)
        away = _too_fast(times, positions)
        step = step_of(positions[~away])
        clipped = _clipped(positions, away, step) & ~away
        noise = resting_noise(positions[~(away | clipped)], step)
        spikes, kept = away.copy(), np.flatnonzero(~away)
        spikes[kept[_off_the_median(positions[kept], noise)]] = True
        spikes &= ~clipped
        repeated = _repeated(times, positions, spikes, clipped, noise)
        if repeated.any():
            kept = np.flatnonzero(~(spikes | repeated | clipped))
            spikes[kept[_off_the_median(positions[kept], noise)]] = True
            spikes &= ~repeated
        wrong = spikes | repeated
        wrong[:-1] |= repeated[1:]
        travel = np.ptp(positions[~wrong]) if not wrong.all() else np.inf
        codes = wrong & (np.abs(positions - np.median(positions)) > FARTHEST * travel)
    return LeftOut(codes, repeated & ~codes, spikes & ~codes, clipped)


def _at_its_pace(times: Array, positions: Array) -> Array:
    """(n,) the times, or ones at which nothing is too fast: what usually is has another unit, which others say."""
    changes, intervals = np.abs(np.diff(positions)), np.diff(times)
    if not (changes > FASTEST * intervals).any():
        return times
    moves = changes > resting_noise(positions, 0.0).seen
    is_fast = moves.any() and np.median(changes[moves] / intervals[moves]) > FASTEST
    return times + np.arange(len(times)) if is_fast else times


def _too_fast(times: Array, positions: Array) -> Mask:
    """(n,) readings between a jump that no plunger makes and the one back; of neighbours the shorter."""
    found, changes = np.zeros(len(positions), dtype=bool), np.diff(positions)
    jumps = np.flatnonzero(np.abs(changes) > FASTEST * np.diff(times))
    if len(jumps) < 2:
        return found
    into, out = changes[jumps[:-1]], changes[jumps[1:]]
    comes_back = np.abs(into + out) < 0.5 * np.minimum(np.abs(into), np.abs(out))
    taken, middle = np.zeros(len(jumps) + 1, dtype=bool), float(np.median(positions))
    farthest = FARTHEST * float(np.ptp(np.quantile(positions, [0.05, 0.95])))
    for place in sorted(np.flatnonzero(comes_back).tolist(), key=lambda place: int(jumps[place + 1] - jumps[place])):
        own = slice(int(jumps[place]) + 1, int(jumps[place + 1]) + 1)
        values = positions[own]
        # What lies between the end of one fault and the beginning of another is right.
        is_fault = len(values) <= BESIDE or not np.ptp(values) or np.abs(values - middle).min() > farthest
        if is_fault and not (taken[place] or taken[place + 1]):
            taken[place : place + 2] = True
            found[own] = True
    return found


def _off_the_median(positions: Array, noise: RestingNoise) -> Mask:
    """(n,) readings that are off the running median by more than noise, and than positions beside them move by."""
    if not len(positions):
        return np.zeros(0, dtype=bool)
    median = running_median(positions)
    apart = np.abs(positions - median)
    usual = float(np.quantile(apart, USUAL[0])) / USUAL[1]
    sigma = max(usual, noise.sigma, SMALLEST, 0.5 * noise.step)
    # Five wrong readings shift a median by up to five moves; a rebound as short is as high as one and a quarter.
    moved = largest_beside(np.abs(np.diff(median, prepend=median[:1])), 2 * BESIDE)
    return np.asarray(apart > SPIKE * (sigma + moved))


def _equal_rows(positions: Array) -> tuple[Places, Places]:
    """(r,) where rows of at least `FEWEST_REPEATED` equal readings begin, and (r,) how many there are in each."""
    equal = np.flatnonzero(positions[1:] == positions[:-1])
    edges = np.concatenate([[0], np.flatnonzero(np.diff(equal) > 1) + 1, [len(equal)]]).astype(np.intp)
    lengths = np.diff(edges) + 1
    is_long = lengths >= FEWEST_REPEATED
    return equal[edges[:-1][is_long]], lengths[is_long]


def _clipped(positions: Array, away: Mask, step: float) -> Mask:
    """(n,) readings at an end of the range: a value of many, next to never passed although there is noise.

    What is so near to the end that noise would carry a part of it beyond goes with them: the rest of it is biased.
    """
    found = np.zeros(len(positions), dtype=bool)
    start, _ = _equal_rows(positions)
    values = positions[start][~away[start]]
    for end, sign in ((values.max(), 1.0), (values.min(), -1.0)) if len(values) else ():
        noise = resting_noise(positions[(positions != end) & ~away], step)
        near = ~away & (sign * (positions - end) > -BIASED * noise.sigma)
        at_end, beyond = (positions == end) & near, near & (sign * (positions - end) > 0.0)
        counts = [int(np.count_nonzero(own)) for own in (at_end, near, beyond)]
        if counts[0] < max(FEWEST_CLIPPED, CLIPPED * counts[1]) or counts[2] > CLIPPED * counts[0]:
            continue
        # All are at the end, or it is often come to: else the readings were held.
        if counts[0] < (1.0 - CLIPPED) * counts[1] and np.count_nonzero(np.diff(at_end)) < 2 * FEWEST_CLIPPED:
            continue
        # Between coarse steps noise shows at one rest, and not at the other.
        if noise.likeliest < HABIT and 2.0 * noise.likeliest * counts[1] < counts[0]:
            found |= near
    return found


def _repeated(times: Array, positions: Array, spikes: Mask, clipped: Mask, noise: RestingNoise) -> Mask:
    """(n,) equal readings in a row, all but the first, where noise or motion excludes them; of spikes that too."""
    count, kept = len(positions), np.flatnonzero(~spikes)
    values = positions[kept]
    start, length = _equal_rows(values)
    is_own = ~clipped[kept[start]]
    start, length = start[is_own], length[is_own]
    stop, last = start + length, len(values) - 1
    at, left = values[start], np.minimum(stop, last)
    after = values[np.minimum(stop + np.array([[0], [1], [BESIDE]]), last)]
    changes = np.stack([at - values[np.maximum(start - 1, 0)], after[0] - at, after[1] - after[0]])
    # A plunger that moves on meanwhile; or one that rested, and is at once where none gets to, and stays away.
    is_passed = (changes > noise.seen).all(axis=0) | (changes < -noise.seen).all(axis=0)
    is_passed &= np.abs(changes[1]) > np.abs(changes[0] + changes[2])
    reach = 0.5 * LARGEST_ACCELERATION * np.square(times[kept[left]] - times[kept[left - 1]])
    comes_back = (changes[0] * changes[1] < 0.0) & (np.abs(changes[0]) > noise.seen + reach)
    is_left = (np.abs(after - at) > noise.seen + reach).all(axis=0)
    is_passed |= noise.is_hidden & is_left & (comes_back | (np.abs(after[2] - after[0]) > noise.seen))
    is_long = (length >= noise.longest_row(count)) & (not noise.is_hidden)
    is_fault = is_passed & (
        np.count_nonzero(is_passed) <= HABIT * np.count_nonzero(np.abs(np.diff(values)) > noise.seen)
    )
    is_fault |= is_long & (np.sum(length[is_long] - 1) <= HABIT * count)
    found = np.zeros(count, dtype=bool)
    found[kept] = _covered(len(values), start[is_fault] + 1, stop[is_fault])
    start, length = _equal_rows(positions)
    found |= _covered(count, start[spikes[start]], (start + length)[spikes[start]])
    return found & ~clipped


def _covered(count: int, start: Places, stop: Places) -> Mask:
    """(n,) which of so many readings are in rows that do not overlap."""
    found = np.zeros(count + 1, dtype=np.int8)
    found[start] = 1
    np.subtract.at(found, stop, 1)
    return np.cumsum(found[:-1], dtype=np.int8) > 0
