"""What an archive holds of one valve, as numbers, as text and as a picture."""

from __future__ import annotations

import math
import statistics
from collections.abc import Mapping, Sequence
from datetime import datetime
from pathlib import Path
from typing import Any, Final, NamedTuple

from valve_sim.files.whole_files import atomic_write
from valve_sim.model.errors import ValveError
from valve_sim.records.archive import Archive

_FIGURES: Final = ("t1", "t2", "closing_time", "main_damping", "residual")
_SHOWN: Final = 20
"""Findings and alarms that are printed, the last ones."""
_LEVELS: Final = {0: "OK", 1: "WARN", 2: "ERROR", 3: "STALE"}
Rows = Sequence[Mapping[str, Any]]


class Month(NamedTuple):
    """The strokes of one month: how many, and the median of each figure, SI; None where there is none."""

    month: str
    strokes: int
    medians: dict[str, float | None]


class Story(NamedTuple):
    """What happened to a valve: strokes by month, and rows of findings, alarms and strokes, by time."""

    valve: str
    months: tuple[Month, ...]
    findings: Rows
    alarms: Rows
    strokes: Rows


def tell(archive: Archive, valve: str, since: datetime | None, until: datetime | None) -> Story:
    """What an archive holds of a valve; the first slash of its name may be left out.

    Raises:
        ValveError: the archive has nothing of that valve, or is damaged.
    """
    known = archive.valves()
    name = valve if valve in known else f"/{valve}"
    if name not in known:
        listed = ", ".join(known) if known else "none at all"
        raise ValveError(f"{valve}: nothing of this valve is in the archive; expected one of {listed}")
    strokes = archive.read("strokes", name, since, until)
    by_month: dict[str, list[Mapping[str, Any]]] = {}
    for row in strokes:
        by_month.setdefault(row["time"].strftime("%Y-%m"), []).append(row)
    months = tuple(
        Month(month, len(rows), {figure: _median(rows, figure) for figure in _FIGURES})
        for month, rows in by_month.items()
    )
    findings, alarms = archive.read("findings", name, since, until), archive.read("alarms", name, since, until)
    return Story(name, months, findings, alarms, strokes)


def story_json(story: Story) -> dict[str, Any]:
    """Months, findings and alarms; times in ISO 8601."""
    return {
        "schema": "valve_sim/history/1",
        "valve": story.valve,
        "months": [{"month": month.month, "strokes": month.strokes, **month.medians} for month in story.months],
        "findings": [_dated(row) for row in story.findings],
        "alarms": [_dated(row) for row in story.alarms],
    }


def story_text(story: Story) -> str:
    """A table of months, and the last findings and alarms."""
    lines = [f"{story.valve}: {len(story.strokes)} strokes, {len(story.findings)} findings, {len(story.alarms)} alarms"]
    lines += ["", "month     strokes    t1, ms    t2, ms   closing, ms   c2, N·s/m   residual, µm"]
    for month in story.months:
        t1, t2, closing, damping, residual = (month.medians[figure] for figure in _FIGURES)
        lines.append(
            f"{month.month}{month.strokes:10d}{_scaled(t1, 1e3):>10}{_scaled(t2, 1e3):>10}{_scaled(closing, 1e3):>14}"
            f"{_scaled(damping, 1.0):>12}{_scaled(residual, 1e6):>15}"
        )
    for name, rows, words in (("findings", story.findings, _finding), ("alarms", story.alarms, _alarm)):
        if rows:
            left = f", the last {_SHOWN} of {len(rows)}" if len(rows) > _SHOWN else ""
            lines += ["", f"{name}{left}:"]
            lines += [f"  {row['time']:%Y-%m-%d %H:%M:%S}Z  {words(row)}" for row in rows[-_SHOWN:]]
    return "\n".join(lines)


def plot_story(path: Path, story: Story) -> None:
    """Draw t1, t2, closing time and damping over time, with the alarms as lines.

    Raises:
        ValveError: there is no stroke to draw, or the picture cannot be written.
    """
    from matplotlib.figure import Figure

    if not story.strokes:
        raise ValveError(f"{path}: there is no stroke of {story.valve} to draw in this time; choose another by --since")
    figure = Figure(figsize=(9.0, 8.0), layout="constrained")
    panels = figure.subplots(4, 1, sharex=True)
    times = [row["time"] for row in story.strokes]
    shown = (("t1", 1e3, "t1, ms"), ("t2", 1e3, "t2, ms"), ("closing_time", 1e3, "closing, ms"))
    for axes, (name, factor, label) in zip(panels, (*shown, ("main_damping", 1.0, "c2, N·s/m")), strict=True):
        values = [math.nan if row[name] is None else factor * row[name] for row in story.strokes]
        axes.plot(times, values, ".", markersize=2.0, color="#1f4e79")
        axes.set_ylabel(label)
        for alarm in story.alarms:
            if alarm["level"]:
                axes.axvline(alarm["time"], color="#b03a2e", linewidth=0.8)
    figure.suptitle(f"{story.valve}: {len(times)} strokes; lines are alarms")
    with atomic_write(path) as partial:
        figure.savefig(partial, format=path.suffix.lstrip(".") or "png", dpi=150)


def _median(rows: Rows, figure: str) -> float | None:
    values = [row[figure] for row in rows if row[figure] is not None]
    return statistics.median(values) if values else None


def _scaled(value: float | None, factor: float) -> str:
    return "–" if value is None else f"{factor * value:.3f}"


def _dated(row: Mapping[str, Any]) -> dict[str, Any]:
    return {**row, "time": row["time"].isoformat()}


def _finding(row: Mapping[str, Any]) -> str:
    return row["summary"] or f"{row['effect']} {row['parameter']} {row['value']} {row['unit'] or ''}".strip()


def _alarm(row: Mapping[str, Any]) -> str:
    return f"{_LEVELS.get(row['level'], row['level'])} {row['message'] or ''}"
