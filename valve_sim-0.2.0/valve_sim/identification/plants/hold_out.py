"""Which strokes a plant's owner would hold out: some of each condition, so that training sees every condition, too.

A condition is what a stroke was made under: for a valve the voltages of its commands and how long each was held.
Strokes taken by their number alone are all of one condition where conditions take turns: with 7.5, 9, 11 and 14 V in
turns every fourth stroke is one at 11 V, which a fit to the others has never seen.
"""

from __future__ import annotations

from collections.abc import Iterable
from typing import Final, Protocol, runtime_checkable

from valve_sim.identification.plants.protocol import Plant, strokes_of_plant

EVERY: Final = 4
"""One in so many strokes is held out."""
SEVERAL: Final = 3
"""Strokes under one condition, from which on one of them at least is held out."""

Stroke = tuple[int, int]
"""(recording, group)."""
Condition = tuple[float, ...]
"""Numbers by which conditions are equal or not, and are put in order: neighbours are alike."""


@runtime_checkable
class UnderConditions(Protocol):
    """A plant that knows under which condition each of its strokes was made: an optional member."""

    def condition_of(self, recording: int, group: int) -> Condition:
        """The condition of a stroke."""


def held_out_strokes(plant: Plant) -> frozenset[Stroke]:
    """About a quarter of a plant's strokes, to judge a fit to the others by.

    Of a condition that occurs several times some strokes are among them, never all; of conditions that occur twice,
    every other one lends a stroke. Where most strokes have a condition of their own, every fourth is held out in the
    order of conditions, and never the first or the last: what is between others is predicted, not what is beyond them.
    Without conditions it is every fourth in the order of time.

    Returns:
        (recording, group) of each; none where there are fewer than four strokes.
    """
    strokes = strokes_of_plant(plant)
    if len(strokes) < EVERY:
        return frozenset()
    if not isinstance(plant, UnderConditions):
        return frozenset(strokes[EVERY - 2 :: EVERY])
    alike = _by_condition(plant, strokes)
    repeated = [own for own in alike if len(own) > 1]
    if 2 * sum(map(len, repeated)) < len(strokes):
        ordered = [stroke for own in alike for stroke in own]
        return frozenset(ordered[1:-1][1::EVERY])
    pairs = [own for own in repeated if len(own) < SEVERAL]
    found = {own[-1] for own in pairs[::2]}
    for own in repeated:
        if len(own) >= SEVERAL:
            count = max(1, round(len(own) / EVERY))
            found.update(own[(2 * place + 1) * len(own) // (2 * count)] for place in range(count))
    return frozenset(found)


def _by_condition(plant: UnderConditions, strokes: Iterable[Stroke]) -> list[list[Stroke]]:
    """The strokes of each condition, in their order; conditions in theirs."""
    found: dict[Condition, list[Stroke]] = {}
    for stroke in strokes:
        found.setdefault(plant.condition_of(*stroke), []).append(stroke)
    return [found[condition] for condition in sorted(found)]
