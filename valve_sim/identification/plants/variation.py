"""What differs of a machine from stroke to stroke: a factor 1 + δ of a parameter in each, with a size that is learned.

Estimates of such a parameter are then of the mean stroke. A plant of one's own takes the nuisances of
`group_variations` as its `varying`, and multiplies the parameter by `group_factors` where it predicts.
"""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from typing import Final

import numpy as np

from valve_sim.identification.plants.protocol import Array, Channel, Nuisance

VARIATION: Final = "stroke_variation"
LARGEST: Final = 0.9
"""Of δ: a stroke's number keeps its sign."""
SMALL_SHARE: Final = 1e-4
"""Step of δ in a difference quotient."""


def variation_name(recording: int, stroke: int, what: str) -> str:
    """The name of δ of something in a stroke of a recording."""
    return f"{VARIATION}[{recording},{stroke},{what}]"


def stroke_of(name: str) -> int:
    """The number of the stroke in such a name.

    Raises:
        ValueError: it is another name.
    """
    return int(_parts(name)[1])


def varies_in(name: str) -> str:
    """What varies, by such a name.

    Raises:
        ValueError: it is another name.
    """
    return _parts(name)[2]


def _parts(name: str) -> list[str]:
    kind, _, rest = name.partition("[")
    parts = rest.removesuffix("]").split(",")
    if kind != VARIATION or not rest.endswith("]") or len(parts) != 3:
        raise ValueError(name)
    return parts


def variation(
    own: tuple[int, int, str], scale: float, group: str, channels: tuple[int, ...], during: tuple[float, float],
    bounds: tuple[float, float] = (-LARGEST, LARGEST),
) -> Nuisance:  # fmt: skip
    """δ in one stroke.

    Args:
        own: recording, stroke, and what varies. scale: of the half-normal prior of its size.
        group: what shares that size. channels, during: of the stroke. bounds: of δ.
    """
    low, high = bounds
    return Nuisance(
        variation_name(*own), scale, "–", channels, during, SMALL_SHARE, lower=low, upper=high, error=VARIATION,
        group=group,
    )  # fmt: skip


def group_variations(channels: Sequence[Channel], scales: Mapping[str, float]) -> tuple[Nuisance, ...]:
    """What varies from group to group of a plant's channels, the `varying` of a plant of one's own.

    Each thing that varies has one size in all recordings. Of a single group there is none: a parameter that differs
    in it is another parameter.

    Args:
        channels: of the plant.
        scales: by what varies, a parameter say, the scale of the half-normal prior of its relative standard deviation.
    """
    spans: dict[tuple[int, int], list[tuple[int, float]]] = {}
    for index, channel in enumerate(channels):
        numbers, begins = np.unique(channel.group, return_index=True)
        for number, begin in zip(numbers.tolist(), channel.times[begins].tolist(), strict=True):
            spans.setdefault((channel.recording, number), []).append((index, begin))
    if len(spans) < 2:
        return ()
    starts = {own: min(begin for _, begin in found) for own, found in spans.items()}
    first = min(recording for recording, _ in spans)
    found = []
    for (recording, stroke), parts in sorted(spans.items()):
        begin = starts[recording, stroke]
        later = [at for (other, _), at in starts.items() if other == recording and at > begin]
        during = begin, min(later, default=np.inf)
        indices = tuple(index for index, _ in parts)
        for what, scale in scales.items():
            found.append(variation((recording, stroke, what), scale, f"{what}[{first}]", indices, during))
    return tuple(found)


def group_factors(channel: Channel, what: str, values: Mapping[str, float]) -> Array:
    """(n,) 1 + δ of something that varies, at each sample of a channel; 1 where the values say nothing of it.

    Args:
        channel: of the plant. what: as `group_variations` has it. values: see `predict`.
    """
    found = np.ones(len(channel.times))
    for number in np.unique(channel.group).tolist():
        deviation = values.get(variation_name(channel.recording, number, what), 0.0)
        if deviation:
            found[channel.group == number] = 1.0 + deviation
    return found
