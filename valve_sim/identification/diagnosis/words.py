"""A decision in sentences: the verdict's summary, and what to record next."""

from __future__ import annotations

import math
from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass, replace
from typing import Final

from valve_sim.identification.diagnosis.decision import Standing, decide
from valve_sim.identification.diagnosis.experiment_design import Recommendation
from valve_sim.identification.diagnosis.outcome import Verdict
from valve_sim.identification.plants.effect_titles import listed, named, what_is_missing
from valve_sim.identification.plants.protocol import Plant, advice_of

SHOWN_UNTRIED: Final = 4
"""How many of the untried hypotheses the summary names."""


@dataclass(frozen=True)
class Findings:
    """What a verdict says.

    Attributes:
        plant: the machine. standing: what is claimed of it. strokes: how many there are.
        confusable: of each effect, what else it could be. evidence: share of the claim in all evidence.
        share: of the base's squared residual that the claim explains.
        places: in words, where a force at one place alone does as well.
        singles_untried: whether not even every single effect was tried.
    """

    plant: Plant
    standing: Standing
    strokes: int
    confusable: Mapping[str, tuple[str, ...]]
    evidence: float
    share: float
    places: Sequence[str]
    singles_untried: bool


def worded(found: Findings, advice: Callable[[], str]) -> tuple[Verdict, str]:
    """The verdict, and what to record next, which `advice` works out where it is asked for."""
    standing, alike = found.standing, dict(found.confusable)
    decision = decide(standing, alike, found.evidence, found.strokes, singles_untried=found.singles_untried)
    kind, sentence = decision.kind, _sentence(decision.kind, found)
    is_ambiguous = standing.is_unknown or any(alike.values())
    next_words = advice() if kind in ("unknown", "insufficient") or (kind == "effects" and is_ambiguous) else ""
    if kind == "insufficient" and next_words:
        sentence += f" {next_words}"
    return Verdict(kind, decision.effects, alike, found.evidence, decision.probability, sentence), next_words


def with_untried(verdict: Verdict, untried: Sequence[str]) -> Verdict:
    """The verdict, saying what was left to try when the time was used up."""
    if not untried:
        return verdict
    few = ", ".join(untried[:SHOWN_UNTRIED]) + (", ..." if len(untried) > SHOWN_UNTRIED else "")
    return replace(verdict, summary=f"{verdict.summary} The time was used up with {len(untried)} left untried: {few}.")


def advise(plant: Plant, strokes: int, telling: Recommendation | None) -> str:
    """What to record next to tell effects apart: and the single pulse that tells most."""
    advice = advice_of(plant).first if strokes <= 1 else advice_of(plant).more
    if telling is None:
        return f"{advice}."
    one, other = (named(candidate.split(" + ")) for candidate in telling.pair)
    return (
        f"{advice}; of single pulses {telling.experiment.words} tells most: {telling.repeats} of them set {one} apart "
        f"from {other} by {math.sqrt(telling.repeats) * telling.separation:.0f} standard deviations, others by more."
    )


def _sentence(kind: str, found: Findings) -> str:
    if found.standing.is_unknown:
        return _of_a_remainder(kind, found)
    if kind == "none":
        return "The declared model with refitted damping explains the data down to the noise."
    if kind == "insufficient":
        if found.strokes <= 1:
            return f"{advice_of(found.plant).ambiguous}."
        count = 1 + max(len(others) for others in found.confusable.values())
        return f"{count} effects explain the data about equally well."
    others = sorted({other for names in found.confusable.values() for other in names})
    places = [f"a force at {place} alone" for place in found.places[:1]]
    alike = listed([*(named([other]) for other in others), *places], "or")
    alternatives = f"; {alike} would explain the data about as well" if alike else ""
    return f"The model {what_is_missing(found.standing.best.effects)}{alternatives}."


def _of_a_remainder(kind: str, found: Findings) -> str:
    """Likewise where something is left that has no name."""
    names = named(found.standing.best.effects)
    share = f"that explains {100.0 * found.share:.1f} % of the squared residual"
    if kind == "effects":
        explains = "nothing that was tried explains" if found.singles_untried else "no effect of the catalogue explains"
        missing = what_is_missing(found.standing.best.effects)
        return f"The model {missing}; {share}. What is left, {explains}."
    closest = f" The closest is {names}; {share}." if names else ""
    if kind == "insufficient":
        return f"The time was too short to find what the model lacks.{closest}"
    return f"Something acts that no effect of the catalogue explains.{closest}"
