"""What is claimed: functions of a closed table of scores and of the hold-out, and of nothing else.

`choose` finds what training strokes support, held-out data judge it (`claim_after_holdout`), and the verdict's numbers
follow from the table. Nothing here fits, simulates or makes sentences.
"""

from __future__ import annotations

import math
from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from typing import Final, NamedTuple

from valve_sim.identification.diagnosis.calibration import calibrated
from valve_sim.identification.selection.held_out import Judgement
from valve_sim.identification.selection.table import (
    DECISIVE,
    MOST_EFFECTS,
    Hypothesis,
    ScoreTable,
    competing_models,
    delta_scores,
    larger_alternatives,
    smaller_alternatives,
)

LARGEST_CLASS: Final = 4
"""A class with more names than this is no answer."""
LIKELY: Final = 4.0
"""Difference of evidence within which a larger look-alike is listed, too: odds of 7 to 1. Measured: where friction is
Coulomb's, stiction is worse by 5 to 8; where it is a stiction too small to be distinguished, by −8 to 3.4."""
MANY: Final = 3
"""Named effects from which the form of the model is in doubt: on plants of another form they stand for its parts, and
friction with a look-alike of it as the truth was named without that one in two of fifteen recordings."""
JUDGED: Final = 2 * LARGEST_CLASS
"""How many competing models are judged by held-out data, beside the best."""
WEAK_EVIDENCE: Final = 30.0
"""Scale of eq. (57): a gain of S that is this large lowers a claim's share by the factor 0.63; at five detection limits
the gain is some hundreds."""
HALVED: Final = 0.5
"""Error with named effects over that without, of strokes left out in turn and of held-out ones, below which they are
named beside an unexplained remainder."""
MOST_FALSE_ALARMS: Final = 0.01
"""Probability that the search finds as much in noise alone, beyond which nothing is claimed."""
EVEN: Final = 0.5
"""Most probable that a claim with a remainder, of more names than usual, or of an unfinished search, may be."""


@dataclass(frozen=True)
class Choice:
    """What training strokes support, before held-out data are opened.

    Attributes:
        best: the hypothesis. is_white: whether its residual is. curve_wins: whether a nonparametric force is decisively
            better. halves_error: whether it more than halves the error of strokes that are left out in turn.
        competing: what explains the training strokes about as well, nearest first; it is judged with the best.
    """

    best: Hypothesis
    is_white: bool
    curve_wins: bool
    halves_error: bool
    competing: tuple[Hypothesis, ...]


@dataclass(frozen=True)
class Claim:
    """What is claimed after held-out data have been opened.

    Attributes:
        best: the choice, or the declared model where it was refuted. refuted: what competed and was refuted.
        is_unknown: whether something is left that has no name. names_most: whether names are claimed beside it.
    """

    best: Hypothesis
    is_unknown: bool
    names_most: bool
    refuted: frozenset[Hypothesis] = frozenset()


class Decision(NamedTuple):
    """Kind of verdict, effects that it names, and the probability that it is right."""

    kind: str
    effects: tuple[str, ...]
    probability: float


def is_claimable(table: ScoreTable, best: Hypothesis, false_alarm: float, *, is_larger: bool) -> bool:
    """Whether training strokes support a claim of effects: it lowers the error, and is no false alarm.

    Args:
        table: of all that was tried. best: what would be claimed.
        false_alarm: probability that the search finds as much in noise.
        is_larger: whether its plain error is larger than the refitted declared model's.
    """
    return not is_larger and not (table[best].is_white and false_alarm > MOST_FALSE_ALARMS)


def choice_of(table: ScoreTable, best: Hypothesis, curves: Sequence[float]) -> Choice:
    """The best, what competes with it, and whether something without a name does better.

    Args:
        table: of all that was tried. best: what is claimed. curves: S of each nonparametric force.
    """
    one = table[best]
    competing: list[Hypothesis] = []
    if one.is_white and best.effects:
        worse = {**delta_scores(table, best), **larger_alternatives(table, best)}
        competing = sorted((other for other in worse if other != best), key=worse.__getitem__)[:JUDGED]
    return Choice(
        best, one.is_white, min(curves, default=math.inf) < one.score - DECISIVE, _halves_error(table, best),
        tuple(competing),
    )  # fmt: skip


def _halves_error(table: ScoreTable, best: Hypothesis) -> bool:
    with_names, without = table[best].cross_validation(), table[best.base].cross_validation()
    if not best.effects or with_names is None or without is None:
        return False
    return with_names.sum_squares < HALVED**2 * without.sum_squares


def claim_after_holdout(
    table: ScoreTable, choice: Choice, judgements: Sequence[Judgement] | None, strokes: int
) -> Claim:
    """The claim that is left of a choice after the hold-out, which can refute it; nothing else takes its place.

    Args:
        table: of all that was tried. choice: what is judged. strokes: how many the machine made.
        judgements: of the refitted declared model, of the best and of each that competes; None where the time was too
            short to open held-out data: then no effect is claimed.
    """
    best, base = choice.best, choice.best.base
    if judgements is None:
        return Claim(base, is_unknown=not table[base].is_white, names_most=False)
    of_base, of_best, *of_others = judgements
    refuted = frozenset(
        other for other, judgement in zip(choice.competing, of_others, strict=True) if judgement.refutes_names
    )
    if best.effects and not of_best.is_gain:
        is_adequate = table[base].is_white and of_base.is_white
        return Claim(base, is_unknown=not is_adequate, names_most=False, refuted=refuted)
    # Dampings of a single stroke are too uncertain to tell.
    is_refuted = (bool(best.effects) or strokes > 1) and not of_best.is_white
    # What held-out data refute is no claim, however much it explains; a remainder known before may stay beside one.
    is_most = choice.halves_error and not of_best.ratio >= HALVED
    names_most = bool(best.effects) and is_most and not choice.is_white and not choice.curve_wins
    return Claim(best, choice.curve_wins or not choice.is_white or is_refuted, names_most, refuted)


def share_of_evidence(table: ScoreTable, claim: Claim, curves: Sequence[float]) -> float:
    """Share of the claim in the evidence, theory, eq. (57), without sets that merely extend it.

    Nonparametric forces have a share, too; `curves` is S of each. A weak effect without a name is easily taken for a
    weak one with a name (measured on the campaign: at a tenth of a strong one, damping that varies with x passes for
    spring hardening), so weak evidence is never certain.
    """
    best, least = claim.best, table[claim.best].score
    near = {
        **delta_scores(table, best), **smaller_alternatives(table, best), **larger_alternatives(table, best),
    }  # fmt: skip
    weight: dict[tuple[str, ...], float] = {}
    for other, one in table.scores.items():
        extends = bool(best.effects) and set(other.effects) > set(best.effects)
        if extends or other in claim.refuted:
            continue
        worse = near.get(other, one.score - least)
        if not best.effects:
            # What it gains only by errors of the recording counts less where these are beyond their prior anyway.
            worse += least - one.score - one.gain_on(table[best])
        weight[other.effects] = max(weight.get(other.effects, 0.0), weight_of(worse))
    if not best.effects:
        weight.update({(name,): weight_of(-gain) for name, gain in table.screened.items() if (name,) not in weight})
    share = weight[best.effects] / (sum(weight.values()) + math.exp(-0.5 * _nearest(curves, least)))
    if not best.effects:
        return share
    gain = table[best].gain_on(table[best.base])
    return share * -math.expm1(-max(gain, 0.0) / WEAK_EVIDENCE)


def weight_of(worse: float) -> float:
    """Likelihood of a model over that of one that is better by so much of S; 1 where it is no worse."""
    return math.exp(-0.5 * min(max(worse, 0.0), 700.0))


def _nearest(curves: Sequence[float], least: float) -> float:
    """By how much the best nonparametric force is worse; those that are far take no part."""
    near = [score - least for score in curves if score < least + 2.0 * DECISIVE]
    return max(min(near, default=math.inf), 0.0)


def look_alikes(table: ScoreTable, claim: Claim) -> dict[str, tuple[str, ...]]:
    """Of each named effect, what else it could be.

    Where the form is wrong, or in doubt because many effects are named, scores mislead, and known look-alikes are
    listed too.
    """
    found: dict[str, tuple[str, ...]] = {}
    for name in claim.best.effects:
        others = _in_place_of(table, claim, name)
        if claim.is_unknown or len(claim.best.effects) >= MANY:
            # What is named itself stands in nobody's place.
            known = [other for other in table.look_alikes.get(name, ()) if other not in claim.best.effects]
            others = tuple(dict.fromkeys([*others, *known]))[: LARGEST_CLASS - 1]
        found[name] = others
    return found


def _in_place_of(table: ScoreTable, claim: Claim, member: str) -> tuple[str, ...]:
    """Effects that would do in place of a member: competing models, and its look-alikes with more parameters."""
    best = claim.best
    rest = best.without(member)
    likely = [other for other, worse in larger_alternatives(table, best).items() if worse < LIKELY]
    remaining = [other for other in (*competing_models(table, best), *likely) if other not in claim.refuted]
    sets = {other.effects for other in remaining}
    names = [name for other in remaining for name in other.effects]
    return tuple(dict.fromkeys(name for name in names if name != member and rest.adding(name).effects in sets))


def competitors(table: ScoreTable, claim: Claim) -> list[Hypothesis]:
    """The claim and what competes with it, best first: what a further recording should tell apart."""
    return [other for other in competing_models(table, claim.best) if other not in claim.refuted]


def decide(
    claim: Claim, alike: Mapping[str, Sequence[str]], evidence: float, strokes: int, *, singles_untried: bool
) -> Decision:
    """The verdict.

    Args:
        claim: after the hold-out. alike: of each effect, what else it could be. evidence: its share.
        strokes: how many the machine made. singles_untried: whether not even every single effect was tried.
    """
    kind = _kind(claim, alike, strokes, singles_untried=singles_untried)
    # No claim of more names was among those that the probabilities were calibrated on.
    is_usual = len(claim.best.effects) <= MOST_EFFECTS
    is_sure = is_usual and not claim.is_unknown and not singles_untried and kind in ("none", "effects")
    probability = calibrated(kind, evidence) if is_sure else min(evidence, EVEN)
    return Decision(kind, () if kind == "none" else claim.best.effects, probability)


def _kind(claim: Claim, alike: Mapping[str, Sequence[str]], strokes: int, *, singles_untried: bool) -> str:
    if claim.is_unknown:
        unnamed = "insufficient" if singles_untried else "unknown"
        return "effects" if claim.names_most else unnamed
    is_ambiguous = any(len(others) + 1 > LARGEST_CLASS for others in alike.values())
    if strokes <= 1 or is_ambiguous:
        return "insufficient"
    return "effects" if claim.best.effects else "none"
