"""Of a long recording, the strokes that a diagnosis looks at: of each kind a few, spread over the recording.

Strokes under the same commands repeat what one of them tells, with other noise; other commands tell something else, and
so does what is early and what is late. All commands stay, so that a coil is as warm and a tank as empty as it was:
only samples are left out. `identify`, `validate` and `info` see all of them.
"""

from __future__ import annotations

import math
from collections import defaultdict
from collections.abc import Callable, Sequence
from dataclasses import replace
from functools import partial
from typing import Any, Final, NamedTuple

import numpy as np
from numpy.typing import NDArray

from valve_sim.identification.plants.protocol import Array
from valve_sim.identification.plants.valve_sensors import STILL, still_mask
from valve_sim.recordings import Signal, Trace
from valve_sim.recordings.strokes import stroke_starts

MANY: Final = 200_000
"""Samples, of all sensors together, up to which a diagnosis takes them all: some 60 strokes of 80 ms at 20 kHz."""
ENOUGH: Final = 100_000
"""Samples that are wanted of more: with so many a search takes half a minute of CPU time (docs/results/measured.md)."""
FEWEST: Final = 24
"""Strokes that are taken at least, however many samples each has."""
AT_REST: Final = 400
"""Samples that are kept at each end of a long rest: enough for the colour of the noise."""
SAME: Final = 0.05
"""Relative difference of times between commands up to which strokes are of one kind."""

Kept = Callable[[Array], NDArray[np.bool_]]
"""(n,) times, s, to which of them are kept."""
Kind = tuple[tuple[float, int], ...]
Place = tuple[int, int]
"""A recording and the number of a stroke in it."""


class StrokeChoice(NamedTuple):
    """Which strokes were chosen.

    Attributes:
        recorded: how many strokes there are. kinds: how many that differ in their commands.
        chosen: (recording, stroke) of each, ascending; recordings and strokes count from 0.
        samples: of all sensors, that are left. of: of how many.
    """

    recorded: int
    kinds: int
    chosen: tuple[Place, ...]
    samples: int
    of: int


def choose_strokes(traces: Sequence[Trace]) -> tuple[list[Trace], StrokeChoice | None]:
    """The recordings with the samples of some strokes alone, where there are very many.

    Returns:
        the recordings as they are, and None, where they hold at most MANY samples; or else with the samples of about as
        many strokes as hold ENOUGH, and which.
    """
    total = sum(map(_count, traces))
    if total <= MANY:
        return list(traces), None
    kept = [_without_long_rests(trace) for trace in traces]
    places = [(index, stroke) for index, trace in enumerate(kept) for stroke in _sampled_strokes(trace)]
    groups: dict[Kind, list[Place]] = defaultdict(list)
    kinds = [stroke_kinds(trace) for trace in kept]
    for index, stroke in places:
        groups[kinds[index][stroke]].append((index, stroke))
    wanted = max(FEWEST, math.floor(len(places) * ENOUGH / max(1, sum(map(_count, kept)))))
    chosen = sorted(_spread_over([groups[kind] for kind in sorted(groups)], min(wanted, len(places))))
    for index, trace in enumerate(kept):
        numbers = np.array([stroke for number, stroke in chosen if number == index], dtype=np.int64)
        kept[index] = _within(trace, partial(_is_in, trace, numbers))
    used = [trace for trace in kept if _count(trace)]
    return used, StrokeChoice(len(places), len(groups), tuple(chosen), sum(map(_count, used)), total)


def _is_in(trace: Trace, strokes: NDArray[np.int64], times: Array) -> NDArray[np.bool_]:
    """(n,) which of the times belong to some of a recording's strokes."""
    kept, edges = np.zeros(len(times), dtype=bool), _edges(trace, times)
    for stroke in strokes.tolist():
        kept[edges[stroke] : edges[stroke + 1]] = True
    return kept


def _sampled_strokes(trace: Trace) -> list[int]:
    """The strokes of which anything was recorded."""
    return list(np.flatnonzero(np.diff(_edges(trace, trace.sample_times))).tolist())


def _edges(trace: Trace, times: Array) -> NDArray[np.intp]:
    """(k + 1,) where among ascending times those of each stroke begin, and where the last one's end.

    What comes before the first stroke belongs to it. Of a long recording nothing is held that is as long.
    """
    later = trace.drive.times[stroke_starts(trace.drive)[1:]]
    return np.concatenate([[0], np.searchsorted(times, later), [len(times)]]).astype(np.intp)


def stroke_kinds(trace: Trace) -> list[Kind]:
    """The kind of each stroke: its voltages, V, and how long each but the last was held, in steps of `SAME`."""
    drive, starts = trace.drive, stroke_starts(trace.drive).tolist()
    kinds = []
    for first, stop in zip(starts, [*starts[1:], len(drive.times)], strict=True):
        held = np.diff(drive.times[first:stop])
        steps = np.round(np.log(np.maximum(held, 1e-6)) / math.log1p(SAME)).astype(int).tolist()
        kinds.append(tuple(zip(np.round(drive.volts[first:stop], 2).tolist(), [*steps, 0], strict=True)))
    return kinds or [()]


def _spread_over(groups: Sequence[Sequence[Place]], wanted: int) -> list[Place]:
    """So many places of all groups: as many of each, as far as it has them, evenly over its own."""
    if len(groups) > wanted:
        groups = [groups[at] for at in np.round(np.linspace(0, len(groups) - 1, wanted)).astype(int)]
    shares = np.zeros(len(groups), dtype=int)
    left = wanted
    while left > 0:
        open_groups = [at for at, group in enumerate(groups) if shares[at] < len(group)]
        for at in open_groups[:left]:
            shares[at] += 1
        left -= len(open_groups[:left])
    chosen: list[Place] = []
    for group, share in zip(groups, shares.tolist(), strict=True):
        chosen += [group[at] for at in np.round(np.linspace(0, len(group) - 1, share)).astype(int)]
    return chosen


def _without_long_rests(trace: Trace) -> Trace:
    """The recording without the middle of each rest that is longer than noise and drift need.

    Behind a valve with gas the pressure still rises when nothing moves: nothing is left out of it.
    """
    if trace.outlet_pressure is not None:
        return trace
    times = trace.sample_times
    rests = [(start, stop) for start, stop in _rests(trace) if stop - start > 2 * AT_REST]
    if not rests:
        return trace
    begins = times[[start + AT_REST for start, _ in rests]]
    ends = times[[stop - AT_REST for _, stop in rests]]

    def is_kept(own: Array) -> NDArray[np.bool_]:
        place = np.searchsorted(begins, own, side="right") - 1
        return np.asarray((place < 0) | (own >= ends[np.maximum(place, 0)]))

    return _within(trace, is_kept)


def _rests(trace: Trace) -> list[tuple[int, int]]:
    """(start, stop) of the samples of each rest, from where what is judged no longer leaves its level.

    The first third of an interval between commands is never taken for noise; here it may be left out.
    """
    times, data = trace.primary_samples
    left_out = trace.left_out.any if trace.has_positions else None
    is_still = still_mask(trace.drive, trace.primary_samples, left_out=left_out).astype(np.int8)
    edges = np.flatnonzero(np.diff(np.concatenate([[0], is_still, [0]]))).reshape(-1, 2)
    commands = np.searchsorted(times, trace.drive.times)
    rests = []
    for start, stop in edges.tolist():
        before = commands[commands <= start]
        first, part = int(before[-1]) if len(before) else 0, data[start:stop]
        left = np.flatnonzero(np.abs(data[first:start] - np.median(part)) > STILL * max(float(np.std(part)), 1e-9))
        rests.append((first + (int(left[-1]) + 1 if len(left) else 0), stop))
    return rests


def _within(trace: Trace, is_kept: Kept) -> Trace:
    """The recording with some samples of what a fit compares; what drives the model stays whole."""
    mask = is_kept(trace.times)
    main = trace.main_position
    signals: dict[str, Any] = {}
    for name, signal in trace.signals("response").items():
        own = is_kept(signal.times)
        signals[name] = Signal(signal.times[own], signal.values[own])
    return replace(
        trace,
        times=trace.times[mask],
        pilot_position=trace.pilot_position[mask],
        main_position=None if main is None else main[mask],
        **signals,
    )


def _count(trace: Trace) -> int:
    """Samples of all that the valve does."""
    return len(trace.times) + sum(len(signal.times) for signal in trace.signals("response").values())
