"""Which hypotheses are tried, in which order, and which of them may be claimed.

Singles, then pairs, triples and quadruples while each gains; members are swapped through the catalogue, and what is not
needed is dropped again. Hypotheses are ordered by training strokes alone: by the score S where the residual is white,
else by what they predict of strokes that are left out.
"""

from __future__ import annotations

import math
from collections.abc import Mapping, Sequence
from typing import Final

from valve_sim.identification.estimation.budget import OutOfTimeError
from valve_sim.identification.estimation.parallel import run_parallel
from valve_sim.identification.plants.protocol import to_internal
from valve_sim.identification.selection.criteria import Criteria
from valve_sim.identification.selection.hypotheses import DECISIVE, Hypothesis, Search
from valve_sim.identification.selection.score_test import score_gains

MOST_EFFECTS: Final = 4
"""In one hypothesis. On the plant of another form, three leave the added effect out in 4 of 10 cases, four in 2."""
LARGEST_CLASS: Final = 4
"""More names than this are no answer."""
BEAM: Final = 2
"""How many of the best hypotheses are extended by one more effect."""
HINT: Final = 0.02
"""P-value below which the search goes on: that costs seconds, stopping too early a wrong verdict."""
NEARLY: Final = 40.0
"""Difference of S within which a better start may reverse the order."""
LIKELY: Final = 4.0
"""Difference of evidence within which a larger look-alike is listed, too: odds of 7 to 1. Measured: where friction is
Coulomb's, stiction is worse by 5 to 8; where it is a stiction too small to be distinguished, by −8 to 3.4."""
EXCLUDES_OFF: Final = 1.96
"""Standard errors that an effect must be away from 'off'."""


class Exploration:
    """The hypotheses that were tried on one problem, and what they are worth.

    Args:
        search: on the training data.

    Attributes:
        is_cut_short: whether the time was used up before all was tried.
        screened: by the score test, by how much each effect would lower the declared model's score, where no effect was
            tried because the declared model leaves nothing to be found; else empty.
    """

    def __init__(self, search: Search) -> None:
        self.search, self.criteria = search, Criteria()
        self.plant = search.problem.plant
        self.is_cut_short = False
        self.screened: dict[str, float] = {}

    def explore(self) -> Hypothesis:
        """The best claimable hypothesis of all that the time allows to try, beside the declared model's fit."""
        try:
            return self._explore()
        except OutOfTimeError:
            self.is_cut_short = True
            return Hypothesis(())

    @property
    def untried(self) -> list[str]:
        """What was left to try."""
        return [*self.search.untried, "sets of more effects"] if self.is_cut_short else list(self.search.untried)

    def singles_untried(self) -> bool:
        """Whether not even every single effect was tried, although there was a reason to."""
        return not self.screened and any(Hypothesis((name,)) not in self.search.fits for name in self.plant.effects)

    def _explore(self) -> Hypothesis:
        """Singles, then pairs and triples while something is left; returns the best claimable hypothesis."""
        search, names, declared = self.search, list(self.plant.effects), Hypothesis(())
        gains = score_gains(search.fit(declared))
        # An adequate declared model costs one fit.
        if not self._is_promising(gains) and self._is_adequate_without_doubt(declared):
            self.screened = gains
            return declared
        search.fit_each([Hypothesis((name,)) for name in names], (0.0, 0.3))
        if self.needs_larger_model(self.best_claimable()):
            self._explore_timing(names)
        for count in range(2, MOST_EFFECTS + 1):
            best = self.best_claimable()
            # Stamps that err take up what friction delays, so two effects must have been tried beside them.
            hides_another = best.timing and len(best.effects) == 1 and count == 2
            if not self.needs_larger_model(best) and not hides_another:
                break
            if best.effects:
                search.polish(best)
            if not self._extend(count, names):
                break
        if not self.is_adequate(self.best_claimable()):
            self._extend_timing(names)
        self._drop_idle()
        return self.eliminate(self.best_claimable())

    def _is_promising(self, gains: Mapping[str, float]) -> bool:
        """Whether the score test finds anything that a refit might make decisive; that of a declared value is exact."""
        effects = self.plant.effects
        return not gains or any(
            gain > (0.5 * DECISIVE if effects[name].is_declared_value else 0.0) for name, gain in gains.items()
        )

    def _drop_idle(self) -> None:
        """Drop members of the best that have no effect: the smaller hypothesis only lacked a good start."""
        hypothesis = self.search.best(self.tried())
        while idle := [member for member in hypothesis.effects if not self._is_on(hypothesis, member)]:
            start = self.search.fit(hypothesis).values
            hypothesis = hypothesis.without(idle[0])
            self.search.refit(hypothesis, start)

    def _explore_timing(self, names: Sequence[str]) -> None:
        """Errors of the commands' stamps, where they explain more than any one effect, or make the residual white."""
        if not self.plant.timing_errors:
            return
        search = self.search
        best = sorted(filter(self.is_claimable, self.tried()), key=search.score)[:BEAM]
        timed = [Hypothesis((), True), *(hypothesis._replace(timing=True) for hypothesis in best)]
        search.fit(timed[0])
        search.fit_each(timed[1:], (0.3, 0.3))
        explain_more = search.score(search.best(timed)) < search.score(best[0]) - DECISIVE
        if explain_more or any(self.is_adequate(hypothesis) for hypothesis in timed):
            search.fit_each([Hypothesis((name,), timing=True) for name in names], (0.3, 0.5))

    def _extend_timing(self, names: Sequence[str]) -> None:
        """Pairs with errors of the stamps, where these explain more than a second effect does."""
        timed = [h for h in self.tried() if h.timing and len(h.effects) == 1 and self._has_effects_on(h)]
        if not timed:
            return
        start = self.search.best(timed)
        if self.search.score(start) > self.search.score(self.best_claimable()):
            return
        self.search.fit_each([start.adding(name) for name in names if name not in start.effects], (0.8, 0.9))

    def _extend(self, count: int, names: Sequence[str]) -> bool:
        """Add one more effect to the best few, swap members; whether that was decisive."""
        search = self.search
        smaller = [hypothesis for hypothesis in self.tried() if len(hypothesis.effects) == count - 1]
        smaller = sorted((h for h in smaller if not h.timing), key=self.selection_criterion)
        before = self.selection_criterion(self.best_claimable())
        larger = [start.adding(name) for start in smaller[:BEAM] for name in names if name not in start.effects]
        done = 0.5 + 0.1 * (count - 2)
        search.fit_each(larger, (done, done + 0.1))
        best = self.best_claimable()
        if len(best.effects) == count:
            best = self._swap(best, names)
            if not self.is_adequate(best):
                search.fit(best, anneal=True)
                timed = best._replace(timing=True)
                if self.plant.timing_errors and not best.timing:
                    search.fit(timed)
        return self.selection_criterion(self.best_claimable()) < before - DECISIVE

    def _swap(self, best: Hypothesis, names: Sequence[str]) -> Hypothesis:
        """Swap each member through the catalogue (which corrected most wrong pairs on the campaign)."""
        rests = [best.without(member) for member in best.effects]
        swapped = [rest.adding(name) for rest in rests for name in names if name not in rest.effects]
        done = 0.5 + 0.1 * (len(best.effects) - 1)
        self.search.fit_each(rests, (done, done))
        self.search.fit_each(swapped, (done, done))
        return self.best_claimable()

    def eliminate(self, best: Hypothesis) -> Hypothesis:
        """Backward: drop every effect whose loss costs less than a decisive difference."""
        for member in best.effects:
            rest = best.without(member)
            self.search.refit(rest, self.search.fit(best).values)
            costs_little = self.search.score(rest) < self.search.score(best) + DECISIVE
            if costs_little or not self.criteria.improves(self.search.fit(rest), self.search.fit(best)):
                return self.eliminate(rest)
        untimed = best._replace(timing=False)
        if best.timing and self.search.score(untimed) < self.search.score(best):
            return untimed
        return best

    # -- what a hypothesis is worth ------------------------------------------------------------------------------------

    def best_claimable(self) -> Hypothesis:
        """The hypothesis of the best criterion of those whose effects are away from off and from bounds."""
        claimable = [hypothesis for hypothesis in self.tried() if self.is_claimable(hypothesis)]
        criteria = run_parallel(self.selection_criterion, claimable)
        return claimable[criteria.index(min(criteria))]

    def selection_criterion(self, hypothesis: Hypothesis) -> float:
        """The selection criterion of a hypothesis: theory, eq. (45)."""
        return self.criteria.score(self.search.fit(hypothesis))

    def tried(self) -> list[Hypothesis]:
        """Every hypothesis that was fitted, in order."""
        return list(self.search.fits)

    def is_adequate(self, hypothesis: Hypothesis) -> bool:
        """Whether its residual is white."""
        return self.criteria.is_white(self.search.fit(hypothesis))

    def needs_larger_model(self, hypothesis: Hypothesis) -> bool:
        """Whether anything hints that something is missing: the residual, or the score test of an effect."""
        if not self._is_adequate_without_doubt(hypothesis):
            return True
        gains = score_gains(self.search.fit(hypothesis)) if hypothesis.effects else {}
        return max(gains.values(), default=0.0) > DECISIVE

    def _is_adequate_without_doubt(self, hypothesis: Hypothesis) -> bool:
        return self.criteria.adequacy(self.search.fit(hypothesis)).p_value >= HINT

    def is_claimable(self, hypothesis: Hypothesis) -> bool:
        """Whether no parameter is on its bound and every effect is significantly on.

        Errors of the stamps are accepted only where the residual is white: they can fit any mismatch.
        """
        return self._has_effects_on(hypothesis) and (not hypothesis.timing or self.is_adequate(hypothesis))

    def _has_effects_on(self, hypothesis: Hypothesis) -> bool:
        return all(self._is_on(hypothesis, name) for name in hypothesis.effects)

    def _is_on(self, hypothesis: Hypothesis, effect: str) -> bool:
        """Whether an effect is significantly on, or decisive although its parameters are collinear."""
        result, away = self.search.fit(hypothesis), []
        choice = self.plant.effects[effect]
        for parameter in choice.parameters:
            name = choice.free_name(parameter)
            index = result.free.index(name)
            at = float(result.coordinates[index])
            if parameter.off is None:
                if result.on_bound(name) is not None:
                    return False
                continue
            off = to_internal(parameter, parameter.off)
            if result.on_bound(name) is not None and not math.isclose(at, off, abs_tol=1e-12):
                return False
            error = math.sqrt(max(0.0, float(result.covariance[index, index])))
            away.append(abs(at - off) > EXCLUDES_OFF * error and at != off)
        rest = hypothesis.without(effect)
        is_missed = rest in self.search.fits and self.search.score(rest) > self.search.score(hypothesis) + DECISIVE
        return any(away) or is_missed

    # -- competing models ----------------------------------------------------------------------------------------------

    def delta_scores(self, best: Hypothesis) -> dict[Hypothesis, float]:
        """By how much each hypothesis of equal size and a similar score is worse than the best, by one criterion."""
        white, count = self.is_adequate(best), max(1, len(best.effects))
        least = self.criteria.score_as(self.search.fit(best), residual_is_white=white)
        worse = {
            h: self.criteria.score_as(self.search.fit(h), residual_is_white=white) - least
            for h in self.tried()
            if len(h.effects) == count
        }
        return {h: by for h, by in worse.items() if by < 2.0 * DECISIVE}

    def polish_near(self, best: Hypothesis) -> None:
        """Polish the best and whatever may be as good, so that all have the same chance."""
        limit = self.selection_criterion(best) + NEARLY
        near = [h for h in self.tried() if len(h.effects) == len(best.effects) and self.selection_criterion(h) < limit]
        nearest = {best, *sorted(near, key=self.selection_criterion)[:LARGEST_CLASS]}
        run_parallel(self.search.polish, list(nearest))

    def competing_models(self, best: Hypothesis) -> list[Hypothesis]:
        """Hypotheses within a decisive difference of the best, itself included where it has effects; best first."""
        delta_scores = self.delta_scores(best)
        return sorted((h for h, worse in delta_scores.items() if worse < DECISIVE), key=delta_scores.__getitem__)

    def larger_alternatives(self, best: Hypothesis) -> dict[Hypothesis, float]:
        """Look-alikes with more parameters, each in place of a member: by how much their evidence is worse.

        S charges ln N for a parameter, however weakly it is determined. That is right for choosing a name, but no
        reason to exclude stiction where Coulomb friction is named: `Fit.evidence`, eq. (42), compares these.
        """
        if not self.is_adequate(best):
            return {}
        size, mine = len(self.search.free_names(best)), self.search.fit(best).evidence
        alike = [
            best.without(member).adding(name)
            for member in best.effects
            for name in self.plant.effects[member].confused_with
            if name not in best.effects
        ]
        larger = [h for h in alike if h in self.search.fits and len(self.search.free_names(h)) > size]
        # What is on a bound names nothing: stiction whose Stribeck velocity is too small to be seen is Coulomb's.
        more = [h for h in larger if self.is_claimable(h)]
        return {hypothesis: self.search.fit(hypothesis).evidence - mine for hypothesis in more}
