"""Pictures of an event diagnosis: the openings beside the events, and the region that fits equally well."""

from __future__ import annotations

from collections.abc import Callable, Mapping
from pathlib import Path
from typing import TYPE_CHECKING, Final

import numpy as np
from matplotlib.axes import Axes
from matplotlib.figure import Figure

from valve_sim.identification.estimation.intervals import CHI2_RISE_95
from valve_sim.identification.plants.effect_titles import title_of, titles_of
from valve_sim.identification.plants.event_table import EventPlant
from valve_sim.identification.plants.protocol import Array
from valve_sim.identification.plants.valve import DAMPINGS
from valve_sim.identification.reporting.figures import MAIN, PILOT, QUIET, SECOND, save_figure

if TYPE_CHECKING:
    from valve_sim.identification.diagnosis.events import EventDiagnosis, Region

_SMALLEST: Final = 0.1
"""N·s/m: the grid's first value is 0, which a logarithmic axis shows here."""


def plot_event_diagnosis(folder: Path, result: EventDiagnosis) -> tuple[Path, ...]:
    """Draw opening.png, region.png and profile.png.

    Returns:
        their paths.

    Raises:
        ValveError: a picture cannot be written.
    """
    drawings: Mapping[str, Callable[[EventDiagnosis], Figure]] = {
        "opening.png": _opening,
        "region.png": _region,
        "profile.png": _profiles,
    }
    paths = []
    for name, draw in drawings.items():
        paths.append(folder / name)
        save_figure(draw(result), paths[-1])
    return tuple(paths)


def _opening(result: EventDiagnosis) -> Figure:
    """Displacement over time: declared, with the best single effect, as shipped; and the events with their errors."""
    figure = Figure(figsize=(8.0, 4.6), layout="constrained")
    axes = figure.subplots()
    plant = EventPlant(result.table)
    end = 1.25 * result.table.events[-1].time
    entries = [("declared", result.declared, QUIET), (titles_of(result.shipped.effects), result.shipped, PILOT)]
    if result.singles:
        entries.insert(1, (f"best single: {title_of(result.singles[0].effects[0])}", result.singles[0], SECOND))
    for name, entry, colour in entries:
        response = plant.response(entry.values)
        inside = response.time <= end
        axes.plot(
            1e3 * response.time[inside], 1e6 * response.pilot_position[inside], color=colour, label=name, linewidth=1.6
        )
    for event in result.table.events:
        axes.errorbar(
            1e3 * event.time, 1e6 * event.displacement, xerr=1.96e3 * event.uncertainty, fmt="o", color=MAIN, capsize=3,
            label=f"{event.name}, published: {1e3 * event.time:g} ms",
        )  # fmt: skip
    axes.set(
        xlabel="time after the voltage, ms", ylabel="displacement, µm", title=f"Opening at {result.table.voltage:g} V"
    )
    axes.legend(frameon=False, loc="upper left")
    axes.grid(visible=True, color="#e4e6ea", linewidth=0.6)
    return figure


def _region(result: EventDiagnosis) -> Figure:
    """The pull at rest and the coil's lag that the events ask for, over both dampings."""
    figure = Figure(figsize=(11.0, 4.8), layout="constrained")
    region = result.region
    pull_axes, lag_axes = figure.subplots(1, 2, sharey=True)
    _contours(pull_axes, region, region.rest_attraction, (3, 4, 5, 7, 10, 15), "pull at rest a0, N")
    _contours(lag_axes, region, 1e3 * region.coil_lag, (0.1, 0.5, 1, 1.5, 2, 3, 4), "coil lag, ms")
    pull_axes.set_ylabel("main damping c2, N·s/m")
    figure.suptitle("Every point in the coloured region gives the published event times")
    return figure


def _contours(axes: Axes, region: Region, values: Array, levels: tuple[float, ...], title: str) -> None:
    across, up = (np.maximum(axis, _SMALLEST) for axis in (region.pilot_damping, region.main_damping))
    shown = np.ma.masked_where(~region.allowed, values).T
    axes.pcolormesh(
        across, up, np.ma.masked_where(~region.allowed, np.ones(values.shape)).T, cmap="Blues", vmin=0, vmax=5
    )
    lines = axes.contour(across, up, shown, levels=levels, colors=PILOT, linewidths=1.2)
    for text in axes.clabel(lines, fmt="%g", fontsize=8, inline=False, colors="black"):
        text.set_bbox({"facecolor": "white", "edgecolor": "none", "pad": 0.6})
    axes.plot(1.0, 4.0, "o", color=MAIN, label="published c1, c2")
    axes.set(xscale="log", yscale="log", xlabel="pilot damping c1, N·s/m (left edge: 0)", title=title)
    axes.set_ylim(_SMALLEST, 2.0 * float(np.max(up[region.allowed.any(axis=0)])))
    axes.legend(frameon=False, loc="upper left")


def _profiles(result: EventDiagnosis) -> Figure:
    """The lowest χ² at each value of a damping, all else free: flat is not identifiable."""
    figure = Figure(figsize=(9.0, 4.0), layout="constrained")
    for axes, name in zip(figure.subplots(1, 2, sharey=True), DAMPINGS, strict=True):
        axis = np.maximum(getattr(result.region, name), _SMALLEST)
        for capped, colour, words in (
            (False, QUIET, "events alone"),
            (True, PILOT, "and a0 within the pull measured"),
        ):
            axes.plot(axis, np.minimum(result.region.profile(name, capped=capped), 20.0), color=colour, label=words)
        axes.axhline(CHI2_RISE_95, color=MAIN, linestyle="--", linewidth=0.9, label="95 %")
        axes.axvline(result.table.valve.declared()[name], color=SECOND, linestyle=":", label="published")
        axes.set(xscale="log", xlabel=f"{name}, N·s/m", ylim=(-0.5, 12.0))
    figure.axes[0].set_ylabel("profile χ²")
    figure.axes[0].legend(frameon=False, fontsize=8, loc="upper left", bbox_to_anchor=(0.0, 0.98))
    return figure
