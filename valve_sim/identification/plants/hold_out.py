"""Which strokes a plant's owner would hold out: some of each condition, so that training sees every condition, too.

A condition is what a stroke was made under: for a valve the voltages of its commands and how long each was held.
Strokes taken by their number alone are all of one condition where conditions take turns: with 7.5, 9, 11 and 14 V in
turns every fourth stroke is one at 11 V, which a fit to the others has never seen.
"""

from __future__ import annotations

from collections import defaultdict
from typing import Final

from valve_sim.identification.plants.protocol import Condition, Plant, strokes_of_plant

EVERY: Final = 4
"""One in so many strokes is held out."""
SEVERAL: Final = 3
"""Strokes under one condition, from which on one of them at least is held out."""

Stroke = tuple[int, int]
"""(recording, group)."""


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
    found = defaultdict[Condition, list[Stroke]](list)
    for stroke in strokes:
        condition = plant.condition_of(*stroke)
        if condition is None:
            return frozenset(strokes[EVERY - 2 :: EVERY])
        found[condition].append(stroke)
    alike = [found[condition] for condition in sorted(found)]
    repeated = [own for own in alike if len(own) > 1]
    if 2 * sum(map(len, repeated)) < len(strokes):
        ordered = [stroke for own in alike for stroke in own]
        return frozenset(ordered[1:-1][1::EVERY])
    pairs = [own for own in repeated if len(own) < SEVERAL]
    held_out = {own[-1] for own in pairs[::2]}
    for own in repeated:
        if len(own) >= SEVERAL:
            count = max(1, round(len(own) / EVERY))
            held_out.update(own[(2 * place + 1) * len(own) // (2 * count)] for place in range(count))
    return frozenset(held_out)
