"""Recordings as people look at them first: each channel over time, and the strokes beside each other."""

from __future__ import annotations

from typing import TYPE_CHECKING, Final

import numpy as np

from valve_sim.files.channels import CHANNELS, SIGNALS, Signal
from valve_sim.recordings.clocks import find_gaps
from valve_sim.recordings.left_out import WORDS

if TYPE_CHECKING:
    from collections.abc import Sequence

    from matplotlib.axes import Axes
    from matplotlib.figure import Figure, SubFigure
    from numpy.typing import NDArray

    from valve_sim.recordings.events import StrokeEvents
    from valve_sim.recordings.strokes import StrokePart
    from valve_sim.recordings.trace import Trace

    Array = NDArray[np.float64]

UNITS: Final = {"length": (1e6, "µm"), "pressure": (1e-3, "kPa"), "temperature": (1.0, "°C")}
"""By dimension, in place of SI."""
COMMAND, GAP, LEFT_OUT = "#8a8f98", "#f2d7b6", "#c2261a"
ORDER: Final = ("#0b6fa4", "#d9730d", "#7b3fa0", "#2e8b57", "#b0306a", "#6b5b00")
"""Of strokes, in their order."""
MARKS: Final = {"spikes": "x", "repeated": "_", "codes": "v", "clipped": "^"}
MOST_POINTS: Final = 4000
"""Points of a line: of more, only the lowest and the highest of neighbours are drawn."""
MOST_STROKES: Final = 40
"""Strokes beside each other, the first and the last of them: more are a band."""
WIDTH, PANEL = 13.0, 1.7
"""Inches of a picture, and of a channel's height."""


def draw_recordings(shown: Sequence[tuple[Trace, Sequence[StrokePart], Sequence[StrokeEvents]]]) -> Figure:
    """Draw recordings below each other.

    On the left stands each channel over time with its commands, its gaps and what was left out; on the right the
    strokes beside each other, from their commands on, with their arrivals. All of one kind have the same axes.

    Args:
        shown: recordings, the parts of their strokes, and their arrivals.
    """
    from matplotlib.figure import Figure

    heights = [PANEL * max(2, len(_channels(trace))) + 0.4 for trace, _, _ in shown]
    figure = Figure(figsize=(WIDTH, sum(heights)), layout="constrained")
    parts = figure.subfigures(len(shown), 1, height_ratios=heights, squeeze=False)[:, 0]
    beside: dict[str, list[Axes]] = {"opening": [], "closing": []}
    for part, (trace, strokes, arrivals) in zip(parts, shown, strict=True):
        left, right = part.subfigures(1, 2, width_ratios=(3, 2))
        part.suptitle(trace.source, fontsize=10)
        _draw_channels(left, trace, strokes)
        panels = right.subplots(2, 1)
        for axes, kind in zip(panels, beside, strict=True):
            _draw_strokes(axes, trace, [own for own in strokes if _is(kind, own)], arrivals)
            axes.set_title(f"{kind}s beside each other", fontsize=9)
            beside[kind].append(axes)
        panels[-1].set_xlabel("time after the command, ms")
    for alike in beside.values():
        for axes in alike[1:]:
            axes.sharex(alike[0])
    return figure


def _is(kind: str, part: StrokePart) -> bool:
    return part.moved and part.kind in (("closing",) if kind == "closing" else ("opening", "pulse"))


def _channels(trace: Trace) -> dict[str, Signal]:
    """By key: positions and signals, in the order of their rows."""
    found = {"position": Signal(trace.times, trace.usable_position)} if trace.has_positions else {}
    if trace.main_position is not None:
        found["main_position"] = Signal(trace.times, trace.main_position)
    recorded = trace.signals()
    return found | {key: recorded[channel.name] for key, channel in SIGNALS.items() if channel.name in recorded}


def _draw_channels(figure: SubFigure, trace: Trace, strokes: Sequence[StrokePart]) -> None:
    channels = _channels(trace)
    panels = figure.subplots(len(channels), 1, sharex=True, squeeze=False)[:, 0]
    for axes, (key, signal) in zip(panels, channels.items(), strict=True):
        factor, unit = _unit(key)
        axes.plot(*thinned(signal.times, factor * signal.values), color=ORDER[0], linewidth=0.9)
        axes.set_ylabel(f"{CHANNELS[key].title}\n{unit}", fontsize=8)
        for place in find_gaps(signal.times).tolist():
            axes.axvspan(signal.times[place], signal.times[place + 1], color=GAP, linewidth=0)
        if key in ("position", "voltage") or len(channels) == 1:
            _draw_command(axes, trace)
        if key == "position":
            _draw_left_out(axes, trace, factor)
        for stroke in strokes:
            axes.axvline(stroke.start, color=COMMAND, linewidth=0.5, linestyle=":")
        _clean(axes)
    panels[-1].set_xlabel("time, s")


def _draw_command(axes: Axes, trace: Trace) -> None:
    times, volts = trace.drive.times, trace.drive.volts
    begin, end = float(trace.sample_times[0]), float(trace.sample_times[-1])
    beside = axes.twinx()
    beside.step(
        [begin, *times.tolist(), max(end, float(times[-1]))], [0.0, *volts.tolist(), float(volts[-1])], where="post",
        color=COMMAND, linewidth=0.9, linestyle="--",
    )  # fmt: skip
    beside.set_ylabel("command, V", color=COMMAND, fontsize=8)
    beside.tick_params(axis="y", colors=COMMAND)
    _clean(beside)


def _draw_left_out(axes: Axes, trace: Trace, factor: float) -> None:
    """What was left out, at its own reading, or at the panel's edge where that would hide everything else."""
    low, high = axes.get_ylim()
    for reason in WORDS:
        if count := trace.left_out.counts[reason]:
            where = getattr(trace.left_out, reason)
            values = np.clip(factor * trace.pilot_position[where], low, high)
            label = f"left out: {count} {WORDS[reason][count != 1]}"
            axes.plot(trace.times[where], values, MARKS[reason], color=LEFT_OUT, markersize=5, label=label)
    axes.set_ylim(low, high)
    if axes.get_legend_handles_labels()[0]:
        axes.legend(loc="upper right", fontsize=7, frameon=False)


def _draw_strokes(axes: Axes, trace: Trace, parts: Sequence[StrokePart], arrivals: Sequence[StrokeEvents]) -> None:
    """One line a stroke from its command on, and its arrivals on it; by the current where no position is recorded."""
    key = trace.primary_signal
    factor, unit = _unit(key)
    times, values = trace.primary_samples
    chosen = parts if len(parts) <= MOST_STROKES else [*parts[: MOST_STROKES // 2], *parts[-MOST_STROKES // 2 :]]
    seen = {own.stroke: own.events for own in arrivals}
    last = max((event.after_command for part in chosen for event in seen.get(part, ())), default=0.0)
    for number, part in enumerate(chosen):
        inside = slice(*np.searchsorted(times, [part.start, part.stop]))
        after, own = times[inside] - part.start, factor * values[inside]
        colour = ORDER[number % len(ORDER)]
        axes.plot(1e3 * after, own, color=colour, linewidth=0.9, label=f"{part.start:.3f} s, {part.volts:.3g} V")
        for event in seen.get(part, ()):
            level = np.interp(event.after_command, after, own) if len(after) else 0.0
            axes.errorbar(
                1e3 * event.after_command, level, xerr=1e3 * event.stderr, fmt="o", color=colour, markersize=4
            )
    axes.set_ylabel(f"{CHANNELS[key].title}, {unit}", fontsize=8)
    if last:
        axes.set_xlim(0.0, 2e3 * last)
    if chosen:
        left = f" ({len(chosen)} of {len(parts)} strokes)" if len(chosen) < len(parts) else ""
        axes.legend(loc="best", fontsize=6, frameon=False, ncols=1 + len(chosen) // 9, title=left or None)
    else:
        axes.annotate("none", (0.5, 0.5), xycoords="axes fraction", color=COMMAND, ha="center")
    _clean(axes)


def _unit(key: str) -> tuple[float, str]:
    channel = CHANNELS[key]
    return UNITS.get(channel.dimension, (1.0, channel.unit))


def thinned(times: Array, values: Array) -> tuple[Array, Array]:
    """A line that looks as that through all points."""
    each = 2 * len(times) // MOST_POINTS
    if each < 2:
        return times, values
    count = len(times) // each * each
    groups = values[:count].reshape(-1, each)
    rows = np.arange(len(groups))[:, None] * each
    places = np.sort(rows + np.stack([groups.argmin(axis=1), groups.argmax(axis=1)], axis=1), axis=1).ravel()
    return times[places], values[places]


def _clean(axes: Axes) -> None:
    axes.spines[["top"]].set_visible(False)
    axes.margins(x=0.01)
    axes.tick_params(labelsize=7)
