"""Pictures: what a valve did, what was measured beside what was predicted, a force map and its residuals.

Drawn without a display and without global state.
"""

from __future__ import annotations

import io
import math
from collections.abc import Mapping, Sequence
from pathlib import Path
from typing import Final

import numpy as np
from matplotlib.axes import Axes
from matplotlib.figure import Figure

from valve_sim.files.whole_files import atomic_write
from valve_sim.identification.diagnosis.outcome import Diagnosis
from valve_sim.identification.reporting.claims import headline
from valve_sim.identification.reporting.diagnosis import force_plots, stroke_plots
from valve_sim.identification.reporting.document import Array, Curve, Document, Panel, Plot, Plots
from valve_sim.identification.reporting.units import percent
from valve_sim.model import Drive, Phase, Response, Valve, ValveError, published_times

PILOT, MAIN, SECOND, QUIET = "#0b6fa4", "#d9730d", "#7b3fa0", "#8a8f98"
"""Colours that colour-blind readers can tell apart, also printed in grey."""
_PHASE_NAMES: Final = {phase: phase.name.lower().replace("_", " ") for phase in Phase}
_COLOURS: Final = {"measured": QUIET, "before": MAIN, "residual": MAIN}
"""Of curves by name; of others `PILOT`."""
PICTURED_STROKES: Final = 3
_STYLE: Final = {"linewidth": 1.6}


class Picture(Figure):
    """A figure that a notebook shows without pyplot; `savefig` writes it."""

    def _repr_png_(self) -> bytes:
        """The picture as a notebook shows it."""
        written = io.BytesIO()
        self.savefig(written, format="png", dpi=100)
        return written.getvalue()


def draw_response(
    response: Response,
    drive: Drive,
    title: str,
    *,
    marks: Mapping[str, float] | None = None,
    levels: Mapping[str, float] | None = None,
) -> Picture:
    """Draw displacement, velocity, current, phase and, of a valve with gas, pressure and flow, one above the other.

    Args:
        response: what the valve did.
        drive: the commanded voltage.
        title: one line.
        marks: times to mark by a name, s.
        levels: displacements to mark by a name, m.
    """
    ratios = (3, 2, 2, 1.6) if response.outlet_pressure is None else (3, 2, 2, 1.6, 2, 2)
    figure = Picture(figsize=(9.0, 8.0 if len(ratios) == 4 else 11.5), layout="constrained")
    displacement, velocity, current, phase, *of_gas = figure.subplots(len(ratios), 1, sharex=True, height_ratios=ratios)
    times = 1e3 * response.time
    displacement.plot(times, 1e6 * response.pilot_position, color=PILOT, label="pilot plunger", **_STYLE)
    displacement.plot(times, 1e6 * response.main_position, color=MAIN, label="main plunger", **_STYLE)
    displacement.set_ylabel("displacement, µm")
    for name, level in (levels or {}).items():
        _mark_level(displacement, name, 1e6 * level)
    displacement.legend(loc="center right", frameon=False)
    velocity.plot(times, 1e3 * response.pilot_velocity, color=PILOT, **_STYLE)
    velocity.axhline(0.0, color=QUIET, linewidth=0.6)
    velocity.set_ylabel("velocity, mm/s")
    current.plot(times, response.coil_current, color=SECOND, **_STYLE)
    current.set_ylabel("coil current, A")
    _draw_voltage(current, drive, response.time)
    _draw_phase(phase, times, response.phase)
    if of_gas and response.outlet_pressure is not None and response.mass_flow is not None:
        pressure, flow = of_gas
        pressure.plot(times, 1e-6 * response.outlet_pressure, color=SECOND, **_STYLE)
        pressure.set_ylabel("outlet, MPa")
        flow.plot(times, 1e3 * response.mass_flow, color=SECOND, **_STYLE)
        flow.set_ylabel("flow, g/s")
    for name, time in (marks or {}).items():
        _mark_time((displacement, velocity, current, phase, *of_gas), name, 1e3 * time)
    _finish(figure, title, "time, ms")
    return figure


def draw_simulation(response: Response, drive: Drive, valve: Valve, title: str) -> Picture:
    """Draw a simulated response, with the paper's t1 and t2, the pilot's gap and the stroke marked."""
    levels = {"stroke": valve.parameters.stroke}
    if not valve.parameters.has_one_plunger:
        levels["gap"] = valve.parameters.pilot_gap
    times = zip(("t1", "t2"), published_times(response), strict=True)
    marks = {name: time for name, time in times if math.isfinite(time)}
    return draw_response(response, drive, title, marks=marks, levels=levels)


def draw_plots(plots: Sequence[Plot], title: str, *, columns: int = 3) -> Picture:
    """Draw plots of a document beside each other, the panels of each below each other."""
    rows = [plots[start : start + columns] for start in range(0, len(plots), columns)]
    width = 10.0 if len(plots) == 1 else 4.6 * min(len(plots), columns) + 0.8
    heights = [sum((3.8, 2.2, 2.2)[: len(row[0].panels)]) for row in rows]
    figure = Picture(figsize=(width, sum(heights) + 0.6), layout="constrained")
    figure.suptitle(title.replace("$", r"\$"), wrap=True)
    for part, row in zip(
        figure.subfigures(len(rows), 1, squeeze=False, height_ratios=heights)[:, 0], rows, strict=True
    ):
        panels = len(row[0].panels)
        grid = part.subplots(panels, len(row), sharex="col", squeeze=False, height_ratios=(3, 2, 2)[:panels])
        for axes, plot in zip(grid.T, row, strict=True):
            if len(plots) > 1:
                axes[0].set_title(plot.title.replace(": ", ":\n").replace("$", r"\$"), fontsize=9)
            for one, panel in zip(axes, plot.panels, strict=True):
                _draw_panel(one, panel, plot.x)
            axes[-1].set_xlabel(plot.x_label)
        if len(row[0].panels[0].curves) > 1:
            grid[0, 0].legend(frameon=False)
    return figure


def save_plots(document: Document, path: Path) -> None:
    """Draw the first plots of a document.

    Raises:
        ValveError: the picture cannot be written.
    """
    blocks = (block for section in document.sections for block in section.blocks)
    plots = next(block for block in blocks if isinstance(block, Plots)).make()
    save_figure(draw_plots(plots, plots[0].title), path)


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
    panel = Panel(f"measured − model, {unit}", [Curve("after", scale * values)], -band, band)
    return draw_plots([Plot(title, "", 1e3 * times, "time, ms", [panel])], title)


def _draw_panel(axes: Axes, panel: Panel, x: Array) -> None:
    for curve in panel.curves:
        colour, width = _COLOURS.get(curve.name, PILOT), 2.8 if curve.name == "measured" else 1.2
        style = {"marker": "o", "markersize": 3.5, "linewidth": 0.0} if curve.has_dots else {"linewidth": width}
        axes.plot(x, curve.y, color=colour, label=curve.name, **style)
    if panel.low is not None and panel.high is not None:
        axes.fill_between(x, panel.low, panel.high, color=PILOT, alpha=0.12, linewidth=0)
    if panel.has_zero:
        axes.axhline(0.0, color=QUIET, linewidth=0.8)
    axes.set_ylabel(panel.label)
    axes.spines[["top", "right"]].set_visible(False)


def _draw_voltage(axes: Axes, drive: Drive, times: Array) -> None:
    """The command, dashed on an axis of its own."""
    volts = axes.twinx()
    volts.step(1e3 * times, drive.at(times), where="post", color=QUIET, linewidth=1.0, linestyle="--")
    volts.set_ylabel("command, V", color=QUIET)
    volts.tick_params(axis="y", colors=QUIET)
    volts.spines[["top"]].set_visible(False)


def _draw_phase(axes: Axes, times: Array, phases: np.typing.NDArray[np.uint8]) -> None:
    axes.step(times, phases, where="post", color="black", linewidth=1.4)
    axes.set_yticks([int(phase) for phase in Phase], [_PHASE_NAMES[phase] for phase in Phase])
    axes.set_ylim(-0.4, len(Phase) - 0.6)
    axes.set_ylabel("phase")


def _mark_level(axes: Axes, name: str, level: float) -> None:
    axes.axhline(level, color=QUIET, linewidth=0.6, linestyle=":")
    axes.annotate(
        f"{name} {level:.0f} µm", (1.0, level), xycoords=("axes fraction", "data"), xytext=(-4, 3),
        textcoords="offset points", fontsize=8, color=QUIET, horizontalalignment="right",
    )  # fmt: skip


def _mark_time(panels: tuple[Axes, ...], name: str, time: float) -> None:
    for axes in panels:
        axes.axvline(time, color=QUIET, linewidth=0.6, linestyle=":")
    panels[0].annotate(
        name, (time, 1.0), xycoords=("data", "axes fraction"), xytext=(0, 3), textcoords="offset points", fontsize=8,
        horizontalalignment="center",
    )  # fmt: skip


def _finish(figure: Figure, title: str, unit: str) -> None:
    figure.suptitle(title)
    figure.axes[0].margins(x=0.01)
    for axes in figure.axes:
        axes.spines[["top"]].set_visible(False)
        axes.grid(visible=True, axis="x", color="#e4e6ea", linewidth=0.6)
    lowest = max((axes for axes in figure.axes), key=lambda axes: axes.get_subplotspec().rowspan.stop)  # type: ignore[union-attr]
    lowest.set_xlabel(unit)


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
