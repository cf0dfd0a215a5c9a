"""The posterior over what may be missing, and the verdict: functions of a table of evidence, and of nothing else.

A hypothesis is a set E of effects and of wrong declared values, with or without something unnamed beside it: a
discrepancy of what is shown (δ), or a force. The priors are these, and no other number decides (theory, section 7):

    the form is as declared, 0.95:   how many effects act, and how many declared numbers without a tolerance are wrong,
                                     are Poisson numbers of mean 1 each; δ = 0
    something unnamed acts, 0.05:    how many named things act beside it is even on 0 … 8; a discrepancy or a force

Sets of one size are equally probable. The posterior is the product of prior and evidence, normalised over all that was
tried and what was left untried when the work was used up, which counts with the best evidence that was found.
"""

from __future__ import annotations

import math
from collections.abc import Iterable, Mapping, Sequence
from dataclasses import dataclass, field
from typing import Final, NamedTuple

import numpy as np

from valve_sim.identification.plants.protocol import Plant

FORM_IS_RIGHT: Final = 0.95
"""Prior probability that nothing acts but what has a name."""
EXPECTED: Final = 1.0
"""Prior means of the numbers of effects that act, and of declared values that are wrong: Poisson numbers."""
MOST_BESIDE: Final = 8
"""Named things beside something unnamed: 0 to this many are equally probable."""
SURE: Final = 0.9
"""Probability from which effects are named."""
EVEN: Final = 0.5
"""Probability from which the verdict is `none`, or `unknown`."""
ALIKE: Final = 20.0
"""Odds within which a set that differs in one member is a look-alike."""
NEARLY: Final = 3.0
"""Odds within which the simpler of two look-alikes gives its name to the class."""
MOST_CLAIMED: Final = 2
"""Names of a claim: what lacks more at once was never tested, and three names together imitate forms that have none. (A
bump of force at the pick-up is a constant force, another gap and another impact to within noise.)"""
LARGEST_CLASS: Final = 4
"""Largest number of names in a class that is claimed."""

Set = tuple[str, ...]
"""Names in alphabetical order."""


class Evidence(NamedTuple):
    """The evidence of one set.

    Attributes:
        plain, unnamed: ln p(data | set) without and with a discrepancy. forced: with a force that has no name.
        is_fitted: whether it was fitted; else it is a linear estimate, or the bound of what was left untried.
        is_untried: whether it is such a bound.
    """

    plain: float
    unnamed: float
    is_fitted: bool = True
    is_untried: bool = False
    forced: float = -math.inf


class Share(NamedTuple):
    """Posterior probabilities of a set: without and beside something unnamed."""

    plain: float
    unnamed: float

    @property
    def total(self) -> float:
        """Probability of the set, whatever acts beside it."""
        return self.plain + self.unnamed


@dataclass(frozen=True)
class Rivals:
    """The names that a hypothesis may contain.

    Attributes:
        effects: names of effects, and of declared values that may be wrong although a tolerance is given.
        declared: of declared values without a tolerance, and of declared effects, that may be wrong.
    """

    effects: frozenset[str]
    declared: frozenset[str]

    def log_prior(self, names: Set) -> tuple[float, float]:
        """Ln of the prior probability of a set, without and with something unnamed beside it."""
        wrong = sum(name in self.declared for name in names)
        right = _poisson(len(names) - wrong, len(self.effects)) + _poisson(wrong, len(self.declared))
        every = len(self.effects) + len(self.declared)
        beside = -math.log(MOST_BESIDE + 1.0) - _choices(every, len(names))
        return math.log(FORM_IS_RIGHT) + right, math.log(0.5 * (1.0 - FORM_IS_RIGHT)) + beside

    def unnamed_beside(self, names: Set, evidence: Evidence) -> float:
        """Probability that something unnamed acts beside a set, were it the only one that is possible."""
        plain, unnamed = self.log_prior(names)
        if math.isinf(evidence.plain):
            return 0.0
        return 1.0 / (1.0 + math.exp(min(700.0, plain + evidence.plain - unnamed - evidence.unnamed)))


def rivals_of(plant: Plant) -> Rivals:
    """The hypotheses about a machine: effects, and declared values that may be wrong."""
    # What has a tolerance is as rarely wrong as an effect acts; of what has none nobody says how well it is known.
    tolerated = {own.name for own in plant.nuisances if own.is_of_machine}
    wrong = frozenset(
        name
        for name, choice in plant.effects.items()
        if choice.is_declared and not tolerated & set(choice.free_names())
    )
    return Rivals(frozenset(plant.effects) - wrong, wrong)


def _poisson(count: int, among: int) -> float:
    """Ln of the probability of one set of so many, where how many there are is a Poisson number."""
    most = [-EXPECTED + size * math.log(EXPECTED) - math.lgamma(size + 1.0) for size in range(among + 1)]
    return most[count] - math.log(math.fsum(map(math.exp, most))) - _choices(among, count)


def _choices(among: int, count: int) -> float:
    """Ln of the number of sets of a size."""
    return math.lgamma(among + 1.0) - math.lgamma(count + 1.0) - math.lgamma(among - count + 1.0)


@dataclass(frozen=True)
class Posterior:
    """Probabilities of all that was tried.

    Attributes:
        shares: of each set.
        beside: of each set, given that a discrepancy acts beside it, by the training data alone: held-out data may say
            that something unnamed acts, not which set is better than another.
        fitted: the sets that were fitted: one of these leads. untried: those that speak for no name.
    """

    shares: Mapping[Set, Share]
    beside: Mapping[Set, float] = field(default_factory=dict)
    fitted: frozenset[Set] = field(default_factory=frozenset)
    untried: frozenset[Set] = field(default_factory=frozenset)

    @property
    def unnamed(self) -> float:
        """Probability that something without a name acts."""
        return math.fsum(share.unnamed for share in self.shares.values())

    @property
    def names(self) -> list[str]:
        """All names in the sets."""
        return sorted({name for names in self.shares for name in names})

    def inclusion(self) -> dict[str, float]:
        """Probability of each name that it acts, alone or among others."""
        return {
            name: math.fsum(share.total for names, share in self.shares.items() if name in names) for name in self.names
        }


def posterior_of(
    rivals: Rivals, table: Mapping[Set, Evidence], odds_of_unnamed: Mapping[Set, float] | None = None
) -> Posterior:
    """The posterior of a table of evidence.

    Args:
        rivals: what may be missing. table: of all that was tried, the empty set among it.
        odds_of_unnamed: of some sets, ln of the factor by which held-out data raise the odds of something unnamed.
    """
    logs: dict[Set, tuple[float, float]] = {}
    beside: dict[Set, float] = {}
    for names, evidence in table.items():
        plain, unnamed = rivals.log_prior(names)
        raised = (odds_of_unnamed or {}).get(names, 0.0)
        beside[names] = unnamed + evidence.unnamed
        logs[names] = plain + evidence.plain, unnamed + float(np.logaddexp(evidence.unnamed, evidence.forced)) + raised
    both = _normalised([one for pair in logs.values() for one in pair])
    shares = {names: Share(*pair) for names, pair in zip(logs, zip(both[::2], both[1::2], strict=True), strict=True)}
    given = dict(zip(beside, _normalised(list(beside.values())), strict=True))
    fitted = frozenset(names for names, evidence in table.items() if evidence.is_fitted)
    untried = frozenset(names for names, evidence in table.items() if evidence.is_untried)
    return Posterior(shares, given, fitted, untried)


def _normalised(logs: Sequence[float]) -> list[float]:
    """Numbers in the ratio of e to these, that add up to 1."""
    most = max(logs)
    found = [math.exp(log - most) for log in logs]
    total = math.fsum(found)
    return [one / total for one in found]


class Class(NamedTuple):
    """A set with the look-alikes of its members.

    Attributes:
        names: of the set that leads. others: of each name, those that would do in its place, the likeliest first.
        probability: that all names of the set act, or of one that would do in its place, whatever acts beside them.
    """

    names: Set
    others: Mapping[str, tuple[str, ...]]
    probability: float

    @property
    def is_answer(self) -> bool:
        """Whether the class names at least one effect, and few names for each."""
        return bool(self.names) and all(len(others) < LARGEST_CLASS for others in self.others.values())


def class_of(weights: Mapping[Set, float], leader: Set) -> Class:
    """The class of a set: those that differ in one member and whose odds to it are within `ALIKE`."""
    least, alike = weights[leader] / ALIKE, [frozenset(leader)]
    others: dict[str, list[tuple[float, str]]] = {name: [] for name in leader}
    for names, weight in weights.items():
        lost, gained = set(leader) - set(names), set(names) - set(leader)
        if len(lost) == len(gained) == 1 and weight >= least:
            others[lost.pop()].append((weight, gained.pop()))
            alike.append(frozenset(names))
    if not leader:
        return Class((), {}, weights[()])
    # A further effect that is too small to be told makes no name wrong.
    total = math.fsum(weight for names, weight in weights.items() if any(one <= set(names) for one in alike))
    return Class(
        leader,
        {name: tuple(other for _, other in sorted(found, reverse=True)) for name, found in others.items()},
        total,
    )


def leader_of(weights: Mapping[Set, float], fitted: Iterable[Set]) -> Set:
    """The most probable set that was fitted; of equal ones the smallest, by name."""
    return min(fitted, key=lambda names: (-weights.get(names, 0.0), len(names), names))


def simplest_of(weights: Mapping[Set, float], leading: Class, sizes: Mapping[str, int]) -> Class:
    """The simplest set that is nearly as probable as the one that leads: one of its class, or one that it contains.

    Coulomb friction is stiction without a breakaway: where the data do not show one, the name without it stands first.
    Friction by direction beside Coulomb friction is friction by direction.

    Args:
        weights: probabilities. leading: the class. sizes: of each name, how many parameters it frees.
    """
    near = [leading.names]
    for name, others in leading.others.items():
        near += [tuple(sorted({*leading.names, other} - {name})) for other in others]
    near += [names for names in weights if names and set(names) < set(leading.names)]
    least = weights[leading.names] / NEARLY
    sizes_of = {names: sum(sizes.get(name, 1) for name in names) for names in near if weights.get(names, 0.0) >= least}
    simplest = min(sizes_of, key=lambda names: (sizes_of[names], -weights[names]))
    return leading if sizes_of[simplest] == sizes_of[leading.names] else class_of(weights, simplest)


class Decision(NamedTuple):
    """The claim.

    Attributes:
        kind: "none", "effects", "unknown" or "insufficient". names, others: see `Class`; of "unknown" the leader's.
        probability: of what is claimed. unnamed: that something without a name acts.
    """

    kind: str
    names: Set
    others: Mapping[str, tuple[str, ...]]
    probability: float
    unnamed: float


def leading_beside(posterior: Posterior, sizes: Mapping[str, int]) -> Class:
    """The class that leads given that something unnamed acts beside it; `sizes`: see `simplest_of`."""
    weights = posterior.beside
    leading = class_of(weights, leader_of(weights, posterior.fitted))
    if not leading.names:
        return leading
    simplest = simplest_of({names: weights[names] for names in posterior.fitted}, leading, sizes)
    return simplest._replace(probability=class_of(weights, simplest.names).probability)


def decide(posterior: Posterior, sizes: Mapping[str, int] | None = None) -> Decision:
    """The verdict.

    Args:
        posterior: of all that was tried. sizes: of each name, how many parameters it frees; default all alike.
    """
    unnamed = posterior.unnamed
    if unnamed > EVEN:
        leading = leading_beside(posterior, sizes or {})
        return Decision("unknown", leading.names, leading.others, unnamed, unnamed)
    weights = {names: share.plain for names, share in posterior.shares.items()}
    leading = class_of(weights, leader_of(weights, posterior.fitted))
    if not leading.names and weights[()] >= EVEN:
        return Decision("none", (), {}, weights[()], unnamed)
    if not leading.names:
        return Decision("insufficient", (), {}, weights[()], unnamed)
    leading = simplest_of({names: weights[names] for names in posterior.fitted}, leading, sizes or {})
    # Whether the names act does not hang on whether something unnamed does, too; what was not tried says nothing of it.
    totals = {names: share.total for names, share in posterior.shares.items() if names not in posterior.untried}
    leading = leading._replace(probability=class_of(totals, leading.names).probability)
    is_claimed = leading.is_answer and len(leading.names) <= MOST_CLAIMED and leading.probability >= SURE
    kind = "effects" if is_claimed else "insufficient"
    return Decision(kind, leading.names, leading.others, leading.probability, unnamed)


@dataclass(frozen=True)
class Grounds:
    """All that a verdict follows from.

    Attributes:
        rivals, table, odds_of_unnamed: see `posterior_of`. sizes: see `decide`.
    """

    rivals: Rivals
    table: Mapping[Set, Evidence]
    odds_of_unnamed: Mapping[Set, float]
    sizes: Mapping[str, int]

    @property
    def posterior(self) -> Posterior:
        """The posterior of the table."""
        return posterior_of(self.rivals, self.table, self.odds_of_unnamed)

    @property
    def decision(self) -> Decision:
        """The verdict."""
        return decide(self.posterior, self.sizes)
