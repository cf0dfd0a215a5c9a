"""Whether what differs from stroke to stroke follows the strokes: along a line, or by one step."""

from __future__ import annotations

import math
from typing import Final, Literal, NamedTuple

import numpy as np
from scipy.special import stdtr

from valve_sim.identification.fit.result import Fit
from valve_sim.identification.fit.unknown import Group
from valve_sim.identification.plants.protocol import Array
from valve_sim.identification.plants.variation import stroke_of, varies_in

FEWEST: Final = 5
"""Strokes, of which a change is told from chance."""
CHANCE: Final = 1e-3
"""Probability by chance, of deviations that are drawn for each stroke, below which they follow the strokes."""
SEEN: Final = 0.5
"""Share of its prior variance that is left of a deviation at most, for the data to have shown it."""


class Change(NamedTuple):
    """How something follows the strokes.

    Attributes:
        kind: of the curve. first, last: its deviations in the first and the last stroke, relative to the mean.
        stroke: number of the stroke, from 0 on, with which a step comes.
    """

    kind: Literal["line", "step"]
    first: float
    last: float
    stroke: int = 0


def changes_in(result: Fit, group: Group, size: float) -> dict[str, Change]:
    """What of a group follows the strokes, by name.

    Args:
        result: of a fit. group: of what varies from stroke to stroke. size: standard deviation of that, relative.
    """
    found: dict[str, list[tuple[int, float]]] = {}
    for own in result.nuisances:
        place = result.names.index(own.name)
        if own.group == group.key and result.covariance[place, place] < SEEN * size**2:
            found.setdefault(varies_in(own.name), []).append((stroke_of(own.name), result.values[own.name]))
    changes = {name: change_over(*np.array(pairs).T) for name, pairs in found.items()}
    return {name: change for name, change in changes.items() if change is not None}


def change_over(strokes: Array, deviations: Array) -> Change | None:
    """How deviations follow the strokes; None where draws would as well.

    Args:
        strokes: (n,) their numbers, ascending. deviations: (n,) relative.
    """
    if len(strokes) < FEWEST or np.ptp(deviations) <= 0.0:
        return None
    line = _chance(float(np.corrcoef(strokes, deviations)[0, 1]), len(strokes))
    edges = range(2, len(strokes) - 1)
    steps = {edge: _chance(_correlation_of_step(deviations, edge), len(strokes)) * len(edges) for edge in edges}
    edge = min(steps, key=lambda one: steps[one])
    if min(line, steps[edge]) >= CHANCE:
        return None
    if line <= steps[edge]:
        first, last = np.polyval(np.polyfit(strokes, deviations, 1), strokes[[0, -1]]).tolist()
        return Change("line", first, last)
    return Change("step", float(np.mean(deviations[:edge])), float(np.mean(deviations[edge:])), int(strokes[edge]))


def _correlation_of_step(deviations: Array, edge: int) -> float:
    return float(np.corrcoef(np.arange(len(deviations)) >= edge, deviations)[0, 1])


def _chance(correlation: float, count: int) -> float:
    """The probability, by Student's t, of a correlation as large between so many draws that have none."""
    free = count - 2
    return 2.0 * float(stdtr(free, -abs(correlation) * math.sqrt(free / max(1.0 - correlation**2, 1e-300))))
