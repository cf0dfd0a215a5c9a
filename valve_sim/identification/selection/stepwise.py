"""Which hypotheses are tried, in which order, and which of them may be claimed.

Singles, then pairs, triples and quadruples while each gains; members are swapped through the catalogue. Where four
leave something, up to two more are added. In the end the best and what is near it are polished alike. Hypotheses are
ordered by training strokes alone: by the score S where the residual is white, else by what they predict of strokes that
are left out. What is claimed is chosen from the table of scores (`table.choose`).
"""

from __future__ import annotations

import functools
import math
from collections.abc import Mapping, Sequence
from typing import Final

from valve_sim.identification.estimation.budget import OutOfTimeError
from valve_sim.identification.estimation.parallel import run_parallel
from valve_sim.identification.estimation.result import MOSTLY, Fit
from valve_sim.identification.plants.protocol import short_step_of
from valve_sim.identification.selection.bootstrap import FalseAlarm, false_alarm, false_alarm_of_few
from valve_sim.identification.selection.criteria import Criteria
from valve_sim.identification.selection.force_maps import NonparametricFit, fit_curves
from valve_sim.identification.selection.hypotheses import NEAR, Search
from valve_sim.identification.selection.score_test import score_gains
from valve_sim.identification.selection.significance import is_away_from_off, is_within_claim
from valve_sim.identification.selection.table import (
    DECISIVE,
    MOST_EFFECTS,
    Hypothesis,
    Score,
    ScoreTable,
    best_claimable,
    best_few,
    choose,
    is_missed,
)

MOST_OF_ANOTHER_FORM: Final = 6
"""In one hypothesis where `MOST_EFFECTS` leave something that no smooth curve explains. What a plant of another form
differs by takes up the names that are allowed, three or four on such plants, before the effect that it was given."""
BEAM: Final = 2
"""How many of the best hypotheses are extended by one more effect."""
HINT: Final = 0.02
"""P-value below which the search goes on: that costs seconds, stopping too early a wrong verdict."""
NEARLY: Final = 40.0
"""Difference of S within which a better start may reverse the order."""
POLISHED: Final = 4
"""How many of the nearest competitors are polished with the best."""
MOST_ROUNDS: Final = 4
"""In which another best may come of polishing, and is polished in turn."""
LEFT: Final = 0.1
"""Share of what is left without errors of the stamps, below which these are believed although something is left.
Measured, commands 50 µs off: 0.1 to 0.6 % on plants of another form."""


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
        self._away: dict[tuple[Fit, str], bool | None] = {}
        self._gains: dict[Fit, dict[str, float]] = {}
        self._pointed_at: tuple[str, ...] = ()
        self._curves: dict[Fit, Sequence[NonparametricFit]] = {}

    def explore(self, *, is_full: bool = False) -> None:
        """Try all that the time allows, beside the declared model; `is_full`: also where that leaves nothing."""
        try:
            self._explore(is_full=is_full)
        except OutOfTimeError:
            self.is_cut_short = True

    def false_alarm(self, best: Hypothesis) -> FalseAlarm:
        """The probability that a search like this one finds as much as the best in noise alone."""
        base, found = self.search.fit(best.base), self.search.fit(best)
        if self._pointed_at and set(best.effects) <= set(self._pointed_at):
            return false_alarm_of_few(base, found, len(self._pointed_at))
        return false_alarm(base, found)

    def settle(self) -> None:
        """Give the best and its competitors the same chance, until that brings up no other best.

        Raises:
            OutOfTimeError: the time is used up.
        """
        settled: Hypothesis | None = None
        for _ in range(MOST_ROUNDS):
            best = choose(self.table())
            if best == settled:
                return
            settled = best
            self.search.fit(best.base)
            for rest in (best.without(member) for member in best.effects):
                self.search.refit(rest, self.search.fit(best).values)
            if choose(self.table()) == best and best.effects:
                self.polish_near(best)

    @property
    def untried(self) -> list[str]:
        """What was left to try."""
        return [*self.search.untried, "sets of more effects"] if self.is_cut_short else list(self.search.untried)

    def singles_untried(self) -> bool:
        """Whether not even every single effect was tried, although there was a reason to."""
        return not self.screened and any(not self.search.is_tried(Hypothesis((name,))) for name in self.plant.effects)

    def _explore(self, *, is_full: bool) -> None:
        """Singles, then pairs and triples while something is left."""
        search, names, declared = self.search, list(self.plant.effects), Hypothesis(())
        if not is_full and (self._leaves_nothing(declared) or self._stamps_explain_all(declared)):
            return
        self._fit_singles()
        if self._pointed_at:
            self._drop_idle()
            return
        if self.needs_larger_model(self._best_without_stamps()):
            self._explore_timing(names)
        for count in range(2, MOST_EFFECTS + 1):
            best = self.best_claimable()
            # Stamps that err take up what friction delays, so two effects must have been tried beside them.
            hides_another = best.timing and len(best.effects) == 1 and count == 2
            if not self.needs_larger_model(best) and not hides_another:
                break
            if count > 2 and best.timing:
                break
            if best.effects:
                search.polish(best)
            if not self._extend(count, names) or (count > 2 and self._is_far_from_curve()):
                break
        if self.needs_larger_model(self.best_claimable()):
            self._extend_timing(names)
            self._extend_further(names)
        self._drop_idle()

    def _fit_singles(self) -> None:
        """Every effect by itself; at little cost where one that the plant points at explains all that there is."""
        search, effects = self.search, self.plant.effects
        pointed_at = [Hypothesis((name,)) for name, effect in effects.items() if effect.start]
        if pointed_at:
            search.fit_pointed_at(pointed_at, (0.0, 0.05))
            explaining = [one for one in pointed_at if one in search.log and self.is_adequate(one)]
            if explaining:
                self._pointed_at = tuple(one.effects[0] for one in pointed_at)
                limit = search.score(search.best(explaining)) + NEARLY
                others = [Hypothesis((name,)) for name, effect in effects.items() if not effect.start]
                search.fit_nearby(others, limit, (0.05, 0.3))
                return
        singles = [Hypothesis((name,)) for name in effects]
        if short_step_of(self.plant) and self._explained_from_declared(singles):
            return
        search.fit_each(singles, (0.0, 0.3))

    def _explained_from_declared(self, singles: Sequence[Hypothesis]) -> bool:
        """Whether an effect explains all that there is from where all else is as declared; it judges the others then.

        With gas the declared model may be far from the data however it is refitted, and a fit of an effect from there
        takes hundreds of runs and ends nowhere.
        """
        search = self.search
        begun = search.begin_from_declared(singles, (0.0, 0.05))
        if begun and not any(map(self.is_adequate, begun)):
            search.leave_strokes_out(search.best(begun))
        explaining = [one for one in begun if self.is_adequate(one)]
        if not explaining:
            return False
        best = search.best(explaining)
        search.fit_beside(best, [one for one in singles if one != best], search.score(best) + NEARLY, (0.05, 0.3))
        return True

    def _leaves_nothing(self, base: Hypothesis) -> bool:
        """Whether the declared model is adequate and no effect promises anything: then it costs one fit."""
        if not self._is_adequate_without_doubt(base):
            return False
        gains = dict(self._score_gains(self.search.fit(base)))
        promising = self._promising(gains)
        tried = {name: base.adding(name) for name in promising}
        self.search.fit_each(list(tried.values()), (0.0, 0.1))
        fitted = {name: larger for name, larger in tried.items() if larger in self.search.log}
        gains |= dict.fromkeys(promising, 0.0)  # of what cannot be simulated, and now of the others:
        gains |= {name: self.search.score(base) - self.search.score(larger) for name, larger in fitted.items()}
        gain = any(gains[name] > 0.0 for name in promising)
        # Beside stamps that err, which may have taken up most of an effect, any gain is looked into.
        if not gains or (gain and (base.timing or choose(self.table()) != base)):
            return False
        self.screened = gains
        return True

    def _stamps_explain_all(self, declared: Hypothesis) -> bool:
        """Whether the declared model leaves nothing with errors of the stamps, which are as small as their prior says.

        An effect may delay all strokes so that it passes for stamps that err; then it explains as much as these do.
        """
        stamped = declared._replace(timing=True)
        if not self.plant.timing_errors or self._is_adequate_without_doubt(declared):
            return False
        if self.search.fit(stamped).stamp_variance > 1.0 or not self._leaves_nothing(stamped):
            return False
        by_effects = max(self._score_gains(self.search.fit(declared)).values(), default=math.inf)
        if by_effects > MOSTLY * (self.search.score(declared) - self.search.score(stamped)):
            self.screened = {}
            return False
        return True

    def _promising(self, gains: Mapping[str, float]) -> list[str]:
        """What a refit might make decisive, by the score test, which is exact only where the model is linear.

        That of a declared value, or of an effect that is the same thing as one, is all but exact: 3.1 tolerances.
        """
        toleranced = {name for own in self.plant.nuisances for name in (own.name, own.same_as)}
        is_exact = {name for name, effect in self.plant.effects.items() if toleranced & set(effect.free_names())}
        return [name for name, gain in gains.items() if gain > (0.5 * DECISIVE if name in is_exact else 0.0)]

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
        best = sorted((h for h in self.tried() if not h.timing and self.is_claimable(h)), key=search.score)[:BEAM]
        timed = [Hypothesis((), True), *(hypothesis._replace(timing=True) for hypothesis in best)]
        search.fit(timed[0])
        search.fit_each(timed[1:], (0.3, 0.3))
        timed = [hypothesis for hypothesis in timed if hypothesis in search.log]
        explain_more = search.score(search.best(timed)) < search.score(best[0]) - DECISIVE
        if explain_more or any(self.is_adequate(hypothesis) for hypothesis in timed):
            search.fit_each([Hypothesis((name,), timing=True) for name in names], (0.3, 0.5))

    def _extend_timing(self, names: Sequence[str]) -> None:
        """Larger sets with errors of the stamps, where these explain more than a second effect does."""
        search = self.search
        for count in range(2, MOST_EFFECTS + 1):
            if self._is_at_hand_with_stamps(count):
                continue
            sized = [h for h in self.tried() if h.timing and len(h.effects) == count - 1]
            smaller = [h for h in sized if self._has_effects_on(h)]
            if not smaller:
                return
            start = search.best(smaller)
            larger = [start.adding(name) for name in names if name not in start.effects]
            before = search.score(start)
            if not larger or before > search.score(self.best_claimable()):
                return
            done = 0.8 + 0.03 * (count - 2)
            search.fit_each(larger, (done, done + 0.03))
            best = search.best([h for h in self.tried() if h.timing and len(h.effects) == count])
            best = self._swap(best, names, done + 0.03)
            if search.score(search.best(self.tried())) >= before - DECISIVE or not self.needs_larger_model(best):
                return

    def _is_at_hand_with_stamps(self, count: int) -> bool:
        """Whether a set of so many effects is the best already, beside stamps that must err, and no curve does better.

        Such a set is tried where it is the best without them. Where stamps explain no more than a further effect might,
        going on from there would name three in place of a force that has no name.
        """
        best = self.best_claimable()
        if not best.timing or len(best.effects) < count:
            return False
        return self._stamps_explain_most(best) and not self._is_far_from_curve()

    def _extend_further(self, names: Sequence[str]) -> None:
        """Further effects beside the most that are usual, one at a time, while each is decisive (`is_missed`)."""
        for count in range(MOST_EFFECTS, MOST_OF_ANOTHER_FORM):
            best = self.best_claimable()
            if len(best.effects) != count or not self.needs_larger_model(best) or self._is_far_from_curve():
                return
            larger = [best.adding(name) for name in names if name not in best.effects]
            self.search.fit_each(larger, (0.92, 0.95))
            table = self.table()
            found = best_claimable(table)
            if len(found.effects) == count or not is_missed(table, best, found):
                return

    def curves(self, base: Fit) -> Sequence[NonparametricFit]:
        """Smooth curves beside a fit, as far as the search has asked for them."""
        return self._curves.get(base, ())

    def _is_far_from_curve(self) -> bool:
        """Whether a smooth curve leaves nothing in place of effects that do not come near it: one more will not either.

        Asked after three have been tried: two right ones are often found by a swap alone, or beside stamps that err.
        """
        best = self.best_claimable()
        base = self.search.fit(best.base)
        if base not in self._curves:
            self._curves[base] = fit_curves(self.search, base)
        white = [entry.fit.score for entry in self._curves[base] if self.criteria.is_white(entry.fit)]
        return self.search.score(best) > min(white, default=math.inf) + NEAR

    def _extend(self, count: int, names: Sequence[str]) -> bool:
        """Add one more effect to the best few, swap members; whether that was decisive."""
        search = self.search
        smaller = [one for one in self.tried() if len(one.effects) == count - 1 and not one.timing]
        smaller = best_few(smaller, BEAM, search.score, self.selection_criterion)
        before = self.selection_criterion(self.best_claimable())
        larger = [start.adding(name) for start in smaller for name in names if name not in start.effects]
        done = 0.5 + 0.1 * (count - 2)
        search.fit_each(larger, (done, done + 0.1))
        best = self.best_claimable()
        if len(best.effects) == count:
            best = self._swap(best, names, done + 0.1)
            if not self.is_adequate(best):
                search.fit(best, anneal=True)
                timed = best._replace(timing=True)
                if self.plant.timing_errors and not best.timing:
                    search.fit(timed)
        return self.selection_criterion(self.best_claimable()) < before - DECISIVE

    def _swap(self, best: Hypothesis, names: Sequence[str], done: float) -> Hypothesis:
        """Swap each member through the catalogue (which corrected most wrong pairs on the campaign)."""
        rests = [best.without(member) for member in best.effects]
        swapped = [rest.adding(name) for rest in rests for name in names if name not in rest.effects]
        self.search.fit_each(rests, (done, done))
        self.search.fit_each(swapped, (done, done), best)
        return self.best_claimable()

    # -- what a hypothesis is worth ------------------------------------------------------------------------------------

    def best_claimable(self) -> Hypothesis:
        """The hypothesis of the best criterion of those whose effects are away from off and from bounds."""
        return best_claimable(self.table())

    def _best_without_stamps(self) -> Hypothesis:
        """The same of those without errors of the stamps."""
        scores = self.table().scores
        return best_claimable(ScoreTable({one: score for one, score in scores.items() if not one.timing}))

    def table(self) -> ScoreTable:
        """The scores of all that was tried so far, but for what another name stands for."""
        fits = [hypothesis for hypothesis in self.search.log.best if self._bears_its_name(hypothesis)]
        scores = run_parallel(self._score, list(fits))
        alike = {name: effect.confused_with for name, effect in self.plant.effects.items()}
        return ScoreTable(dict(zip(fits, scores, strict=True)), alike, dict(self.screened))

    def _score(self, hypothesis: Hypothesis) -> Score:
        result = self.search.log[hypothesis]
        return Score(
            hypothesis, result.score, self.criteria.evidence(result), len(result.free), self.criteria.is_white(result),
            self.is_claimable(hypothesis), result.problem.variance_inflation, result.chi2, result.chi2_of_declared,
            functools.partial(self.criteria.cross_validation, result), result.chi2_of_recordings, result.stamp_variance,
        )  # fmt: skip

    def _bears_its_name(self, hypothesis: Hypothesis) -> bool:
        """Whether all lies where its names may be claimed: a coil slower than declared is a coil lag, and only that."""
        result = self.search.log[hypothesis]
        return all(is_within_claim(result, self.plant.effects[name]) for name in hypothesis.effects)

    def selection_criterion(self, hypothesis: Hypothesis) -> float:
        """The selection criterion of a hypothesis: theory, eq. (45)."""
        return self.criteria.score(self.search.fit(hypothesis))

    def tried(self) -> list[Hypothesis]:
        """Every hypothesis that was fitted, in order."""
        return list(self.search.log.best)

    def is_adequate(self, hypothesis: Hypothesis) -> bool:
        """Whether its residual is white."""
        return self.criteria.is_white(self.search.fit(hypothesis))

    def needs_larger_model(self, hypothesis: Hypothesis) -> bool:
        """Whether anything hints that something is missing: the residual, or the score test of an effect."""
        if not self._is_adequate_without_doubt(hypothesis):
            return True
        gains = self._score_gains(self.search.fit(hypothesis)) if hypothesis.effects else {}
        return max(gains.values(), default=0.0) > DECISIVE

    def _score_gains(self, result: Fit) -> dict[str, float]:
        """As of `score_gains`, worked out once."""
        if result not in self._gains:
            self._gains[result] = score_gains(result)
        return self._gains[result]

    def _is_adequate_without_doubt(self, hypothesis: Hypothesis) -> bool:
        return self.criteria.adequacy(self.search.fit(hypothesis)).p_value >= HINT

    def is_claimable(self, hypothesis: Hypothesis) -> bool:
        """Whether no parameter is on its bound and every effect is significantly on.

        Errors of the stamps can fit any mismatch. They are accepted only where the residual is white, or where they
        explain nearly all that is left without them.
        """
        if not self._has_effects_on(hypothesis):
            return False
        return not hypothesis.timing or self.is_adequate(hypothesis) or self._stamps_explain_most(hypothesis)

    def _stamps_explain_most(self, hypothesis: Hypothesis) -> bool:
        """Whether stamps that err leave a small share of what every set leaves without them, which is more than noise.

        A model of another form leaves less than that, and stamps would take up what is named after it.
        """
        without = min(self._excess(other) for other in self.tried() if not other.timing)
        return without > 1.0 and self._excess(hypothesis) < LEFT * without

    def _excess(self, hypothesis: Hypothesis) -> float:
        """By how much χ² exceeds what noise alone leaves, over that."""
        result = self.search.fit(hypothesis)
        return result.chi2 / result.problem.variance_inflation / result.problem.effective_samples - 1.0

    def _has_effects_on(self, hypothesis: Hypothesis) -> bool:
        return all(self._is_on(hypothesis, name) for name in hypothesis.effects)

    def _is_on(self, hypothesis: Hypothesis, effect: str) -> bool:
        """Whether an effect is significantly on, or decisive although its parameters are collinear."""
        result = self.search.fit(hypothesis)
        key = (result, effect)
        if key not in self._away:
            self._away[key] = is_away_from_off(result, self.plant.effects[effect])
        is_away = self._away[key]
        if is_away is not None and not is_away:
            rest = hypothesis.without(effect)
            return rest in self.search.log and self.search.score(rest) > self.search.score(hypothesis) + DECISIVE
        return bool(is_away)

    def polish_near(self, best: Hypothesis) -> None:
        """Polish the best and whatever may be as good, so that all have the same chance.

        An effect that the plant points at and that explains all has no need of one where nothing else is near.
        """
        limit = self.selection_criterion(best) + NEARLY
        alike = [one for one in self.tried() if len(one.effects) == len(best.effects)]
        near = best_few(alike, POLISHED, self.search.score, self.selection_criterion)
        nearest = {best, *(one for one in near if self.selection_criterion(one) < limit)}
        if self._pointed_at and nearest == {best}:
            return
        run_parallel(self.search.polish, list(nearest))
