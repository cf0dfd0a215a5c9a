"""From the explored hypotheses to a diagnosis, within the budget.

The search is settled, its log of fits is closed, and everything that follows is drawn from the table of scores: the
choice, by training strokes alone; the judgement, for which held-out strokes are opened; the verdict. One rule
precedes all others: what is claimed or written never has a larger error than the refitted declared model, neither
on fitted nor on held-out data, where copies of one reading of a coarse sensor count once. Where it would, or where the
time is too short to tell, the declared model stands.
"""

from __future__ import annotations

import functools
import math
from collections.abc import Callable, Mapping
from typing import Final, NamedTuple, TypeVar

from valve_sim.identification.diagnosis.decision import (
    LARGEST_CLASS,
    Choice,
    Claim,
    choice_of,
    claim_after_holdout,
    competitors,
    decide,
    is_claimable,
    look_alikes,
    share_of_evidence,
    weight_of,
)
from valve_sim.identification.diagnosis.experiment_design import Recommendation, recommend
from valve_sim.identification.diagnosis.outcome import Candidate, Diagnosis, Grounds, Rival, State, Verdict
from valve_sim.identification.estimation.budget import OutOfTimeError
from valve_sim.identification.estimation.followed_positions import follows_positions
from valve_sim.identification.estimation.intervals import Interval, covariance_interval, profile_interval
from valve_sim.identification.estimation.result import Fit, effective_rmse, is_relief, rmse
from valve_sim.identification.plants.effect_titles import named_value
from valve_sim.identification.plants.protocol import strokes_of_plant
from valve_sim.identification.selection.bootstrap import NOT_ASKED, FalseAlarm
from valve_sim.identification.selection.detection_limits import Limits, detection_limits
from valve_sim.identification.selection.force_maps import (
    NonparametricFit,
    Unexplained,
    describe,
    explains_all,
    fit_local_forces,
    fit_maps,
    on_top,
    where,
)
from valve_sim.identification.selection.held_out import ALIKE, SAME, HeldOut
from valve_sim.identification.selection.residual_tests import adequacy
from valve_sim.identification.selection.stepwise import Exploration
from valve_sim.identification.selection.table import DECISIVE, Hypothesis, ScoreTable, choose

COMPARED_BY, CLAIMED_BY, MAPPED_BY, CONCLUDED_BY, SHOWN_BY = 0.75, 0.87, 0.88, 0.96, 0.98
"""Shares of the budget by the end of which models are compared, the claim is checked, force maps are fitted, the
verdict is drawn, and the unexplained force is computed."""
COMPARED_MAPS: Final = 3
"""Number of force maps, by score, that are compared by cross-validation over strokes: a curve over time fits anything
in its own strokes and predicts no other."""
LISTED: Final = 30
"""Most candidates in the report."""

Result = TypeVar("Result")


class _Curves(NamedTuple):
    """Nonparametric forces on the declared model, and at one place in place of an effect; best score first.

    Not whole are those on the declared model where effects explain all: only what comes near these is there.
    """

    maps: list[NonparametricFit]
    local: list[NonparametricFit]
    is_whole: bool

    @property
    def all(self) -> list[NonparametricFit]:
        return sorted([*self.maps, *self.local], key=lambda entry: entry.fit.score)

    @property
    def scores(self) -> list[float]:
        return [entry.fit.score for entry in self.all]


class Named(NamedTuple):
    """A verdict, and the intervals of what it frees, by name."""

    verdict: Verdict
    intervals: Mapping[str, Interval]


class Conclusion:
    """Draws the conclusion from what was explored.

    Args:
        exploration: what was tried. held_out: what judges the claim.
    """

    def __init__(self, exploration: Exploration, held_out: HeldOut) -> None:
        self.exploration, self.search, self.held_out = exploration, exploration.search, held_out
        self.plant, self.budget = exploration.plant, exploration.search.problem.budget
        self.strokes = len(strokes_of_plant(self.plant))
        self.untried: list[str] = []

    def name(self) -> Named:
        """Choose, judge and decide: what a diagnosis names, and nothing of what a report has beside."""
        table, _, curves, claim = self.chosen()
        self.search.say("intervals", 0.99)
        result = self.fit(claim.best)
        interval = covariance_interval if claim.is_unknown else self.interval
        return Named(self.verdict(table, claim, curves), {name: interval(result, name) for name in result.free})

    def chosen(self) -> tuple[ScoreTable, FalseAlarm, _Curves, Claim]:
        """The table of scores, and what is claimed of it."""
        table = self.closed_table()
        best, alarm = self.claimed(table)
        curves = self.curves(table, best)
        return table, alarm, curves, self.judged(table, choice_of(table, best, curves.scores))

    def conclude(self) -> Diagnosis:
        """Choose, judge, decide, and describe the result."""
        table, alarm, curves, claim = self.chosen()
        after_fit, unexplained = self.corrected(claim, curves)
        self.search.say("intervals", 0.99)
        timing, base_fit = self.needs_timing(self.fit(claim.best)), self.fit(claim.best.base)
        before = self.state(base_fit, profile=False, timing=timing)
        is_declared = after_fit is base_fit
        after = before if is_declared else self.state(after_fit, profile=not claim.is_unknown, timing=timing)
        verdict = self.verdict(table, claim, curves)
        find = functools.partial(self.recommended_experiment, table, claim)
        recommendation = self.in_time(CONCLUDED_BY, "what to record next", find, None) if verdict.is_open else None
        candidates = self.candidates(table, claim.best.base, timing=timing)
        limits = self.limits(base_fit) if verdict.kind == "none" else {}
        fitted = {str(hypothesis) for hypothesis in table.scores}
        left = dict.fromkeys([*self.exploration.untried, *self.untried])
        untried = tuple(what for what in left if what not in fitted)
        return Diagnosis(
            self.plant, before, after, verdict, candidates, unexplained,
            tuple(describe(entry.choice, entry.fit, base_fit) for entry in curves.maps), alarm,
            tuple(channel.name for channel in self.plant.channels), recommendation, untried, self.held_out.looks,
            limits, self.rivals(table, claim, after_fit, timing=timing),
        )  # fmt: skip

    def fit(self, hypothesis: Hypothesis) -> Fit:
        """The best row of a hypothesis."""
        return self.search.log[hypothesis]

    # -- the choice, by training strokes alone -------------------------------------------------------------------------

    def closed_table(self) -> ScoreTable:
        """The scores of all that was tried, which no further fit changes."""
        competing = "models that compete with the best"
        self.in_time(COMPARED_BY, "" if self.exploration.screened else competing, self.exploration.settle, None)
        self.search.log.close()
        return self.exploration.table()

    def claimed(self, table: ScoreTable) -> tuple[Hypothesis, FalseAlarm]:
        """What training strokes support, if it is no false alarm; else the declared model."""
        best = choose(table)
        self.search.say("what the same search finds in noise alone", 0.88)
        what = f"whether {best} holds" if best.effects else ""
        # The rest of the time for claims is enough, even where the comparison used up its share.
        return self.in_time(CLAIMED_BY, what, lambda: self.kept(table, best), (best.base, NOT_ASKED))

    def kept(self, table: ScoreTable, best: Hypothesis) -> tuple[Hypothesis, FalseAlarm]:
        """The best, if training strokes support it."""
        base_fit, best_fit = self.fit(best.base), self.fit(best)
        alarm = self.exploration.false_alarm(best)
        # What tolerances find incredible is no work of noise: their own false alarms are priced by eq. (82).
        by_noise = 0.0 if is_relief(base_fit, best_fit) else alarm.probability
        is_kept = is_claimable(table, best, by_noise, is_larger=is_larger(best_fit, base_fit))
        return (best if is_kept else best.base), alarm

    def curves(self, table: ScoreTable, best: Hypothesis) -> _Curves:
        """Nonparametric forces on the base, where it does not explain all, and in place of members of the best."""
        with self.budget.until(MAPPED_BY):
            base, chosen = self.fit(best.base), self.fit(best)
            explaining = chosen if explains_all(base, chosen) else None
            known = self.exploration.curves(base)
            maps = [] if table[best.base].is_white else fit_maps(self.search, base, known, explaining)
            has_rests = all(best.without(member) in table for member in best.effects)
            nothing: list[NonparametricFit] = []
            if not (table[best].is_white and has_rests and self.strokes > 1):
                return _Curves(maps, nothing, explaining is None)
            find = functools.partial(fit_local_forces, self.search, best)
            return _Curves(maps, self.in_time(MAPPED_BY, "forces at one place", find, nothing), explaining is None)

    # -- the judgement -------------------------------------------------------------------------------------------------

    def judged(self, table: ScoreTable, choice: Choice) -> Claim:
        """The claim after held-out data are opened."""
        best = choice.best
        fits = [self.fit(hypothesis) for hypothesis in (best, *choice.competing)]
        judge = functools.partial(self.held_out.open, self.fit(best.base), *fits)
        judgements = self.in_time(CONCLUDED_BY, f"whether {best} holds" if best.effects else "", judge, None)
        return claim_after_holdout(table, choice, judgements, self.strokes)

    def corrected(self, claim: Claim, curves: _Curves) -> tuple[Fit, Unexplained | None]:
        """The corrected model, and what it leaves unexplained.

        Where the verdict names effects, it has these and nothing else. Else it may hold a force map, which then is the
        curve that is described.
        """
        best_fit, base_fit = self.fit(claim.best), self.fit(claim.best.base)
        if not claim.is_unknown:
            return best_fit, None
        if claim.names_most:
            return best_fit, self.beside(best_fit, base_fit, curves)
        with self.budget.until(CONCLUDED_BY):
            fitted = curves.maps if best_fit is base_fit and curves.is_whole else []
            left = fitted or fit_maps(self.search, best_fit)
        options = [*curves.all[:COMPARED_MAPS], *left[:COMPARED_MAPS]]
        criteria = self.exploration.criteria
        chosen = min(options, key=lambda entry: criteria.score(entry.fit), default=None)
        if chosen is not None and self.is_sound(chosen.fit, best_fit, base_fit):
            return chosen.fit, describe(chosen.choice, chosen.fit, base_fit)
        if not left:
            return best_fit, None
        shown = self.in_time(SHOWN_BY, "", lambda: on_top(left[0].choice, best_fit), left[0].fit)
        return best_fit, describe(left[0].choice, shown, best_fit)

    def beside(self, best: Fit, base: Fit, curves: _Curves) -> Unexplained | None:
        """The remainder beside named effects, as a force over the variable that explains most of it."""
        choices = [entry.choice for entry in curves.maps] or list(self.plant.force_maps)
        if not choices:
            return None
        shown = self.in_time(SHOWN_BY, "", lambda: on_top(choices[0], best), None)
        return None if shown is None else describe(choices[0], shown, base)

    def is_sound(self, result: Fit, best: Fit, base: Fit) -> bool:
        """Whether a force map explains more than the best, and held-out data do not contradict it."""
        criteria = self.exploration.criteria
        if criteria.score(result) >= criteria.score(best) or is_larger(result, base):
            return False
        opened = self.in_time(CONCLUDED_BY, "", lambda: self.held_out.open(base, result), None)
        return opened is not None and not opened[1].is_larger

    def needs_timing(self, result: Fit) -> bool:
        """Whether held-out errors are with errors of the stamps estimated, as far as there is time to find out."""
        needs = functools.partial(self.held_out.needs_timing, result)
        return self.in_time(CONCLUDED_BY, "", needs, self.held_out.is_in_doubt(result))

    # -- the verdict ---------------------------------------------------------------------------------------------------

    def verdict(self, table: ScoreTable, claim: Claim, curves: _Curves) -> Verdict:
        """What is claimed, and on what grounds."""
        # A smooth curve can be the constant or linear force that a name stands for: it competes by doing better alone.
        places = sorted(curves.local, key=lambda entry: entry.fit.score)
        limit = table[claim.best].score + DECISIVE
        grounds = Grounds(
            claim.best.effects, claim.is_unknown, self.share(claim.best),
            tuple(where(entry.choice, entry.fit) for entry in places if entry.fit.score < limit), self.strokes,
            self.exploration.singles_untried(),
        )  # fmt: skip
        alike = look_alikes(table, claim)
        evidence = share_of_evidence(table, claim, [entry.fit.score for entry in places])
        decision = decide(claim, alike, evidence, self.strokes, singles_untried=grounds.singles_untried)
        return Verdict(decision.kind, decision.effects, alike, evidence, decision.probability, grounds)

    def share(self, best: Hypothesis) -> float:
        """How much of the squared residual of the base a hypothesis explains, from 0 to 1."""
        before = rmse(self.fit(best.base))
        return 1.0 - (rmse(self.fit(best)) / before) ** 2 if before > 0.0 else 0.0

    def recommended_experiment(self, table: ScoreTable, claim: Claim) -> Recommendation | None:
        """The recording that separates the competing models best."""
        few = competitors(table, claim)[:LARGEST_CLASS]
        candidates = {" + ".join(hypothesis.effects): self.fit(hypothesis) for hypothesis in few}
        return recommend(candidates, self.plant.experiments) if len(candidates) > 1 else None

    # -- tables, when all is decided -----------------------------------------------------------------------------------

    def candidates(self, table: ScoreTable, base: Hypothesis, *, timing: bool) -> tuple[Candidate, ...]:
        """Everything tried, best first, at most thirty; fewer where the time is used up."""
        found: list[Candidate] = []
        tried = sorted((one for one in table.scores.values() if one.hypothesis.effects), key=lambda one: one.score)
        for one in tried[:LISTED]:
            result = self.fit(one.hypothesis)
            held = self.in_time(CONCLUDED_BY, "", functools.partial(self.held_out.fit, result, timing=timing), None)
            if held is None and self.budget.spent > CONCLUDED_BY * self.budget.seconds:
                break
            found.append(
                Candidate(
                    one.hypothesis.effects, one.hypothesis.timing, one.score - table[base].score, rmse(result),
                    math.nan if held is None else rmse(held),
                    {name: covariance_interval(result, name) for name in result.free},
                )
            )  # fmt: skip
        return tuple(found)

    def state(self, result: Fit, *, profile: bool, timing: bool) -> State:
        """A fit with its errors, test and intervals."""
        held = self.in_time(CONCLUDED_BY, "", functools.partial(self.held_out.fit, result, timing=timing), None)
        intervals = {
            name: self.interval(result, name)
            if profile and ("." in name or result.is_collinear(name))
            else covariance_interval(result, name)
            for name in result.free
        }
        return State(result, held, rmse(result), math.nan if held is None else rmse(held), adequacy(result), intervals)

    def rivals(self, table: ScoreTable, claim: Claim, after_fit: Fit, *, timing: bool) -> tuple[Rival, ...]:
        """What competes with the corrected model, where positions follow from a fit."""
        if not follows_positions(self.plant) or after_fit is not self.fit(claim.best):
            return ()
        found = []
        for other in competitors(table, claim)[:LARGEST_CLASS]:
            if other != claim.best:
                weight = weight_of(table[other].score - table[claim.best].score)
                work = functools.partial(self.held_out.fit, self.fit(other), timing=timing)
                found.append(Rival(self.fit(other), self.in_time(CONCLUDED_BY, "", work, None), weight))
        return tuple(found)

    def interval(self, result: Fit, name: str) -> Interval:
        """By profile likelihood; from the covariance where the time is used up."""
        what = f"the interval of {named_value(self.plant, name)[0]} by profile likelihood"
        work = functools.partial(profile_interval, result, name)
        found = self.in_time(CONCLUDED_BY, what, work, None)
        return covariance_interval(result, name) if found is None else found[0]

    def limits(self, base: Fit) -> Limits:
        """How large each effect would have to be to show."""
        nothing: Limits = {}
        return self.in_time(SHOWN_BY, "", functools.partial(detection_limits, base), nothing)

    def in_time(self, share: float, what: str, work: Callable[[], Result], otherwise: Result) -> Result:
        """The work's result if it ends before this share of the time is used up; else it is noted as untried."""
        try:
            with self.budget.until(share):
                return work()
        except OutOfTimeError:
            if what:
                self.untried.append(what)
            return otherwise


def is_larger(result: Fit, base: Fit) -> bool:
    """Whether a fit's error on training strokes is larger than the base's, but for rounding; copies count once."""
    slack = ALIKE if is_relief(base, result) else SAME
    return effective_rmse(result) > (1.0 + slack) * effective_rmse(base)
