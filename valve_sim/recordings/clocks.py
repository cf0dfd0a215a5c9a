"""When each sample was taken: reordered, duplicated and jumping stamps, and two clocks in one bag.

A recorder notes when a message arrived (bag time); a sensor stamps when it measured. The stamp is the better time, as
long as its clock did not jump. The neighbouring samples show whether a late message was only delivered late or has a
wrong stamp: a late message fills the gap that it left, a wrong stamp falls where there already is a sample.
"""

from __future__ import annotations

import itertools
from typing import TYPE_CHECKING, NamedTuple

import numpy as np

if TYPE_CHECKING:
    from collections.abc import Sequence

    from numpy.typing import NDArray

    Stamps = NDArray[np.int64]
    Delays = NDArray[np.integer]

SECOND = 1_000_000_000
"""ns."""

DAY = 86_400 * SECOND
"""Stamps and bag times further apart are of two clocks (model time from 0, wall time), not of one with a delay."""

LONG_DELAY = SECOND
"""Stamps older than this when recorded are reported: the clocks of two computers may differ."""

JUMP_RUN = 20
"""So many wrong stamps in a row mean that the clock was set, not that messages were misdelivered."""

FORWARD_JUMP = SECOND // 10
"""A step of the stamps that exceeds the step of bag time by so much, and stays so, means that the clock was set."""

MOST_DRIFT, SMALLEST_DRIFT, NOT_STEADY = 0.02, SECOND // 50, 0.15
"""Clocks of one rate differ by a smaller share of the time, or by fewer ns; so far from a line nothing is steady."""
ENOUGH = 2000
"""Samples that tell the rate of a clock."""

GAP_FACTOR = 3.0
"""An interval so many times the usual one is a gap."""


class Ordered(NamedTuple):
    """The samples to keep.

    Attributes:
        places: Where they are in the recording, in the order of their stamps, shape (n,); None: all, as they are.
        shift: What to add to the clock of the samples before a jump to get that of the samples kept, ns; for commands.
        findings: What was reordered and dropped.
    """

    places: NDArray[np.intp] | None
    shift: int
    findings: tuple[str, ...]


def order_samples(stamps: Stamps, delays: Delays, values: Sequence[NDArray[np.float64]], topic: str) -> Ordered:
    """Put samples into the order of their stamps; drop duplicates and those with a wrong stamp.

    Args:
        stamps: ns, shape (n,), in bag order.
        delays: What bag times, which ascend, are after the stamps, ns, shape (n,).
        values: (n,) each; a repeated stamp with equal values is a repeated message.
        topic: For the findings.
    """
    findings: list[str] = []
    if (stamps[1:] > stamps[:-1]).all() and not _jumps_forward(delays).any():
        return Ordered(None, 0, ())
    index = np.arange(len(stamps))
    index, lead = _without_foreign(index, stamps, delays, topic, findings)
    index = _without_repeated(index, stamps, values, topic, findings)
    index, shift = _longest_stretch(index, stamps, delays, topic, findings)
    index = _without_wrong(index, stamps, topic, findings)
    late = int(_is_late(stamps[index]).sum())
    if late:
        findings.append(
            f"{topic}: {late} of {len(stamps)} samples were recorded out of order and put back by their stamps"
        )
    return Ordered(index[np.argsort(stamps[index], kind="stable")], lead + shift, tuple(findings))


def _jumps_forward(delays: Delays) -> NDArray[np.bool_]:
    """Return after which samples the stamps step forward more than bag time, and so the delay falls."""
    return np.asarray(delays[:-1] - delays[1:] > FORWARD_JUMP)


def _is_late(stamps: Stamps) -> NDArray[np.bool_]:
    """Return which stamps are below an earlier one."""
    late: NDArray[np.bool_] = stamps < np.maximum.accumulate(stamps)
    return late


def _without_foreign(
    index: NDArray[np.intp], stamps: Stamps, delays: Delays, topic: str, findings: list[str]
) -> tuple[NDArray[np.intp], int]:
    """Drop stamps further from the others than the whole recording lasts (0, or another century).

    Returns the rest, and its lead as in `Ordered`: many such stamps mean that the clock was set while recording.
    """
    usual = np.sort(delays)[(len(delays) - 1) // 2]
    foreign = np.abs(delays - usual) > np.ptp(stamps + delays) + SECOND
    if not foreign.any():
        return index, 0
    first = stamps[np.argmax(foreign)] / SECOND
    findings.append(
        f"{topic}: dropped {foreign.sum()} of {len(stamps)} samples whose stamps are of another time "
        f"(first: {first:.3f} s)"
    )
    other = int(np.median(delays[foreign]))
    was_set = foreign.sum() >= JUMP_RUN and abs(other) < abs(int(usual))
    return index[~foreign[index]], other - int(usual) if was_set else 0


def _without_repeated(
    index: NDArray[np.intp], stamps: Stamps, values: Sequence[NDArray[np.float64]], topic: str, findings: list[str]
) -> NDArray[np.intp]:
    """Drop duplicated messages: same stamp and same values."""
    order = index[np.argsort(stamps[index], kind="stable")]
    same = np.diff(stamps[order]) == 0
    for column in values:
        numbers = np.nan_to_num(column[order])  # what is missing in both is the same
        same &= numbers[1:] == numbers[:-1]
    if not same.any():
        return index
    findings.append(f"{topic}: dropped {same.sum()} of {len(stamps)} samples that were recorded twice")
    return np.sort(order[np.concatenate([[True], ~same])])


def _misfits(stamps: Stamps) -> NDArray[np.bool_]:
    """Return which late samples do not fill a gap between those in order."""
    late = _is_late(stamps)
    result = np.zeros(len(stamps), dtype=bool)
    if not late.any():
        return result
    in_order = stamps[~late]
    usual = max(1.0, float(np.median(np.diff(np.unique(stamps)))))
    right = np.searchsorted(in_order, stamps[late])
    # The gap before the first sample has no end: a late sample from there always fits.
    hole = np.where(right == 0, np.inf, in_order[right] - in_order[right - 1])
    room = np.round(hole / usual) - 1
    crowd = np.bincount(right, minlength=len(in_order))[right]
    result[late] = (crowd > 1.1 * room) | (in_order[right] == stamps[late])
    return result


def _runs_start(flags: NDArray[np.bool_]) -> NDArray[np.intp]:
    """Return where runs of at least `JUMP_RUN` begin."""
    edges = np.flatnonzero(np.diff(np.concatenate([[0], flags.astype(np.int8), [0]])))
    starts, stops = edges[::2], edges[1::2]
    return starts[stops - starts >= JUMP_RUN]


def _longest_stretch(
    index: NDArray[np.intp], stamps: Stamps, delays: Delays, topic: str, findings: list[str]
) -> tuple[NDArray[np.intp], int]:
    """Cut where the clock was set, back or forward, and keep the longest stretch and its lead on the first clock."""
    kept_stamps = stamps[index]
    backward = _runs_start(_misfits(kept_stamps))
    forward = np.flatnonzero(_jumps_forward(delays[index])) + 1
    if len(backward) == 0:
        # A message delivered late is followed by a step forward, too: only a step that is not undone later is a jump.
        lowest_ahead = np.minimum.accumulate(kept_stamps[::-1])[::-1]
        forward = forward[lowest_ahead[forward] > np.maximum.accumulate(kept_stamps)[forward - 1]]
    cuts = np.union1d(backward, forward)
    cuts = cuts[[cut in backward or is_set for cut, is_set in zip(cuts, _are_set(delays[index], cuts), strict=True)]]
    if len(cuts) == 0:
        return index, 0
    stretches = np.split(index, cuts)
    usual = [int(np.median(delays[stretch])) for stretch in stretches]
    longest = int(np.argmax([len(stretch) for stretch in stretches]))
    shift = min(usual, key=abs) - usual[longest]
    jumps = ", ".join(
        f"{(before - after) / SECOND:+.3f} s at {(kept_stamps[cut - 1] - kept_stamps[0]) / SECOND:.3f} s"
        for cut, before, after in zip(cuts[:3], usual, usual[1:], strict=False)
    )
    findings.append(
        f"{topic}: the stamps' clock was set {len(cuts)} times ({jumps}); kept the longest stretch, "
        f"{len(stretches[longest])} of {len(stamps)} samples"
    )
    return stretches[longest], shift


def _are_set(delays: Delays, cuts: NDArray[np.intp]) -> list[bool]:
    """At which cuts the level of the delay falls, by more than it scatters: a recorder that stalls returns to it."""
    pieces = np.split(delays, cuts)
    ends = [np.quantile(piece, [0.1, 0.9]) if len(piece) >= JUMP_RUN else None for piece in pieces]
    found = []
    for before, after in itertools.pairwise(ends):
        if before is None or after is None:
            found.append(False)
        else:
            scatter = max(float(np.diff(before)[0]), float(np.diff(after)[0]))
            found.append(bool(before[0] - after[0] > max(FORWARD_JUMP, scatter)))
    return found


def _without_wrong(index: NDArray[np.intp], stamps: Stamps, topic: str, findings: list[str]) -> NDArray[np.intp]:
    wrong = _misfits(stamps[index])
    if wrong.any():
        findings.append(
            f"{topic}: dropped {wrong.sum()} of {len(stamps)} samples whose stamps jump back to where other samples are"
        )
    return index[~wrong]


def clock_offset(delays: Delays, topic: str) -> tuple[int, tuple[str, ...]]:
    """Return what to take from bag times to get the stamps' clock, ns, and what to say about it.

    Bag times and stamps are of one clock unless they are days apart; in that case the median difference is removed.

    Args:
        delays: What bag times are after the stamps, ns, shape (n,).
        topic: For what is said.
    """
    delay = int(np.median(delays))
    if abs(delay) > DAY:
        return delay, (
            f"{topic}: stamps and bag times are of two clocks, {delay / SECOND:.3f} s apart (median): commands and "
            "other messages without a header were moved onto the stamps' clock, good to the transport delay only",
        )
    if abs(delay) > LONG_DELAY:
        return 0, (
            f"{topic}: bag times are {delay / SECOND:.3f} s from the stamps (median) and were taken as the same clock; "
            "if the computers' clocks differ, commands and samples do not belong together: give clock: bag in a map",
        )
    return 0, ()


def clock_rate(delays: Delays, recorded: Stamps) -> float:
    """How far the stamps' clock advances in a second of bag time; 1 unless it steadily gains or loses.

    The clock of a simulation that is slower than real time does; a recorder that stalls makes no steady change.

    Args:
        delays: What bag times are after the stamps, ns, shape (n,). recorded: Bag times, ns, shape (n,).
    """
    if len(delays) < 5 * JUMP_RUN:
        return 1.0
    thinned = slice(None, None, max(1, len(delays) // ENOUGH))
    times = np.array([np.median(part) for part in np.array_split(recorded[thinned] - recorded[0], 5)])
    parts = np.array_split(delays[thinned] - delays[0], 5)
    low, late, high = np.transpose([np.quantile(part, [0.1, 0.5, 0.9]) for part in parts])
    change, span = late[-1] - late[0], times[-1] - times[0]
    if not abs(change) > max(SMALLEST_DRIFT, MOST_DRIFT * span):
        return 1.0
    off = np.abs(late - np.interp(times, times[::4], late[::4])).max()
    is_steady = off < NOT_STEADY * abs(change) and (high - low).max() < 2.0 * abs(change) / len(parts)
    return float(1.0 - change / span) if is_steady else 1.0


def find_gaps(times: NDArray[np.float64], factor: float = GAP_FACTOR) -> NDArray[np.intp]:
    """Return after which samples an interval is more than so many times the usual one."""
    intervals = np.diff(times)
    return np.flatnonzero(intervals > factor * np.median(intervals)) if len(intervals) else np.empty(0, np.intp)
