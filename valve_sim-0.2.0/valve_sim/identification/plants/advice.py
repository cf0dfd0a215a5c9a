"""What to record next, in the words of a plant's owner."""

from __future__ import annotations

from typing import Final, NamedTuple

from valve_sim.identification.plants.protocol import Plant


class Advice(NamedTuple):
    """What a plant's owner should record next, in whole sentences without the full stop.

    Attributes:
        ambiguous: why one stroke cannot tell effects apart. first: after a single stroke. more: after several.
    """

    ambiguous: str
    first: str
    more: str


GENERIC_ADVICE: Final = Advice(
    "one stroke cannot tell an effect from what is refitted anyway",
    "Record next: at least eight strokes under different conditions, in one recording",
    "Record next: strokes under conditions not used yet",
)


def advice_of(plant: Plant) -> Advice:
    """The plant's own `advice`, an optional member, or general advice for any machine."""
    found = getattr(plant, "advice", GENERIC_ADVICE)
    return found if isinstance(found, Advice) else GENERIC_ADVICE
