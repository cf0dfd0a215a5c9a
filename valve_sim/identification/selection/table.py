"""The fits of a search, as rows that are only ever appended, and the table of scores that decisions are drawn from.

Every fit is a row: the hypothesis, the kind of start it was made from, and the fit. The score of a hypothesis is that
of its best row. When the search ends the log is closed, so that no score changes after a decision was drawn from it.
What follows is functions of the table alone.
"""

from __future__ import annotations

import threading
from collections.abc import Callable, Iterable, Mapping, Sequence
from dataclasses import dataclass, field
from typing import Final, NamedTuple, TypeVar

import numpy as np

from valve_sim.identification.estimation.result import MOSTLY, Fit
from valve_sim.identification.plants.effect_titles import titles_of
from valve_sim.identification.selection.cross_validation import CrossValidation, predicts_better

DECISIVE: Final = 10.0
"""Difference of the score S, theory, eq. (41), that decides: odds of 150 to 1."""
MOST_EFFECTS: Final = 4
"""In one hypothesis. On the plant of another form, three leave the added effect out in 4 of 10 cases, four in 2."""
NEGLIGIBLE: Final = 0.1
"""Difference of χ² that is no reason to put a parameter on its bound, where it names nothing."""

Item = TypeVar("Item")


class Hypothesis(NamedTuple):
    """A set of effects, in alphabetical order, and whether each command's stamp may err."""

    effects: tuple[str, ...]
    timing: bool = False

    def __str__(self) -> str:
        model = titles_of(self.effects) if self.effects else "the declared model"
        return model + (", with errors of the commands' stamps" if self.timing else "")

    def adding(self, effect: str) -> Hypothesis:
        """The same and one effect more."""
        return Hypothesis(tuple(sorted((*self.effects, effect))), self.timing)

    def without(self, effect: str) -> Hypothesis:
        """The same less one effect."""
        return Hypothesis(tuple(name for name in self.effects if name != effect), self.timing)

    @property
    def base(self) -> Hypothesis:
        """The declared model, its stamps treated alike."""
        return Hypothesis((), self.timing)


class Row(NamedTuple):
    """One fit: of which hypothesis, and from which kind of start."""

    hypothesis: Hypothesis
    start: str
    fit: Fit


class FitLog:
    """Rows in the order in which they were made; hypotheses in the order in which they were asked for."""

    def __init__(self) -> None:
        self._rows: list[Row] = []
        self._order: dict[Hypothesis, None] = {}
        self._best: dict[Hypothesis, Fit] = {}
        self._lock = threading.Lock()
        self._is_closed = False

    @property
    def rows(self) -> tuple[Row, ...]:
        """All of them."""
        return tuple(self._rows)

    @property
    def best(self) -> dict[Hypothesis, Fit]:
        """The best fit of each hypothesis; of equal ones the first."""
        with self._lock:
            return {hypothesis: self._best[hypothesis] for hypothesis in self._order if hypothesis in self._best}

    def rows_of(self, hypothesis: Hypothesis) -> list[Row]:
        """Those of one hypothesis."""
        return [row for row in self.rows if row.hypothesis == hypothesis]

    def expect(self, hypotheses: Iterable[Hypothesis]) -> None:
        """Fix the order of what is fitted in parallel: ties must not depend on what is ready first."""
        with self._lock:
            for hypothesis in hypotheses:
                self._order.setdefault(hypothesis)

    def append(self, row: Row) -> None:
        """Add a row.

        Raises:
            RuntimeError: the log is closed: decisions were drawn from its scores.
        """
        with self._lock:
            if self._is_closed:
                raise RuntimeError(f"{row.hypothesis}: a fit after the table of scores was closed")
            self._rows.append(row)
            self._order.setdefault(row.hypothesis)
            before = self._best.get(row.hypothesis)
            if before is None or _is_better(row.fit, before):
                self._best[row.hypothesis] = row.fit
                superseded = before
            else:
                superseded = row.fit
        if superseded is not None:
            superseded.derivatives.drop()

    def drop_derivatives(self, kept: int) -> None:
        """Drop the Jacobians of all but the best few fits: they are worked out again when asked for."""
        for found in sorted(self.best.values(), key=lambda found: found.score)[kept:]:
            found.derivatives.drop()

    def close(self) -> None:
        """Take no further row."""
        with self._lock:
            self._is_closed = True

    def __contains__(self, hypothesis: object) -> bool:
        return hypothesis in self._best

    def __getitem__(self, hypothesis: Hypothesis) -> Fit:
        return self._best[hypothesis]


def _is_better(new: Fit, old: Fit) -> bool:
    """Whether a fit is better than another of the same hypothesis; of equal ones the one with less on its bounds."""
    on_bounds = [sum(one.on_bound(name) is not None for name in one.free) for one in (new, old)]
    return new.chi2 < old.chi2 + NEGLIGIBLE * float(np.sign(on_bounds[1] - on_bounds[0]))


@dataclass(frozen=True, eq=False)
class Score:
    """What training strokes say of a hypothesis, by its best row.

    Attributes:
        score: S. evidence: −2 ln of the evidence, theory, eq. (42). parameters: how many it frees.
        is_white: whether its residual is. is_claimable: whether every effect is significantly on and on no bound.
        variance_inflation: f. chi2: the criterion. of_declared: what values off their tolerances add to it.
        cross_validation: what it predicts of strokes left out; None of one stroke.
        of_recordings: what errors of clocks and stamps add to the criterion. stamp_variance: mean square of the errors
            of stamps, in variances of their prior, where they refute it; else 1.
    """

    hypothesis: Hypothesis
    score: float
    evidence: float
    parameters: int
    is_white: bool
    is_claimable: bool
    variance_inflation: float
    chi2: float
    of_declared: float
    cross_validation: Callable[[], CrossValidation | None] = field(default=lambda: None, repr=False)
    of_recordings: float = 0.0
    stamp_variance: float = 1.0

    def gain_on(self, smaller: Score) -> float:
        """By how much S is less than that of a smaller model, theory, below eq. (46).

        Where even this model leaves stamps that refute their prior, that errors of the recording are smaller counts by
        the variance that these have.
        """
        relief = max(0.0, smaller.of_recordings - self.of_recordings) / self.variance_inflation
        return smaller.score - self.score - relief * (1.0 - 1.0 / self.stamp_variance)

    def criterion(self, *, residual_is_white: bool) -> float:
        """The selection criterion, theory, eq. (45), where it is said whether a form is right."""
        left_out = None if residual_is_white else self.cross_validation()
        return self.score if left_out is None else self.score + left_out.rise / self.variance_inflation

    @property
    def own_criterion(self) -> float:
        """The same where its own residual says so."""
        return self.criterion(residual_is_white=self.is_white)

    def improves_on(self, smaller: Score) -> bool:
        """Whether it predicts strokes that are left out better than a smaller model does, theory, eq. (46).

        What mostly brings declared values back within their tolerances is not asked to: theory, below eq. (83).
        """
        if smaller.of_declared - self.of_declared > MOSTLY * (smaller.chi2 - self.chi2) > 0.0:
            return True
        one, other = smaller.cross_validation(), self.cross_validation()
        return one is None or other is None or predicts_better(one, other, self.variance_inflation)


@dataclass(frozen=True, eq=False)
class ScoreTable:
    """Scores of all that was fitted, in the order in which it was asked for; the declared model is among them.

    Attributes:
        look_alikes: of each effect. screened: by the score test, by how much each effect would lower the declared
            model's S, where none was fitted because none would; else empty.
    """

    scores: Mapping[Hypothesis, Score]
    look_alikes: Mapping[str, Sequence[str]] = field(default_factory=dict)
    screened: Mapping[str, float] = field(default_factory=dict)

    def __getitem__(self, hypothesis: Hypothesis) -> Score:
        return self.scores[hypothesis]

    def __contains__(self, hypothesis: object) -> bool:
        return hypothesis in self.scores


def choose(table: ScoreTable) -> Hypothesis:
    """The hypothesis that training strokes speak for: the best criterion, after backward elimination.

    A look-alike with more parameters takes its place where its evidence is decisively better: S charges ln N for a
    parameter even where tolerances, not the number of samples, limit what is known of it.
    """
    best = backward(table, best_claimable(table))
    near = competing_models(table, best)
    if table[best].is_white and not best.effects:
        near = [other for other in near if table[other].gain_on(table[best]) > 0.0]
    best = next((other for other in near if table[other].is_claimable and other.base in table), best)
    larger = larger_alternatives(table, best)
    likeliest = min(larger, key=larger.__getitem__, default=best)
    return likeliest if larger.get(likeliest, 0.0) < -DECISIVE else best


def best_claimable(table: ScoreTable) -> Hypothesis:
    """The hypothesis of the best criterion of those that may be claimed."""
    claimable = [one for one in table.scores.values() if one.is_claimable and one.hypothesis.base in table]
    return best_few(claimable, 1, lambda one: one.score, lambda one: one.own_criterion)[0].hypothesis


def best_few(
    items: Iterable[Item], count: int, least: Callable[[Item], float], criterion: Callable[[Item], float]
) -> list[Item]:
    """The few items of the best criterion, best first; of equal ones the first.

    Strokes are left out in turn only of fits that may be among these: S is never more than the criterion.

    Args:
        items: to choose from. count: how many. least: what the criterion is at least, known at no cost.
        criterion: of an item.
    """
    found: list[tuple[float, int, Item]] = []
    for index, item in sorted(enumerate(items), key=lambda numbered: least(numbered[1])):
        if len(found) == count and least(item) > found[-1][0]:
            break
        found = sorted([*found, (criterion(item), index, item)])[:count]
    return [item for _, _, item in found]


def backward(table: ScoreTable, best: Hypothesis) -> Hypothesis:
    """Drop effects whose loss costs less than a decisive difference, one at a time, the one that costs least first."""
    rests = [rest for rest in map(best.without, best.effects) if rest in table and not is_missed(table, rest, best)]
    if rests:
        return backward(table, min(rests, key=lambda rest: table[rest].own_criterion))
    untimed = best._replace(timing=False)
    is_better = best.timing and untimed in table and table[untimed].score < table[best].score
    return untimed if is_better else best


def is_missed(table: ScoreTable, rest: Hypothesis, best: Hypothesis) -> bool:
    """Whether what a larger hypothesis has beside a smaller one is decisive.

    Where no form is right any effect lowers the score, and must predict other strokes better besides. No form is right
    where the residual is not white, and more effects than usual may make it white because they add up to another form.
    """
    form_is_right = table[best].is_white and len(best.effects) <= MOST_EFFECTS
    is_decisive = table[best].gain_on(table[rest]) >= DECISIVE
    return is_decisive and (form_is_right or table[best].improves_on(table[rest]))


def delta_scores(table: ScoreTable, best: Hypothesis) -> dict[Hypothesis, float]:
    """By how much each hypothesis of equal size and a similar criterion is worse than the best, by one criterion.

    Look-alikes with fewer parameters are compared by their evidence; those with more are `larger_alternatives`.
    """
    is_white, count = table[best].is_white, max(1, len(best.effects))
    least = table[best].criterion(residual_is_white=is_white)
    resized = _by_evidence(table, best)
    worse = {
        other: one.criterion(residual_is_white=is_white) - least
        for other, one in table.scores.items()
        if len(other.effects) == count and other not in resized and one.score - least < 2.0 * DECISIVE
    }
    worse.update(smaller_alternatives(table, best))
    return {other: by for other, by in worse.items() if by < 2.0 * DECISIVE}


def competing_models(table: ScoreTable, best: Hypothesis) -> list[Hypothesis]:
    """Hypotheses within a decisive difference of the best, itself included where it has effects; best first."""
    worse = delta_scores(table, best)
    return sorted((other for other, by in worse.items() if by < DECISIVE), key=worse.__getitem__)


def smaller_alternatives(table: ScoreTable, best: Hypothesis) -> dict[Hypothesis, float]:
    """Look-alikes with fewer parameters, each in place of a member: by how much their evidence is worse."""
    fewer = table[best].parameters
    return {other: by for other, by in _by_evidence(table, best).items() if table[other].parameters < fewer}


def larger_alternatives(table: ScoreTable, best: Hypothesis) -> dict[Hypothesis, float]:
    """Look-alikes with more parameters, each in place of a member: by how much their evidence is worse.

    S charges ln N for a parameter, however weakly it is determined. That is right for choosing a name, but no reason to
    exclude stiction where Coulomb friction is named: the evidence, eq. (42), compares these. What is on a bound names
    nothing: stiction whose Stribeck velocity is too small to be seen is Coulomb's. Nor is it a hypothesis of its own
    where its further parameters explain no more than their number, as they would of noise.
    """
    return {
        other: by
        for other, by in _by_evidence(table, best).items()
        if table[other].is_claimable and _explains_more(table[best], table[other])
    }


def _by_evidence(table: ScoreTable, best: Hypothesis) -> dict[Hypothesis, float]:
    """Look-alikes with another number of parameters: by how much their evidence is worse; none where no form is right.

    S and the evidence charge alike for parameters that the data determine. Beside declared values within tolerances
    they determine less, and more samples do not change that.
    """
    if not table[best].is_white:
        return {}
    alike = [
        best.without(member).adding(name)
        for member in best.effects
        for name in table.look_alikes.get(member, ())
        if name not in best.effects
    ]
    return {
        other: table[other].evidence - table[best].evidence
        for other in alike
        if other in table and table[other].parameters != table[best].parameters
    }


def _explains_more(smaller: Score, larger: Score) -> bool:
    """Whether a larger model explains more than as many parameters would explain of noise."""
    further = larger.parameters - smaller.parameters
    return further > 0 and (smaller.chi2 - larger.chi2) / smaller.variance_inflation > further
