"""Pictures: what a valve did, what was measured beside what was predicted, a force map and its residuals.

Drawn without a display and without global state.
"""

from __future__ import annotations

import io
import math
from collections.abc import Mapping
from pathlib import Path
from typing import Final

import numpy as np
from matplotlib.axes import Axes
from matplotlib.figure import Figure

from valve_sim.files.whole_files import atomic_write
from valve_sim.identification.fit.static_force import StaticForce
from valve_sim.identification.plants.protocol import Array
from valve_sim.identification.reporting.units import three_digits
from valve_sim.identification.validation.replay import Replay
from valve_sim.model import Drive, Phase, Response, Valve, ValveError, published_times

PILOT, MAIN, SECOND, QUIET = "#0b6fa4", "#d9730d", "#7b3fa0", "#8a8f98"
"""Colours that colour-blind readers can tell apart, also printed in grey."""
_PHASE_NAMES: Final = {phase: phase.name.lower().replace("_", " ") for phase in Phase}
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


def draw_residual(times: Array, values: Array, sigma: float, scale: float, unit: str, title: str) -> Picture:
    """Draw what a fit leaves, and the band of two standard deviations of the sensor's noise.

    Args:
        times: (n,) s. values: (n,) measured less shown, SI. sigma: standard deviation of the noise, SI.
        scale, unit: from SI to the unit that is shown. title: one line.
    """
    figure = Picture(figsize=(9.0, 3.2), layout="constrained")
    axes = figure.subplots()
    axes.axhspan(-2.0 * scale * sigma, 2.0 * scale * sigma, color=QUIET, alpha=0.3, label="±2σ of the sensor's noise")
    axes.plot(1e3 * times, scale * values, color=PILOT, linewidth=0.8)
    axes.set_ylabel(f"measured − model, {unit}")
    axes.legend(loc="upper right", frameon=False)
    _finish(figure, title, "time, ms")
    return figure


def plot_replay(path: Path | str, replay: Replay) -> None:
    """Draw measured and predicted displacement, current or pressure, and the residual beside the tolerance.

    Raises:
        ValveError: the picture cannot be written.
    """
    figure = Figure(figsize=(10.0, 6.0), layout="constrained")
    above, below = figure.subplots(2, 1, sharex=True, height_ratios=(3, 2))
    scale, unit = replay.readable
    times, measured = 1e3 * replay.measured.times, replay.measured.values
    above.plot(times, scale * measured, color=QUIET, linewidth=2.6, label="measured")
    above.plot(times, scale * replay.predicted, color=PILOT, linewidth=1.0, label="model")
    above.set_ylabel(f"{replay.title}, {unit}")
    above.legend(loc="upper right", frameon=False)
    below.plot(times, scale * (measured - replay.predicted), color=MAIN, linewidth=0.7)
    for sign in (-1.0, 1.0):
        below.axhline(sign * scale * replay.tolerance, color=QUIET, linestyle="--", linewidth=0.8)
    below.set_ylabel(f"measured − model, {unit}")
    verdict = "within" if replay.passed else "outside"
    title = f"{replay.source}: {verdict} {three_digits(scale * replay.tolerance)} {unit} (dashed)"
    _finish(figure, title, "time, ms")
    save_figure(figure, Path(path))


def plot_static_force(path: Path | str, fitted: StaticForce) -> None:
    """Draw the measured force, the polynomial through it, and the residuals.

    Raises:
        ValveError: the picture cannot be written.
    """
    figure = Figure(figsize=(8.0, 6.0), layout="constrained")
    above, below = figure.subplots(2, 1, sharex=True, height_ratios=(3, 2))
    order = np.argsort(fitted.displacement)
    x = 1e6 * fitted.displacement[order]
    above.plot(x, fitted.force[order], "o", color=QUIET, markersize=3.5, label="measured")
    above.plot(x, fitted.predicted[order], color=PILOT, label="polynomial", **_STYLE)
    above.set_ylabel(f"attraction at {fitted.voltage:g} V, N")
    above.legend(loc="upper left", frameon=False)
    below.plot(x, (fitted.force - fitted.predicted)[order], "o", color=MAIN, markersize=3.5)
    below.axhline(0.0, color=QUIET, linewidth=0.8)
    below.set_ylabel("measured − polynomial, N")
    _finish(figure, f"{fitted.source}: residual {fitted.rmse:.3g} N rms", "displacement, µm")
    save_figure(figure, Path(path))


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
