"""A diagnosis as a document: report.html, report.json and what the terminal shows."""

from __future__ import annotations

import functools
import math
import shlex
import shutil
from collections.abc import Callable, Iterator
from pathlib import Path
from typing import Any, Final

from valve_sim import __version__
from valve_sim.identification.diagnosis.outcome import Candidate, Diagnosis, State
from valve_sim.identification.fit.intervals import Interval
from valve_sim.identification.plants.effect_titles import named, named_value, title_of, titles_of
from valve_sim.identification.plants.protocol import Plant
from valve_sim.identification.plants.tolerances import GROUP
from valve_sim.identification.reporting import claims, values
from valve_sim.identification.reporting import document as doc
from valve_sim.identification.reporting.correction_chapter import correction_section
from valve_sim.identification.reporting.force_curves import MovingSamples, force_curve, motion_of, unexplained_json
from valve_sim.identification.reporting.record_next import profile_of, typed_commands, typed_option
from valve_sim.identification.reporting.recording_document import limits_table, recording_sections
from valve_sim.identification.reporting.strokes import strokes_followed, worst_first
from valve_sim.identification.reporting.units import (
    change,
    error_words,
    gain_words,
    in_unit,
    in_units,
    measured,
    percent,
    quantity,
    three_digits,
)

SHOWN_STROKES: Final = 6
"""Strokes that are shown at once, those with the largest error of the declared model; the others unfold."""
SHOWN_CANDIDATES: Final = 8
LEAST_SHOWN: Final = 0.01
"""Smallest probability of an effect that is listed."""
_SPACES: Final = str.maketrans("._", "  ")
"""Turns names of parameters into words."""
_SMALLEST_PROBABILITY: Final = 1e-6
"""Smaller p-values are shown as below this one."""
LEGEND: Final = (("measured", "measured"), ("before", "before"), ("after", "after"))
BAND: Final = (
    "Below each stroke: measured − model. The band is two standard deviations of that difference as the model predicts "
    "it, noise included. Errors are computed from all samples; the plots show the extremes of equal bins."
)
TRIED: Final = (
    "Sets of effects that were fitted beside the declared model; click a title to sort. Probability is posterior, "
    "among all sets that were tried. Ln evidence is the logarithm of the Bayes factor against the declared model: +5 "
    "means odds of 150 to 1. Held-out strokes are predicted, not fitted."
)
FORCES: Final = (
    "For each variable, the force that explains the residual of the refitted declared model best; the best variable "
    "comes first. The band is two standard errors, and the rms counts only while the machine moves. Gaps in a curve "
    "are values that the recording did not reach, or at which a stop takes up any force."
)
FOLLOWED: Final = (
    "No position was measured in these strokes. It is computed by the corrected model, and is only as correct as that. "
    "The band is two standard errors of the estimated parameters."
)
LIMITS: Final = "An effect of this size would be named in half of such recordings."
CHANGES_A_NODE: Final = "ros2 param load"
"""Begins a command that is shown only where ROS 2 is installed."""
OUTDONE: Final = "No force over position, velocity or time alone explains the data nearly as well as the named effects."


def diagnosis_document(
    diagnosis: Diagnosis, folder: Path | None = None, options: str = "", provenance: str = ""
) -> doc.Document:
    """The whole report of a diagnosis.

    Errors are in `unit`, the one in which people read the response: µm of a position, mA of a current, N of a force. Of
    a position they also stand under the names `noise_um` and `rmse_um`, of a current under `noise_ma` and `rmse_ma`.

    Args:
        diagnosis: of any machine.
        folder: where its files will lie, for commands that work where this process was started.
        options: of these commands: the machine and the map, as "--params my_valve.yaml --map map.yaml".
        provenance: how it was made.
    """
    verdict, fit = diagnosis.verdict, diagnosis.before.fit
    status, is_sure = claims.certainty(verdict)
    noise, unit = fit.problem.noise.sigma, diagnosis.primary_channel.unit
    is_bare = verdict.kind == "partly" or (verdict.kind == "insufficient" and verdict.is_cut_short)
    sections = [
        _verdict(diagnosis),
        _meaning(diagnosis, is_sure=is_sure),
        correction_section(diagnosis),
        _record_next(diagnosis, folder, options),
        _before_and_after(diagnosis),
        _strokes(diagnosis),
        _followed(diagnosis),
        _forces(diagnosis),
        _tried(diagnosis),
        values.declared_section(diagnosis.declared, says_exact=diagnosis.plant.wording.says_exact),
        *recording_sections(diagnosis.recording, noise, unit, is_unknown=verdict.kind == "unknown"),
        _use(diagnosis, folder, options, is_sure=is_sure),
        _made(diagnosis, provenance),
    ]
    of_what = "likeliest set: " if verdict.kind == "insufficient" else ""
    chance = "" if is_bare else f"{of_what}probability {percent(verdict.probability)}"
    return doc.Document("Diagnosis", sections, claims.headline(diagnosis), verdict.kind, status, chance, is_sure)


def _in_unit_of(diagnosis: Diagnosis) -> Callable[[float], str]:
    """Tells an error of the response in the unit in which people read it; – where it is not known."""
    return functools.partial(error_words, unit=diagnosis.primary_channel.unit)


def _verdict(diagnosis: Diagnosis) -> doc.Chapter:
    """The verdict beside the headline, and what the errors come to."""
    verdict, before, after = diagnosis.verdict, diagnosis.before, diagnosis.after
    scale, unit = diagnosis.primary_channel.readable
    unseen = claims.unseen_noise_words(diagnosis)

    def told(name: str) -> str:
        first, last = (scale * getattr(state, name) for state in (before, after))
        return change(first, last, unit) if verdict.is_corrected else f"{three_digits(first)} {unit}"

    model = ", before → after" if verdict.is_corrected else " of the refitted declared model"
    held_out = f", {told('holdout_rmse')} on held-out data" if math.isfinite(before.holdout_rmse) else ""
    sigma = three_digits(scale * before.fit.problem.noises[diagnosis.primary_channel.kind].sigma)
    least = f"{'The best model leaves' if unseen else 'The noise of the sensor is'} {sigma} {unit}."
    errors = f"Root-mean-square error{model}: {told('train_rmse')} on fitted data{held_out}. {least}"
    chosen = claims.choice_words(diagnosis), claims.holdout_words(diagnosis)
    remarks = (claims.rounding_words(diagnosis), unseen, *claims.grounds(diagnosis))
    untried = [doc.Items(diagnosis.untried, f"all {len(diagnosis.untried)} sets that were not tried", on="page")]
    return doc.Chapter(
        "",
        [
            doc.Words(errors, style="soft"),
            *(doc.Words(words) for words in remarks if words and words != claims.recording_advice(diagnosis)),
            *(untried if len(diagnosis.untried) > claims.SHOWN_UNTRIED else []),
            *(doc.Words(words, on="terminal") for words in chosen if words),
        ],
        {
            "schema": "valve_sim/diagnosis/3",
            "sources": list(diagnosis.sources),
            "unit": unit,
            **in_unit("noise", scale * before.fit.problem.noise.sigma, unit),
            "verdict": {
                "kind": verdict.kind,
                "effects": list(verdict.effects),
                "confusable_with": {name: list(others) for name, others in verdict.confusable_with.items()},
                "probability": verdict.probability,
                "unnamed": verdict.unnamed,
                "share": verdict.share,
                "ended": "budget" if verdict.is_cut_short else None,
                "worth": {name: worth._asdict() for name, worth in verdict.worth.items()},
                "summary": claims.summarise(diagnosis),
                "headline": claims.headline(diagnosis),
            },
            "untried": list(diagnosis.untried),
            "work": {"strokes": diagnosis.work, "allowed": diagnosis.allowed},
            "held_out_gain": diagnosis.held_out_gain,
            "strokes": diagnosis.choice,
        },
    )


def _meaning(diagnosis: Diagnosis, *, is_sure: bool) -> doc.Chapter:
    told, alike = claims.meanings(diagnosis), diagnosis.verdict.confusable_with
    title = "What it means" if is_sure else "What it would mean"
    entries = [claims.meaning_entry(name, meaning, alike.get(name, ())) for name, meaning in told.items()]
    return doc.Chapter(title, entries, {"meaning": told})


def _record_next(diagnosis: Diagnosis, folder: Path | None, options: str) -> doc.Chapter:
    """What to record next, what that is expected to show, and the commands."""
    advice, best = claims.recording_advice(diagnosis), diagnosis.recommendation
    fields: dict[str, Any] = {"record_next": advice or None, "record_next_gain": None}
    blocks: list[doc.Block] = [doc.Words(advice)] if advice else []
    if best is not None:
        fields["record_next_gain"] = {
            "experiment": best.experiment.words,
            "repeats": best.repeats,
            "separates": [{"candidates": list(pair), "standard_deviations": apart} for pair, apart in best.together],
        }
        pairs = [
            f"{' and '.join(titles_of(name.split(' + ')) for name in pair)}: {apart:.0f} standard deviations"
            for pair, apart in best.together
        ]
        if advice:
            expected = "Expected separation by this recording, all else refitted:"
            blocks += [doc.Words(expected, on="page"), doc.Items(pairs, on="page")]
    drive = profile_of(diagnosis) if advice else None
    if drive is not None:
        care = (
            "The commands are in record_next.yaml, beside this page. Read it before you use it: the voltages must suit"
        )
        file = (folder or Path()) / "record_next.yaml"
        simulate, command = typed_commands(drive, file, options, "expected.csv")
        blocks += [doc.Words(f"{care} your coil.", on="page"), doc.Typed([simulate, command])]
    return doc.Chapter("What to record next", blocks, fields)


def _before_and_after(diagnosis: Diagnosis) -> doc.Chapter:
    """Errors and values of the refitted declared model and of the corrected one."""
    verdict, before, after = diagnosis.verdict, diagnosis.before, diagnosis.after
    scale, unit = diagnosis.primary_channel.readable
    unseen = claims.unseen_noise_words(diagnosis)
    states = (before, after) if verdict.is_corrected else (before,)

    number = _in_unit_of(diagnosis)
    lines = {
        "rms error, fitted data": [number(state.train_rmse) for state in states],
        "rms error, held-out data": [number(state.holdout_rmse) for state in states],
        "rms error expected by the model": [
            f"{number(state.train_predicted)}; held out {number(state.holdout_predicted)}" for state in states
        ],
        "residual is white": ["not known" if unseen else _whiteness(state) for state in states],
        "χ² per sample": [f"{state.fit.chi2 / state.fit.problem.effective_samples:.4g}" for state in states],
    }
    models = ("declared model, refitted", "corrected model")[: len(states)]
    rows = [doc.TableRow((label, *cells, "")) for label, cells in lines.items()]
    table = doc.Table(("", *models, "95 % interval"), [*rows, *values.value_rows(diagnosis)], is_by_name=True)
    doubt = "These values are of the declared model, and distorted by what it lacks."
    distorted = [doc.Words(doubt, style="doubt")] if verdict.kind == "unknown" else []
    corrected = {**_state_json(after, scale, unit), "effects": _effects_json(diagnosis)}
    return doc.Chapter(
        "Before and after" if verdict.is_corrected else "The refitted model",
        [*distorted, table, *_nearest(diagnosis)],
        {"before": _state_json(before, scale, unit), "after": corrected if verdict.is_corrected else None},
    )


def _nearest(diagnosis: Diagnosis) -> Iterator[doc.Block]:
    """What the nearest names, which are not claimed, would come to beside something unnamed."""
    verdict, number = diagnosis.verdict, _in_unit_of(diagnosis)
    nearest = next((one for one in diagnosis.candidates if set(one.effects) == set(verdict.effects)), None)
    if verdict.kind != "unknown" or not verdict.effects or nearest is None:
        return
    held_out = "" if math.isnan(nearest.holdout_rmse) else f", {number(nearest.holdout_rmse)} on held-out data"
    error = f"the rms error would be {number(nearest.train_rmse)} on fitted data{held_out}"
    yield doc.Words(f"Nearest, but not claimed: with {named(verdict.effects)} {error}.")
    told = ((name, interval, *named_value(diagnosis.plant, name)) for name, interval in nearest.intervals.items())
    rows = [doc.TableRow((words, measured(interval, unit)), name) for name, interval, words, unit in told]
    yield doc.Table(("value", "with them"), rows, is_by_name=True)
    alike = [(effect, others) for effect, others in verdict.confusable_with.items() if others]
    yield doc.Items([f"{title_of(effect)} could also be: {named(others, 'or')}." for effect, others in alike])


def _whiteness(state: State) -> str:
    probability = state.adequacy.p_value
    words = f"p = {probability:.2g}" if probability >= _SMALLEST_PROBABILITY else "p < 10⁻⁶"
    return f"{'yes' if state.adequacy.is_white else 'no'} ({words})"


def _state_json(state: State, scale: float, unit: str) -> dict[str, Any]:
    errors = {
        "rmse": {"train": scale * state.train_rmse, "holdout": scale * state.holdout_rmse},
        "predicted": {"train": scale * state.train_predicted, "holdout": scale * state.holdout_predicted},
    }
    return {
        "parameters": values.intervals_json({name: one for name, one in state.intervals.items() if "." not in name}),
        **in_units(errors, unit),
        "white": state.adequacy.is_white,
        "chi2_per_sample": state.fit.chi2 / state.fit.problem.effective_samples,
        "test": {"p_value": state.adequacy.p_value, "worst": state.adequacy.worst},
    }


def _effects_json(diagnosis: Diagnosis) -> dict[str, dict[str, Any]]:
    """What each effect came to; what only stands in for something has no error."""
    state, plant = diagnosis.after, diagnosis.after.fit.problem.plant
    effects: dict[str, dict[str, Any]] = {}

    def entry(name: str, interval: Interval) -> dict[str, Any]:
        bare = {"stderr": None, "ci95": [None, None]} if values.is_stand_in(diagnosis, name) and "." in name else {}
        return {**values.interval_json(interval), "was": plant.declared(name), **bare}

    for wrong in plant.effects.values():
        names = wrong.free_names() if wrong.is_declared_value else ()
        if names and set(names) <= set(state.intervals):
            effects[wrong.name] = {name: entry(name, state.intervals[name]) for name in names}
    for name, interval in state.intervals.items():
        effect, dot, parameter = name.partition(".")
        if dot and not name.startswith(GROUP):
            effects.setdefault(effect, {})[parameter] = entry(name, interval)
    for name, value in state.fit.values.items():
        effect, dot, parameter = name.partition(".")
        if dot and effect in effects and parameter not in effects[effect]:
            effects[effect][parameter] = {"value": value, "stderr": 0.0, "ci95": [value, value]}
    return effects


# --- what is drawn --------------------------------------------------------------------------------------------------


def stroke_plots(diagnosis: Diagnosis, most: int = SHOWN_STROKES) -> list[doc.Plot]:
    """Strokes of the response, of which the declared model misses those first that are within `most`; then others."""
    judged, others = worst_first(diagnosis, most)
    return [stroke.plot() for stroke in (*judged, *others)]


def force_plots(diagnosis: Diagnosis, motion: MovingSamples | None = None) -> list[doc.Plot]:
    """The force maps, restricted to the range that the data visited."""
    if diagnosis.maps and motion is None:
        motion = motion_of(diagnosis)
    return [] if motion is None else [force_curve(entry, motion).plot() for entry in diagnosis.maps]


def _strokes(diagnosis: Diagnosis) -> doc.Chapter:
    legend = LEGEND if diagnosis.verdict.is_corrected else (LEGEND[0], ("after", "refitted model"))
    plots = doc.Plots(functools.partial(stroke_plots, diagnosis), SHOWN_STROKES, legend)
    return doc.Chapter("Measured against model", [plots, doc.Words(BAND, style="soft")], on="page")


def _followed(diagnosis: Diagnosis) -> doc.Chapter:
    fits = [fit for fit in (diagnosis.after.fit, diagnosis.after.holdout) if fit is not None]
    has_any = any(fit.problem.plant.follows_positions for fit in fits)
    followed = functools.cache(lambda: strokes_followed(diagnosis) if has_any else [])
    plots = doc.Plots(lambda: [stroke.plot() for stroke in followed()[:SHOWN_STROKES]], is_small=True)
    return doc.Chapter(
        "The position that follows from the current",
        [doc.Words(FOLLOWED, style="soft"), plots] if has_any else [],
        {"position_from_current": lambda: [stroke.to_json() for stroke in followed()]},
        on="page",
    )


def _forces(diagnosis: Diagnosis) -> doc.Chapter:
    """What the residual looks like as a force over each variable, and what no named effect explains."""
    motion, left = functools.cache(lambda: motion_of(diagnosis)), diagnosis.unexplained
    fields = {
        "unexplained": lambda: None if left is None else unexplained_json(left, motion()),
        "force_maps": lambda: [unexplained_json(entry, motion()) for entry in diagnosis.maps],
    }
    blocks: list[doc.Block] = []
    if diagnosis.maps:
        plots = doc.Plots(lambda: force_plots(diagnosis, motion()), is_small=True)
        blocks = [doc.Words(FORCES, style="soft"), plots]
    elif not diagnosis.before.adequacy.is_white and diagnosis.verdict.effects:
        blocks = [doc.Words(OUTDONE, style="soft")]
    if left is not None:
        curve = force_curve(left, motion())
        told = f"a force of {quantity(curve.rms, 'N')} rms while it moves, strongest at {curve.where}."
        blocks.append(doc.Words(told, lead="Left over"))
    return doc.Chapter("What the residual looks like as a force", blocks, fields, on="page")


# --- what was tried -------------------------------------------------------------------------------------------------


def _tried(diagnosis: Diagnosis) -> doc.Chapter:
    """The sets that were fitted, how probable each effect is, and what would have been named."""
    plant, limits = diagnosis.plant, diagnosis.detection_limits
    beside = ("probability", "with an unmodelled effect", "ln evidence", "rms, fitted", "rms, held out")
    verdict, number = diagnosis.verdict, _in_unit_of(diagnosis)
    errors = (number(diagnosis.before.train_rmse), number(diagnosis.before.holdout_rmse))
    share = percent(verdict.probability) if verdict.kind == "none" else "–"
    nothing = ("nothing: the declared model, refitted", share, "–", "0", *errors, "")
    rows = [doc.TableRow(nothing, is_marked=verdict.kind == "none")]
    rows += [_candidate_row(candidate, diagnosis) for candidate in diagnosis.candidates]
    tried = doc.Table(
        ("what is missing", *beside, "values"), rows, SHOWN_CANDIDATES, is_sorted_on_click=True, on="page"
    )
    ordered = sorted(diagnosis.inclusion.items(), key=lambda entry: -entry[1])
    likely = [
        doc.TableRow((title_of(name), percent(share)))
        for name, share in ordered[:SHOWN_CANDIDATES]
        if share >= LEAST_SHOWN
    ]
    blocks: list[doc.Block] = [doc.Words(TRIED, style="soft", on="page"), tried]
    if not diagnosis.candidates and not diagnosis.verdict.is_cut_short:
        blocks.append(
            doc.Words("No effect was fitted: the score test finds none that would gain evidence.", style="soft")
        )
    if likely:
        blocks.append(doc.Table(("each effect, alone or beside others", "probability"), likely, on="page"))
    if limits:
        blocks.append(doc.Words(LIMITS, style="soft"))
        table = limits_table(plant, limits, head=("effect that would act alone", "smallest size that is named"))
        blocks.append(table)
    return doc.Chapter(
        "What was tried",
        blocks,
        {
            "inclusion": dict(diagnosis.inclusion),
            "candidates": [_candidate_json(candidate, diagnosis) for candidate in diagnosis.candidates],
            "detection_limits": {name: dict(sizes) for name, sizes in limits.items()},
        },
    )


def _candidate_row(candidate: Candidate, diagnosis: Diagnosis) -> doc.TableRow:
    plant, effects, number = diagnosis.plant, set(candidate.effects), _in_unit_of(diagnosis)
    freed = {name for effect in effects & plant.effects.keys() for name in plant.effects[effect].free_names()}
    # By name: a description, such as "C in −C v |v|", does not fit beside a number.
    told = [
        f"{_short_name(name)} {_value_words(plant, name, interval.value)}"
        for name, interval in candidate.intervals.items()
        if ("." in name or name in freed) and not name.startswith("force_map.")
    ]
    shares = (percent(candidate.probability), percent(candidate.unnamed), gain_words(-0.5 * candidate.delta_bic))
    errors = (number(candidate.train_rmse), number(candidate.holdout_rmse))
    # Where all sets have them, they tell none apart.
    has_stamps = candidate.timing and not all(other.timing for other in diagnosis.candidates)
    title = titles_of(candidate.effects) + (" with errors of the commands' stamps" if has_stamps else "")
    is_chosen = diagnosis.verdict.is_corrected and effects == set(diagnosis.verdict.effects)
    cells = (title, *shares, *errors, "; ".join(told))
    return doc.TableRow(cells, " + ".join(candidate.effects), is_marked=is_chosen)


def _candidate_json(candidate: Candidate, diagnosis: Diagnosis) -> dict[str, Any]:
    scale, unit = diagnosis.primary_channel.readable
    errors = {"train": scale * candidate.train_rmse, "holdout": scale * candidate.holdout_rmse}
    return {
        "effect": " + ".join(candidate.effects),
        "effects": list(candidate.effects),
        "command_errors": candidate.timing,
        "probability": candidate.probability,
        "unnamed": candidate.unnamed,
        "log_evidence": candidate.log_evidence,
        "delta_bic": candidate.delta_bic,
        **in_unit("rmse", errors, unit),
        "parameters": values.intervals_json(candidate.intervals),
    }


def _short_name(name: str) -> str:
    return (name.partition(".")[2] or values.plain_name(name)).translate(_SPACES)


def _value_words(plant: Plant, name: str, value: float) -> str:
    """A value with its unit; of one at which the search ended, that the data do not say it."""
    parameter = plant.parameter(name)
    return quantity(value, parameter.unit) if claims.is_inside(value, parameter) else "not determined"


# --- what to do with it ---------------------------------------------------------------------------------------------


def _use(diagnosis: Diagnosis, folder: Path | None, options: str, *, is_sure: bool) -> doc.Chapter:
    """Commands that check the corrected model and start it."""
    wording, file = diagnosis.plant.wording, shlex.quote(str((folder or Path()) / "corrected.yaml"))
    if not wording.corrected:
        return doc.Chapter()
    source = typed_option(options, "--map") + typed_option(options, "--valve")
    has_ros = shutil.which("ros2") is not None
    lines = [
        use.format(file=file, options=source) for use in wording.uses if has_ros or not use.startswith(CHANGES_A_NODE)
    ]
    values = "these values" if diagnosis.after.intervals else "the declared values"
    what = (
        f"corrected.yaml, beside this page, is {wording.corrected} with {values}. Check it against a recording that "
        "was not used here, and start it, in the folder where this diagnosis was made:"
    )
    doubt = [] if is_sure else [doc.Words("The verdict is uncertain: check first, and record more.", style="doubt")]
    model = "corrected" if diagnosis.verdict.is_corrected else "refitted"
    return doc.Chapter(f"How to use the {model} model", [doc.Words(what), doc.Typed(lines), *doubt], on="page")


def _made(diagnosis: Diagnosis, provenance: str) -> doc.Chapter:
    channel = diagnosis.primary_channel
    noise = diagnosis.before.fit.problem.noises[channel.kind]
    scale, unit = channel.readable
    origin = (
        "read while the machine is still" if noise.samples else "the residual of the best model, as it is never still"
    )
    if channel.noise > 0.0:
        origin = "as declared"
    rows = [
        ("Made by", f"valve_sim {__version__}"),
        ("Sources", "\n".join(diagnosis.sources)),
        ("Noise", f"{three_digits(scale * noise.sigma)} {unit} rms of the {channel.kind} sensor, {origin}"),
        ("Strokes", claims.choice_words(diagnosis)),
        ("Held out", claims.holdout_words(diagnosis)),
        ("Provenance", provenance),
    ]
    return doc.Chapter(
        "How this was made", [doc.Table(("", ""), [doc.TableRow(row) for row in rows if row[1]])], on="page"
    )
