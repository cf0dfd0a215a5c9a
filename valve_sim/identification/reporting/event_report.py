"""The diagnosis of an event table: as JSON and as text, as pictures, and as the valve's file with its values."""

from __future__ import annotations

import math
import re
from collections.abc import Callable, Mapping
from pathlib import Path
from typing import Any, Final

import numpy as np
from matplotlib.axes import Axes
from matplotlib.figure import Figure

from valve_sim.files.json_text import json_text, plain_mapping
from valve_sim.files.whole_files import write_whole
from valve_sim.identification.diagnosis.events import (
    COVARIANCE_DIGITS,
    ROUNDED,
    Candidate,
    EventDiagnosis,
    FurtherMeasurement,
    Quantity,
    Region,
    declared_counterparts,
)
from valve_sim.identification.estimation.intervals import CHI2_RISE_95
from valve_sim.identification.plants.effect_titles import title_of, titles_of
from valve_sim.identification.plants.event_table import EventPlant
from valve_sim.identification.plants.protocol import Array
from valve_sim.identification.plants.valve import DAMPINGS
from valve_sim.identification.reporting.figures import MAIN, PILOT, QUIET, SECOND, save_figure
from valve_sim.identification.reporting.units import listed_values, signed
from valve_sim.model import ParameterError
from valve_sim.model.tolerances import COVARIANCE_NAME

_SMALLEST: Final = 0.1
"""N·s/m: the grid's first value is 0, which a logarithmic axis shows here."""


def event_json(result: EventDiagnosis) -> dict[str, Any]:
    """The content of report.json."""
    report = {
        "schema": "valve_sim/event_diagnosis/1",
        "source": result.table.source,
        "events": [vars(event) for event in result.table.events],
        "verdict": {"kind": "insufficient", "summary": _summary(result)},
        "before": _candidate_json(result, result.declared),
        "after": {**_candidate_json(result, result.shipped), "standard_errors": dict(result.standard_errors)},
        "candidates": [_candidate_json(result, entry) for entry in (*result.singles, *result.pairs)],
        "largest_attraction_n": {"predicted": result.largest_attraction, "measured": result.table.largest_attraction},
        "intervals": {
            name: {
                "by_events": result.region.interval(name, capped=False),
                "and_plausible_pull": result.region.interval(name, capped=True),
            }
            for name in DAMPINGS
        },
        "record_next": [_measurement_json(entry) for entry in result.measurements],
    }
    return plain_mapping(report)


def _candidate_json(result: EventDiagnosis, entry: Candidate) -> dict[str, Any]:
    return {
        "effects": list(entry.effects),
        "parameters": dict(entry.values),
        "times_ms": [1e3 * time for time in entry.times],
        "errors_ms": [1e3 * error for error in result.errors(entry)],
        "closes": entry.closes,
    }


def _measurement_json(entry: FurtherMeasurement) -> dict[str, Any]:
    return {
        "name": measurement_words(entry),
        "lowest": entry.lowest,
        "highest": entry.highest,
        "uncertainty": entry.uncertainty,
        "unit": entry.unit,
        "power": entry.power,
    }


def measurement_words(entry: FurtherMeasurement) -> str:
    """What is to be measured, and where."""
    match entry.quantity:
        case Quantity.STATIC_ATTRACTION:
            words = "static attraction at the largest gap"
        case Quantity.CURRENT_TIME_CONSTANT:
            words = "time constant of the coil current"
        case Quantity.ARRIVAL:
            words = f"{entry.event} at {entry.volts:.3g} V"
        case Quantity.CLOSING_TIME:
            words = f"closing time after release from {entry.volts:g} V"
        case Quantity.DISPLACEMENT:
            words = f"displacement at {entry.volts:g} V, {1e3 * entry.time:.1f} ms"
    return words


def _summary(result: EventDiagnosis) -> str:
    """The verdict in one sentence."""
    singles, pairs = (sum(entry.closes for entry in found) for found in (result.singles, result.pairs))
    opens = "never opens" if math.isnan(result.declared.times[-1]) else "opens"
    return (
        f"The declared valve {opens}; {singles or 'no'} single effects and {pairs or 'no'} pairs close the table, "
        "so few numbers can name none of them."
    )


def event_text(result: EventDiagnosis) -> str:
    """The report for the terminal."""
    names = [event.name for event in result.table.events]
    head = "".join(f"{name + ' error, ms':>16}" for name in names)
    lines = [f"{'added to the declared valve':<38}{head}   values"]
    closing = [entry for entry in result.pairs if entry.closes]
    best_of_rest = [entry for entry in result.pairs if not entry.closes][:3]
    for entry in (result.declared, *result.singles, *closing, *best_of_rest):
        errors = "".join(
            f"{'never':>16}" if math.isnan(e) else f"{signed(1e3 * e, 3):>16}" for e in result.errors(entry)
        )
        values = listed_values(EventPlant(result.table), entry.values)
        lines.append(f"{' + '.join(entry.effects) or '(nothing)':<38}{errors}   {values}")
    lines += ["", _summary(result)]
    for name in DAMPINGS:
        free, capped = (_interval_words(result.region.interval(name, capped=flag)) for flag in (False, True))
        lines.append(
            f"{name}, N·s/m: the events allow {free}; with a pull at rest below the largest measured, {capped}"
        )
    shipped = listed_values(EventPlant(result.table), result.shipped.values, 5)
    errors = ", ".join(
        f"{name} off by {signed(1e6 * error, 2)} µs"
        for name, error in zip(names, result.errors(result.shipped), strict=True)
    )
    lines.append(f"written: {shipped} ({errors})")
    if result.table.largest_attraction is not None:
        lines.append(
            f"largest attraction while opening: {result.largest_attraction:.1f} N, measured "
            f"{result.table.largest_attraction:.1f} N: not fitted"
        )
    lines.append(
        "what would decide, the most decisive first (what the region predicts, and how well it can be measured):"
    )
    lines += [
        f"    {measurement_words(entry):<46}{entry.lowest:>9.3g} to {entry.highest:.3g} {entry.unit} ± "
        f"{entry.uncertainty:g} ({entry.power:.0f} standard errors)"
        for entry in result.measurements
    ]
    return "\n".join(lines)


def _interval_words(interval: tuple[float, float]) -> str:
    low, high = interval
    return f"{low:.3g} and above, to the end of the search" if math.isinf(high) else f"{low:.3g} to {high:.3g}"


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


def write_event_report(result: EventDiagnosis, folder: Path) -> tuple[Path, ...]:
    """Write report.json, valve.yaml and the pictures.

    Returns:
        what was written.

    Raises:
        ValveError: a file cannot be written.
    """
    report, valve = folder / "report.json", folder / "valve.yaml"
    write_whole(report, json_text(event_json(result)))
    write_valve(valve, result)
    return report, valve, *plot_event_diagnosis(folder, result)


def write_valve(path: Path, result: EventDiagnosis) -> None:
    """Write the declared valve's file anew, with the shipped values in place: comments and all else as they were.

    Raises:
        ParameterError: the file cannot be written, or the declared file has not one line for a value.
    """
    text = result.table.valve_file.read_text(encoding="utf-8")
    body = text[text.index("/**:") :]
    values = result.valve.declared()
    folded = declared_counterparts()
    for name in result.shipped.values:
        key, scalar = folded[name]
        value = f"{values[scalar]:.{ROUNDED}g}"
        body = _replaced(body, key, value, result.table.source, str(result.table.valve_file))
    if not result.valve.tolerances.is_exact:
        body = _with_tolerances(body, result)
    write_whole(path, _header(result) + body)


def _with_tolerances(body: str, result: EventDiagnosis) -> str:
    """The tolerances of the values in place, below `tolerances:` on a line of its own."""
    source = str(result.table.valve_file)
    match = re.search(r"^ *tolerances:", body, re.MULTILINE)
    if match is None:
        raise ParameterError(f"{source}: tolerances: found no line of its own, expected 'tolerances:'")
    before, below = body[: match.start()], body[match.start() :]
    tolerances, folded = result.valve.tolerances, declared_counterparts()
    for name in result.shipped.values:
        scalar = folded[name][1]
        if scalar != "a0":
            below = _replaced(below, scalar, f"{tolerances.declared[scalar]:g}", result.table.source, source)
        elif tolerances.attraction_covariance is not None:
            variance = f"{tolerances.attraction_covariance[0][0]:.{COVARIANCE_DIGITS}g}"
            below = _replaced(below, COVARIANCE_NAME, variance, result.table.source, source)
    return before + below


def _replaced(body: str, key: str, value: str, table: str, source: str) -> str:
    """A parameter file with the first number of one line replaced, and a comment that says from which table it is."""
    match = re.search(rf"^( *{key}: \[?)([^,\s\]]+)([^\n#]*?) *(?:(# \S+)[^\n]*)?$", body, re.MULTILINE)
    if match is None:
        raise ParameterError(f"{source}: valve.{key}: found no line of its own, expected '{key}: value'")
    before, old, rest, unit = match.groups()
    words = f"calibrated to {Path(table).name}; {Path(source).name} has {old}"
    mark = "# a0" if rest else f"{unit or '#'}     "
    return f"{body[: match.start()]}{before}{value}{rest}  {mark} {words}{body[match.end() :]}"


def _header(result: EventDiagnosis) -> str:
    """How the file was made, as comments."""
    table = result.table
    times = ", ".join(
        f"{event.name} = {1e3 * time:.4f} ms (measured {1e3 * event.time:g})"
        for event, time in zip(table.events, result.shipped.times, strict=True)
    )
    shipped = ", ".join(f"{name} = {value:.{ROUNDED}g}" for name, value in result.shipped.values.items())
    return "".join(
        f"# {line}".rstrip() + "\n"
        for line in (
            f"The default valve: {table.valve_file.name}, with two values calibrated to the event times in",
            f"{Path(table.source).name} and all others kept. Written by",
            f"    valve-sim diagnose --events config/{Path(table.source).name} --output DIR",
            "as DIR/valve.yaml; running it again gives this file. Do not edit it by hand.",
            "",
            'Source of every published number: Choi, Ahn and Kim, "Modeling the Dynamic Behavior of a Pilot-Operated',
            'Solenoid Valve for an Ultra-High Pressure Vessel", Appl. Sci. 2021, 11, 2329, converted to SI.',
            "",
            "As printed, that valve never opens: its attraction polynomial is 0 at x = 0. Calibrated, in SI units:",
            f"    {shipped}",
            f"(added to a0 and to the coil's lag), which gives, at {table.voltage:g} V from rest,",
            f"    {times}.",
            "Two event times leave no freedom to check the damping: it is the paper's, and not confirmed.",
            "docs/theory/paper.md says what else would fit.",
        )
    )
