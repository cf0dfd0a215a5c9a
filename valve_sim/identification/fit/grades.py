"""How far each name of a correction is to be believed: theory, section 9.

    named       the posterior is sure of its class, nothing unnamed acts, unseen conditions do not contradict, and the
                name is not for next to nothing among several
    acts like   without it and its look-alikes every set and curve that was fitted errs more on unseen conditions
    possible    in the correction, not claimed

The values of what only acts like a name are a stand-in's: they have no standard error.
"""

from __future__ import annotations

import math
from typing import Final, Literal, NamedTuple

import numpy as np

from valve_sim.identification.fit.correction import (
    DECISIVE,
    MATTERS,
    Correction,
    Score,
    Scores,
    agrees,
    falls,
    is_curve,
)
from valve_sim.identification.fit.posterior import EVEN, SURE, Decision, Posterior, Set
from valve_sim.identification.fit.result import Fit
from valve_sim.identification.fit.search import added, without

EQUAL: Final = 0.003
"""Ln of the factor between errors up to which a look-alike predicts as well, however small its standard error."""
LITTLE: Final = 0.01
"""Of what a correction takes off: one of `SEVERAL` members that has less, and that unseen conditions do not miss, is no
name. (Where a machine is of another form, such members make up for that to the last percent.)"""
SEVERAL: Final = 3
"""So many effects are seldom missing at once; of two the weaker one is often as weak, and there."""
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


def grades(correction: Correction, decision: Decision, posterior: Posterior) -> tuple[Grade, ...]:
    """The grade of each name of a correction; a curve has none. Arguments are of one search."""
    names = correction.names
    return () if is_curve(names) else tuple(_grade(name, correction, decision, posterior) for name in names)


def without_support(correction: Correction, graded: tuple[Grade, ...]) -> bool:
    """Whether a correction that the posterior chose has names that are not certain, and predicts no better."""
    if not correction.is_applied or correction.by == "prediction" or all(own.word == "named" for own in graded):
        return False
    return correction.names not in correction.scores or not falls(correction.scores, correction.names)


def kind_of(correction: Correction, graded: tuple[Grade, ...], decision: Decision) -> Kind:
    """The verdict: what is claimed, beside what is corrected."""
    if correction.is_applied:
        return "effects" if graded and all(grade.word == "named" for grade in graded) else "partly"
    if decision.kind == "none":
        return "none"
    return "unknown" if decision.unnamed > EVEN else "insufficient"


def _grade(name: str, correction: Correction, decision: Decision, posterior: Posterior) -> Grade:
    scores, names = correction.scores, correction.names
    of_class = decision.others.get(name, ()) if name in decision.names else ()
    probability = _probability({name, *of_class}, posterior)
    is_sure = decision.unnamed <= EVEN and probability >= SURE and correction.is_applied
    is_sure &= len(of_class) <= MOST_ALIKE and not ends_its_range(correction.tried[names].result, name)
    if names not in scores:
        return Grade(name, "named" if is_sure else "possible", probability, of_class, math.nan, math.nan)
    alike = look_alikes(scores, names, name)
    rise, error = rise_without(scores, names, {name, *alike})
    share, factor = _share(scores, names, name), math.exp(rise)
    if is_sure and agrees(scores, names) and not adds_nothing(scores, names, name):
        return Grade(name, "named", probability, of_class, share, factor)
    every = tuple(dict.fromkeys((*of_class, *alike)))
    is_real = correction.is_applied and len(alike) <= MOST_ALIKE and rise > max(MATTERS, DECISIVE * error)
    word: Word = "acts_like" if is_real else "possible"
    return Grade(name, word, _probability({name, *every}, posterior), every, share, factor)


def _probability(names: set[str], posterior: Posterior) -> float:
    """That at least one of some names acts."""
    return min(1.0, math.fsum(share.total for one, share in posterior.shares.items() if names & set(one)))


def ends_its_range(result: Fit, name: str) -> bool:
    """Whether a switch of an effect, or a wrong value, is on an end of its range where it does not do nothing."""
    own = [one for one in result.free if one.startswith(f"{name}.") or one == name.removeprefix("valve.")]
    at = dict(zip(result.names, result.coordinates.tolist(), strict=True))
    return any(
        result.unknown(one).is_switch and result.on_bound(one) is not None and at[one] != result.unknown(one).start
        for one in own
    )


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


def adds_nothing(scores: Scores, names: Set, name: str) -> bool:
    """Whether one of several has next to nothing of what a set takes off, and unseen conditions do not miss it."""
    rest = without(names, name)
    if len(names) < SEVERAL or rest not in scores:
        return False
    rise, error = scores[names].rise(scores[rest])
    return _share(scores, names, name) < LITTLE and rise <= max(MATTERS, DECISIVE * error)


def _share(scores: Scores, names: Set, name: str) -> float:
    """The part of what the correction takes off that is lost without a member, all of it at most; nan: not fitted."""

    def square(score: Score) -> float:
        return float(np.mean(np.exp(2.0 * score.logs)))

    rest = without(names, name)
    gain = square(scores[()]) - square(scores[names])
    if rest not in scores or not gain > 0.0:
        return math.nan
    return min(max((square(scores[rest]) - square(scores[names])) / gain, 0.0), 1.0)
