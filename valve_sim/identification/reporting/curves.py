"""What a report draws of each stroke: measured, and the model before and after, thinned without hiding extremes."""

from __future__ import annotations

from collections.abc import Iterator, Mapping
from dataclasses import dataclass
from typing import Final

import numpy as np
from numpy.typing import NDArray

from valve_sim.identification.diagnosis.run import Diagnosis
from valve_sim.identification.fit.gram import root_mean_square
from valve_sim.identification.fit.result import Fit
from valve_sim.identification.plants.protocol import Array, Channel, primary_channels
from valve_sim.identification.plants.valve import ValvePlant

DRAWN_POINTS: Final = 450
"""Most points drawn of a stroke: 100 strokes then make a report of some 2 MB."""


@dataclass(frozen=True)
class StrokeCurves:
    """One stroke of one channel; arrays are (n,), in display units.

    Attributes:
        title: recording and stroke. is_held_out: whether it took no part in the fit.
        time: ms. measured, before, after: in `unit`. noise: σ of the sensor, in `unit`.
        band: standard deviation that the corrected model predicts of measured − after, in `unit`; of held-out strokes
            its root mean square.
        root_mean_squares: of measured − before and measured − after, over all samples.
    """

    title: str
    is_held_out: bool
    quantity: str
    unit: str
    time: Array
    measured: Array
    before: Array
    after: Array
    noise: float
    band: Array
    root_mean_squares: tuple[float, float]

    def thinned(self) -> StrokeCurves:
        """At most `DRAWN_POINTS` samples: in each of equal bins, those at which a curve or residual is extreme."""
        curves = (self.measured, self.measured - self.before, self.measured - self.after)
        kept = keep_extremes(curves, DRAWN_POINTS)
        return StrokeCurves(
            self.title, self.is_held_out, self.quantity, self.unit, self.time[kept], self.measured[kept],
            self.before[kept], self.after[kept], self.noise, self.band[kept],
            self.root_mean_squares,
        )  # fmt: skip


def keep_extremes(curves: tuple[Array, ...], most: int) -> NDArray[np.int64]:
    """Indices of at most `most` samples: the ends, and in each of equal bins the minimum and maximum of each curve.

    Args:
        curves: (n,) each.
        most: more than 2 and the number of extremes of one bin.
    """
    count = len(curves[0])
    if count <= most:
        return np.arange(count)
    bins = max(1, (most - 2) // (2 * len(curves)))
    kept = {0, count - 1}
    for part in np.array_split(np.arange(count), bins):
        for curve in curves:
            kept.add(int(part[np.argmin(curve[part])]))
            kept.add(int(part[np.argmax(curve[part])]))
    return np.array(sorted(kept))


def strokes_of(diagnosis: Diagnosis) -> list[StrokeCurves]:
    """Every stroke of every channel: those that were fitted, then those held out.

    The channels in which errors are reported come first; then others that were fitted too, as a current.
    """
    before, after = diagnosis.before, diagnosis.after
    found = list(_strokes(before.fit, after.fit, after.bands, is_held_out=False))
    if before.holdout is not None and after.holdout is not None:
        found += _strokes(before.holdout, after.holdout, after.holdout_bands, is_held_out=True)
    return found


def _strokes(before: Fit, after: Fit, bands: Mapping[int, Array], *, is_held_out: bool) -> Iterator[StrokeCurves]:
    problem = before.problem
    shown_before, shown_after = (fitted.shown() for fitted in (before, after))
    judged = primary_channels(problem.plant)
    fitted = [index for index in range(len(problem.plant.channels)) if np.any(problem.weight(index) > 0.0)]
    for index in [*judged, *(index for index in fitted if index not in judged)]:
        channel, first, second = problem.plant.channels[index], shown_before[index], shown_after[index]
        takes_part = problem.weight(index) > 0.0
        sigma = problem.noise_of(index).sigma
        for group in np.unique(channel.group[takes_part]):
            chosen = takes_part & (channel.group == group)
            shown = first[chosen], second[chosen], bands[index][chosen]
            part = "stroke" if isinstance(problem.plant, ValvePlant) else "part"
            title = f"{channel.name}, {part} {int(group) + 1}" + (", held out" if is_held_out else "")
            yield _stroke(title, channel, chosen, shown, sigma, is_held_out=is_held_out)


def _stroke(
    title: str,
    channel: Channel,
    chosen: NDArray[np.bool_],
    shown: tuple[Array, Array, Array],
    sigma: float,
    *,
    is_held_out: bool,
) -> StrokeCurves:
    scale, unit = channel.readable
    measured = scale * channel.data[chosen]
    before, after, band = (scale * curve for curve in shown)
    errors = (root_mean_square(measured - before), root_mean_square(measured - after))
    return StrokeCurves(
        title, is_held_out, channel.kind, unit, 1e3 * channel.times[chosen], measured, before, after, scale * sigma,
        band, errors,
    )  # fmt: skip
