"""A diagnosis as people look at it: one self-contained page, and the same plots as a picture.

The page needs no network: its plots are drawn by a few lines of script that it carries along.
"""

from __future__ import annotations

import math
from collections.abc import Callable, Iterator
from pathlib import Path
from typing import TYPE_CHECKING, Any, Final

import numpy as np
from jinja2 import Environment, PackageLoader

from valve_sim import __version__
from valve_sim.files.whole_files import write_whole
from valve_sim.identification.diagnosis import Candidate, Diagnosis, State
from valve_sim.identification.fitting import Interval
from valve_sim.identification.nameless import Unexplained
from valve_sim.identification.stroke_curves import StrokeCurves, readable_unit, strokes_of

if TYPE_CHECKING:
    from matplotlib.axes import Axes

SHOWN_STROKES: Final = 6
"""So many are drawn at once, those that the declared model misses most; the others unfold."""
PICTURED_STROKES: Final = 3
_POINTS_A_KNOT: Final = 10
_SMALLEST_PROBABILITY: Final = 1e-6
"""Below it a p-value says nothing more."""
_KINDS: Final = {
    "none": "Nothing is missing",
    "effects": "Missing effect found",
    "unknown": "Something unknown acts",
    "insufficient": "The data cannot tell",
}
_AXES: Final = {"x": ("x", 1e3, "mm"), "v": ("v", 1.0, "m/s"), "t": ("t", 1e3, "ms")}
_FORCES: Final = {"x·v": "N·s/m", "t·v": "N·s/m", "x·u²": "N"}


def write_report(diagnosis: Diagnosis, path: Path | str, provenance: str = "") -> None:
    """Write report.html, whole or not at all.

    Args:
        diagnosis: what was found.
        path: of the page.
        provenance: how it was made, shown as it stands.

    Raises:
        ValveError: the page cannot be written.
    """
    environment = Environment(
        loader=PackageLoader("valve_sim.identification"), autoescape=True, trim_blocks=True, lstrip_blocks=True
    )
    page = environment.get_template("report.html.j2").render(_content(diagnosis), provenance=provenance)
    write_whole(Path(path), page)


def plot_diagnosis(diagnosis: Diagnosis, path: Path | str) -> None:
    """Draw the strokes that the declared model misses most, their residuals, and the force maps.

    Raises:
        ValveError: the picture cannot be written.
    """
    # Loaded here because a report.html, and --help, do not need it.
    from matplotlib.figure import Figure

    from valve_sim.identification.plots import MAIN, PILOT, QUIET, save_figure

    strokes = _worst_first(strokes_of(diagnosis))[:PICTURED_STROKES]
    figure = Figure(figsize=(4.6 * len(strokes) + 0.8, 8.6 if diagnosis.maps else 6.4), layout="constrained")
    figure.suptitle(diagnosis.verdict.summary, wrap=True)
    ratios = (5, 3) if diagnosis.maps else (1,)
    rows = list(figure.subfigures(len(ratios), 1, squeeze=False, height_ratios=ratios)[:, 0])
    for above, below, stroke in zip(
        *rows[0].subplots(2, len(strokes), sharex="col", squeeze=False), strokes, strict=True
    ):
        above.set_title(_wrapped(stroke.title), fontsize=9)
        above.plot(stroke.time, stroke.measured, color=QUIET, linewidth=2.8, label="measured")
        above.plot(stroke.time, stroke.before, color=MAIN, linewidth=1.2, label="before")
        above.plot(stroke.time, stroke.after, color=PILOT, linewidth=1.2, label="after")
        above.set_ylabel(f"{stroke.quantity}, {stroke.unit}")
        below.axhspan(-2 * stroke.noise, 2 * stroke.noise, color=PILOT, alpha=0.1, linewidth=0)
        below.plot(stroke.time, stroke.measured - stroke.before, color=MAIN, linewidth=0.8)
        below.plot(stroke.time, stroke.measured - stroke.after, color=PILOT, linewidth=0.8)
        below.set_ylabel(f"residual, {stroke.unit}")
        below.set_xlabel("time, ms")
    rows[0].axes[0].legend(frameon=False)
    if diagnosis.maps:
        axes = rows[1].subplots(1, len(diagnosis.maps), squeeze=False)[0]
        for panel, entry in zip(axes, diagnosis.maps, strict=True):
            _draw_map(panel, entry, PILOT, QUIET)
    for panel in [axes for row in rows for axes in row.axes]:
        panel.spines[["top", "right"]].set_visible(False)
    save_figure(figure, Path(path))


def _draw_map(axes: Axes, entry: Unexplained, colour: str, quiet: str) -> None:
    drawn = _map_plot(entry)
    axes.plot(drawn["at"], drawn["force"], "o-", color=colour, markersize=3.5, markevery=drawn["knots"])
    axes.axhline(0.0, color=quiet, linewidth=0.8)
    axes.set_xlabel(drawn["label"])
    axes.set_ylabel(drawn["force_label"])


def _wrapped(title: str) -> str:
    return title.replace(": ", ":\n").replace("$", r"\$")


# --- what the page says -------------------------------------------------------------------------------------------


def _content(diagnosis: Diagnosis) -> dict[str, Any]:
    """Everything that the template names."""
    verdict, strokes = diagnosis.verdict, _worst_first(strokes_of(diagnosis))
    channel = next(channel for channel in diagnosis.plant.channels if channel.kind != "current")
    scale, unit = readable_unit(channel.unit)
    captions = [
        {"index": index, "title": stroke.title, "rms": _change(*stroke.root_mean_squares, unit)}
        for index, stroke in enumerate(strokes)
    ]
    held_out = sum(stroke.is_held_out for stroke in strokes)
    sigma = scale * diagnosis.before.fit.problem.noises[channel.kind].sigma
    return {
        "heading": f"Diagnosis: {verdict.summary}",
        "kind": verdict.kind,
        "kind_words": _KINDS.get(verdict.kind, verdict.kind),
        "probability": verdict.probability,
        "summary": verdict.summary,
        "improvement": _improvement(diagnosis, scale, unit, sigma),
        "comparison": _comparison(diagnosis, scale, unit),
        "first": captions[:SHOWN_STROKES],
        "rest": captions[SHOWN_STROKES:],
        "maps": [
            {
                "variable": entry.variable,
                "gain": f"{-entry.gain:.1f}",
                "rms": f"{entry.force_rms:.3g} {_force_unit(entry)}",
                "where": entry.where,
            }
            for entry in diagnosis.maps
        ],
        "unexplained": _unexplained(diagnosis.unexplained),
        "candidates": [_candidate_row(candidate, diagnosis, scale, unit) for candidate in diagnosis.candidates],
        "confusable": "; ".join(
            f"{name} and {', '.join(others)}" for name, others in verdict.confusable_with.items() if others
        ),
        "intervals": [_interval_row(diagnosis, name, found) for name, found in diagnosis.after.intervals.items()],
        "record_next": diagnosis.record_next,
        "version": __version__,
        "sources": diagnosis.sources,
        "noise": f"{_three_digits(sigma)} {unit} rms of the {channel.kind} sensor, read where the machine is still",
        "strokes": f"{len(strokes) - held_out} fitted, {held_out} held out. Errors are over all samples; drawn are, of "
        "equal bins of each stroke, the samples at which a curve or a residual is lowest or highest.",
        "plots": {
            "strokes": [_stroke_plot(stroke.thinned()) for stroke in strokes],
            "maps": [_map_plot(entry) for entry in diagnosis.maps],
        },
    }


def _worst_first(strokes: list[StrokeCurves]) -> list[StrokeCurves]:
    return sorted(strokes, key=lambda stroke: -stroke.root_mean_squares[0])


def _improvement(diagnosis: Diagnosis, scale: float, unit: str, sigma: float) -> str:
    words = (
        f"On fitted strokes: {_change(scale * diagnosis.before.train_rmse, scale * diagnosis.after.train_rmse, unit)}."
    )
    if math.isfinite(diagnosis.before.holdout_rmse):
        held = _change(scale * diagnosis.before.holdout_rmse, scale * diagnosis.after.holdout_rmse, unit)
        words += f" On held-out strokes: {held}."
    return f"{words} The sensor's noise is {_three_digits(sigma)} {unit}."


def _change(before: float, after: float, unit: str) -> str:
    return f"{_three_digits(before)} → {_three_digits(after)} {unit}"


def _comparison(diagnosis: Diagnosis, scale: float, unit: str) -> list[tuple[str, str, str]]:
    """Rows of a label, the value before and the value after."""
    before, after = diagnosis.before, diagnosis.after

    def of_both(label: str, say: Callable[[State], str]) -> tuple[str, str, str]:
        return label, say(before), say(after)

    rows = [
        of_both("rms error, fitted strokes", lambda state: _number(scale * state.train_rmse, unit)),
        of_both("rms error, held-out strokes", lambda state: _number(scale * state.holdout_rmse, unit)),
        of_both("what is left is noise", _whiteness),
        of_both("χ² per sample", lambda state: f"{state.fit.chi2 / state.fit.problem.effective_samples:.4g}"),
    ]
    for name in dict.fromkeys([*before.intervals, *after.intervals]):
        rows.append((f"{name}, {diagnosis.plant.parameter(name).unit}", _value(before, name), _value(after, name)))
    return rows


def _whiteness(state: State) -> str:
    probability = state.adequacy.p_value
    words = f"p = {probability:.2g}" if probability >= _SMALLEST_PROBABILITY else f"p < {_SMALLEST_PROBABILITY:g}"
    return f"{'yes' if state.adequacy.is_white else 'no'} ({words})"


def _value(state: State, name: str) -> str:
    found = state.intervals.get(name)
    return "–" if found is None else f"{found.value:.5g} ± {found.stderr:.2g}"


def _number(value: float, unit: str) -> str:
    return f"{_three_digits(value)} {unit}" if math.isfinite(value) else "–"


def _three_digits(value: float) -> str:
    """1.00, not 1: people compare columns."""
    return f"{value:#.3g}".rstrip(".")


def _candidate_row(candidate: Candidate, diagnosis: Diagnosis, scale: float, unit: str) -> dict[str, Any]:
    name = " + ".join(candidate.effects) + (" with errors of the commands' stamps" if candidate.timing else "")
    values = [f"{key} = {found.value:.3g}" for key, found in candidate.intervals.items() if "." in key]
    return {
        "name": name,
        "gain": f"{candidate.delta_score:.1f}",
        "train": _number(scale * candidate.train_rmse, unit),
        "holdout": _number(scale * candidate.holdout_rmse, unit),
        "text": ", ".join(value.partition(".")[2] for value in values),
        "chosen": set(candidate.effects) == set(diagnosis.verdict.effects) and _is_fit(candidate, diagnosis.after),
    }


def _is_fit(candidate: Candidate, state: State) -> bool:
    """Whether it is the candidate that the corrected model was made of, with or without errors of the stamps."""
    return candidate.train_rmse == state.train_rmse


def _interval_row(diagnosis: Diagnosis, name: str, found: Interval) -> tuple[str, ...]:
    remark = f" ({found.remark})" if found.remark else ""
    limits = f"{found.low:.5g} … {found.high:.5g}".replace("inf", "∞")
    return name + remark, f"{found.value:.5g}", f"{found.stderr:.2g}", limits, diagnosis.plant.parameter(name).unit


def _unexplained(entry: Unexplained | None) -> str:
    if entry is None:
        return ""
    return f"{entry.force_rms:.3g} {_force_unit(entry)} rms over {entry.variable}, strongest at {entry.where}."


def _stroke_plot(stroke: StrokeCurves) -> dict[str, Any]:
    return {
        "quantity": stroke.quantity,
        "unit": stroke.unit,
        "noise": float(f"{stroke.noise:.3g}"),
        "time": _rounded(stroke.time, 4),
        "measured": _rounded(stroke.measured, 2),
        "before": _rounded(stroke.before, 2),
        "after": _rounded(stroke.after, 2),
        "residual_before": _rounded(stroke.measured - stroke.before, 3),
        "residual_after": _rounded(stroke.measured - stroke.after, 3),
    }


def _map_plot(entry: Unexplained) -> dict[str, Any]:
    """The curve through the knots, as the model takes it (Catmull–Rom), and which of its points are knots."""
    # Loaded here because it takes a third of a second, and few diagnoses end in a curve.
    from scipy.interpolate import CubicHermiteSpline

    name, scale, unit = _AXES.get(entry.variable[0], (entry.variable, 1.0, ""))
    at, force = np.array(entry.at), np.array(entry.force)
    padded = np.concatenate([force[:1], force, force[-1:]])
    slopes = 0.5 * (padded[2:] - padded[:-2]) / (at[1] - at[0])
    drawn = np.linspace(at[0], at[-1], (len(at) - 1) * _POINTS_A_KNOT + 1)
    factor = entry.variable[1:].replace("·", "")
    return {
        "label": f"{name}, {unit}",
        "force_label": f"{f'force / {factor}' if factor else 'force'}, {_force_unit(entry)}",
        "at": _rounded(scale * drawn, 5),
        "force": _rounded(CubicHermiteSpline(at, force, slopes)(drawn), 5),
        "knots": list(range(0, len(drawn), _POINTS_A_KNOT)),
    }


def _force_unit(entry: Unexplained) -> str:
    return _FORCES.get(entry.variable, "N")


def _rounded(values: np.typing.NDArray[np.float64], digits: int) -> list[float | None]:
    """Short numbers for the page; what is not finite has no place in JSON."""
    return list(_finite(np.round(values, digits)))


def _finite(values: np.typing.NDArray[np.float64]) -> Iterator[float | None]:
    for value in values.tolist():
        yield value if math.isfinite(value) else None
