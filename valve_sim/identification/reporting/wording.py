"""A verdict in plain words: title and amount of each effect, and how sure the verdict is."""

from __future__ import annotations

import math
from collections.abc import Mapping
from typing import Any, Final, NamedTuple

from valve_sim.identification.diagnosis.run import Diagnosis, Verdict
from valve_sim.identification.fit.result import effective_rmse
from valve_sim.identification.plants.effect_titles import capitalised, named, title_of, what_is_missing
from valve_sim.identification.plants.own import OwnPlant
from valve_sim.identification.plants.protocol import Plant, primary_channels
from valve_sim.identification.plants.tolerances import GROUP
from valve_sim.identification.plants.valve import ValvePlant
from valve_sim.identification.reporting.correction import partly_headline
from valve_sim.identification.reporting.declared_values import amount_words, plain_name
from valve_sim.identification.reporting.units import amount, quantity
from valve_sim.model import CATALOGUE, Effect, Parameter

SURE: Final = 0.9
"""Probability above which a verdict is called found."""
COORDINATES: Final = {"attraction_polynomial": "attraction"}
"""Declared values that are estimated by coordinates, and the name of these."""
EVEN: Final = 0.5
"""Probability below which a verdict is more likely wrong than right."""

LEAST_SHARE: Final = 0.01
"""Share of the improvement that is no more told by a number."""
VISIBLE: Final = 1e-3
"""Relative difference of two errors that a reader sees."""


class Meaning(NamedTuple):
    """A named effect in words.

    Attributes:
        name: in code. title: plain.
        amounts: (what, value with interval and unit) of each parameter.
        severity: its size beside something known, or empty. on_a_real_valve, what_to_do: a sentence each, or empty.
        others: plain titles of what would explain the data about as well.
    """

    name: str
    title: str
    amounts: tuple[tuple[str, str], ...]
    severity: str
    on_a_real_valve: str
    what_to_do: str
    others: tuple[str, ...]

    def to_json(self) -> dict[str, Any]:
        """What report.json holds of it."""
        return {
            "title": self.title,
            "amounts": dict(self.amounts),
            "severity": self.severity or None,
            "on_a_real_valve": self.on_a_real_valve or None,
            "what_to_do": self.what_to_do or None,
        }


def kind_words(verdict: Verdict) -> tuple[str, bool]:
    """The verdict in a few words, and whether it is sure enough to act on."""
    if verdict.kind == "insufficient":
        return "The budget ended too soon" if verdict.is_cut_short else "The data cannot tell", False
    if verdict.kind == "unknown":
        return "Something without a name", False
    if verdict.kind == "partly":
        return "Corrected in part", False
    found = "Nothing is missing" if verdict.kind == "none" else "Missing effect found"
    if verdict.probability >= SURE:
        return found, True
    alike = any(verdict.confusable_with.values())
    first = "A first guess among look-alikes" if alike else "A first guess, more likely wrong than right"
    guess = "Perhaps nothing is missing" if verdict.kind == "none" else first
    probable = "Probably nothing is missing" if verdict.kind == "none" else "Missing effect, probably"
    return (probable, False) if verdict.probability >= EVEN else (guess, False)


def percent(probability: float) -> str:
    """A probability in percent; never 0 or 100."""
    if probability >= 0.995:
        return "> 99 %"
    return f"{100 * probability:.0f} %" if probability >= 0.005 else "< 1 %"


def headline(diagnosis: Diagnosis) -> str:
    """The verdict in a sentence or two of plain words."""
    verdict = diagnosis.verdict
    if verdict.kind == "none":
        is_valve = isinstance(diagnosis.plant, ValvePlant)
        model = "the declared valve with refitted damping" if is_valve else "the declared model, refitted,"
        return f"{kind_words(verdict)[0]}: {model} reproduces the measurement down to the noise."
    if verdict.kind == "partly":
        return partly_headline(diagnosis)
    missing = named(verdict.effects)
    others = list(dict.fromkeys(other for names in verdict.confusable_with.values() for other in names))
    alike = named(others, "or")
    if verdict.kind == "insufficient":
        start = "These recordings cannot tell what is missing"
        if verdict.is_cut_short:
            best = f"; so far {missing} fits best" if missing else ""
            return f"The budget ended before it could be told what is missing{best}."
        return (
            f"{start}; {missing} fits best, {alike} about as well."
            if missing and alike
            else (f"{start}; {missing} fits best." if missing else f"{start}.")
        )
    if verdict.kind == "unknown":
        nearest = f" The closest is {missing}." if missing else ""
        return f"Something acts that no effect of the catalogue explains.{nearest}"
    lacks = what_is_missing(verdict.effects, declared_effects(diagnosis.plant))
    claim = f"The model {lacks}" if verdict.probability >= EVEN else f"Perhaps the model {lacks}"
    amounts = [_largest(meaning) for meaning in meanings(diagnosis)]
    much = f": {amounts[0]}" if len(amounts) == 1 and amounts[0] else ""
    alternatives = f" {capitalised(alike)} would explain the data about as well." if alike else ""
    return f"{claim}{much}.{alternatives}"


def holdout_words(diagnosis: Diagnosis) -> str:
    """The use that was made of held-out data, in a sentence."""
    if diagnosis.before.holdout is None:
        return "No data were held out: only the fitted data support this."
    return (
        "Held-out data take no part in the fits. They are predicted with everything that the fitted data have "
        "determined; only the errors of their own recording, its clocks and stamps, are estimated anew."
    )


def unseen_noise_words(diagnosis: Diagnosis) -> str:
    """What it means that a machine is never still, in a sentence or two; empty where the sensor's noise is known."""
    problem, channel = diagnosis.before.fit.problem, primary_channels(diagnosis.plant)[0]
    if problem.noise_of(channel).samples:
        return ""
    mend = (
        " Declare it where a data sheet has it (noise: of an output)." if isinstance(diagnosis.plant, OwnPlant) else ""
    )
    return (
        "The sensor's noise is not known, since the machine is never still for long enough to show it: what the best "
        f"model leaves is taken for it, and what else is as small may act unseen.{mend}"
    )


def choice_words(diagnosis: Diagnosis) -> str:
    """Which strokes of a long recording were looked at, and why, in a sentence or two; empty where all were."""
    choice = diagnosis.choice
    if choice is None:
        return ""
    kinds = f", some of each of {choice.kinds} kinds of command," if choice.kinds > 1 else ""
    return (
        f"{len(choice.chosen)} of {choice.recorded} strokes were examined{kinds} spread over the recording, because "
        "strokes under the same commands tell the same. validate checks all strokes."
    )


def rounding_words(diagnosis: Diagnosis) -> str:
    """Why the error after may be larger than before, in a sentence; empty where it is not.

    A coarse sensor at rest repeats one rounding error, and what is reported is over all samples.
    """
    before, after = diagnosis.before, diagnosis.after
    pairs = [(before.fit, after.fit, before.train_rmse, after.train_rmse)]
    if before.holdout is not None and after.holdout is not None:
        pairs.append((before.holdout, after.holdout, before.holdout_rmse, after.holdout_rmse))
    unit = diagnosis.plant.channels[primary_channels(diagnosis.plant)[0]].unit
    falls = [
        f"{quantity(effective_rmse(first), unit)} to {quantity(effective_rmse(second), unit)}"
        for first, second, least, most in pairs
        if most > (1.0 + VISIBLE) * least
    ]
    if not falls:
        return ""
    return (
        "At rest the sensor repeats one rounded reading. If each such run is counted once, not once for each sample, "
        f"the error goes from {' and from '.join(falls)}."
    )


def meanings(diagnosis: Diagnosis) -> list[Meaning]:
    """What each named effect is on a real valve, how much of it there is, and what to do."""
    verdict, after, plant = diagnosis.verdict, diagnosis.after, diagnosis.plant
    found: list[Meaning] = []
    if not verdict.is_corrected:
        return found  # nothing is claimed
    for effect in verdict.effects:
        if effect in plant.effects and plant.effects[effect].is_declared_value:
            found.append(_wrong_value(diagnosis, effect))
            continue
        own = {name: one for name, one in after.intervals.items() if name.startswith(f"{effect}.")}
        is_declared = effect in declared_effects(plant)
        amounts = tuple(
            (
                plant.parameter(name).description,
                _amount(diagnosis, name, with_declared=is_declared),
            )
            for name in own
        )
        amounts += _worth_words(diagnosis, effect)
        values = {name.partition(".")[2]: one.value for name, one in own.items()}
        others = verdict.confusable_with.get(effect, ())
        # What the catalogue says of an effect is about a valve; an effect of a user's own may share its name.
        entry = CATALOGUE.get(effect) if isinstance(plant, ValvePlant) else None
        found.append(
            Meaning(
                effect, title_of(effect), amounts, _severity(entry, values, plant),
                entry.on_a_real_valve if entry else "", entry.what_to_do if entry else "",
                tuple(title_of(other) for other in others),
            )
        )  # fmt: skip
    return found


def _worth_words(diagnosis: Diagnosis, effect: str) -> tuple[tuple[str, str], ...]:
    """How much of the error one of several named effects explains, in words; empty for a single name."""
    worth = diagnosis.verdict.worth.get(effect)
    if worth is None or len(diagnosis.verdict.effects) < 2:
        return ()
    left = (
        "" if math.isnan(worth.remaining) else f"; with it alone {percent(worth.remaining)} of the error would be left"
    )
    if worth.improvement < LEAST_SHARE:
        return (("explains", f"less than {percent(LEAST_SHARE)} of what all named effects explain{left}"),)
    return (("explains", f"{percent(worth.improvement)} of what all named effects explain{left}"),)


def told_amounts(meaning: Meaning) -> str:
    """The amounts of an effect, its size beside something known, and what it explains."""
    own = [f"{what} {value}" for what, value in meaning.amounts if what != "explains"]
    shares = [f"it {what} {value}" for what, value in meaning.amounts if what == "explains"]
    return "; ".join([", ".join(["; ".join(own), *([meaning.severity] if meaning.severity else [])]), *shares])


def limit_rows(diagnosis: Diagnosis) -> list[tuple[str, str]]:
    """Each effect that has a detection limit, and how much of it would have shown; of several parameters each."""
    rows = []
    for name, limits in diagnosis.detection_limits.items():
        switches = {switch.name: switch.unit for switch in diagnosis.plant.effects[name].parameters}
        known = {parameter: limit for parameter, limit in limits.items() if math.isfinite(limit)}
        if known:
            words = ", ".join(
                (f"{parameter.replace('_', ' ')} " if len(known) > 1 else "") + quantity(limit, switches[parameter])
                for parameter, limit in known.items()
            )
            rows.append((title_of(name), words))
    return rows


def declared_effects(plant: Plant) -> list[str]:
    """Effects that the declared model has already; of these another size is named."""
    return [name for name, effect in plant.effects.items() if effect.is_on and not effect.is_declared_value]


def _amount(diagnosis: Diagnosis, name: str, *, with_declared: bool) -> str:
    """0.80 ± 0.01 N, declared 0.30 N."""
    parameter, found = diagnosis.plant.parameter(name), diagnosis.after.intervals[name]
    unit = parameter.unit
    words = amount(found, unit) if is_inside(found.value, parameter) else value_words(found.value, parameter)
    if _is_stand_in(diagnosis, name):
        words = f"about {quantity(found.value, unit, 2)}"  # a stand-in's value has no error
    return f"{words}, declared {quantity(diagnosis.plant.declared(name), unit)}" if with_declared else words


def _is_stand_in(diagnosis: Diagnosis, name: str) -> bool:
    """Whether a value is of an effect that is not named, but only acts like what is there."""
    effect = name.partition(".")[0]
    return any(own.effect == effect and own.word != "named" for own in diagnosis.grades)


def is_inside(value: float, parameter: Parameter) -> bool:
    """Whether a value is none at which the search ended for want of a larger or smaller one."""
    ends = {parameter.lower, parameter.upper} - {parameter.off, 0.0, math.inf, -math.inf}
    return not any(math.isclose(value, end, rel_tol=1e-6) for end in ends)


def value_words(value: float, parameter: Parameter) -> str:
    """A value with its unit; of one at which the search ended, that the data do not say it."""
    return quantity(value, parameter.unit) if is_inside(value, parameter) else "not determined"


def _wrong_value(diagnosis: Diagnosis, effect: str) -> Meaning:
    """A declared value that is not what was declared."""
    name = effect.removeprefix("valve.")
    rows = [row for row in diagnosis.declared if row.name == name or row.name.startswith(f"{COORDINATES.get(name)}[")]
    words = name.removeprefix(GROUP).replace("_", " ")
    amounts = tuple((plain_name(row.name), amount_words(row)) for row in rows)
    if not amounts:  # declared without a tolerance
        own = diagnosis.plant.effects[effect].free_names()
        estimated = [one for one in own if one in diagnosis.after.intervals]
        amounts = tuple((plain_name(one), _amount(diagnosis, one, with_declared=True)) for one in estimated)
    return Meaning(
        effect, title_of(effect), amounts, "",
        f"The {words} is not what was declared: another part was fitted, or the number was copied wrongly.",
        f"Measure the {words} again, and write what you find into the parameter file with its tolerance.",
        tuple(title_of(other) for other in diagnosis.verdict.confusable_with.get(effect, ())),
    )  # fmt: skip


def _severity(entry: Effect | None, values: Mapping[str, float], plant: Plant) -> str:
    """Its size beside something known; empty where nothing compares, or not all of the effect's values are free."""
    if entry is None or not isinstance(plant, ValvePlant) or set(values) != {p.name for p in entry.parameters}:
        return ""
    found = entry.severity_of(values, plant.valve.declared())
    return "" if found is None else str(found)


def _largest(meaning: Meaning) -> str:
    """The amount that a headline shows: of an effect with one parameter only."""
    return meaning.amounts[0][1] if len(meaning.amounts) == 1 else ""
