"""A verdict in sentences: its summary, and what to record next."""

from __future__ import annotations

import math
from typing import Final

from valve_sim.identification.diagnosis.run import Diagnosis, Verdict
from valve_sim.identification.plants.advice import Advice, advice_of
from valve_sim.identification.plants.effect_titles import listed, named, what_is_missing

SHOWN_UNTRIED: Final = 4
"""How many of the untried hypotheses the summary names."""


def summarise(diagnosis: Diagnosis) -> str:
    """What is claimed, how well that is known, and what was left untried."""
    verdict, untried = diagnosis.verdict, diagnosis.untried
    sentences = [claim(verdict, advice_of(diagnosis.plant))]
    if verdict.kind == "insufficient":
        sentences.append(recording_advice(diagnosis))
    if untried:
        few = ", ".join(untried[:SHOWN_UNTRIED]) + (", ..." if len(untried) > SHOWN_UNTRIED else "")
        sentences.append(f"For want of time, or because it cannot be simulated, {len(untried)} left untried: {few}.")
    return " ".join(sentences)


def recording_advice(diagnosis: Diagnosis) -> str:
    """What to record next to separate the candidates, and the best single pulse; empty where nothing is open."""
    if not diagnosis.verdict.is_open:
        return ""
    advice = advice_of(diagnosis.plant)
    words = advice.first if diagnosis.verdict.grounds.strokes <= 1 else advice.more
    best = diagnosis.recommendation
    if best is None:
        return f"{words}."
    one, other = (named(candidate.split(" + ")) for candidate in best.pair)
    return (
        f"{words}; of single pulses {best.experiment.words} tells most: {best.repeats} of them set {one} apart from "
        f"{other} by {math.sqrt(best.repeats) * best.separation:.0f} standard deviations, others by more."
    )


def claim(verdict: Verdict, advice: Advice) -> str:
    """The verdict in one or two sentences.

    Args:
        verdict: what is claimed.
        advice: of the plant, which says why a single stroke is not enough.
    """
    grounds = verdict.grounds
    if grounds.has_remainder:
        return _claim_beside_a_remainder(verdict)
    if verdict.kind == "none":
        return "The declared model with refitted damping explains the data down to the noise."
    if verdict.kind == "insufficient":
        if grounds.strokes <= 1:
            return f"{advice.ambiguous}."
        count = 1 + max(len(others) for others in verdict.confusable_with.values())
        return f"{count} effects explain the data about equally well."
    others = sorted({other for names in verdict.confusable_with.values() for other in names})
    places = [f"a force at {place} alone" for place in grounds.places[:1]]
    alike = listed([*(named([other]) for other in others), *places], "or")
    alternatives = f"; {alike} would explain the data about as well" if alike else ""
    return f"The model {what_is_missing(grounds.best)}{alternatives}."


def _claim_beside_a_remainder(verdict: Verdict) -> str:
    """Likewise where something is left that no effect explains."""
    grounds = verdict.grounds
    share = f"that explains {100.0 * grounds.share:.1f} % of the squared residual"
    if verdict.kind == "effects":
        nothing = "nothing that was tried" if grounds.singles_untried else "no effect of the catalogue"
        return f"The model {what_is_missing(grounds.best)}; {share}. What is left, {nothing} explains."
    closest = f" The closest is {named(grounds.best)}; {share}." if grounds.best else ""
    if verdict.kind == "insufficient":
        return f"The time was too short to find what the model lacks.{closest}"
    return f"Something acts that no effect of the catalogue explains.{closest}"
