"""Readings that are no measurements of a position, found before anything is fitted: codes, repeats, spikes, clipping.

A wrong reading that is kept costs a fit more than many right ones that are left out; but a contact, a rebound or a lift
that was left out would cost it the very samples by which effects are told apart. So nothing is left out for being
unlikely under a model of the valve: codes are where no plunger can be, repeats are what the sensor's own noise
excludes, clipped readings are at an end of the range, and spikes (`spikes`) are off what their neighbours agree on.
"""

from __future__ import annotations

from dataclasses import dataclass, fields
from functools import cached_property
from typing import TYPE_CHECKING, Final, NamedTuple

import numpy as np

from valve_sim.signals.resting_noise import RestingNoise, resting_noise, step_of
from valve_sim.signals.spikes import FEWEST, LONGEST, find_spikes, reach

if TYPE_CHECKING:
    from numpy.typing import NDArray

    Array = NDArray[np.float64]
    Mask = NDArray[np.bool_]
    Places = NDArray[np.intp]

FARTHEST: Final = 1.6
"""Strokes from the median reading, beyond which a reading is a code: a plunger is within one of it."""
FEW_CODES: Final = 0.05
"""Share of the readings that may be codes; where more are far off, the valve may well be there."""
FASTEST: Final = 10.0
"""m/s; no plunger is so fast (those of the paper reach 0.5): a reading that comes and goes faster is no position."""
FEW_VALUES: Final = 3
"""Different readings, up to which what is far off is taken for codes, of a sensor that shows noise elsewhere."""
TRAVELS: Final = 25.0
"""Standard deviations of the noise that a travel exceeds, as `strokes.MOTION_SIGMAS` has it."""
FEWEST_REPEATED: Final = 3
"""Equal readings in a row from which they may be repeats; two are often equal by chance."""
SAME_LEVEL: Final = 10.0
"""Standard deviations within which readings are of one level: most of them are no repeats, if noise is seen there."""
HABIT: Final = 0.2
"""Share of readings that repeat, or of moves that follow repeats, above which the sensor works so."""
ALIKE: Final = (0.5, 2.0)
"""Speeds before, over and after repeats in motion, over that just before them: a stop is not left at once."""
RETURNS: Final = 0.5
"""Share of a jump, by which a dropout may end elsewhere than it began: the plunger may move meanwhile."""
RANGE_END: Final = 2e-6
"""m from an end of the range, within which clipped readings are one value, or three steps of a coarse sensor."""
ONE_VALUE: Final = 0.98
"""Share of the readings there, or beyond, that are this value, where they are clipped."""
PART_OF_THEM: Final = 0.05
"""Share of the readings that are this value, where a plunger rests so near to the range's end that noise reaches it."""
FEWEST_CLIPPED: Final = 20
"""Readings at one value, from which the former can be said, and times that it is come to, from which the latter can."""
PASSED: Final = 0.05
"""Readings beyond the end of the range over those at it, which spikes may have made; noise would make more."""
FINE: Final = 0.5
"""Standard deviations of the noise that a step is at most, where noise is known to pass each value."""
BIASED: Final = 16.0
"""Resting noise from an end of the range, within which noise is cut off: four standard deviations of what has a
correlation of 0.9, of which resting noise is a quarter."""
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
        codes: (n,) farther than 1.6 strokes from where the plunger usually is, as of a sensor that has lost its signal.
        repeated: (n,) equal to the reading before, in a row of at least three, where noise or motion excludes that.
        spikes: (n,) at most five in a row, more than six standard deviations off a curve on which their neighbours lie.
        clipped: (n,) at one end of the range, where many are one value and the noise is larger elsewhere, or beside it.
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


class _Rows(NamedTuple):
    """Equal readings in a row: where each row begins, and how many there are in it."""

    start: Places
    length: Places


def words_of(counts: dict[str, int]) -> str:
    """Return what is left out in words: "37 spikes, 4 codes"; empty where nothing is."""
    return ", ".join(f"{counts[reason]} {WORDS[reason][counts[reason] != 1]}" for reason in WORDS if counts.get(reason))


def find_left_out(times: Array, positions: Array, stroke: float) -> LeftOut:
    """Find the readings of a position that are no measurements.

    Args:
        times: Ascending, s, shape (n,).
        positions: m, shape (n,), finite.
        stroke: From closed to open, m; `usual_travel` where it is not declared. 0: not known, so there are no codes.

    Returns:
        The readings by reason. Spikes are looked for among those that are no codes and no repeats.
    """
    count = len(positions)
    none = np.broadcast_to(np.False_, count)
    if count < FEWEST:
        return LeftOut(none, none, none, none)
    times, positions = np.asarray(times, dtype=np.float64), np.asarray(positions, dtype=np.float64)
    with np.errstate(all="ignore"):
        codes = _beyond(positions, FARTHEST * stroke) if stroke > 0.0 else none
        rows = _equal_rows(positions)
        step = _step_within(positions, codes, rows)
        clipped = _clipped(positions, codes, rows, step)
        repeated = _repeated(times, positions, codes | clipped, rows, step)
        # Clipped readings are neighbours of spikes: they are where the plunger is, or next to it.
        spikes, others = np.zeros(count, dtype=bool), codes | repeated
        if others.any():
            kept = np.flatnonzero(~others)
            spikes[kept[find_spikes(times[kept], positions[kept], step, clipped[kept])]] = True
        else:
            spikes[find_spikes(times, positions, step, clipped)] = True
        spikes &= ~clipped
    return LeftOut(codes, repeated, spikes, clipped)


def usual_travel(times: Array, positions: Array) -> float:
    """Return the travel of a position without codes, m, in place of a stroke that nobody has declared.

    Few readings that are far from all others are not of the travel, if the others have moved already, and if they come
    and go faster than any plunger, or are the same few values though the sensor shows noise. So a valve that is open
    for a small part of a long recording is found to be open.

    Args:
        times: Ascending, s, shape (n,).
        positions: m, shape (n,).
    """
    count = len(positions)
    if count < FEWEST:
        return float(np.ptp(positions)) if count else 0.0
    times, positions = np.asarray(times, dtype=np.float64), np.asarray(positions, dtype=np.float64)
    with np.errstate(all="ignore"):
        middle = float(np.median(positions))
        apart = np.abs(positions - middle)
        few = int(FEW_CODES * count)
        usual = float(np.partition(apart, count - 1 - few)[count - 1 - few])
        tail = np.flatnonzero(apart > usual)
        tail = tail[np.argsort(apart[tail], kind="stable")]
        apart = apart[tail]
        rest = np.where(np.abs(positions - middle) > usual, middle, positions)
        low = np.minimum.accumulate(np.concatenate([[rest.min()], positions[tail]]))
        high = np.maximum.accumulate(np.concatenate([[rest.max()], positions[tail]]))
        travel = high - low
        for first in np.flatnonzero(apart > FARTHEST * travel[:-1]).tolist():
            is_far = np.zeros(count, dtype=bool)
            is_far[tail[first:]] = True
            if _are_codes(times, positions, is_far, float(travel[first])):
                return float(travel[first])
    return float(travel[-1])


def bridged(times: Array, values: Array, left_out: Mask) -> Array:
    """Return values, shape (n,), with those that are left out on straight lines between their neighbours."""
    if not left_out.any() or left_out.all():
        return values
    kept = ~left_out
    found = np.array(values)
    found[left_out] = np.interp(times[left_out], times[kept], values[kept])
    return found


def _are_codes(times: Array, positions: Array, is_far: Mask, travel: float) -> bool:
    """Whether readings that are far from all others, whose travel is given, are codes."""
    others = positions[~is_far]
    noise = resting_noise(others, step_of(others))
    if not travel > TRAVELS * noise.sigma + noise.seen:
        return False
    speeds = np.abs(np.diff(positions)) / np.diff(times)
    between = is_far[1:] != is_far[:-1]
    usual = ~is_far[1:] & ~is_far[:-1]
    # What moves as fast anyway is in another unit, which is for others to say.
    if float(np.max(speeds[usual], initial=0.0)) > FASTEST:
        return False
    if bool((speeds[between] > FASTEST).all()):
        return True
    return len(np.unique(positions[is_far])) <= FEW_VALUES and not noise.is_hidden


def _beyond(positions: Array, farthest: float) -> Mask:
    """(n,) readings that are farther than this from the median one, m."""
    return np.asarray(np.abs(positions - np.median(positions)) > farthest)


def _equal_rows(positions: Array) -> _Rows:
    """The rows of at least `FEWEST_REPEATED` equal readings."""
    equal = np.flatnonzero(positions[1:] == positions[:-1])
    edges = np.concatenate([[0], np.flatnonzero(np.diff(equal) > 1) + 1, [len(equal)]]).astype(np.intp)
    lengths = np.diff(edges) + 1
    is_long = lengths >= FEWEST_REPEATED
    return _Rows(equal[edges[:-1][is_long]], lengths[is_long])


def _step_within(positions: Array, codes: Mask, rows: _Rows) -> float:
    """The step of a sensor; readings at an end of its range need not be on the grid of the others."""
    values = positions[rows.start][~codes[rows.start]]
    known = positions[~codes] if codes.any() else positions
    if not len(values):
        return step_of(known)
    inner = known[(known < values.max()) & (known > values.min())]
    step = step_of(inner) if len(inner) >= FEWEST else 0.0
    return step or step_of(known)


def _clipped(positions: Array, codes: Mask, rows: _Rows, step: float) -> Mask:
    """(n,) readings at an end of the range, where the noise away from it is larger than what is seen there.

    What is so near to the end that noise would carry a part of it beyond goes with them: the rest of it is biased.
    """
    found = np.zeros(len(positions), dtype=bool)
    values = positions[rows.start][~codes[rows.start]]
    if not len(values):
        return found
    for end, sign in ((float(values.max()), 1.0), (float(values.min()), -1.0)):
        is_near = ~codes & (sign * (positions - end) > -max(RANGE_END, 3.0 * step))
        is_end = positions == end
        at_end, near = np.count_nonzero(is_end), np.count_nonzero(is_near)
        if at_end < max(FEWEST_CLIPPED, PART_OF_THEM * near):
            continue
        noise = resting_noise(positions[~is_near & ~codes], step)
        is_whole = at_end >= ONE_VALUE * near and not noise.is_hidden
        if is_whole or (step <= FINE * noise.sigma and noise.sigma > 0.0 and _is_partly_clipped(positions, end, sign)):
            found |= ~codes & (sign * (positions - end) > -BIASED * noise.sigma)
    return found


def _is_partly_clipped(positions: Array, end: float, sign: float) -> bool:
    """Whether a value of many readings is often come to, and next to never passed, as noise would pass it."""
    is_end = positions == end
    visits = np.count_nonzero(is_end[1:] & ~is_end[:-1])
    beyond = np.count_nonzero(sign * (positions - end) > 0.0)
    return bool(visits >= FEWEST_CLIPPED and beyond <= PASSED * np.count_nonzero(is_end))


def _repeated(times: Array, positions: Array, others: Mask, rows: _Rows, step: float) -> Mask:
    """(n,) equal readings in a row, where noise or motion excludes them; all but the first, unless that is wrong, too.

    Where there is a third one, the second is as old as that: while the plunger moves, it is as wrong.
    """
    is_own = ~others[rows.start]
    start, length = rows.start[is_own], rows.length[is_own]
    if not len(start):
        return np.zeros(len(positions), dtype=bool)
    noise = resting_noise(positions[~others], step)
    moves = int(np.count_nonzero(np.abs(np.diff(positions)) > noise.seen))
    is_fault = _but_no_habit(_are_passed_in_motion(times, positions, start, length, noise), moves)
    is_left = _are_left_at_once(times, positions, start, length, noise)
    is_dropout = _are_dropouts(positions, start, length, is_left)
    is_fault |= is_dropout
    if noise.is_hidden:
        # A rest that was held while the plunger left it: from when on, a sensor without noise does not tell.
        wrong = others | _covered(len(positions), start[is_dropout], length[is_dropout])
        is_fault |= _but_no_habit(is_left & ~_are_before(wrong, start + length), moves)
    is_long = length >= noise.longest_row(len(positions))
    if not noise.is_hidden and np.sum(length[is_long] - 1) <= HABIT * len(positions):
        is_free = ~others & ~_covered(len(positions), rows.start, rows.length)
        is_excluded = _are_beside_noise(positions[start], length, positions[is_free], noise)
        is_excluded |= is_left
        is_fault |= is_excluded & is_long
    start, length = start[is_fault], length[is_fault]
    kept = (~_are_entered_at_once(times, positions, start, noise)).astype(np.intp)
    return _covered(len(positions), start + kept, length - kept)


def _but_no_habit(is_fault: Mask, moves: int) -> Mask:
    """(r,) rows that are faults; none where many moves follow one, as of a sensor slower than its recorder."""
    return is_fault & (np.count_nonzero(is_fault) <= HABIT * moves)


def _covered(count: int, start: Places, length: Places) -> Mask:
    """(n,) which of so many readings are in rows, which do not overlap."""
    found = np.zeros(count + 1, dtype=np.int8)
    found[start] += 1
    np.subtract.at(found, start + length, 1)
    return np.cumsum(found[:-1], dtype=np.int8) > 0


def _are_beside_noise(values: Array, length: Places, free: Array, noise: RestingNoise) -> Mask:
    """(r,) whether most readings near the value of a row are in no row: the sensor shows its noise there.

    Args:
        values: (r,) what is read in each row. length: (r,) how often. free: readings that are in no row, of any order.
        noise: at rest.
    """
    near = SAME_LEVEL * noise.sigma + 3.0 * noise.step
    ends = values - near, values + near
    order = np.argsort(values, kind="stable")
    up_to = np.concatenate([[0], np.cumsum(length[order])])
    low, high = (np.searchsorted(values, end, sorter=order) for end in ends)
    free = np.sort(free)
    others = np.searchsorted(free, ends[1]) - np.searchsorted(free, ends[0])
    return np.asarray(others > up_to[high] - up_to[low])


def _are_left_at_once(times: Array, positions: Array, start: Places, length: Places, noise: RestingNoise) -> Mask:
    """(r,) whether readings after a row are at once where no plunger that rested gets to, and stay away."""
    last, count = start + length - 1, len(positions)
    interval = times[np.minimum(last + 1, count - 1)] - times[last]
    found = last + 1 < count
    for later in range(1, LONGEST + 2):
        place = np.minimum(last + later, count - 1)
        found &= np.abs(positions[place] - positions[last]) > noise.seen + reach(interval)
    return np.asarray(found)


def _are_dropouts(positions: Array, start: Places, length: Places, is_left: Mask) -> Mask:
    """(r,) to which of the rows that are left at once the position jumped from where it jumps back to.

    Between two of them a rest looks so, too: of neighbours the shortest are taken for dropouts.
    """
    last = np.minimum(start + length, len(positions) - 1)
    into, out = positions[start] - positions[np.maximum(start - 1, 0)], positions[last] - positions[start]
    may_be = is_left & (np.abs(into + out) < RETURNS * np.minimum(np.abs(into), np.abs(out)))
    rows = np.flatnonzero(may_be)
    found = np.zeros(len(start) + 2, dtype=bool)
    follows = np.concatenate([[False], start[1:] == start[:-1] + length[:-1], [False]])
    for row in rows[np.argsort(length[rows], kind="stable")].tolist():
        beside = (follows[row] and found[row]) or (follows[row + 1] and found[row + 2])
        found[row + 1] = not beside
    return found[1:-1]


def _are_before(wrong: Mask, stop: Places) -> Mask:
    """(r,) whether any of the readings after rows that stop there, which may be a spike, is wrong."""
    up_to = np.concatenate([[0], np.cumsum(wrong)])
    return np.asarray(up_to[np.minimum(stop + LONGEST + 1, len(wrong))] > up_to[stop])


def _are_entered_at_once(times: Array, positions: Array, start: Places, noise: RestingNoise) -> Mask:
    """(r,) whether a row begins with a jump that does not go on with the motion before: its first reading is wrong."""
    first = np.maximum(start, 2)
    jump = np.abs(positions[first] - positions[first - 1])
    before = np.abs(positions[first - 1] - positions[first - 2])
    return np.asarray(jump > noise.seen + 2.0 * before + reach(times[first] - times[first - 1]))


def _are_passed_in_motion(times: Array, positions: Array, start: Places, length: Places, noise: RestingNoise) -> Mask:
    """(r,) whether the plunger moved on during a row: the next reading catches up with it."""
    is_inside = (start > 1) & (start + length < len(positions) - 1)
    first, last = np.maximum(start, 2), np.minimum(start + length - 1, len(positions) - 3)

    def speed(index: Places) -> Array:
        return (positions[index] - positions[index - 1]) / (times[index] - times[index - 1])

    found = is_inside & (np.abs(positions[first] - positions[first - 1]) > noise.seen)
    over = (positions[last + 1] - positions[last]) / (times[last + 1] - times[first])
    for other in (speed(first - 1), over, speed(last + 2)):
        share = other / speed(first)
        found &= (share > ALIKE[0]) & (share < ALIKE[1])
    return np.asarray(found)
