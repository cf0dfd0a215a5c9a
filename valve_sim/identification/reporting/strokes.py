"""What a report draws of each stroke: measured, the model before and after, and positions that the current gives."""

from __future__ import annotations

from collections.abc import Iterator, Mapping
from typing import Any, Final, NamedTuple

import numpy as np
from numpy.typing import NDArray

from valve_sim.identification.diagnosis.followed_positions import followed_positions
from valve_sim.identification.diagnosis.outcome import Diagnosis
from valve_sim.identification.fit.gram import root_mean_square
from valve_sim.identification.fit.result import Fit
from valve_sim.identification.plants.protocol import Array, Followed, primary_channels
from valve_sim.identification.reporting.document import Line, Panel, Plot
from valve_sim.identification.reporting.units import quantity, three_digits

DRAWN_POINTS: Final = 450
"""Most points drawn of a stroke: 100 strokes then make a report of some 2 MB."""
FOLLOWED_POINTS: Final = 200
"""Most points of a position that follows from the current."""
MICRO: Final = 1e6


class StrokeCurves(NamedTuple):
    """One stroke of one channel; arrays are (n,), in display units.

    Attributes:
        title: recording and stroke. is_held_out: whether it took no part in the fit. quantity: kind of the channel.
        time: ms. measured, before, after: in `unit`.
        band: standard deviation that the corrected model predicts of measured − after, in `unit`; of held-out strokes
            its root mean square.
    """

    title: str
    is_held_out: bool
    quantity: str
    unit: str
    time: Array
    measured: Array
    before: Array
    after: Array
    band: Array

    @property
    def root_mean_squares(self) -> tuple[float, float]:
        """Of measured − before and of measured − after, in `unit`."""
        return root_mean_square(self.measured - self.before), root_mean_square(self.measured - self.after)

    def plot(self) -> Plot:
        """Of at most `DRAWN_POINTS` samples: in each of equal bins, those at which a curve or residual is extreme."""
        models = {"before": self.before, "after": self.after}
        if np.array_equal(self.before, self.after):  # nothing is corrected
            del models["before"]
        residuals = {name: self.measured - model for name, model in models.items()}
        kept = keep_extremes((self.measured, *residuals.values()), DRAWN_POINTS)
        above = [Line(name, model[kept]) for name, model in {"measured": self.measured, **models}.items()]
        below = [Line(name, left[kept]) for name, left in residuals.items()]
        panels = [
            Panel(f"{self.quantity}, {self.unit}", above),
            Panel(f"residual, {self.unit}", below, -2.0 * self.band[kept], 2.0 * self.band[kept], has_zero=True),
        ]
        errors = " → ".join(three_digits(root_mean_square(left)) for left in residuals.values())
        return Plot(self.title, f"rms {errors} {self.unit}", self.time[kept], "time, ms", panels)


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
            kept |= {int(part[np.argmin(curve[part])]), int(part[np.argmax(curve[part])])}
    return np.array(sorted(kept))


def strokes_of(diagnosis: Diagnosis) -> list[StrokeCurves]:
    """Every stroke of every channel: those that were fitted, then those held out.

    The channels in which errors are reported come first; then others that were fitted too, as a current.
    """
    before, after = diagnosis.before, diagnosis.after
    strokes = list(_strokes(before.fit, after.fit, after.bands, is_held_out=False))
    if before.holdout is not None and after.holdout is not None:
        strokes += _strokes(before.holdout, after.holdout, after.holdout_bands, is_held_out=True)
    return strokes


def _strokes(before: Fit, after: Fit, bands: Mapping[int, Array], *, is_held_out: bool) -> Iterator[StrokeCurves]:
    problem = before.problem
    plant, shown_before, shown_after = problem.plant, before.shown(), after.shown()
    judged = primary_channels(plant)
    fitted = [index for index in range(len(plant.channels)) if np.any(problem.weight(index) > 0.0)]
    for index in [*judged, *(index for index in fitted if index not in judged)]:
        channel, takes_part = plant.channels[index], problem.weight(index) > 0.0
        scale, unit = channel.readable
        every = (channel.data, shown_before[index], shown_after[index], bands[index])
        for group in np.unique(channel.group[takes_part]):
            chosen = takes_part & (channel.group == group)
            title = f"{channel.name}, {plant.wording.part} {int(group) + 1}" + (", held out" if is_held_out else "")
            curves = (scale * values[chosen] for values in every)
            yield StrokeCurves(title, is_held_out, channel.kind, unit, 1e3 * channel.times[chosen], *curves)


def worst_first(diagnosis: Diagnosis, most: int) -> tuple[list[StrokeCurves], list[StrokeCurves]]:
    """Strokes of the channels in which errors are reported, and of others that were fitted too, as a current.

    Of the first, those that the declared model misses most come before the others; either in the order of recording.
    """
    strokes = strokes_of(diagnosis)
    kind = diagnosis.primary_channel.kind
    judged = [stroke for stroke in strokes if stroke.quantity == kind]
    errors = [stroke.root_mean_squares[0] for stroke in judged]
    names = [stroke.title.partition(", stroke ")[0] for stroke in judged]
    worst = sorted(range(len(judged)), key=lambda index: -errors[index])

    def recorded(index: int) -> tuple[int, float]:
        return names.index(names[index]), float(judged[index].time[0])

    order = [*sorted(worst[:most], key=recorded), *sorted(worst[most:], key=recorded)]
    return [judged[index] for index in order], [stroke for stroke in strokes if stroke.quantity != kind]


# --- positions that follow from the current -------------------------------------------------------------------------


class FollowedStroke(NamedTuple):
    """One stroke without a measured position: time since the recording's start, s; position and its error, m."""

    source: str
    number: int
    time: Array
    position: Array
    stderr: Array

    def to_json(self) -> dict[str, Any]:
        """Times in s, lengths in µm."""
        return {
            "source": self.source,
            "stroke": self.number,
            "time_s": self.time.tolist(),
            "position_um": (MICRO * self.position).tolist(),
            "stderr_um": (MICRO * self.stderr).tolist(),
        }

    def plot(self) -> Plot:
        """The position, and a band of two standard errors."""
        usual, largest = (quantity(float(size), "m") for size in (np.median(self.stderr), self.stderr.max()))
        position, band = MICRO * self.position, 2.0 * MICRO * self.stderr
        panel = Panel("pilot plunger, µm", [Line("after", position)], position - band, position + band, has_zero=True)
        caption = f"standard error {usual} (median), {largest} (largest)"
        return Plot(f"{self.source}, stroke {self.number}", caption, 1e3 * self.time, "time, ms", [panel])


def strokes_followed(diagnosis: Diagnosis) -> list[FollowedStroke]:
    """Strokes without measured positions, by the corrected model: those fitted, then those held out."""
    rivals = [(rival.fit, rival.weight) for rival in diagnosis.rivals]
    followed = followed_positions(diagnosis.after.fit, rivals)
    if diagnosis.after.holdout is not None:
        held_out = [(rival.holdout, rival.weight) for rival in diagnosis.rivals if rival.holdout is not None]
        followed += followed_positions(diagnosis.after.holdout, held_out)
    return [stroke for one in followed for stroke in _followed(one)]


def _followed(one: Followed) -> Iterator[FollowedStroke]:
    for number in np.unique(one.strokes).tolist():
        chosen = np.flatnonzero(one.strokes == number)
        kept = chosen[keep_extremes((one.position[chosen], one.stderr[chosen]), FOLLOWED_POINTS)]
        yield FollowedStroke(one.source, number + 1, one.times[kept], one.position[kept], one.stderr[kept])
