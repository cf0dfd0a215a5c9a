"""A verdict in sentences: its summary, and what to record next."""

from __future__ import annotations

import math
from collections.abc import Collection
from typing import Final

from valve_sim.identification.diagnosis.run import Diagnosis, Verdict
from valve_sim.identification.fit.budget import STROKES_A_SECOND
from valve_sim.identification.plants.effect_titles import named, what_is_missing
from valve_sim.identification.plants.protocol import Advice, advice_of
from valve_sim.identification.reporting.wording import declared_effects, percent

NO_LEADER: Final = 0.05
"""Probability below which no set of effects is called the likeliest."""
SHOWN_UNTRIED: Final = 4
"""How many of the untried hypotheses the summary names."""


def summarise(diagnosis: Diagnosis) -> str:
    """What is claimed, how well that is known, and what was left untried."""
    verdict, untried = diagnosis.verdict, diagnosis.untried
    sentences = [claim(verdict, advice_of(diagnosis.plant), declared_effects(diagnosis.plant))]
    if verdict.kind == "insufficient" and not verdict.is_cut_short:
        sentences.append(recording_advice(diagnosis))
    if untried:
        few = ", ".join(untried[:SHOWN_UNTRIED]) + (", ..." if len(untried) > SHOWN_UNTRIED else "")
        sentences.append(
            f"{len(untried)} sets were left untried, by the budget or because they cannot be simulated: {few}."
        )
    if verdict.is_cut_short:
        sentences.append(budget_advice(diagnosis.allowed))
    return " ".join(sentences)


def budget_advice(allowed: float) -> str:
    """What to give where the budget, in simulated strokes, ended too soon."""
    more = 2.0 * allowed / STROKES_A_SECOND
    return (
        f"The budget of {allowed:,.0f} simulated strokes ended before the search did: repeat with a larger one, "
        f"e.g. --budget {more:.3g}."
    )


def recording_advice(diagnosis: Diagnosis) -> str:
    """What to record next to separate the candidates, and the best single pulse; empty where nothing is open."""
    if not diagnosis.verdict.is_open:
        return ""
    advice = advice_of(diagnosis.plant)
    words = advice.first if diagnosis.verdict.strokes <= 1 else advice.more
    best = diagnosis.recommendation
    if best is None:
        return f"{words}."
    one, other = (named(candidate.split(" + ")) for candidate in best.pair)
    return (
        f"{words}; the best single pulse is {best.experiment.words}: {best.repeats} of them separate {one} from "
        f"{other} by {math.sqrt(best.repeats) * best.separation:.0f} standard deviations, and other pairs by more."
    )


def claim(verdict: Verdict, advice: Advice, declared: Collection[str] = ()) -> str:
    """The verdict in one or two sentences.

    Args:
        verdict: what is claimed.
        advice: of the plant, which says why a single stroke is not enough.
        declared: effects that the declared model has already.
    """
    if verdict.kind == "unknown":
        share = f"explains {percent(verdict.share)} of the squared error beyond noise"
        closest = f" The nearest is {named(verdict.effects)}, which {share}." if verdict.effects else ""
        return f"Something acts that no effect of the catalogue explains.{closest}"
    if verdict.kind == "partly":
        return "A correction that predicts unseen strokes better is applied; not all that acts has a certain name."
    if verdict.kind == "none":
        return "The declared model with refitted damping explains the data down to the noise."
    others = sorted({other for names in verdict.confusable_with.values() for other in names})
    alike = named(others, "or")
    if verdict.kind == "insufficient":
        return _open_claim(verdict, advice, alike)
    alternatives = f"; {alike} would explain the data about as well" if alike else ""
    return f"The model {what_is_missing(verdict.effects, declared)}{alternatives}."


def _open_claim(verdict: Verdict, advice: Advice, alike: str) -> str:
    """Why nothing is claimed: the budget, or the recordings; `alike` would do in the place of what is nearest."""
    if verdict.is_cut_short:
        best = named(verdict.effects) if verdict.effects else "the declared model by itself"
        return f"Nothing is claimed, because the budget ended before all was tried. So far {best} fits best."
    if verdict.strokes <= 1:
        return f"{advice.ambiguous[:1].upper()}{advice.ambiguous[1:]}."
    if verdict.probability < NO_LEADER:
        return "The data cannot tell what the model lacks: no set of effects is likelier than many others."
    nearest = named(verdict.effects) if verdict.effects else "no effect at all"
    rivals = f", or {alike} in its place," if alike else ""
    return (
        f"The data cannot tell what the model lacks: {nearest}{rivals} is the likeliest, with a probability of "
        f"{percent(verdict.probability)}."
    )
