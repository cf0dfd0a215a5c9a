"""When inputs have jumped: between two readings, and a recording does not say where.

A logger samples a switched voltage, and the switch does not wait for it. Taken to act with the first reading that shows
it, or on a straight line from the one before, it acts at a wrong time, at each jump by another part of an interval, and
that would pass for an error of the machine.
"""

from __future__ import annotations

import itertools
import math
from collections.abc import Sequence
from typing import Final, NamedTuple

import numpy as np
from numpy.typing import NDArray

from valve_sim.identification.plants.protocol import Array, Nuisance
from valve_sim.identification.plants.recording_errors import CLOCK_SIGMA
from valve_sim.model.core.own.simulation import Inputs, level_at

PLAIN: Final = 0.05
"""Of an input's range: a change by more between two readings is a jump, if it rests on either side."""
SELDOM: Final = 0.1
"""Of the changes of a switched input at most that are jumps."""
RESTS: Final = 0.2
"""Of a jump, that the input changes by from the two readings before on, and to the two after it, at most."""
BESIDE: Final = 2
SPARSE: Final = 10.0
"""Times the interval of the outputs' samples, from which readings of an input are messages of its changes."""
MOST: Final = 64
"""Jumps of a recording whose times are estimated; of one with more none is."""
LONGEST: Final = 500_000
"""Readings of an input beyond which none is."""
APART: Final = 3.0
"""Intervals to the next jump, at least."""
FURTHEST: Final = 1.5
"""Intervals by which a jump may have been at another time."""
SMALL: Final = 0.01
"""Of an input's range: standard deviation of what may be its noise."""
FEWEST: Final = 8
"""Readings of a rest whose noise is averaged."""
PLAINLY: Final = 4.0
"""Standard deviations of von Neumann's ratio, beyond which more than noise is on a rest."""
STEP: Final = 1e-2
"""Of a difference quotient, in standard deviations."""
INPUT_EDGE: Final = "input_edge"


class Edge(NamedTuple):
    """A jump of inputs.

    Attributes:
        name: of the error of its time, s, which is added.
        time: s, of the first reading after it of an input that holds; in the middle between two of another one.
        interval: s, in which it lies. columns: the numbers of the inputs that jump.
        recording, number: of the recording, and of the jump in it, from 0 on.
    """

    name: str
    time: float
    interval: float
    columns: tuple[int, ...]
    recording: int = 0
    number: int = 0


def edges_of(recording: int, columns: Sequence[tuple[Array, Array]], held: Sequence[bool], rate: float) -> list[Edge]:
    """The jumps of the inputs of a recording whose times are to be estimated.

    Args:
        recording: its number. columns: (n,) s and (n,) levels of each input. held: which of them hold.
        rate: s, between samples of its outputs.
    """
    found: dict[float, tuple[float, list[int]]] = {}
    for number, ((times, levels), holds) in enumerate(zip(columns, held, strict=True)):
        steps = np.diff(times)
        is_sparse = len(steps) > 0 and holds and float(np.median(steps)) > SPARSE * rate
        for jump in jumps_of(levels, rests=not is_sparse).tolist():
            interval = math.sqrt(3.0) * CLOCK_SIGMA if is_sparse else float(steps[jump])
            time = float(times[jump + 1]) if holds else float(times[jump] + 0.5 * steps[jump])
            found.setdefault(time, (interval, []))[1].append(number)
    at = sorted(found)
    if len(at) > MOST or max((len(times) for times, _ in columns), default=0) > LONGEST:
        return []
    gaps = np.diff([-math.inf, *at, math.inf])
    return [
        Edge(f"{INPUT_EDGE}[{recording},{place}]", time, found[time][0], tuple(found[time][1]), recording, place)
        for place, time in enumerate(at)
        if min(gaps[place], gaps[place + 1]) > APART * found[time][0]
    ]


def jumps_of(levels: Array, *, rests: bool = True) -> NDArray[np.intp]:
    """The readings after which an input jumps, and before and after which it rests, if that is asked.

    One that jumps more often than it rests has none: what it does is not switching.
    """
    changes = np.abs(np.diff(levels))
    jumps = changes > PLAIN * np.ptp(levels) if len(changes) else np.zeros(0, dtype=bool)
    if rests and np.count_nonzero(jumps) > SELDOM * len(changes):
        return np.zeros(0, dtype=np.intp)
    for beside in range(1, BESIDE + 1 if rests else 1):
        jumps[beside:] &= changes[:-beside] < RESTS * changes[beside:]
        jumps[:-beside] &= changes[beside:] < RESTS * changes[:-beside]
    return np.flatnonzero(jumps)


class Level(NamedTuple):
    """A level at which a measured input rests, known as well as its noise lets the mean of its readings be known.

    Attributes:
        rests: the readings, from which to before which, of each of its rests. error: standard deviation of the mean.
    """

    rests: tuple[tuple[int, int], ...]
    error: float


def without_noise(levels: Array) -> tuple[Array, list[Level]]:
    """(n,) readings of a measured input, each rest between its jumps at its mean where nothing but noise is on it.

    Noise of a measured voltage drives a machine that never saw it. (By von Neumann's ratio: noise is what differs from
    reading to reading as much as over the whole rest.) Rests that do not differ have one level.
    """
    found, jumps, most = levels.copy(), jumps_of(levels) + 1, SMALL * float(np.ptp(levels))
    rests = []
    for first, last in itertools.pairwise([0, *jumps.tolist(), len(levels)]) if len(jumps) else ():
        own = levels[first:last]
        if len(own) >= FEWEST:
            of_neighbours = 0.5 * float(np.mean(np.square(np.diff(own))))
            if float(np.var(own)) <= min(most**2, (1.0 + PLAINLY / math.sqrt(len(own))) * of_neighbours):
                rests.append((float(np.mean(own)), math.sqrt(of_neighbours / len(own)), (first, last)))
    alike: list[list[tuple[float, float, tuple[int, int]]]] = []
    for one in sorted(rests):
        if alike and one[0] - alike[-1][-1][0] <= PLAINLY * math.hypot(one[1], alike[-1][-1][1]):
            alike[-1].append(one)
        else:
            alike.append([one])
    for group in alike:
        places = np.concatenate([np.arange(*own) for _, _, own in group])
        found[places] = np.mean(levels[places])
    return found, [
        Level(tuple(sorted(own for _, _, own in group)), math.fsum(error**-2.0 for _, error, _ in group) ** -0.5)
        for group in alike
        if all(error > 0.0 for _, error, _ in group)
    ]


class LevelError(NamedTuple):
    """What is added to an input while it rests at a level.

    Attributes:
        name: of it. column: the number of the input. spans: (k, 2) s, of the first and last reading of each rest.
    """

    name: str
    column: int
    spans: Array


def raised(inputs: Inputs, levels: Sequence[LevelError], by: Sequence[float]) -> Inputs:
    """Inputs with something added to each of some levels, in the unit of the input."""
    if not any(by):
        return inputs
    found = inputs.levels.copy()
    for level, more in zip(levels, by, strict=True):
        first = np.searchsorted(level.spans[:, 0], inputs.times, side="right") - 1
        rests = (first >= 0) & (inputs.times <= level.spans[np.maximum(first, 0), 1])
        found[rests, level.column] += more
    return Inputs(inputs.times, found, inputs.held)


def edge_errors(edges: Sequence[Edge], channels: tuple[int, ...], interval: float) -> list[Nuisance]:
    """The errors of the times of jumps.

    Args:
        edges: of a recording. channels: of it.
        interval: s, the longest of all recordings, whose errors share a size: anywhere in it is as likely.
    """
    sigma = interval / math.sqrt(3.0)
    begins = [edge.time - FURTHEST * edge.interval for edge in edges]
    return [
        Nuisance(
            edge.name, sigma, "s", channels, during, step=STEP * sigma, lower=-FURTHEST * edge.interval,
            upper=FURTHEST * edge.interval, error="input_edges", number=INPUT_EDGE, recording=edge.recording,
            part=edge.number,
        )
        for edge, during in zip(edges, itertools.pairwise([*begins, math.inf]), strict=True)
    ]  # fmt: skip


def with_edges(inputs: Inputs, edges: Sequence[Edge], by: Sequence[float]) -> Inputs:
    """Inputs that step at their jumps, each at another time.

    Args:
        inputs: that jump. edges: when. by: s, how much later each is, less than to any other jump.
    """
    if not edges or (not any(by) and all(inputs.held[list(edge.columns)].all() for edge in edges)):
        return inputs
    steps = np.array([edge.time + late for edge, late in zip(edges, by, strict=True)])
    # Where a straight line ends in a step there are two rows of one time.
    times = np.sort(np.concatenate([np.setdiff1d(inputs.times, steps), steps, steps]))
    levels = np.column_stack([
        level_at(times, inputs.times, own, is_held=bool(holds))
        for own, holds in zip(inputs.levels.T, inputs.held, strict=True)
    ])  # fmt: skip
    for edge, step in zip(edges, steps.tolist(), strict=True):
        at = int(np.searchsorted(times, step))
        for column in edge.columns:
            first, last, old, new = _ends(inputs, edge, column)
            levels[int(np.searchsorted(times, min(first, step))) : at + 1, column] = old
            levels[at + 1 : int(np.searchsorted(times, max(last, step))), column] = new
    return Inputs(times, levels, inputs.held)


def _ends(inputs: Inputs, edge: Edge, column: int) -> tuple[float, float, float, float]:
    """The times, s, between which a recording has a jump of an input, and the levels there."""
    own = inputs.levels[:, column]
    if inputs.held[column]:
        after = int(np.searchsorted(inputs.times, edge.time))
        return edge.time, edge.time, float(own[after - 1]), float(own[after])
    first, last = edge.time - 0.5 * edge.interval, edge.time + 0.5 * edge.interval
    old, new = np.interp([first, last], inputs.times, own).tolist()
    return first, last, old, new
