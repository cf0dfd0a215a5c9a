"""How far each name of a correction is to be believed: theory, section 9.

    named       the posterior is sure of its class, nothing unnamed acts, and unseen conditions do not contradict
    acts like   without it and its look-alikes every set and curve that was fitted errs more on unseen conditions
    possible    in the correction, not claimed

The values of what only acts like a name are a stand-in's: they have no standard error.
"""

from __future__ import annotations

import math
from collections.abc import Mapping
from typing import Final, Literal, NamedTuple

import numpy as np

from valve_sim.identification.fit.correction import DECISIVE, MATTERS, Correction, Score, Scores, agrees, is_curve
from valve_sim.identification.fit.posterior import EVEN, SURE, Decision, Set
from valve_sim.identification.fit.search import added, without

EQUAL: Final = 0.003
"""Ln of the factor between errors up to which a look-alike predicts as well, however small its standard error."""
MOST_ALIKE: Final = 3
"""Look-alikes, beyond which a name says nothing."""

Word = Literal["named", "acts_like", "possible"]
Kind = Literal["none", "effects", "partly", "unknown", "insufficient"]


class Grade(NamedTuple):
    """What is to be believed of an effect.

    Attributes:
        effect: its name. word: the grade. probability: that it or a look-alike acts, by the posterior.
        alike: names that would do in its place. share: of what the correction takes off, the part that is its own.
        factor: by which unseen conditions err more without it and its look-alikes; nan where nothing was left out.
    """

    effect: str
    word: Word
    probability: float
    alike: tuple[str, ...]
    share: float
    factor: float


def grades(correction: Correction, decision: Decision, inclusion: Mapping[str, float]) -> tuple[Grade, ...]:
    """The grade of each name of a correction; a curve has none.

    Args:
        correction, decision: of one search. inclusion: probability of each name, by the posterior.
    """
    names = correction.names
    return () if is_curve(names) else tuple(_grade(name, correction, decision, inclusion) for name in names)


def kind_of(correction: Correction, graded: tuple[Grade, ...], decision: Decision) -> Kind:
    """The verdict: what is claimed, beside what is corrected."""
    if correction.is_applied:
        return "effects" if graded and all(grade.word == "named" for grade in graded) else "partly"
    if decision.kind == "none":
        return "none"
    return "unknown" if decision.unnamed > EVEN else "insufficient"


def _grade(name: str, correction: Correction, decision: Decision, inclusion: Mapping[str, float]) -> Grade:
    scores, names = correction.scores, correction.names
    of_class = decision.others.get(name, ()) if name in decision.names else ()
    probability = min(1.0, math.fsum(inclusion.get(one, 0.0) for one in (name, *of_class)))
    is_sure = decision.unnamed <= EVEN and probability >= SURE and correction.is_applied
    if names not in scores:
        return Grade(name, "named" if is_sure else "possible", probability, of_class, math.nan, math.nan)
    alike = look_alikes(scores, names, name)
    rise, error = rise_without(scores, names, {name, *alike})
    word: Word = "possible"
    if is_sure and agrees(scores, names):
        word = "named"
    elif correction.is_applied and len(alike) <= MOST_ALIKE and rise > max(MATTERS, DECISIVE * error):
        word = "acts_like"
    every = tuple(dict.fromkeys((*of_class, *alike)))
    return Grade(name, word, probability, every, _share(scores, names, name), math.exp(rise))


def look_alikes(scores: Scores, names: Set, name: str) -> list[str]:
    """Names that predict as well in the place of a member."""
    rest, found = without(names, name), []
    for other in {one for swapped in scores if not is_curve(swapped) for one in swapped} - set(names):
        swapped = added(rest, other)
        if swapped in scores:
            rise, error = scores[names].rise(scores[swapped])
            if rise <= max(error, EQUAL):
                found.append((rise, other))
    return [other for _, other in sorted(found)]


def rise_without(scores: Scores, names: Set, absent: set[str]) -> tuple[float, float]:
    """By how much, in ln, the best of all that lacks some names errs more, and its standard error."""
    rivals = [one for one in scores if not absent & set(one)]
    best = min(rivals, key=lambda one: float(np.mean(scores[one].logs)))
    return scores[names].rise(scores[best])


def _share(scores: Scores, names: Set, name: str) -> float:
    """The part of the correction's squares that is lost without a member; nan where that was not fitted."""

    def square(score: Score) -> float:
        return float(np.mean(np.exp(2.0 * score.logs)))

    rest = without(names, name)
    gain = square(scores[()]) - square(scores[names])
    return (square(scores[rest]) - square(scores[names])) / gain if rest in scores and gain > 0.0 else math.nan
