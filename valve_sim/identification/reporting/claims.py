"""What a diagnosis claims, in plain words: the headline, how sure it is, what each effect means, what to do next."""

from __future__ import annotations

import math
from collections.abc import Collection, Iterator, Mapping, Sequence
from typing import Any, Final

from valve_sim.identification.diagnosis.outcome import Diagnosis, Verdict
from valve_sim.identification.fit.budget import STROKES_A_SECOND
from valve_sim.identification.fit.correction import Correction, is_curve
from valve_sim.identification.fit.posterior import EVEN, SURE
from valve_sim.identification.fit.result import effective_rmse
from valve_sim.identification.plants.effect_titles import capitalised, named, title_of, what_is_missing
from valve_sim.identification.plants.protocol import Meaning, Plant
from valve_sim.identification.plants.tolerances import GROUP
from valve_sim.identification.reporting.document import Entry, Words
from valve_sim.identification.reporting.units import amount, percent, quantity
from valve_sim.identification.reporting.values import amount_words, is_stand_in, plain_name
from valve_sim.model import Parameter

COORDINATES: Final = {"attraction_polynomial": "attraction"}
"""Declared values that are estimated by coordinates, and the name of these."""
LEAST_SHARE: Final = 0.01
"""Share of the improvement, below which the report gives no number."""
VISIBLE: Final = 1e-3
"""Relative difference of two errors that a reader notices."""
NO_LEADER: Final = 0.05
"""Probability below which no set of effects is called the likeliest."""
SHOWN_UNTRIED: Final = 4
"""How many of the untried sets the summary names."""
OVER: Final = {"x": "the position", "v": "the velocity", "t": "time"}
"""Variables of a smooth force in words; others stand as they are."""


def certainty(verdict: Verdict) -> tuple[str, bool]:
    """How sure the verdict is, in a few words, and whether it is sure enough to act on."""
    fixed = {"unknown": "An unmodelled effect", "partly": "Corrected in part"}
    if verdict.kind == "insufficient":
        return "The budget ended too soon" if verdict.is_cut_short else "The data cannot tell", False
    if verdict.kind in fixed:
        return fixed[verdict.kind], False
    is_none, alike = verdict.kind == "none", any(verdict.confusable_with.values())
    if verdict.probability >= SURE:
        return "Nothing is missing" if is_none else "Missing effect found", True
    if verdict.probability >= EVEN:
        return "Probably nothing is missing" if is_none else "Missing effect, probably", False
    first = "A first guess among look-alikes" if alike else "A first guess, more likely wrong than right"
    return "Perhaps nothing is missing" if is_none else first, False


def headline(diagnosis: Diagnosis) -> str:
    """The verdict in a sentence or two."""
    verdict = diagnosis.verdict
    nearest, alike = named(verdict.effects), named(_look_alikes(verdict), "or")
    match verdict.kind:
        case "none":
            model = diagnosis.plant.wording.refitted
            return f"{certainty(verdict)[0]}: {model} reproduces the measurement down to the noise."
        case "partly":
            return _partly(diagnosis)
        case "insufficient":
            return _not_told(diagnosis, nearest, alike)
        case "unknown":
            share = f"which explains {percent(verdict.share)} of the squared error beyond noise"
            closest = f" The nearest is {nearest}, {share}." if nearest else ""
            return f"No effect of the catalogue explains the data.{closest}"
    claim = f"The model {what_is_missing(verdict.effects, declared_effects(diagnosis.plant))}"
    if verdict.probability < EVEN:
        claim = f"Perhaps t{claim[1:]}"
    amounts = [amount for meaning in meanings(diagnosis).values() for amount in meaning["amounts"].values()]
    much = f": {amounts[0]}" if len(amounts) == 1 else ""
    return f"{claim}{much}.{f' {capitalised(alike)} would explain the data about as well.' if alike else ''}"


def _not_told(diagnosis: Diagnosis, nearest: str, alike: str) -> str:
    """Why nothing is claimed: the budget, or the recordings."""
    verdict = diagnosis.verdict
    if verdict.is_cut_short:
        best = f"; so far {nearest} fits best" if nearest else ""
        return f"The budget ended before the search could find what is missing{best}."
    if verdict.strokes <= 1:
        return f"{capitalised(diagnosis.plant.advice.ambiguous)}."
    start = "These recordings cannot tell what is missing"
    if verdict.probability < NO_LEADER:
        return f"{start}: no set of effects is likelier than many others."
    also = f", {alike} about as well" if alike else ""
    return f"{start}; {nearest or 'the declared model by itself'} fits best{also}."


def _partly(diagnosis: Diagnosis) -> str:
    correction = diagnosis.correction
    assert correction is not None
    unit = diagnosis.primary_channel.unit
    before, after = (quantity(size, unit) for size in (correction.before, correction.after))
    error = f": the error of unseen strokes falls from {before} to {after}" if correction.conditions else ""
    if is_curve(correction.names):
        return f"Corrected by an unmodelled force over {curve_words(correction)}{error}."
    like = [grade.effect for grade in diagnosis.grades if grade.word != "possible"]
    rest = [grade.effect for grade in diagnosis.grades if grade.word == "possible"]
    if not like:
        return f"Corrected by {named(rest)}{error}. These names are not certain."
    beside = f" {capitalised(named(rest))} also changed, and may stand for something else." if rest else ""
    return f"Corrected. The machine acts as if it had {named(like)}{error}.{beside}"


def curve_words(correction: Correction) -> str:
    """What a curve that corrects is a function of."""
    variable = correction.names[0].removeprefix("curve(").removesuffix(")")
    return OVER.get(variable, variable)


def _look_alikes(verdict: Verdict) -> list[str]:
    return list(dict.fromkeys(other for names in verdict.confusable_with.values() for other in names))


def summarise(diagnosis: Diagnosis) -> str:
    """The headline, what it leaves open, and what was left untried."""
    return " ".join([headline(diagnosis), *grounds(diagnosis)])


def _sets(untried: Sequence[str]) -> str:
    return "1 set was" if len(untried) == 1 else f"{len(untried)} sets were"


def _few(untried: Sequence[str]) -> str:
    return ", ".join(untried[:SHOWN_UNTRIED]) + (", ..." if len(untried) > SHOWN_UNTRIED else "")


def grounds(diagnosis: Diagnosis) -> Iterator[str]:
    """Sentences beside the headline: what was left untried, why, and a larger budget."""
    verdict, why = diagnosis.verdict, diagnosis.impossible
    untried = [one for one in diagnosis.untried if one not in why]
    if verdict.kind == "insufficient" and not verdict.is_cut_short:
        yield recording_advice(diagnosis)
    if untried:
        yield f"{_sets(untried)} not tried, because the budget ended: {_few(untried)}."
    if why:
        reason = next(iter(why.values()))
        yield f"{_sets(tuple(why))} not tried: {_few(tuple(why))}. The simulation fails" + (
            f": {reason}." if reason else "."
        )
    if verdict.is_cut_short:
        yield (
            f"The budget of {diagnosis.allowed:,.0f} simulated strokes ended before the search did: repeat with a "
            f"larger one, e.g. --budget {2.0 * diagnosis.allowed / STROKES_A_SECOND:.3g}."
        )


def recording_advice(diagnosis: Diagnosis) -> str:
    """What to record next to separate the candidates, and the best single pulse; empty where nothing is open."""
    if not diagnosis.verdict.is_open:
        return ""
    advice, best = diagnosis.plant.advice, diagnosis.recommendation
    words = advice.first if diagnosis.verdict.strokes <= 1 else advice.more
    if best is None:
        return f"{words}."
    one, other = (named(candidate.split(" + ")) for candidate in best.pair)
    return (
        f"{words}; the best single pulse is {best.experiment.words}: {best.repeats} of them separate {one} from "
        f"{other} by {math.sqrt(best.repeats) * best.separation:.0f} standard deviations, and other pairs by more."
    )


# --- remarks on the errors ------------------------------------------------------------------------------------------


def holdout_words(diagnosis: Diagnosis) -> str:
    """The use that was made of held-out data."""
    if diagnosis.before.holdout is None:
        return "No data were held out: only the fitted data support this."
    return (
        "Held-out data take no part in the fits. The fitted values predict them; only the errors of their recording, "
        "such as its clock's, are estimated again."
    )


def unseen_noise_words(diagnosis: Diagnosis) -> str:
    """What it means that a machine is never still; empty where the sensor's noise is known."""
    if diagnosis.before.fit.problem.noise.samples:
        return ""
    told = (
        "The sensor's noise is not known, because the machine is never still for long enough. The residual of the best "
        "model stands for the noise, so an effect of that size cannot be found."
    )
    return " ".join(filter(None, [told, diagnosis.plant.wording.unknown_noise]))


def choice_words(diagnosis: Diagnosis) -> str:
    """Which strokes of a long recording were looked at, and why; empty where all were."""
    choice = diagnosis.choice
    if choice is None:
        return ""
    kinds = f", some of each of {choice.kinds} kinds of command," if choice.kinds > 1 else ""
    return (
        f"{len(choice.chosen)} of {choice.recorded} strokes were examined{kinds} spread over the recording, because "
        "strokes under the same commands show the same. validate checks all strokes."
    )


def rounding_words(diagnosis: Diagnosis) -> str:
    """Why the error after may be larger than before; empty where it is not.

    A coarse sensor at rest repeats one rounding error, and what is reported is over all samples.
    """
    before, after = diagnosis.before, diagnosis.after
    pairs = [(before.fit, after.fit, before.train_rmse, after.train_rmse)]
    if before.holdout is not None and after.holdout is not None:
        pairs.append((before.holdout, after.holdout, before.holdout_rmse, after.holdout_rmse))
    unit = diagnosis.primary_channel.unit
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


# --- what an effect means -------------------------------------------------------------------------------------------


def meanings(diagnosis: Diagnosis) -> dict[str, dict[str, Any]]:
    """What each effect of a correction is on a real valve, how much of it there is, and what to do: see report.json."""
    verdict = diagnosis.verdict
    return {effect: _meaning(diagnosis, effect) for effect in verdict.effects} if verdict.is_corrected else {}


def meaning_entry(effect: str, meaning: Mapping[str, Any], alike: Sequence[str]) -> Entry:
    """The same in sentences; `alike` would do in its place."""
    amounts = dict(meaning["amounts"])
    worth = amounts.pop("explains", "")
    size = ", ".join(filter(None, ["; ".join(map(" ".join, amounts.items())), meaning["severity"]]))
    much = "; ".join(filter(None, [size, worth and f"it accounts for {worth}"]))
    told = {
        "How much": much and f"{much}.",
        "On a real valve": meaning["on_a_real_valve"],
        "What to do": meaning["what_to_do"],
        "These data cannot distinguish it from": alike and f"{named(alike, 'or')}.",
    }
    return Entry(meaning["title"], effect, [Words(str(words), lead=lead) for lead, words in told.items() if words])


def _meaning(diagnosis: Diagnosis, effect: str) -> dict[str, Any]:
    plant, intervals = diagnosis.plant, diagnosis.after.intervals
    worth = _worth_words(diagnosis, effect)
    if effect in plant.effects and plant.effects[effect].is_declared_value:
        amounts, meaning = _wrong_value(diagnosis, effect), Meaning("", *_wrong_words(effect))
    else:
        is_declared = effect in declared_effects(plant)
        names = [name for name in intervals if name.startswith(f"{effect}.")]
        amounts = {plant.parameter(name).description: _amount(diagnosis, name, is_declared) for name in names}
        meaning = plant.meaning(effect, {name.partition(".")[2]: intervals[name].value for name in names})
    return {
        "title": title_of(effect),
        "amounts": amounts | ({"explains": worth} if worth else {}),
        "severity": meaning.severity or None,
        "on_a_real_valve": meaning.cause or None,
        "what_to_do": meaning.advice or None,
    }


def _wrong_value(diagnosis: Diagnosis, effect: str) -> dict[str, str]:
    """Amounts of a declared value that is not what was declared."""
    name = effect.removeprefix("valve.")
    rows = [row for row in diagnosis.declared if row.name == name or row.name.startswith(f"{COORDINATES.get(name)}[")]
    if rows:
        return {plain_name(row.name): amount_words(row) for row in rows}
    estimated = [one for one in diagnosis.plant.effects[effect].free_names() if one in diagnosis.after.intervals]
    return {plain_name(one): _amount(diagnosis, one, True) for one in estimated}


def _wrong_words(effect: str) -> tuple[str, str]:
    words = effect.removeprefix("valve.").removeprefix(GROUP).replace("_", " ")
    return (
        f"The {words} is not what was declared: another part was fitted, or the number was copied wrongly.",
        f"Measure the {words} again, and write what you find into the parameter file with its tolerance.",
    )


def _worth_words(diagnosis: Diagnosis, effect: str) -> str:
    """How much of the error one of several named effects explains; empty for a single name."""
    worth = diagnosis.verdict.worth.get(effect)
    if worth is None or len(diagnosis.verdict.effects) < 2:
        return ""
    alone = "" if math.isnan(worth.remaining) else percent(worth.remaining)
    share = percent(worth.improvement) if worth.improvement >= LEAST_SHARE else f"less than {percent(LEAST_SHARE)}"
    left = f"; by itself it would leave {alone} of the error" if alone else ""
    return f"{share} of the improvement{left}"


def _amount(diagnosis: Diagnosis, name: str, with_declared: bool) -> str:
    """0.80 ± 0.01 N, declared 0.30 N; of a stand-in, whose value has no error, "about"."""
    parameter, interval = diagnosis.plant.parameter(name), diagnosis.after.intervals[name]
    words = amount(interval, parameter.unit) if is_inside(interval.value, parameter) else "not determined"
    if is_stand_in(diagnosis, name):
        words = f"about {quantity(interval.value, parameter.unit, 2)}"
    declared = quantity(diagnosis.plant.declared(name), parameter.unit)
    return f"{words}, declared {declared}" if with_declared else words


def is_inside(value: float, parameter: Parameter) -> bool:
    """Whether a value is none at which the search ended for want of a larger or smaller one."""
    ends = {parameter.lower, parameter.upper} - {parameter.off, 0.0, math.inf, -math.inf}
    return not any(math.isclose(value, end, rel_tol=1e-6) for end in ends)


def declared_effects(plant: Plant) -> Collection[str]:
    """Effects that the declared model has already; of these another size is named."""
    return [name for name, effect in plant.effects.items() if effect.is_on and not effect.is_declared_value]
