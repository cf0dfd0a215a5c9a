"""From what was found to the verdict and its words."""

from __future__ import annotations

import math
from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass, replace
from typing import Final

from valve_sim.identification.diagnosis.calibration import calibrated
from valve_sim.identification.diagnosis.experiment_design import Recommendation
from valve_sim.identification.diagnosis.outcome import Verdict
from valve_sim.identification.plants.effect_titles import listed, named, what_is_missing
from valve_sim.identification.plants.protocol import Plant, advice_of
from valve_sim.identification.selection.force_maps import NonparametricFit, where
from valve_sim.identification.selection.hypotheses import Hypothesis
from valve_sim.identification.selection.stepwise import LARGEST_CLASS

SHOWN_UNTRIED: Final = 4
"""How many of the untried hypotheses the summary names."""


@dataclass(frozen=True)
class Findings:
    """What a verdict is decided from.

    Attributes:
        plant: the machine. best: the hypothesis that is claimed. strokes: how many there are.
        is_unknown: whether something is left that has no name. names_most: whether the effects explain most beside it.
        confusable: of each effect, what else it could be. evidence: share of the claim in all evidence.
        share: of the base's squared residual that the claim explains. places: nonparametric forces that do as well.
        advice: works out what to record next.
        singles_untried: whether not even every single effect was tried.
    """

    plant: Plant
    best: Hypothesis
    strokes: int
    is_unknown: bool
    names_most: bool
    confusable: Mapping[str, tuple[str, ...]]
    evidence: float
    share: float
    places: Sequence[NonparametricFit]
    advice: Callable[[], str]
    singles_untried: bool

    @property
    def is_ambiguous(self) -> bool:
        """Whether more effects are possible than an answer may list."""
        return any(len(others) + 1 > LARGEST_CLASS for others in self.confusable.values())


def decide(found: Findings) -> tuple[Verdict, str]:
    """The verdict, and what to record next."""
    kind, sentence = _decided(found)
    is_ambiguous = found.is_unknown or any(found.confusable.values())
    advice = found.advice() if kind in ("unknown", "insufficient") or (kind == "effects" and is_ambiguous) else ""
    if kind == "insufficient" and advice:
        sentence += f" {advice}"
    is_sure = not found.is_unknown and not found.singles_untried and kind in ("none", "effects")
    probability = calibrated(kind, found.evidence) if is_sure else min(found.evidence, 0.5)
    effects = () if kind == "none" else found.best.effects
    return Verdict(kind, effects, dict(found.confusable), found.evidence, probability, sentence), advice


def with_untried(verdict: Verdict, untried: Sequence[str]) -> Verdict:
    """The verdict, saying what was left to try when the time was used up."""
    if not untried:
        return verdict
    few = ", ".join(untried[:SHOWN_UNTRIED]) + (", ..." if len(untried) > SHOWN_UNTRIED else "")
    return replace(verdict, summary=f"{verdict.summary} The time was used up with {len(untried)} left untried: {few}.")


def _decided(found: Findings) -> tuple[str, str]:
    """The kind of verdict, and its sentence."""
    if found.is_unknown:
        return _of_a_remainder(found)
    if found.strokes <= 1:
        return "insufficient", f"{advice_of(found.plant).ambiguous}."
    if found.is_ambiguous:
        count = 1 + max(len(others) for others in found.confusable.values())
        return "insufficient", f"{count} effects explain the data about equally well."
    if not found.best.effects:
        return "none", "The declared model with refitted damping explains the data down to the noise."
    others = sorted({other for names in found.confusable.values() for other in names})
    places = [f"a force at {where(entry.choice, entry.fit)} alone" for entry in found.places[:1]]
    alike = listed([*(named([other]) for other in others), *places], "or")
    alternatives = f"; {alike} would explain the data about as well" if alike else ""
    return "effects", f"The model {what_is_missing(found.best.effects)}{alternatives}."


def _of_a_remainder(found: Findings) -> tuple[str, str]:
    """Likewise where something is left that has no name."""
    names = named(found.best.effects)
    share = f"that explains {100.0 * found.share:.1f} % of the squared residual"
    if found.names_most:
        explains = "nothing that was tried explains" if found.singles_untried else "no effect of the catalogue explains"
        remainder = f"What is left, {explains}."
        return "effects", f"The model {what_is_missing(found.best.effects)}; {share}. {remainder}"
    closest = f" The closest is {names}; {share}." if names else ""
    if found.singles_untried:
        return "insufficient", f"The time was too short to find what the model lacks.{closest}"
    return "unknown", f"Something acts that no effect of the catalogue explains.{closest}"


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
