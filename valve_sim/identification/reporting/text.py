"""A diagnosis as text for the terminal: plain words first, then names of code."""

from __future__ import annotations

import math
import textwrap

from valve_sim.identification.diagnosis.run import Diagnosis, Verdict
from valve_sim.identification.plants.effect_titles import capitalised, named, named_value, title_of
from valve_sim.identification.plants.protocol import primary_channels
from valve_sim.identification.plants.valve import ValvePlant
from valve_sim.identification.reporting.correction import correction_lines
from valve_sim.identification.reporting.declared_values import summary_words
from valve_sim.identification.reporting.findings import remark_on
from valve_sim.identification.reporting.recording_state import UNTOLD, recording_lines
from valve_sim.identification.reporting.summary import recording_advice, summarise
from valve_sim.identification.reporting.units import limits, measured, quantity
from valve_sim.identification.reporting.wording import (
    choice_words,
    headline,
    holdout_words,
    kind_words,
    limit_rows,
    meanings,
    percent,
    rounding_words,
    told_amounts,
    unseen_noise_words,
)

_WIDTH = 44


def diagnosis_text(diagnosis: Diagnosis) -> str:
    """The verdict, the errors before and after, what each effect is and what to do, and the values with their units."""
    verdict, before, after = diagnosis.verdict, diagnosis.before, diagnosis.after
    lines = [
        f"{verdict.kind}: {headline(diagnosis)}",
        f"  {_certainty(verdict)} {summarise(diagnosis)}",
    ]
    unit, noise = _unit_and_noise(diagnosis)
    for label, errors in (
        ("fitted data", (before.train_rmse, after.train_rmse)),
        ("held-out data", (before.holdout_rmse, after.holdout_rmse)),
    ):
        if not any(map(math.isnan, errors)):
            lines.append(
                f"  {label + ', rms error':<28}{quantity(errors[0], unit)} before, {quantity(errors[1], unit)} after"
            )
    unseen = unseen_noise_words(diagnosis)
    label = "left by the best model" if unseen else "noise of the sensor"
    lines.append(f"  {label:<28}{quantity(noise, unit)}")
    remarks = (choice_words(diagnosis), rounding_words(diagnosis), unseen, holdout_words(diagnosis))
    lines += [f"  {words}" for words in remarks if words]
    lines += [f"  {words}" for words in correction_lines(diagnosis)]
    for meaning in meanings(diagnosis):
        lines.append(f"  {meaning.title} ({meaning.name}): {told_amounts(meaning)}")
        lines += [f"    {words}" for words in (meaning.on_a_real_valve, meaning.what_to_do) if words]
    if verdict.kind == "unknown":
        lines.append("  Values of the declared model by itself, which what is missing distorts:")
    for name, found in after.intervals.items():
        unit = named_value(diagnosis.plant, name)[1]
        lines.append(f"  {name:<{_WIDTH}}{measured(found, unit)}")
        if remark := remark_on(found):
            lines += textwrap.wrap(
                f"95 % interval {limits(found, unit)}: {remark}.", 118, initial_indent="    ", subsequent_indent="    "
            )
    lines += _nearest_lines(diagnosis)
    state = [UNTOLD] if diagnosis.verdict.kind == "unknown" else recording_lines(diagnosis.recording)
    lines += [f"  {words}" for words in state]
    if rows := limit_rows(diagnosis):
        lines.append("  Each effect alone would be named in half of such recordings from this size on:")
        lines += [f"    {title:<{_WIDTH - 2}}{words}" for title, words in rows]
    declared = diagnosis.declared
    if declared or isinstance(diagnosis.plant, ValvePlant):
        lines.append(f"  {capitalised(summary_words(declared))}.")
    is_untold = verdict.kind == "insufficient" and verdict.is_cut_short  # most of its rivals were never fitted
    for effect, others in verdict.confusable_with.items():
        if others and not is_untold:
            alike = ", ".join(f"{title_of(other)} ({other})" for other in others)
            lines.append(f"  {title_of(effect)} ({effect}) could also be: {alike}")
    if advice := recording_advice(diagnosis):
        lines.append(f"  {advice}")
    return "\n".join(lines)


def _nearest_lines(diagnosis: Diagnosis) -> list[str]:
    """What the nearest names, which are not claimed, would come to beside something unnamed."""
    verdict = diagnosis.verdict
    found = next((one for one in diagnosis.candidates if set(one.effects) == set(verdict.effects)), None)
    if verdict.kind != "unknown" or not verdict.effects or found is None:
        return []
    unit = _unit_and_noise(diagnosis)[0]
    held_out = "" if math.isnan(found.holdout_rmse) else f", {quantity(found.holdout_rmse, unit)} held out"
    error = f"rms error {quantity(found.train_rmse, unit)} fitted{held_out}"
    lines = [f"  With {named(verdict.effects)}, which is not claimed, {error}:"]
    for name, value in found.intervals.items():
        lines.append(f"    {name:<{_WIDTH - 2}}{measured(value, named_value(diagnosis.plant, name)[1])}")
    return lines


def _certainty(verdict: Verdict) -> str:
    """How sure the verdict is; of `none` only the probability, because the headline has the rest."""
    if verdict.kind == "insufficient" and verdict.is_cut_short:
        return f"{kind_words(verdict)[0]}."
    probability = f"probability {percent(verdict.probability)}"
    return f"{capitalised(probability)}." if verdict.kind == "none" else f"{kind_words(verdict)[0]} ({probability})."


def _unit_and_noise(diagnosis: Diagnosis) -> tuple[str, float]:
    channel = diagnosis.plant.channels[primary_channels(diagnosis.plant)[0]]
    return channel.unit, diagnosis.before.fit.problem.noises[channel.kind].sigma
