"""Pictures of plots: what a valve did, what was measured beside what was predicted, a force map and its residuals.

Drawn without a display and without global state.
"""

from __future__ import annotations

import io
import math
from collections.abc import Mapping, Sequence
from pathlib import Path
from typing import Any, Final

import numpy as np
from matplotlib.axes import Axes
from matplotlib.figure import Figure

from valve_sim.files.whole_files import atomic_write
from valve_sim.identification.diagnosis.outcome import Diagnosis
from valve_sim.identification.reporting import document as doc
from valve_sim.identification.reporting.claims import headline
from valve_sim.identification.reporting.diagnosis_document import force_plots, stroke_plots
from valve_sim.identification.reporting.document import Array, Line, Panel, Plot
from valve_sim.identification.reporting.units import percent
from valve_sim.model import Drive, Phase, Response, Valve, ValveError, published_times

PILOT, MAIN, SECOND, QUIET = "#0b6fa4", "#d9730d", "#7b3fa0", "#8a8f98"
"""Colours that colour-blind readers can tell apart, also printed in grey."""
_COLOURS: Final = {
    "measured": QUIET, "before": MAIN, "residual": MAIN, "main plunger": MAIN, "current": SECOND, "command": QUIET,
    "phase": "black",
}  # fmt: skip
"""Of curves by name; of others `PILOT`."""
PICTURED_STROKES: Final = 3
COLUMNS: Final = 3
"""Plots beside each other."""


class Picture(Figure):
    """A figure that a notebook shows without pyplot; `savefig` writes it."""

    def _repr_png_(self) -> bytes:
        """The picture as a notebook shows it."""
        written = io.BytesIO()
        self.savefig(written, format="png", dpi=100)
        return written.getvalue()


def draw_response(
    response: Response, drive: Drive, title: str, *, marks: Mapping[str, float], levels: Mapping[str, float]
) -> Picture:
    """Draw displacement, velocity, current, command, phase and, of a valve with gas, pressure and flow.

    Args:
        response: what the valve did. drive: the commanded voltage. title: one line.
        marks: times to mark by a name, s. levels: displacements to mark by a name, m.
    """
    plungers = {"pilot plunger": response.pilot_position, "main plunger": response.main_position}
    panels = [
        Panel("displacement, µm", [Line(name, 1e6 * position) for name, position in plungers.items()]),
        Panel("velocity, mm/s", [Line("velocity", 1e3 * response.pilot_velocity)], has_zero=True),
        Panel("coil current, A", [Line("current", response.coil_current)]),
        Panel("command, V", [Line("command", drive.at(response.time))]),
        Panel("phase", [Line("phase", response.phase.astype(float))]),
    ]
    if response.outlet_pressure is not None and response.mass_flow is not None:
        panels.append(Panel("outlet, MPa", [Line("current", 1e-6 * response.outlet_pressure)]))
        panels.append(Panel("flow, g/s", [Line("current", 1e3 * response.mass_flow)]))
    figure = draw_plots([Plot(title, "", 1e3 * response.time, "time, ms", panels)], title)
    first, _, _, _, phase, *_ = figure.subfigs[0].axes
    phase.set_yticks([int(one) for one in Phase], [one.name.lower().replace("_", " ") for one in Phase])
    for name, level in levels.items():
        first.axhline(1e6 * level, color=QUIET, linewidth=0.6, linestyle=":")
        first.annotate(f"{name} {1e6 * level:.0f} µm", (0.02, 1e6 * level), xycoords=("axes fraction", "data"), **_MARK)
    for name, time in marks.items():
        for axes in figure.subfigs[0].axes:
            axes.axvline(1e3 * time, color=QUIET, linewidth=0.6, linestyle=":")
        first.annotate(name, (1e3 * time, 0.02), xycoords=("data", "axes fraction"), **_MARK)
    return figure


_MARK: Final[dict[str, Any]] = {"xytext": (3, 3), "textcoords": "offset points", "fontsize": 8, "color": QUIET}


def draw_simulation(response: Response, drive: Drive, valve: Valve, title: str) -> Picture:
    """Draw a simulated response, with the paper's t1 and t2, the pilot's gap and the stroke marked."""
    levels = {"stroke": valve.parameters.stroke}
    if not valve.parameters.has_one_plunger:
        levels["gap"] = valve.parameters.pilot_gap
    times = zip(("t1", "t2"), published_times(response), strict=True)
    marks = {name: time for name, time in times if math.isfinite(time)}
    return draw_response(response, drive, title, marks=marks, levels=levels)


def draw_diagnosis(diagnosis: Diagnosis) -> Picture:
    """Draw the strokes that the declared model misses most, their residuals, and the force maps."""
    plots = [*stroke_plots(diagnosis, PICTURED_STROKES)[:PICTURED_STROKES], *force_plots(diagnosis)]
    return draw_plots(plots, f"{headline(diagnosis)}\nProbability {percent(diagnosis.verdict.probability)}")


def draw_residual(times: Array, values: Array, sigma: float, scale: float, unit: str, title: str) -> Picture:
    """Draw what a fit leaves, and the band of two standard deviations of the sensor's noise.

    Args:
        times: (n,) s. values: (n,) measured less shown, SI. sigma: standard deviation of the noise, SI.
        scale, unit: from SI to the unit that is shown. title: one line.
    """
    band = np.full(len(times), 2.0 * scale * sigma)
    panel = Panel(f"measured − model, {unit}", [Line("after", scale * values)], -band, band)
    return draw_plots([Plot(title, "", 1e3 * times, "time, ms", [panel])], title)


def draw_plots(plots: Sequence[Plot], title: str) -> Picture:
    """Draw plots beside each other, the panels of each below each other."""
    rows = [plots[start : start + COLUMNS] for start in range(0, len(plots), COLUMNS)]
    ratios = [(3.8, *(2.2 for _ in row[0].panels[1:])) for row in rows]
    width = 10.0 if len(plots) == 1 else 4.6 * len(rows[0]) + 0.8
    figure = Picture(figsize=(width, sum(map(sum, ratios)) + 0.6), layout="constrained")
    figure.suptitle(title.replace("$", r"\$"), wrap=True)
    parts = figure.subfigures(len(rows), 1, squeeze=False, height_ratios=[sum(heights) for heights in ratios])[:, 0]
    for part, row, heights in zip(parts, rows, ratios, strict=True):
        grid = part.subplots(len(heights), len(row), sharex="col", squeeze=False, height_ratios=heights)
        for column, plot in zip(grid.T, row, strict=True):
            if len(plots) > 1:
                column[0].set_title(plot.title.replace(": ", ":\n").replace("$", r"\$"), fontsize=9)
            for axes, panel in zip(column, plot.panels, strict=True):
                _draw_panel(axes, panel, plot.x)
            column[-1].set_xlabel(plot.x_label)
        if len(row[0].panels[0].curves) > 1:
            grid[0, 0].legend(frameon=False)
    return figure


def _draw_panel(axes: Axes, panel: Panel, x: Array) -> None:
    for curve in panel.curves:
        colour, width = _COLOURS.get(curve.name, PILOT), 2.8 if curve.name == "measured" else 1.2
        dots = {"marker": "o", "markersize": 3.5, "linewidth": 0.0}
        axes.plot(x, curve.y, color=colour, label=curve.name, **(dots if curve.has_dots else {"linewidth": width}))
    if panel.low is not None and panel.high is not None:
        axes.fill_between(x, panel.low, panel.high, color=PILOT, alpha=0.12, linewidth=0)
    if panel.has_zero:
        axes.axhline(0.0, color=QUIET, linewidth=0.8)
    axes.set_ylabel(panel.label)
    axes.margins(x=0.01)
    axes.spines[["top", "right"]].set_visible(False)


def save_plots(document: doc.Document, path: Path) -> None:
    """Draw the first plots of a document.

    Raises:
        ValveError: the picture cannot be written.
    """
    blocks = (block for section in document.sections for block in section.blocks)
    plots = next(block for block in blocks if isinstance(block, doc.Plots)).make()
    save_figure(draw_plots(plots, plots[0].title), path)


def save_figure(figure: Figure, path: Path) -> None:
    """Write a picture, whole or not at all.

    Raises:
        ValveError: it cannot be written.
    """
    ending = path.suffix.lstrip(".") or "png"
    try:
        with atomic_write(path) as partial:
            figure.savefig(partial, dpi=130, format=ending)
    except ValueError as error:
        raise ValveError(
            f"{path}: the picture cannot be written ({error}); expected a path that ends with .png"
        ) from error
