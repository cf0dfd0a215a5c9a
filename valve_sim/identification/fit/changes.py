"""Whether what differs from stroke to stroke follows them along a line or by one step, or is there in some alone."""

from __future__ import annotations

import math
from typing import Final, Literal, NamedTuple

import numpy as np
from scipy.special import stdtr

from valve_sim.identification.fit.result import Fit
from valve_sim.identification.fit.unknown import Group
from valve_sim.identification.plants.protocol import Array, Nuisance

FEWEST: Final = 5
"""Strokes, of which a change is told from chance."""
CHANCE: Final = 1e-3
"""Probability by chance, of deviations that are drawn for each stroke, below which they follow the strokes."""
ABSENT: Final = 0.1
"""Of its size in the other strokes, below which something is not there."""
SEEN: Final = 0.5
"""Share of its prior variance that is left of a deviation at most, for the data to have shown it."""


class Change(NamedTuple):
    """How something follows the strokes.

    Attributes:
        kind: of the curve; or that it comes and goes.
        first, last: its deviations in the first and the last stroke, relative to the mean; where it is not, and is.
        strokes: numbers, from 0 on, of the stroke with which a step comes, or of those in which it is.
        others: of those in which it is not.
    """

    kind: Literal["line", "step", "some"]
    first: float
    last: float
    strokes: tuple[int, ...] = ()
    others: tuple[int, ...] = ()


def changes_in(result: Fit, group: Group, size: float) -> dict[str, Change]:
    """What of a group follows the strokes, by name.

    Args:
        result: of a fit. group: of what varies from stroke to stroke. size: standard deviation of that, relative.
    """
    found: dict[str, list[Nuisance]] = {}
    for own in result.nuisances:
        place = result.names.index(own.name)
        if own.group == group.key and result.covariance[place, place] < SEEN * size**2:
            found.setdefault(own.number, []).append(own)
    changes: dict[str, Change | None] = {}
    for name, each in found.items():
        places = [result.names.index(own.name) for own in each]
        # The mean of all, in which they err alike, says nothing of how they differ.
        errors = np.diag(np.linalg.inv(result.covariance[np.ix_(places, places)])) ** -0.5
        strokes, deviations = np.array([(own.part, result.values[own.name]) for own in each]).T
        changes[name] = change_over(strokes, deviations, errors)
    return {name: change for name, change in changes.items() if change is not None}


def change_over(strokes: Array, deviations: Array, errors: Array) -> Change | None:
    """How deviations follow the strokes; None where draws would as well.

    Args:
        strokes: (n,) their numbers, ascending. deviations: (n,) relative.
        errors: (n,) standard errors of each, the others given.
    """
    if len(strokes) < FEWEST or np.ptp(deviations) <= 0.0:
        return None
    line = _chance(float(np.corrcoef(strokes, deviations)[0, 1]), len(strokes))
    edges = range(2, len(strokes) - 1)
    steps = {edge: _chance(_correlation_of_step(deviations, edge), len(strokes)) * len(edges) for edge in edges}
    edge = min(steps, key=lambda one: steps[one])
    if min(line, steps[edge]) >= CHANCE:
        return _in_some(strokes, deviations, errors)
    if line <= steps[edge]:
        first, last = np.polyval(np.polyfit(strokes, deviations, 1), strokes[[0, -1]]).tolist()
        return Change("line", first, last)
    return Change("step", float(np.mean(deviations[:edge])), float(np.mean(deviations[edge:])), (int(strokes[edge]),))


def _in_some(strokes: Array, deviations: Array, errors: Array) -> Change | None:
    """Something that is alike in some strokes and not there in the others; None where draws would be that, too.

    The odds of two levels, whichever strokes have which, to draws about none: by their densities.
    """
    order = np.argsort(deviations)
    at = int(np.argmax(np.diff(deviations[order]))) + 1
    levels = np.empty(len(order))
    for own in (order[:at], order[at:]):
        levels[own] = np.average(deviations[own], weights=errors[own] ** -2)
    low, high = 1.0 + levels[order[0]], 1.0 + levels[order[-1]]
    spread = math.sqrt(float(np.mean(np.square(deviations))))
    apart = 0.5 * float(np.sum(np.square((deviations - levels) / errors)) - len(order))
    odds = float(np.sum(np.log(spread / errors))) - apart - len(order) * math.log(2.0)
    odds -= 2.0 * math.log(spread / float(np.min(errors)))
    if low > ABSENT * high or odds < -math.log(CHANCE):
        return None
    without, within = (tuple(np.sort(strokes[own]).astype(int).tolist()) for own in (order[:at], order[at:]))
    return Change("some", low - 1.0, high - 1.0, within, without)


def _correlation_of_step(deviations: Array, edge: int) -> float:
    return float(np.corrcoef(np.arange(len(deviations)) >= edge, deviations)[0, 1])


def _chance(correlation: float, count: int) -> float:
    """The probability, by Student's t, of a correlation as large between so many draws that have none."""
    free = count - 2
    return 2.0 * float(stdtr(free, -abs(correlation) * math.sqrt(free / max(1.0 - correlation**2, 1e-300))))
