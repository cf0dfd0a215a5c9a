"""What a correction is worth, in sentences and in report.json: errors of unseen strokes, how far to trust each name."""

from __future__ import annotations

import math
from collections.abc import Iterator, Sequence
from typing import Any, Final

import numpy as np

from valve_sim.identification.diagnosis.outcome import Diagnosis
from valve_sim.identification.fit.correction import Correction, is_curve
from valve_sim.identification.fit.grades import Grade
from valve_sim.identification.fit.intervals import Interval
from valve_sim.identification.fit.left_out import Stroke, levels_of
from valve_sim.identification.plants.effect_titles import inside_sentence, named, named_value, title_of
from valve_sim.identification.plants.hold_out import UnderConditions
from valve_sim.identification.plants.protocol import READABLE_UNITS, primary_channels
from valve_sim.identification.plants.valve import ValvePlant
from valve_sim.identification.reporting.units import in_unit, measured, quantity

WORDS: Final = {"named": "named", "acts_like": "acts like", "possible": "possible"}
"""Grades in words."""
LISTED: Final = 12
"""Most conditions that are printed."""
OVER: Final = {"x": "the position", "v": "the velocity", "t": "time"}
"""Variables of a smooth force in words; others stand as they are."""
SEEN: Final = 1.05
"""Factor between errors, below which nothing is said of it: another set that was fitted predicts as well."""
FULL: Final = 0.9
"""Of the declared stroke: a lift that goes as far is full."""
IN_REACH: Final = 1.2
"""Error of the corrected model over the noise, up to which nothing is said to be left."""


def falls_words(diagnosis: Diagnosis) -> str:
    """By how much the error of unseen strokes falls: "from 4.9 µm to 2.1 µm"; empty where nothing was left out."""
    found = diagnosis.correction
    if found is None or not found.conditions:
        return ""
    unit = _unit(diagnosis)
    return f"from {quantity(found.before, unit)} to {quantity(found.after, unit)}"


def curve_words(found: Correction) -> str:
    """What a curve that corrects is a function of, in words."""
    variable = found.names[0].removeprefix("curve(").removesuffix(")")
    return OVER.get(variable, variable)


def partly_headline(diagnosis: Diagnosis) -> str:
    """The verdict `partly` in a sentence or two."""
    found = diagnosis.correction
    assert found is not None
    fall = falls_words(diagnosis)
    error = f": the error of unseen strokes falls {fall}" if fall else ""
    if is_curve(found.names):
        return f"Corrected by a force over {curve_words(found)} that has no name{error}."
    like = [own.effect for own in diagnosis.grades if own.word in ("named", "acts_like")]
    rest = [own.effect for own in diagnosis.grades if own.word == "possible"]
    if not like:
        return f"Corrected by {named(rest)}{error}. These names are not certain."
    beside = f" {named(rest).capitalize()} also changed, and may stand for something else." if rest else ""
    return f"Corrected. The machine acts as if it had {named(like)}{error}.{beside}"


def correction_lines(diagnosis: Diagnosis) -> Iterator[str]:
    """What the correction predicts of each condition, what each name is worth, and what is left."""
    found, unit = diagnosis.correction, _unit(diagnosis)
    if found is None or not found.names or not found.conditions:
        return
    how = "real refits" if found.is_refitted else "to first order"
    what = "each condition left out in turn" if found.parts and len(found.conditions) > 1 else "strokes left out"
    yield f"Unseen strokes, {what} ({how}):"
    for own in found.conditions[:LISTED]:
        yield f"  {own.words}: {quantity(own.before, unit)} before, {quantity(own.after, unit)} after"
    if not found.is_applied:
        yield f"Not applied: {applied_words(found)}"
        return
    for grade in diagnosis.grades:
        yield grade_words(grade)
    yield from _left_words(diagnosis, found)


def applied_words(found: Correction) -> str:
    """Why a correction is not applied."""
    names = f"a force over {curve_words(found)}" if is_curve(found.names) else named(found.names)
    return f"with {names} the error of unseen strokes does not fall by a third, or separate strokes are worse with it."


def grade_words(own: Grade) -> str:
    """One name of a correction: its grade, what unseen strokes lose without it, and what would do in its place."""
    title = inside_sentence(title_of(own.effect))
    words = {"named": f"Named: {title}", "acts_like": f"Acts like {title}", "possible": f"Possible: {title}"}[own.word]
    without = ""
    if own.factor >= SEEN:
        without = f"; without it unseen strokes err {own.factor:.2g} times as much"
    alike = f"; {named(own.alike, 'or')} would do as well" if own.alike else ""
    return f"{words}{without}{alike}."


def _left_words(diagnosis: Diagnosis, found: Correction) -> Iterator[str]:
    """What is left beside the correction, and where it lies."""
    if found.after > IN_REACH * found.noise:
        left = _beyond_noise(found)
        worst = _worst_channel(found)
        where = f", most of it in the {worst}" if len(found.channels) > 1 else ""
        if place := _place_words(diagnosis, found):
            where += f"{' and' if where else ', most of it'} {place}"
        yield f"Something else is left: {quantity(left, _unit(diagnosis))} beyond the noise{where}."
    apart = [names for names in found.alternatives if not is_curve(names) and not set(found.names) < set(names)]
    others = [" + ".join(map(title_of, names)) or "nothing" for names in sorted(apart, key=len)]
    if others:
        yield f"These predict unseen strokes as well: {'; '.join(others[:3])}."
    if found.parts:
        beyond = "" if found.elsewhere else " Of other commands nothing is known."
        yield f"Holds for strokes like those recorded ({_range_of(found)}).{beyond}"
    if found.elsewhere:
        pulse, unit = max(found.elsewhere, key=lambda own: own.spread), _unit(diagnosis)
        yield (
            f"Not recorded: {pulse.words}. There the correction moves the response by {quantity(pulse.moved, unit)}, "
            f"and corrections that predict unseen strokes as well differ from it by {quantity(pulse.spread, unit)}."
        )


def _place_words(diagnosis: Diagnosis, found: Correction) -> str:
    """Where most is left: "at 0.5 to 0.7 mm, rising"; empty where no place stands out."""
    place, unit = found.place, _unit(diagnosis)
    if place is None:
        return ""
    ends = f"{quantity(place.low, unit, 2)} to {quantity(place.high, unit, 2)}"
    return f"at {ends}, {'rising' if place.is_rising else 'falling'}"


def _beyond_noise(found: Correction) -> float:
    """Error of unseen conditions beyond the noise, in the response's unit."""
    return math.sqrt(max(found.after**2 - found.noise**2, 0.0))


def _worst_channel(found: Correction) -> str:
    """The kind of channel that is left furthest above its noise."""
    return max(found.channels, key=lambda kind: found.channels[kind].after / max(found.channels[kind].noise, 1e-300))


def _remains_json(diagnosis: Diagnosis, found: Correction) -> dict[str, Any]:
    scale, unit = _scale(diagnosis)
    return {
        **in_unit("rms", scale * _beyond_noise(found), unit),
        "channel": _worst_channel(found) if found.channels else None,
        "where": _place_words(diagnosis, found) or None,
    }


def _valid_for_json(diagnosis: Diagnosis, found: Correction) -> dict[str, Any]:
    """Under what the strokes were made that confirm a correction."""
    plant, strokes = diagnosis.plant, [stroke for own in found.parts for stroke in own.strokes]
    volts: set[float] = set()
    if isinstance(plant, UnderConditions):
        volts = {level for stroke in strokes for level in levels_of(plant.condition_of(*stroke))}
    return {
        "voltages": sorted(volts - {0.0}),
        "lifts": _lifts(diagnosis, strokes),
        "profiles": [own.words for own in found.parts],
    }


def _lifts(diagnosis: Diagnosis, strokes: Sequence[Stroke]) -> str | None:
    """Whether a valve's plunger went to its stop in these strokes; None where its position was not recorded."""
    plant, found = diagnosis.plant, set[bool]()
    if not isinstance(plant, ValvePlant):
        return None
    for recording, group in strokes:
        for channel in (one for one in plant.channels if one.recording == recording and one.kind == "position"):
            highest = np.max(channel.data[channel.group == group], initial=0.0)
            found.add(bool(highest > FULL * plant.valve.parameters.stroke))
    return " and ".join(word for word, is_full in (("full", True), ("partial", False)) if is_full in found) or None


def _range_of(found: Correction) -> str:
    words = [own.words for own in found.parts]
    return words[0] if len(words) == 1 else f"{words[0]} to {words[-1]}"


def correction_json(diagnosis: Diagnosis) -> dict[str, Any] | None:
    """The key `correction` of report.json; None where none is applied."""
    found = diagnosis.correction
    if found is None or not found.is_applied or not found.names:
        return None
    scale, unit = _scale(diagnosis)
    has_curve = is_curve(found.names)
    return {
        "effects": [] if has_curve else list(found.names),
        "curve": {"over": found.names[0].removeprefix("curve(").removesuffix(")")} if has_curve else None,
        "chosen_by": found.by,
        "left_out": {
            "conditions": len(found.conditions),
            **in_unit("before", scale * found.before, unit),
            **in_unit("after", scale * found.after, unit),
            **in_unit("predicted", scale * found.predicted, unit),
            **in_unit("best", scale * found.best, unit),
            "each": [
                {
                    "condition": own.words,
                    **in_unit("before", scale * own.before, unit),
                    **in_unit("after", scale * own.after, unit),
                }
                for own in found.conditions
            ],
            "refitted": found.is_refitted,
        },
        "share": found.share,
        "alternatives": [list(names) for names in found.alternatives],
        **in_unit("spread", scale * found.spread, unit),
        "remains": _remains_json(diagnosis, found),
        "valid_for": _valid_for_json(diagnosis, found),
    }


def names_json(diagnosis: Diagnosis) -> list[dict[str, Any]]:
    """The key `names` of report.json."""
    return [
        {
            "effect": own.effect,
            "grade": own.word,
            "probability": own.probability,
            "confusable_with": list(own.alike),
            "share": own.share,
            "without": own.factor,
            "amount": {
                name.partition(".")[2] or name: value
                for name, value in _values(diagnosis).items()
                if name.startswith(f"{own.effect}.") or name == own.effect.removeprefix("valve.")
            },
        }
        for own in diagnosis.grades
    ]


def _values(diagnosis: Diagnosis) -> dict[str, float]:
    """What was freed came to, by name."""
    values = diagnosis.after.fit.values
    return {name: values[name] for name in diagnosis.after.fit.free if name in values}


def is_stand_in(diagnosis: Diagnosis, name: str) -> bool:
    """Whether a value is of an effect that is not named, but only acts like what is there: it has no error."""
    effect = name.partition(".")[0]
    stand_ins = [own.effect for own in diagnosis.grades if own.word != "named"]
    return effect in {*stand_ins, *(one.removeprefix("valve.") for one in stand_ins)}


def told_value(diagnosis: Diagnosis, name: str, found: Interval) -> str:
    """A value with its unit and error; of a stand-in "about" and no error."""
    unit = named_value(diagnosis.plant, name)[1]
    return f"about {quantity(found.value, unit, 2)}" if is_stand_in(diagnosis, name) else measured(found, unit)


def channels_json(diagnosis: Diagnosis) -> dict[str, dict[str, Any]]:
    """The key `channels` of report.json: what each kind of channel leaves before and after, in its own unit."""
    found = diagnosis.correction
    if found is None:
        return {}
    units = {own.kind: own.unit for own in diagnosis.plant.channels}
    excess = {kind: max(own.before**2 / own.noise**2 - 1.0, 0.0) for kind, own in found.channels.items() if own.noise}
    total = math.fsum(excess.values())
    return {
        kind: {
            "unit": READABLE_UNITS.get(units[kind], (1.0, units[kind]))[1],
            "noise": READABLE_UNITS.get(units[kind], (1.0, ""))[0] * own.noise,
            "rms_before": READABLE_UNITS.get(units[kind], (1.0, ""))[0] * own.before,
            "rms_after": READABLE_UNITS.get(units[kind], (1.0, ""))[0] * own.after,
            "share_of_misfit": excess.get(kind, 0.0) / total if total > 0.0 else None,
        }
        for kind, own in found.channels.items()
    }


def _scale(diagnosis: Diagnosis) -> tuple[float, str]:
    return diagnosis.plant.channels[primary_channels(diagnosis.plant)[0]].readable


def _unit(diagnosis: Diagnosis) -> str:
    return diagnosis.plant.channels[primary_channels(diagnosis.plant)[0]].unit
