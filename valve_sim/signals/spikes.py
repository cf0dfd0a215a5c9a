"""Spikes of a position: up to five readings in a row that are off what the readings before and after them agree on.

The readings on both sides have to lie on one parabola, so that a plunger in motion has spikes as one at rest has. Where
a contact bends its way two parabolas that meet explain all readings, and there is no spike. A rebound that is over
within a few readings is told by what it follows: no parabola goes through the arrival before it and the rest after it.
"""

from __future__ import annotations

import math
from typing import TYPE_CHECKING, Final, NamedTuple

import numpy as np

from valve_sim.signals.resting_noise import ENOUGH, MAD_TO_SIGMA, SMALLEST, resting_noise

if TYPE_CHECKING:
    from numpy.typing import NDArray

    Array = NDArray[np.float64]
    Mask = NDArray[np.bool_]
    Places = NDArray[np.intp]

FEWEST: Final = 40
"""Readings, of fewer of which nothing is said: a spike needs sixteen neighbours, and their usual scatter is unknown."""
SPIKE: Final = 6.0
"""Robust standard deviations off the curve through its neighbours, beyond which a reading is a spike."""
SUSPECT: Final = 4.5
"""Robust standard deviations off a quick estimate, beyond which a reading is looked at."""
COARSE: Final = 0.5
"""Steps of a coarse sensor that its noise is taken to be at least: what flickers by two of them is no spike."""
LONGEST: Final = 5
"""Readings in a row that are one spike."""
LONGEST_TIME: Final = 1.001e-3
"""s from the first to the last of these: a plunger that leaves its rest comes back later than after a millisecond."""
APART: Final = 3
"""Readings between suspects up to which they are of one crowd."""
LONGEST_CROWD: Final = LONGEST + 16
"""Readings in a row of which such a spike makes suspects: the quick estimate of eight on either side rests on it."""
SIDE: Final = 8
"""Neighbours on either side of a spike that have to lie on one parabola."""
LONG_SIDE: Final = 10
"""Neighbours that have to lie on a parabola on one side, where there is a contact on the other."""
SHORT_SIDE: Final = 3
"""Neighbours that have to lie on a parabola on the side of such a contact."""
MARGIN: Final = 2
"""Readings beside a crowd that are not taken for its neighbours: they may be of the spike's foot."""
CROWDED: Final = 4
"""Suspects among the neighbours on one side, beyond which nothing is said: there is a contact, or much noise."""
CALM: Final = 1.7
"""Usual scatter of neighbours about their parabola, up to which they agree: white noise has more at 1 place of 100."""
STILLEST: Final = 2.5
"""Resting noise, beyond which the usual scatter is that of motion: noise with a correlation of 0.9 has 2.2 of it."""
BENT: Final = 4.0
"""Robust standard deviations, within which all readings are that two parabolas explain which meet."""
LARGEST_ACCELERATION: Final = 1e4
"""m/s² of a plunger that flies between two contacts; 14 V make 400 of the paper's valve, and springs make 20."""
FASTER: Final = 2.0
"""Times the fastest motion that jumps to a spike and back exceed; a plunger that rebounds is slower than before."""
LOOKED_AT: Final = 1000
"""Places, spread over a recording, at which the usual scatter about parabolas is seen."""
AT_ONCE: Final = 4096
"""Crowds of readings that are worked out together: each takes a kilobyte."""
SHORTEST: Final = 1e-12
"""s that neighbours are apart at least, where their stamps are equal."""
DEPENDENT: Final = 1e-12
"""Information of one reading that is added to that of a curve, whose terms may depend on each other."""


class _Usual(NamedTuple):
    """Readings that are no suspects, ascending indices; their distance from parabolas, and the largest scatter, m."""

    places: Places
    sigma: float
    calm: float


class _Parabolas(NamedTuple):
    """What m parabolas through k neighbours each say of the w readings between them, or fewer.

    Attributes:
        places: (m, w) indices of these readings. inside: (m, w) whether there is one. off: (m, w) by how much, m.
        scatter: (m,) of the neighbours about the parabola, m; infinite where there are too few, or too far away.
        spread: (m,) their standard deviation, m. neighbours: (m, k) their indices.
    """

    places: Places
    inside: Mask
    off: Array
    scatter: Array
    spread: Array
    neighbours: Places


def find_spikes(times: Array, positions: Array, step: float, clipped: Mask) -> Places:
    """Return the indices of spikes, ascending.

    Args:
        times: Ascending, s, shape (n,).
        positions: m, shape (n,).
        step: By which they are rounded, m; 0 for none.
        clipped: (n,) Those whose noise is cut off.
    """
    nothing = np.empty(0, dtype=np.intp)
    suspect = _suspects(positions, step) if len(positions) >= FEWEST else np.zeros(0, dtype=bool)
    at = np.flatnonzero(suspect)
    if not len(at):
        return nothing
    usual = _usual(times, positions, np.flatnonzero(~suspect), step, clipped)
    if usual is None:
        return nothing
    ends = np.flatnonzero(np.diff(at) > APART)
    first, last = at[np.concatenate([[0], ends + 1])], at[np.concatenate([ends, [len(at) - 1]])]
    is_short = last - first < LONGEST_CROWD
    first, last = first[is_short], last[is_short]
    found = _come_and_go(times, positions, usual)
    for start in range(0, len(first), AT_ONCE):
        own = slice(start, start + AT_ONCE)
        for sides in ((SIDE, SIDE), (LONG_SIDE, SHORT_SIDE), (SHORT_SIDE, LONG_SIDE)):
            seen = _parabolas(times, positions, usual.places, (first[own], last[own]), sides)
            is_spike = _are_off(times, seen, usual, is_beside_contact=sides[0] != sides[1])
            rows = np.flatnonzero(is_spike.any(axis=1))
            rows = rows[~_are_bent(times, positions, seen, rows, usual)]
            found[seen.places[rows][is_spike[rows]]] = True
    return np.flatnonzero(found)


def reach(interval: Array) -> Array:
    """Return how far a plunger gets from rest within intervals, s, shape (m,), at the most, m."""
    return np.asarray(0.5 * LARGEST_ACCELERATION * np.square(interval))


def _suspects(positions: Array, step: float) -> Mask:
    """(n,) readings that are off the median of five estimates, each by a parabola through four neighbours.

    A median of neighbours would see nothing where a plunger moves by more in an interval than a spike is high.
    """
    wide, count = 2 * LONGEST, len(positions)
    around = np.pad(positions, wide, mode="reflect")
    both = {
        shift: around[wide - shift : wide - shift + count] + around[wide + shift : wide + shift + count]
        for shift in (1, 2, 3, 4, 5, 6, 8, 10)
    }
    said = [(4.0 * both[shift] - both[2 * shift]) / 6.0 for shift in range(1, LONGEST + 1)]
    apart = np.abs(positions - _median_of_five(*said))
    usual = float(np.median(apart[:: max(1, count // ENOUGH)]))
    return np.asarray(apart > max(SUSPECT * MAD_TO_SIGMA * usual, SPIKE * SMALLEST, LONGEST * COARSE * step))


def _median_of_five(a: Array, b: Array, c: Array, d: Array, e: Array) -> Array:
    """The medians of five columns."""
    a, b = np.minimum(a, b), np.maximum(a, b)
    c, d = np.minimum(c, d), np.maximum(c, d)
    # The least and the largest of these four are not in the middle.
    low, high = np.maximum(a, c), np.minimum(b, d)
    low, high = np.minimum(low, high), np.maximum(low, high)
    return np.asarray(np.maximum(low, np.minimum(high, e)))


def _usual(times: Array, positions: Array, places: Places, step: float, clipped: Mask) -> _Usual | None:
    """How far readings and neighbours usually are from parabolas at rest; None where nothing is seen of it."""
    seen = places[2 * SIDE : -2 * SIDE]
    is_cut_off = clipped.any()
    if is_cut_off:
        seen = seen[~clipped[seen]]
    if not len(seen):
        return None
    seen = seen[:: max(1, len(seen) // LOOKED_AT)]
    ordinary = _parabolas(times, positions, places, (seen, seen), (SIDE, SIDE))
    least = max(SMALLEST, COARSE * step)
    at_rest = STILLEST * resting_noise(positions[~clipped] if is_cut_off else positions, step).sigma
    calm = CALM * max(least, min(at_rest, float(np.quantile(ordinary.scatter, 0.25))))
    own = np.abs(ordinary.off[ordinary.scatter <= calm, MARGIN])
    return _Usual(places, max(least, MAD_TO_SIGMA * float(np.median(own))), calm) if len(own) else None


def _come_and_go(times: Array, positions: Array, usual: _Usual) -> Mask:
    """(n,) readings to which the position jumps and from which it jumps back, faster than the plunger ever moves.

    These need no neighbours that agree, and so are found beside a contact, too.
    """
    count, noise = len(positions), math.sqrt(2.0) * SPIKE * usual.sigma
    intervals, changes = np.diff(times), np.diff(positions)
    speeds = changes / intervals
    # A motion goes on: what a spike adds to a jump it takes from the next one.
    goes_on = speeds[1:] * speeds[:-1] > 0.0
    fastest = FASTER * float(np.max(np.minimum(np.abs(speeds[1:]), np.abs(speeds[:-1]))[goes_on], initial=0.0))
    at = np.flatnonzero(np.abs(changes) > fastest * intervals + noise)
    begin, end = at[:-1] + 1, at[1:]
    into, out = positions[begin] - positions[begin - 1], positions[end + 1] - positions[end]
    height = 0.25 * reach(times[end + 1] - times[begin - 1]) + np.abs(positions[end + 1] - positions[begin - 1])
    is_spike = (into * out < 0.0) & (np.minimum(np.abs(into), np.abs(out)) > height)
    is_spike &= (end - begin < LONGEST) & (times[end] - times[begin] <= LONGEST_TIME)
    found = np.zeros(count, dtype=bool)
    for begins, ends in zip(begin[is_spike].tolist(), end[is_spike].tolist(), strict=True):
        found[begins : ends + 1] = True
    return found


def _are_off(times: Array, seen: _Parabolas, usual: _Usual, *, is_beside_contact: bool) -> Mask:
    """(m, w) which readings are spikes, but for contacts."""
    apart = np.where(seen.inside, np.abs(seen.off), 0.0)
    is_off = apart > SPIKE * np.maximum(usual.sigma, seen.scatter)[:, None]
    first = np.argmax(is_off, axis=1)
    last = is_off.shape[1] - 1 - np.argmax(is_off[:, ::-1], axis=1)
    rows = np.arange(len(is_off))
    begin, end = seen.places[rows, first], seen.places[rows, last]
    is_short = (last - first < LONGEST) & ((first == last) | (times[end] - times[begin] <= LONGEST_TIME))
    is_spike = (seen.scatter <= usual.calm) & is_off.any(axis=1) & is_short
    if is_beside_contact:
        base = times[np.minimum(end + 1, len(times) - 1)] - times[np.maximum(begin - 1, 0)]
        # A flight of constant acceleration a is a T² / 8 high; what rests before and after does not fly between.
        is_spike &= (apart.max(axis=1) > 0.25 * reach(base)) | (seen.spread <= usual.calm)
    return np.asarray(is_off & is_spike[:, None])


def _are_bent(times: Array, positions: Array, seen: _Parabolas, rows: Places, usual: _Usual) -> Mask:
    """(r,) of which of these rows two parabolas that meet explain all readings: it is a contact."""
    places, neighbours = seen.places[rows], seen.neighbours[rows]
    every = np.concatenate([neighbours, places], axis=1)
    counts = np.concatenate([np.ones_like(neighbours, dtype=bool), seen.inside[rows]], axis=1)
    at, centre, scale = _scaled(times, every)
    values = positions[every] - np.median(positions[neighbours], axis=1)[:, None]
    freedom = np.maximum(counts.sum(axis=1) - 5, 1)
    found = np.zeros(len(rows), dtype=bool)
    for column in range(places.shape[1]):
        after = np.maximum(at - (times[places[:, column]][:, None] - centre) / scale, 0.0)
        left, _ = _left_by(np.concatenate([_powers(at), _powers(after)[..., 1:]], axis=-1), values, counts)
        is_calm = np.sum(np.square(left), axis=1) <= np.square(usual.calm) * freedom
        found |= is_calm & (np.abs(left).max(axis=1) <= BENT * usual.sigma)
    return found


def _parabolas(
    times: Array, positions: Array, usual: Places, spans: tuple[Places, Places], sides: tuple[int, int]
) -> _Parabolas:
    """Parabolas through the neighbours of spans of readings, by least squares.

    Args:
        times, positions: (n,). usual: ascending indices of readings that are no suspects.
        spans: (m,) the first and the last reading of each. sides: how many neighbours before and after.
    """
    count, width = len(positions), 2 * MARGIN + LONGEST_CROWD
    begin, end = np.maximum(spans[0] - MARGIN, 0), np.minimum(spans[1] + MARGIN, count - 1)
    before, after = np.searchsorted(usual, begin), np.searchsorted(usual, end, side="right")
    shifts = np.concatenate([np.arange(-sides[0], 0), np.arange(sides[1])])
    index = np.where(shifts < 0, before[:, None] + shifts, after[:, None] + shifts)
    is_known = (index[:, 0] >= 0) & (index[:, -1] < len(usual))
    near = usual[np.clip(index, 0, len(usual) - 1)]
    is_known &= (begin - near[:, 0] <= sides[0] + CROWDED) & (near[:, -1] - end <= sides[1] + CROWDED)
    if len(begin):
        width = min(width, 1 + int((end - begin).max()))
    places = begin[:, None] + np.arange(width)
    inside = places <= end[:, None]
    places = np.minimum(places, count - 1)
    at, centre, scale = _scaled(times, near)
    level = np.median(positions[near], axis=1)[:, None]
    left, curve = _left_by(_powers(at), positions[near] - level, np.ones(near.shape, dtype=bool))
    off = positions[places] - level - (_powers((times[places] - centre) / scale) @ curve)[..., 0]
    scatter = np.sqrt(np.sum(np.square(left), axis=1) / (len(shifts) - 3))
    scatter = np.where(is_known & np.isfinite(scatter), scatter, math.inf)
    return _Parabolas(places, inside, off, scatter, np.std(positions[near], axis=1), near)


def _scaled(times: Array, places: Places) -> tuple[Array, Array, Array]:
    """(m, k) times of places from −1 to 1, and (m, 1) the middle of each row and half its length, s."""
    own = times[places]
    low, high = own.min(axis=1)[:, None], own.max(axis=1)[:, None]
    centre, scale = 0.5 * (low + high), np.maximum(0.5 * (high - low), SHORTEST)
    return (own - centre) / scale, centre, scale


def _left_by(basis: Array, values: Array, counts: Mask) -> tuple[Array, Array]:
    """What least squares leave of (m, k) values by (m, k, p) columns, 0 where a value does not count; and (m, p, 1)."""
    basis = np.where(counts[..., None], basis, 0.0)
    values = np.where(counts, values, 0.0)
    normal = np.einsum("mki,mkj->mij", basis, basis)
    target = np.einsum("mki,mk->mi", basis, values)
    # Numbers that are too large to be squared are on no curve.
    is_known = np.isfinite(normal).all(axis=(1, 2)) & np.isfinite(target).all(axis=1)
    normal = np.where(is_known[:, None, None], normal, 0.0) + DEPENDENT * np.eye(basis.shape[-1])
    curve = np.linalg.solve(normal, target[..., None])
    return values - (basis @ curve)[..., 0], curve


def _powers(at: Array) -> Array:
    """(m, k, 3) powers 0 to 2 of (m, k) numbers."""
    return np.stack([np.ones_like(at), at, np.square(at)], axis=-1)
