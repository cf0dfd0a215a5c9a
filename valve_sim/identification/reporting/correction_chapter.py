"""What a correction is worth: errors of strokes that it has not seen, how far to trust each name, and what is left."""

from __future__ import annotations

import math
from collections.abc import Iterator, Sequence
from typing import Any, Final

import numpy as np

from valve_sim.identification.diagnosis.outcome import Diagnosis
from valve_sim.identification.fit.correction import Correction, is_curve
from valve_sim.identification.fit.grades import Grade
from valve_sim.identification.fit.left_out import Stroke, levels_of
from valve_sim.identification.plants.effect_titles import inside_sentence, named, title_of
from valve_sim.identification.plants.protocol import READABLE_UNITS
from valve_sim.identification.reporting.claims import curve_words
from valve_sim.identification.reporting.document import Block, Chapter, Items, Table, TableRow, Words
from valve_sim.identification.reporting.units import in_unit, in_units, quantity

LISTED: Final = 12
"""Most conditions in the table."""
SEEN: Final = 1.05
"""Another set predicts as well if its error is larger by less than this factor; the report does not mention it."""
FULL: Final = 0.9
"""Of the declared stroke: a lift that goes as far is full."""
IN_REACH: Final = 1.2
"""Error of the corrected model over the noise, up to which the report says that only noise is left."""


def correction_section(diagnosis: Diagnosis) -> Chapter:
    """How well the correction predicts strokes that it has not seen, what each name is worth, and what is left."""
    correction, unit = diagnosis.correction, diagnosis.primary_channel.unit
    fields = {
        "correction": None,
        "names": [_name_json(diagnosis, grade) for grade in diagnosis.grades],
        "channels": {} if correction is None else _channels_json(diagnosis, correction),
    }
    if correction is None or not correction.names or not correction.conditions:
        is_told = correction is not None and correction.is_applied and correction.names
        return Chapter(fields=fields | ({"correction": _json(diagnosis, correction)} if correction and is_told else {}))
    is_each = correction.parts and len(correction.conditions) > 1
    left_out = "Each condition was left out in turn" if is_each else "These strokes were left out"
    how = "the model was refitted to the others" if correction.is_refitted else "predicted to first order"
    conditions = Table(
        ("strokes that were left out", "error before", "error after"),
        [
            TableRow((condition.words, quantity(condition.before, unit), quantity(condition.after, unit)))
            for condition in correction.conditions[:LISTED]
        ],
    )
    blocks: list[Block] = [Words(f"{left_out}, and {how}.", style="soft"), conditions]
    if not correction.is_applied:
        names = f"a force over {curve_words(correction)}" if is_curve(correction.names) else named(correction.names)
        why = "it does not reduce the error of unseen strokes by a third, or increases that of held-out strokes"
        blocks.append(Words(f"Not applied: a correction by {names}, because {why}.", style="doubt"))
    else:
        fields["correction"] = _json(diagnosis, correction)
        blocks.append(Items([*map(_grade_words, diagnosis.grades), *_left_words(diagnosis, correction)]))
    return Chapter("How well it predicts unseen strokes", blocks, fields)


def _grade_words(grade: Grade) -> str:
    """Its grade, what unseen strokes lose without it, and what would do in its place."""
    title = inside_sentence(title_of(grade.effect))
    words = {"named": f"Named: {title}", "acts_like": f"Acts like {title}", "possible": f"Possible: {title}"}[
        grade.word
    ]
    seen = grade.factor >= SEEN
    without = f"; without it the error of unseen strokes is {grade.factor:.2g} times as large" if seen else ""
    alike = f"; {named(grade.alike, 'or')} would predict as well" if grade.alike else ""
    return f"{words}{without}{alike}."


def _left_words(diagnosis: Diagnosis, correction: Correction) -> Iterator[str]:
    """What is left beside the correction, where it lies, what predicts as well, and how far it holds."""
    unit = diagnosis.primary_channel.unit
    if correction.after > IN_REACH * correction.noise:
        channel = f"in the {_worst_channel(correction)}" if len(correction.channels) > 1 else ""
        where = " and ".join(words for words in (channel, _place_words(diagnosis, correction)) if words)
        left = quantity(_beyond_noise(correction), unit)
        yield f"An unmodelled effect is left: {left} rms beyond the noise{where and f', most of it {where}'}."
    names = set(correction.names)
    apart = [other for other in correction.alternatives if not is_curve(other) and not names < set(other)]
    others = [named(other) or "nothing" for other in sorted(apart, key=len)]
    if others:
        yield f"Other corrections predict unseen strokes as well: {'; '.join(others[:3])}."
    if correction.parts:
        beyond = "" if correction.elsewhere else " Other commands were not tried."
        ends = dict.fromkeys((correction.parts[0].words, correction.parts[-1].words))
        commands = "" if any(words.startswith("stroke ") for words in ends) else f": {' to '.join(ends)}"
        yield f"Confirmed for strokes like those recorded{commands}.{beyond}"
    if correction.elsewhere:
        pulse = max(correction.elsewhere, key=lambda one: one.spread)
        yield (
            f"Not confirmed for {pulse.words}, which was not recorded. There the correction changes the response by "
            f"{quantity(pulse.moved, unit)}, and corrections that predict unseen strokes as well differ by "
            f"{quantity(pulse.spread, unit)}."
        )


def _place_words(diagnosis: Diagnosis, correction: Correction) -> str:
    """Where most is left: "at 0.5 to 0.7 mm, rising"; empty where no place stands out."""
    place, unit = correction.place, diagnosis.primary_channel.unit
    if place is None:
        return ""
    ends = f"{quantity(place.low, unit, 2)} to {quantity(place.high, unit, 2)}"
    return f"at {ends}, {'rising' if place.is_rising else 'falling'}"


def _beyond_noise(correction: Correction) -> float:
    """Error of unseen conditions beyond the noise, in the response's unit."""
    return math.sqrt(max(correction.after**2 - correction.noise**2, 0.0))


def _worst_channel(correction: Correction) -> str:
    """The kind of channel that is left furthest above its noise."""
    channels = correction.channels
    return max(channels, key=lambda kind: channels[kind].after / max(channels[kind].noise, 1e-300))


def _json(diagnosis: Diagnosis, correction: Correction) -> dict[str, Any]:
    scale, unit = diagnosis.primary_channel.readable
    has_curve = is_curve(correction.names)

    def sizes(holder: Any, *names: str) -> dict[str, Any]:
        return in_units({name: scale * getattr(holder, name) for name in names}, unit)

    return {
        "effects": [] if has_curve else list(correction.names),
        "curve": {"over": correction.names[0].removeprefix("curve(").removesuffix(")")} if has_curve else None,
        "chosen_by": correction.by,
        "left_out": {
            "conditions": len(correction.conditions),
            **sizes(correction, "before", "after", "predicted", "best"),
            "each": [{"condition": one.words, **sizes(one, "before", "after")} for one in correction.conditions],
            "refitted": correction.is_refitted,
        },
        "share": correction.share,
        "alternatives": [list(names) for names in correction.alternatives],
        **sizes(correction, "spread"),
        "remains": {
            **in_unit("rms", scale * _beyond_noise(correction), unit),
            "channel": _worst_channel(correction) if correction.channels else None,
            "where": _place_words(diagnosis, correction) or None,
        },
        "valid_for": _valid_for_json(diagnosis, correction),
    }


def _valid_for_json(diagnosis: Diagnosis, correction: Correction) -> dict[str, Any]:
    """Under what the strokes were made that confirm a correction."""
    plant, strokes = diagnosis.plant, [stroke for part in correction.parts for stroke in part.strokes]
    volts = {level for stroke in strokes for level in levels_of(plant.condition_of(*stroke) or ())}
    return {
        "voltages": sorted(volts - {0.0}),
        "lifts": _lifts(diagnosis, strokes),
        "profiles": [part.words for part in correction.parts],
    }


def _lifts(diagnosis: Diagnosis, strokes: Sequence[Stroke]) -> str | None:
    """Whether a valve's plunger went to its stop in these strokes; None where its position was not recorded."""
    plant, lifts = diagnosis.plant, set[bool]()
    if plant.travel is None:
        return None
    for recording, group in strokes:
        for channel in (one for one in plant.channels if one.recording == recording and one.kind == "position"):
            highest = np.max(channel.data[channel.group == group], initial=0.0)
            lifts.add(bool(highest > FULL * plant.travel))
    return " and ".join(word for word, is_full in (("full", True), ("partial", False)) if is_full in lifts) or None


def _name_json(diagnosis: Diagnosis, grade: Grade) -> dict[str, Any]:
    fit, bare = diagnosis.after.fit, grade.effect.removeprefix("valve.")
    freed = [name for name in fit.free if name in fit.values and (name == bare or name.startswith(f"{grade.effect}."))]
    return {
        "effect": grade.effect,
        "grade": grade.word,
        "probability": grade.probability,
        "confusable_with": list(grade.alike),
        "share": grade.share,
        "without": grade.factor,
        "amount": {name.partition(".")[2] or name: fit.values[name] for name in freed},
    }


def _channels_json(diagnosis: Diagnosis, correction: Correction) -> dict[str, dict[str, Any]]:
    """What each kind of channel leaves before and after, in its unit."""
    units = {channel.kind: channel.unit for channel in diagnosis.plant.channels}
    channels = correction.channels
    excess = {kind: max(one.before**2 / one.noise**2 - 1.0, 0.0) for kind, one in channels.items() if one.noise}
    total, told = math.fsum(excess.values()), {}
    for kind, one in channels.items():
        scale, unit = READABLE_UNITS.get(units[kind], (1.0, units[kind]))
        told[kind] = {
            "unit": unit,
            "noise": scale * one.noise,
            "rms_before": scale * one.before,
            "rms_after": scale * one.after,
            "share_of_misfit": excess.get(kind, 0.0) / total if total > 0.0 else None,
        }
    return told
