"""A diagnosis as people look at it: one self-contained page, and the same plots as a picture.

The page needs no network: its plots are drawn by a few lines of script that it carries along.
"""

from __future__ import annotations

import math
import shlex
import shutil
from collections.abc import Callable
from pathlib import Path
from typing import TYPE_CHECKING, Any, Final

import numpy as np
from jinja2 import Environment, PackageLoader

from valve_sim import __version__
from valve_sim.files.json_text import finite_or_none
from valve_sim.files.whole_files import write_whole
from valve_sim.identification.diagnosis.run import Candidate, Diagnosis, State
from valve_sim.identification.fit.noise import Noise
from valve_sim.identification.plants.effect_titles import named_value, title_of, titles_of
from valve_sim.identification.plants.protocol import Channel, primary_channels
from valve_sim.identification.plants.valve import ValvePlant
from valve_sim.identification.reporting.correction import correction_lines, is_stand_in, told_value
from valve_sim.identification.reporting.curves import StrokeCurves, strokes_of
from valve_sim.identification.reporting.declared_values import declared_section, plain_name
from valve_sim.identification.reporting.findings import remark_on
from valve_sim.identification.reporting.followed_positions import stroke_plot, stroke_words, strokes_followed
from valve_sim.identification.reporting.force_curves import ForceCurve, force_curve, motion_of
from valve_sim.identification.reporting.recording_profile import (
    duration_of,
    most_volts,
    option_of,
    params_of,
    profile_to_record,
)
from valve_sim.identification.reporting.recording_state import recording_rows
from valve_sim.identification.reporting.summary import recording_advice, summarise
from valve_sim.identification.reporting.units import gain_words, limits, quantity, three_digits
from valve_sim.identification.reporting.wording import (
    choice_words,
    headline,
    holdout_words,
    kind_words,
    limit_rows,
    meanings,
    percent,
    rounding_words,
    unseen_noise_words,
    value_words,
)

if TYPE_CHECKING:
    from matplotlib.axes import Axes

    from valve_sim.identification.reporting.figures import Picture

SHOWN_STROKES: Final = 6
"""Strokes that are shown at once, those with the largest error of the declared model; the others unfold."""
FIRST_STROKES: Final = 2
"""Strokes that stay on one page with their heading when printed."""
PICTURED_STROKES: Final = 3
_FACTOR_WORDS: Final = {
    "·v": ", times velocity",
    "·u²": ", with the current squared",
}
SHOWN_CANDIDATES: Final = 8
LEAST_SHOWN: Final = 0.01
"""Smallest probability of an effect that the page lists."""
_SPACES: Final = str.maketrans("._", "  ")
"""Turns names of parameters into words."""
_SMALLEST_PROBABILITY: Final = 1e-6
"""Smaller p-values are shown as below this one."""


def write_report(
    diagnosis: Diagnosis, path: Path | str, provenance: str = "", folder: Path | None = None, options: str = ""
) -> None:
    """Write report.html, whole or not at all.

    Args:
        diagnosis: what was found.
        path: of the page.
        provenance: how it was made, shown as it stands.
        folder: where the page will lie, for the commands that it prints; default that of `path`.
        options: of these commands, as of `write_diagnosis`.

    Raises:
        ValveError: the page cannot be written.
    """
    environment = Environment(
        loader=PackageLoader("valve_sim.identification.reporting"),
        autoescape=True,
        trim_blocks=True,
        lstrip_blocks=True,
    )
    page = environment.get_template("report.html.j2").render(
        _content(diagnosis), **_typed(diagnosis, folder or Path(path).parent, options), provenance=provenance
    )
    write_whole(Path(path), page)


def _typed(diagnosis: Diagnosis, folder: Path, options: str) -> dict[str, Any]:
    """The template's variables for commands, such that they work where this process was started."""
    plant, drive = diagnosis.plant, None
    if isinstance(plant, ValvePlant):
        drive = profile_to_record(diagnosis.recommendation, diagnosis.valve, plant.driven)
    return {
        "duration": "" if drive is None else f"{duration_of(drive):.2f}",
        "max_voltage": "" if drive is None else most_volts(drive),
        "params": params_of(options),
        "source": option_of(options, "--map") + option_of(options, "--valve"),
        "has_ros2": shutil.which("ros2") is not None,
        "profile": shlex.quote(str(folder / "record_next.yaml")),
        "corrected": shlex.quote(str(folder / "corrected.yaml")),
    }


def draw_diagnosis(diagnosis: Diagnosis) -> Picture:
    """Draw the strokes that the declared model misses most, their residuals, and the force maps."""
    # Loaded here because a report.html, and --help, do not need it.
    from valve_sim.identification.reporting.figures import MAIN, PILOT, QUIET, Picture

    strokes = _drawn(diagnosis, PICTURED_STROKES)[0][:PICTURED_STROKES]
    figure = Picture(figsize=(4.6 * len(strokes) + 0.8, 8.6 if diagnosis.maps else 6.4), layout="constrained")
    figure.suptitle(f"{headline(diagnosis)}\nProbability {percent(diagnosis.verdict.probability)}", wrap=True)
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
        below.fill_between(stroke.time, -2 * stroke.band, 2 * stroke.band, color=PILOT, alpha=0.1, linewidth=0)
        below.plot(stroke.time, stroke.measured - stroke.before, color=MAIN, linewidth=0.8)
        below.plot(stroke.time, stroke.measured - stroke.after, color=PILOT, linewidth=0.8)
        below.set_ylabel(f"residual, {stroke.unit}")
        below.set_xlabel("time, ms")
    rows[0].axes[0].legend(frameon=False)
    if diagnosis.maps:
        axes = rows[1].subplots(1, len(diagnosis.maps), squeeze=False)[0]
        for panel, curve in zip(axes, force_curves(diagnosis), strict=True):
            _draw_curve(panel, curve, PILOT, QUIET)
    for panel in [axes for row in rows for axes in row.axes]:
        panel.spines[["top", "right"]].set_visible(False)
    return figure


def _draw_curve(axes: Axes, curve: ForceCurve, colour: str, quiet: str) -> None:
    axes.fill_between(
        curve.at, curve.force - curve.band, curve.force + curve.band, color=colour, alpha=0.15, linewidth=0
    )
    axes.plot(curve.at, curve.force, color=colour)
    axes.axhline(0.0, color=quiet, linewidth=0.8)
    axes.set_xlabel(curve.label)
    axes.set_ylabel(curve.force_label)


def _wrapped(title: str) -> str:
    return title.replace(": ", ":\n").replace("$", r"\$")


# --- the words of the page ------------------------------------------------------------------------------------------


def _content(diagnosis: Diagnosis) -> dict[str, Any]:
    """The other variables of the template."""
    verdict = diagnosis.verdict
    channel = diagnosis.plant.channels[primary_channels(diagnosis.plant)[0]]
    judged, others = _drawn(diagnosis, SHOWN_STROKES)
    strokes = [*judged, *others]
    scale, unit = channel.readable
    captions = [
        {"index": index, "title": stroke.title, "rms": _change(*stroke.root_mean_squares, stroke.unit)}
        for index, stroke in enumerate(strokes)
    ]
    held_out = sum(stroke.is_held_out for stroke in judged)
    noise = diagnosis.before.fit.problem.noises[channel.kind]
    sigma, source = scale * noise.sigma, _source_of_noise(noise, channel)
    words, is_sure = kind_words(verdict)
    candidates = [_candidate_row(candidate, diagnosis, scale, unit) for candidate in diagnosis.candidates]
    candidates.insert(0, _declared_row(diagnosis, scale, unit))
    return {
        "kind": verdict.kind,
        "kind_words": words,
        "is_sure": is_sure,
        "probability": "" if verdict.kind == "partly" else percent(verdict.probability),
        "headline": headline(diagnosis),
        "summary": summarise(diagnosis),
        "improvement": _improvement(diagnosis, scale, unit, sigma),
        "meanings": meanings(diagnosis),
        "correction": list(correction_lines(diagnosis)),
        "comparison": _comparison(diagnosis, scale, unit),
        "first": captions[:FIRST_STROKES],
        "second": captions[FIRST_STROKES:SHOWN_STROKES],
        "rest": captions[SHOWN_STROKES:],
        **_forces(diagnosis),
        "candidates": candidates[:SHOWN_CANDIDATES],
        "inclusion": _inclusion_rows(diagnosis),
        "limits": limit_rows(diagnosis),
        "more_candidates": candidates[SHOWN_CANDIDATES:],
        "intervals": _interval_rows(diagnosis),
        "has_parameters": isinstance(diagnosis.plant, ValvePlant),
        "declared": declared_section(diagnosis.declared),
        "is_unknown": diagnosis.verdict.kind == "unknown",
        "recording": recording_rows(diagnosis.recording, diagnosis.before.fit.problem.noise.sigma, channel.unit),
        "record_next": recording_advice(diagnosis),
        "gain": _gain_rows(diagnosis),
        "untried": diagnosis.untried,
        "choice": choice_words(diagnosis),
        "held_out": holdout_words(diagnosis),
        "version": __version__,
        "sources": diagnosis.sources,
        "noise": f"{three_digits(sigma)} {unit} rms of the {channel.kind} sensor, {source}",
        "strokes": f"{len(judged) - held_out} fitted, {held_out} held out. Errors are over all samples; drawn are, of "
        "equal bins of each part, the samples at which a curve or a residual is lowest or highest.",
        "strokes_data": [_stroke_plot(stroke.thinned()) for stroke in strokes],
    }


def _drawn(diagnosis: Diagnosis, most: int) -> tuple[list[StrokeCurves], list[StrokeCurves]]:
    """Strokes of the channels in which errors are reported, and of others that were fitted too, as a current.

    Of the first, those that the declared model misses most come before the others; either in the order of recording.
    """
    strokes = strokes_of(diagnosis)
    kind = diagnosis.plant.channels[primary_channels(diagnosis.plant)[0]].kind
    judged = [stroke for stroke in strokes if stroke.quantity == kind]
    worst = sorted(range(len(judged)), key=lambda index: -judged[index].root_mean_squares[0])
    names = [stroke.title.partition(", stroke ")[0] for stroke in judged]

    def recorded(index: int) -> tuple[int, float]:
        return names.index(names[index]), float(judged[index].time[0])

    order = [*sorted(worst[:most], key=recorded), *sorted(worst[most:], key=recorded)]
    return [judged[index] for index in order], [stroke for stroke in strokes if stroke.quantity != kind]


def _source_of_noise(noise: Noise, channel: Channel) -> str:
    """From what the noise of a sensor is known."""
    if channel.noise > 0.0:
        return "as declared"
    return "read where the machine is still" if noise.samples else "which the best model leaves: it is never still"


def _improvement(diagnosis: Diagnosis, scale: float, unit: str, sigma: float) -> str:
    before, after = diagnosis.before, diagnosis.after
    words = f"On fitted data: {_change(scale * before.train_rmse, scale * after.train_rmse, unit)}."
    if math.isfinite(before.holdout_rmse):
        words += f" On held-out data: {_change(scale * before.holdout_rmse, scale * after.holdout_rmse, unit)}."
    unseen = unseen_noise_words(diagnosis)
    what = "The best model leaves" if unseen else "The sensor's noise is"
    words += f" {what} {three_digits(sigma)} {unit}. {rounding_words(diagnosis)} {unseen}"
    return f"Root-mean-square error before → after. {words.rstrip()}"


def _change(before: float, after: float, unit: str) -> str:
    return f"{three_digits(before)} → {three_digits(after)} {unit}"


def _comparison(diagnosis: Diagnosis, scale: float, unit: str) -> list[tuple[str, str, str]]:
    """Rows of a label, the value before and the value after, each with its unit."""
    before, after, unseen = diagnosis.before, diagnosis.after, unseen_noise_words(diagnosis)

    def of_both(label: str, words: Callable[[State], str]) -> tuple[str, str, str]:
        return label, words(before), words(after)

    rows = [
        of_both("rms error, fitted data", lambda state: _number(scale * state.train_rmse, unit)),
        of_both("rms error, held-out data", lambda state: _number(scale * state.holdout_rmse, unit)),
        of_both("rms error that the model predicts", lambda state: _predicted(state, scale, unit)),
        of_both("residual is white", _whiteness if not unseen else lambda state: "not known"),
        of_both("χ² per sample", lambda state: f"{state.fit.chi2 / state.fit.problem.effective_samples:.4g}"),
    ]
    for name in dict.fromkeys([*before.intervals, *after.intervals]):
        if not _is_drawn(name):
            first, last = (
                "–" if (found := state.intervals.get(name)) is None else told_value(diagnosis, name, found)
                for state in (before, after)
            )
            rows.append((named_value(diagnosis.plant, name)[0], first, last))
    return rows


def _predicted(state: State, scale: float, unit: str) -> str:
    """What the posterior predicts of the errors of fitted and of held-out strokes."""
    fitted, held_out = (_number(scale * found, unit) for found in (state.train_predicted, state.holdout_predicted))
    return f"{fitted}; held out {held_out}"


def _inclusion_rows(diagnosis: Diagnosis) -> list[tuple[str, str]]:
    """Names that act with a probability worth a look, the likeliest first."""
    ordered = sorted(diagnosis.inclusion.items(), key=lambda entry: -entry[1])
    return [(title_of(name), percent(found)) for name, found in ordered[:SHOWN_CANDIDATES] if found >= LEAST_SHOWN]


def _declared_row(diagnosis: Diagnosis, scale: float, unit: str) -> dict[str, Any]:
    """The row of the declared model in the table of hypotheses."""
    verdict, before = diagnosis.verdict, diagnosis.before
    return {
        "title": "nothing: the declared model, refitted",
        "name": "",
        "probability": percent(verdict.probability) if verdict.kind == "none" else "–",
        "unnamed": "–",
        "gain": "0",
        "train": _number(scale * before.train_rmse, unit),
        "holdout": _number(scale * before.holdout_rmse, unit),
        "text": "",
        "chosen": verdict.kind == "none",
    }


def _whiteness(state: State) -> str:
    probability = state.adequacy.p_value
    words = f"p = {probability:.2g}" if probability >= _SMALLEST_PROBABILITY else f"p < {_SMALLEST_PROBABILITY:g}"
    return f"{'yes' if state.adequacy.is_white else 'no'} ({words})"


def _number(value: float, unit: str) -> str:
    return f"{three_digits(value)} {unit}" if math.isfinite(value) else "–"


def _candidate_row(candidate: Candidate, diagnosis: Diagnosis, scale: float, unit: str) -> dict[str, Any]:
    plant = diagnosis.plant
    own = {
        name for effect in candidate.effects if effect in plant.effects for name in plant.effects[effect].free_names()
    }
    values = [
        # By name: a description, such as "C in −C v |v|", does not fit beside a number.
        f"{(name.partition('.')[2] or plain_name(name)).translate(_SPACES)} "
        f"{value_words(found.value, plant.parameter(name))}"
        for name, found in candidate.intervals.items()
        if ("." in name or name in own) and not _is_drawn(name)
    ]
    return {
        "title": titles_of(candidate.effects) + (" with errors of the commands' stamps" if candidate.timing else ""),
        "name": " + ".join(candidate.effects),
        "probability": percent(candidate.probability),
        "unnamed": percent(candidate.unnamed),
        "gain": gain_words(-0.5 * candidate.delta_bic),
        "train": _number(scale * candidate.train_rmse, unit),
        "holdout": _number(scale * candidate.holdout_rmse, unit),
        "text": "; ".join(values),
        "chosen": set(candidate.effects) == set(diagnosis.verdict.effects) and _is_fit(candidate, diagnosis.after),
    }


def _is_fit(candidate: Candidate, state: State) -> bool:
    """Whether it is the fit of the corrected model; with and without errors of the stamps are two candidates."""
    return candidate.train_rmse == state.train_rmse


def _interval_rows(diagnosis: Diagnosis) -> list[dict[str, str]]:
    rows = []
    for name, found in diagnosis.after.intervals.items():
        if not _is_drawn(name):
            words, unit = named_value(diagnosis.plant, name)
            row = {
                "words": words,
                "name": name,
                "value": told_value(diagnosis, name, found),
                "limits": "",
                "remark": "",
            }
            if not is_stand_in(diagnosis, name):
                row |= {"limits": limits(found, unit), "remark": remark_on(found)}
            rows.append(row)
    return rows


def _is_drawn(name: str) -> bool:
    """A force map is drawn, its coefficients are not listed."""
    return name.startswith("force_map.")


def _gain_rows(diagnosis: Diagnosis) -> list[str]:
    """How far the recommended recording is expected to separate each pair of candidates."""
    if diagnosis.recommendation is None:
        return []
    return [
        f"{' and '.join(titles_of(name.split(' + ')) for name in pair)}: {deviations:.0f} standard deviations"
        for pair, deviations in diagnosis.recommendation.together
    ]


# --- the drawings of the page ---------------------------------------------------------------------------------------


def force_curves(diagnosis: Diagnosis) -> list[ForceCurve]:
    """The force maps, restricted to the range that the data visited."""
    motion = motion_of(diagnosis) if diagnosis.maps else None
    return [force_curve(entry, motion) for entry in diagnosis.maps] if motion is not None else []


def _forces(diagnosis: Diagnosis) -> dict[str, Any]:
    curves, followed = force_curves(diagnosis), strokes_followed(diagnosis)
    maps = [
        {
            "variable": curve.label.partition(",")[0] + _FACTOR_WORDS.get(curve.variable[1:], ""),
            "gain": gain_words(0.5 * curve.gain),
            "rms": quantity(curve.rms, "N"),
            "where": curve.where,
        }
        for curve in curves
    ]
    unexplained = ""
    if diagnosis.unexplained is not None:
        curve = force_curve(diagnosis.unexplained, motion_of(diagnosis))
        unexplained = f"{quantity(curve.rms, 'N')} rms while it moves, strongest at {curve.where}."
    return {
        "maps": maps,
        "is_noise": diagnosis.before.adequacy.is_white and not unseen_noise_words(diagnosis),
        "followed": [stroke_words(stroke) for stroke in followed[:SHOWN_STROKES]],
        "maps_data": [*map(_curve_plot, curves), *map(stroke_plot, followed[:SHOWN_STROKES])],
        "unexplained": unexplained,
        "is_outdone": bool(diagnosis.verdict.effects) and not diagnosis.before.adequacy.is_white,
        "is_partial": any(curve.is_partial for curve in curves),
    }


def _stroke_plot(stroke: StrokeCurves) -> dict[str, Any]:
    return {
        "quantity": stroke.quantity,
        "unit": stroke.unit,
        "band": _rounded(2.0 * stroke.band, 3),
        "time": _rounded(stroke.time, 4),
        "measured": _rounded(stroke.measured, 2),
        "before": _rounded(stroke.before, 2),
        "after": _rounded(stroke.after, 2),
        "residual_before": _rounded(stroke.measured - stroke.before, 3),
        "residual_after": _rounded(stroke.measured - stroke.after, 3),
    }


def _curve_plot(curve: ForceCurve) -> dict[str, Any]:
    return {
        "label": curve.label,
        "force_label": curve.force_label,
        "at": _rounded(curve.at, 5),
        "force": _rounded(curve.force, 6),
        "low": _rounded(curve.force - curve.band, 6),
        "high": _rounded(curve.force + curve.band, 6),
    }


def _rounded(values: np.typing.NDArray[np.float64], digits: int) -> list[float | None]:
    """Rounded, to keep the page small; null for what is not finite, which JSON lacks."""
    return [finite_or_none(value) for value in np.round(values, digits).tolist()]
