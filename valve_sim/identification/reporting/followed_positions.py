"""Positions that follow from the current, as report.json and report.html have them: one stroke after the other."""

from __future__ import annotations

from collections.abc import Iterator
from typing import Any, Final, NamedTuple

import numpy as np

from valve_sim.files.json_text import finite_or_none
from valve_sim.identification.diagnosis.followed_positions import FollowedPosition, followed_positions
from valve_sim.identification.diagnosis.run import Diagnosis
from valve_sim.identification.plants.protocol import Array
from valve_sim.identification.reporting.curves import keep_extremes
from valve_sim.identification.reporting.units import quantity
from valve_sim.traces import stroke_numbers

POINTS: Final = 200
"""Most points of a stroke."""
MICRO: Final = 1e6


class Stroke(NamedTuple):
    """One stroke: time since the recording's start, s; position and its standard error, m."""

    source: str
    number: int
    time: Array
    position: Array
    stderr: Array


def strokes_followed(diagnosis: Diagnosis) -> list[Stroke]:
    """Strokes without measured positions, by the corrected model: those fitted, then those held out."""
    rivals = [(rival.fit, rival.weight) for rival in diagnosis.rivals]
    followed = followed_positions(diagnosis.after.fit, rivals)
    if diagnosis.after.holdout is not None:
        held_out = [(rival.holdout, rival.weight) for rival in diagnosis.rivals if rival.holdout is not None]
        followed += followed_positions(diagnosis.after.holdout, held_out)
    return [stroke for found in followed for stroke in _strokes(found)]


def _strokes(found: FollowedPosition) -> Iterator[Stroke]:
    times = found.trace.sample_times
    numbers = stroke_numbers(found.trace.drive, times)
    for number in np.unique(numbers).tolist():
        chosen = np.flatnonzero(numbers == number)
        kept = chosen[keep_extremes((found.position[chosen], found.stderr[chosen]), POINTS)]
        yield Stroke(found.trace.source, number + 1, times[kept], found.position[kept], found.stderr[kept])


def strokes_json(strokes: list[Stroke]) -> list[dict[str, Any]]:
    """Strokes as report.json has them: times in s, lengths in µm."""
    return [
        {
            "source": stroke.source,
            "stroke": stroke.number,
            "time_s": stroke.time.tolist(),
            "position_um": (MICRO * stroke.position).tolist(),
            "stderr_um": (MICRO * stroke.stderr).tolist(),
        }
        for stroke in strokes
    ]


def stroke_words(stroke: Stroke) -> str:
    """A caption."""
    usual, largest = (quantity(float(size), "m") for size in (np.median(stroke.stderr), stroke.stderr.max()))
    return f"{stroke.source}, stroke {stroke.number}: standard error {usual} (median), {largest} (largest)"


def stroke_plot(stroke: Stroke) -> dict[str, Any]:
    """What the page's script draws: the curve, and a band of two standard errors."""
    low, high = (stroke.position + way * stroke.stderr for way in (-2.0, 2.0))
    return {
        "label": "time, ms",
        "force_label": "pilot plunger, µm",
        "at": np.round(1e3 * stroke.time, 4).tolist(),
        **{
            name: [finite_or_none(value) for value in np.round(MICRO * curve, 3).tolist()]
            for name, curve in (("force", stroke.position), ("low", low), ("high", high))
        },
    }
