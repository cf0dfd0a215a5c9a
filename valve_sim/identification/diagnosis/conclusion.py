"""From the explored hypotheses to a diagnosis: the claim, its residual, and the verdict's numbers, within the budget.

One rule precedes all others: what is claimed or written never has a larger error than the refitted declared model,
neither on fitted nor on held-out data. Where it would, or where the time is too short to tell, the declared model
stands.
"""

from __future__ import annotations

import functools
import math
from collections.abc import Callable, Sequence
from typing import Final, NamedTuple, TypeVar

from valve_sim.identification.diagnosis.decision import Findings, advise, decide, with_untried
from valve_sim.identification.diagnosis.experiment_design import Recommendation, recommend
from valve_sim.identification.diagnosis.outcome import Candidate, Diagnosis, State
from valve_sim.identification.estimation.budget import OutOfTimeError
from valve_sim.identification.estimation.intervals import Interval, covariance_interval, profile_interval
from valve_sim.identification.estimation.result import Fit, rmse
from valve_sim.identification.plants.effect_titles import named_value
from valve_sim.identification.plants.protocol import strokes_of_plant
from valve_sim.identification.selection.bootstrap import NOT_ASKED, FalseAlarm, false_alarm
from valve_sim.identification.selection.force_maps import (
    NonparametricFit,
    Unexplained,
    describe,
    fit_local_forces,
    fit_maps,
    on_top,
)
from valve_sim.identification.selection.hypotheses import DECISIVE, Hypothesis
from valve_sim.identification.selection.residual_tests import adequacy
from valve_sim.identification.selection.stepwise import LARGEST_CLASS, LIKELY, Exploration

WEAK_EVIDENCE: Final = 30.0
"""Scale of eq. (51): a gain of S that is this large lowers a claim's share by the factor 0.63; at five detection limits
the gain is some hundreds."""
HALVED: Final = 0.5
"""Held-out error with named effects over that without, below which they are named beside an unexplained remainder."""
MOST_FALSE_ALARMS: Final = 0.01
"""Probability that the search finds as much in noise alone, beyond which nothing is claimed."""
SAME: Final = 1e-9
"""Relative difference up to which two errors are equal but for rounding."""
COMPARED_BY, CLAIMED_BY, MAPPED_BY, WORDED_BY = 0.75, 0.87, 0.92, 0.96
"""Shares of the time by which models are compared, the claim is checked, force maps are fitted, and all is written."""
LISTED: Final = 30
"""Candidates in the report, the best."""

Result = TypeVar("Result")


class Conclusion:
    """Draws the conclusion from what was explored.

    Args:
        exploration: what was tried.
    """

    def __init__(self, exploration: Exploration) -> None:
        self.exploration, self.search, self.held_out = exploration, exploration.search, exploration.held_out
        self.plant, self.budget = exploration.plant, exploration.search.problem.budget
        self.strokes = len(strokes_of_plant(self.plant))
        self.untried: list[str] = []
        self._reported_timing = False
        self._telling: Recommendation | None = None

    def conclude(self, explored: Hypothesis) -> Diagnosis:
        """Check the best hypothesis, and describe what it comes to."""
        best, alarm = self.claimed(explored)
        base = Hypothesis((), best.timing)
        base_fit, best_fit = self.search.fit(base), self.search.fit(best)
        nonparametric = self.nonparametric_forces(best, base_fit)
        map_wins = bool(nonparametric.best) and nonparametric.best[0].fit.score < best_fit.score - DECISIVE
        is_unknown = map_wins or not self.exploration.is_adequate(best) or self.is_refuted(best)
        names_most = is_unknown and not map_wins and self.halves_held_out_error(base_fit, best_fit)
        after_fit, unexplained = best_fit, None
        if is_unknown:
            after_fit, unexplained = self.remainder(best_fit, base_fit, nonparametric, names_effects=names_most)
        self.search.say("intervals", 0.99)
        before = self.state(base_fit, profile=False)
        after = before if after_fit is base_fit else self.state(after_fit, profile=not is_unknown)
        competing_models = self.nonparametric_competitors(best, nonparametric.best)
        findings = Findings(
            self.plant, best, self.strokes, is_unknown, names_most, self.confusable(best, is_unknown),
            self.evidence(best, [worse for _, worse in competing_models]), self.share(best),
            [entry for entry, worse in competing_models if worse < DECISIVE], functools.partial(self.advice, best),
            self.exploration.singles_untried(),
        )  # fmt: skip
        verdict, record_next = decide(findings)
        candidates = tuple(self.candidates(base))
        untried = tuple(dict.fromkeys([*self.exploration.untried, *self.untried]))
        return Diagnosis(
            self.plant, before, after, with_untried(verdict, untried), candidates, unexplained,
            tuple(describe(entry.choice, entry.fit, base_fit) for entry in nonparametric.maps), record_next, alarm,
            tuple(channel.name for channel in self.plant.channels), self._telling, untried,
        )  # fmt: skip

    # -- the claim -----------------------------------------------------------------------------------------------------

    def claimed(self, explored: Hypothesis) -> tuple[Hypothesis, FalseAlarm]:
        """The best hypothesis after competing models, held-out data and the bootstrap; the base where it fails one."""
        if self.exploration.is_cut_short:
            explored = self.in_time(COMPARED_BY, "", self.exploration.best_claimable, Hypothesis(()))
        competing_models = f"models that compete with {explored}" if explored.effects else ""
        best = self.in_time(COMPARED_BY, competing_models, lambda: self.compared(explored), explored)
        base = Hypothesis((), best.timing)
        if base not in self.search.fits:
            base = self.in_time(COMPARED_BY, "", lambda: self.tried(base), Hypothesis(()))
            best = best if base.timing == best.timing else base
        self.search.say("what the same search finds in noise alone", 0.88)
        nothing = (base, NOT_ASKED)
        # The rest of the time for claims is enough, even where the comparison used up its share.
        return self.in_time(
            CLAIMED_BY, f"whether {best} holds" if best.effects else "", lambda: self.kept(best), nothing
        )

    def tried(self, hypothesis: Hypothesis) -> Hypothesis:
        """The hypothesis, fitted."""
        self.search.fit(hypothesis)
        return hypothesis

    def compared(self, best: Hypothesis) -> Hypothesis:
        """The best after backward elimination, and after its competitors had the same chance."""
        exploration = self.exploration
        if not exploration.is_adequate(best):
            best = exploration.eliminate(exploration.best_on_hold_out(best))
        if best.effects:
            exploration.polish_near(best)
            best = next(filter(exploration.is_claimable, exploration.competing_models(best)), best)
        return best

    def kept(self, best: Hypothesis) -> tuple[Hypothesis, FalseAlarm]:
        """The best if it predicts better, has no larger error than the base and is no false alarm; else the base."""
        base = Hypothesis((), best.timing)
        base_fit, best_fit = self.search.fit(base), self.search.fit(best)
        timing = self.held_out.needs_timing(best_fit)
        is_better = self.held_out.improves_holdout(base_fit, best_fit) and not self.is_worse(
            best_fit, base_fit, timing=timing
        )
        if best.effects and not is_better:
            best, best_fit = base, base_fit
        alarm = false_alarm(base_fit, best_fit)
        if best.effects and self.exploration.is_adequate(best) and alarm.probability > MOST_FALSE_ALARMS:
            best = base
        self._reported_timing = self.held_out.needs_timing(self.search.fit(best))
        return best, alarm

    def is_worse(self, result: Fit, base: Fit, *, timing: bool) -> bool:
        """Whether a fit has a larger error than the base, on its own or on held-out data, stamps treated alike."""
        if rmse(result) > (1.0 + SAME) * rmse(base):
            return True
        if self.held_out.problem is None:
            return False
        here, there = (self.held_out.fit(fitted, timing=timing) for fitted in (result, base))
        return here is None or (there is not None and rmse(here) > (1.0 + SAME) * rmse(there))

    def is_refuted(self, hypothesis: Hypothesis) -> bool:
        """Whether its residual on held-out data is not white; dampings of a single stroke are too uncertain to tell."""
        is_founded = bool(hypothesis.effects) or self.strokes > 1
        return is_founded and self.in_time(
            WORDED_BY, "", lambda: self.exploration.fails_hold_out(hypothesis), otherwise=False
        )

    def halves_held_out_error(self, base: Fit, best: Fit) -> bool:
        """Whether named effects more than halve the held-out error, so that they are claimed beside a remainder."""
        return best is not base and self.in_time(
            WORDED_BY, "", lambda: self.held_out.error(best) < HALVED * self.held_out.error(base), otherwise=False
        )

    # -- what has no name ----------------------------------------------------------------------------------------------

    def nonparametric_forces(self, best: Hypothesis, base_fit: Fit) -> _NonparametricForces:
        """Nonparametric forces on the base, where it does not explain all, and in place of members of the best."""
        base = Hypothesis((), best.timing)
        is_explained = self.exploration.is_adequate(base) and not self.is_refuted(base)
        with self.budget.until(MAPPED_BY):
            maps = [] if is_explained else fit_maps(self.search, base_fit)
            can_tell = self.exploration.is_adequate(best) and self.strokes > 1
            nothing: list[NonparametricFit] = []
            find = functools.partial(fit_local_forces, self.search, best)
            local = self.in_time(MAPPED_BY, "forces at one place", find, nothing) if can_tell else nothing
        return _NonparametricForces(maps, local, sorted([*maps, *local], key=lambda entry: entry.fit.score))

    def remainder(
        self, best_fit: Fit, base_fit: Fit, nonparametric: _NonparametricForces, *, names_effects: bool
    ) -> tuple[Fit, Unexplained | None]:
        """The corrected model where something is unexplained, and that remainder.

        Where the verdict names effects, the corrected model has these and nothing else. Else it may hold a force map,
        which then is the curve that is described.
        """
        with self.budget.until(MAPPED_BY):
            left = nonparametric.maps if best_fit is base_fit else fit_maps(self.search, best_fit)
        options = [] if names_effects else [*nonparametric.best[:1], *left[:1]]
        find = functools.partial(self.better_map, options, best_fit, base_fit)
        better = self.in_time(WORDED_BY, "", find, None)
        if better is not None:
            return better.fit, describe(better.choice, better.fit, base_fit)
        if not left:
            return best_fit, None
        shown = self.in_time(WORDED_BY, "", lambda: on_top(left[0].choice, best_fit), left[0].fit)
        return best_fit, describe(left[0].choice, shown, best_fit)

    def better_map(self, options: Sequence[NonparametricFit], best: Fit, base: Fit) -> NonparametricFit | None:
        """The map of the least held-out error, if that is less than the best's and none is larger than the base's."""
        sound = [entry for entry in options if not self.is_worse(entry.fit, base, timing=self._reported_timing)]
        chosen = min(sound, key=lambda entry: self.held_out.error(entry.fit), default=None)
        if chosen is None or self.held_out.error(chosen.fit) >= self.held_out.error(best):
            return None
        return chosen

    def nonparametric_competitors(
        self, best: Hypothesis, nonparametric: Sequence[NonparametricFit]
    ) -> list[tuple[NonparametricFit, float]]:
        """Nonparametric forces with a score near the best, and by how much they are worse.

        Held-out data take no part: a nonparametric force need not predict better to make a name uncertain.
        """
        least = self.search.score(best)
        return [(entry, entry.fit.score - least) for entry in nonparametric if entry.fit.score < least + 2.0 * DECISIVE]

    # -- numbers of the verdict ----------------------------------------------------------------------------------------

    def confusable(self, best: Hypothesis, is_unknown: bool) -> dict[str, tuple[str, ...]]:
        """Of each named effect, what else it could be."""
        found: dict[str, tuple[str, ...]] = {}
        for name in best.effects:
            known = tuple(self.plant.effects[name].confused_with)
            others = self.in_time(WORDED_BY, "", functools.partial(self.alternatives, best, name), known)
            found[name] = self.relatives(name, others) if is_unknown else others
        return found

    def alternatives(self, best: Hypothesis, member: str) -> tuple[str, ...]:
        """Effects that would do in place of a member: competing models, and its look-alikes with more parameters."""
        rest = best.without(member)

        def in_its_place(hypotheses: Sequence[Hypothesis]) -> list[str]:
            names = [name for hypothesis in hypotheses for name in hypothesis.effects]
            sets = {hypothesis.effects for hypothesis in hypotheses}
            return [name for name in names if name != member and rest.adding(name).effects in sets]

        competing_models = in_its_place(self.exploration.competing_models(best))
        likely = [
            hypothesis for hypothesis, worse in self.exploration.larger_alternatives(best).items() if worse < LIKELY
        ]
        return tuple(dict.fromkeys([*competing_models, *in_its_place(likely)]))

    def relatives(self, name: str, found: Sequence[str]) -> tuple[str, ...]:
        """Names beside the best: where the form is wrong, scores mislead, and known look-alikes are listed too."""
        return tuple(dict.fromkeys([*found, *self.plant.effects[name].confused_with]))[: LARGEST_CLASS - 1]

    def evidence(self, best: Hypothesis, nonparametric: Sequence[float]) -> float:
        """Share of the best set in the evidence, theory, eq. (51), without sets that merely extend it.

        Nonparametric forces have a share, too; `nonparametric` is by how much each is worse than the best
        set. A weak effect without a name is easily taken for a weak one with a name (measured on the campaign:
        at a tenth of a strong one, damping that varies with x passes for spring hardening), so weak evidence is
        never certain.
        """
        least = self.search.score(best)
        nothing: dict[Hypothesis, float] = {}
        delta_scores = self.in_time(WORDED_BY, "", functools.partial(self.delta_scores, best), nothing)
        weight: dict[tuple[str, ...], float] = {}
        for hypothesis in self.exploration.tried():
            if set(hypothesis.effects) > set(best.effects) and best.effects:
                continue
            worse = delta_scores.get(hypothesis, self.search.score(hypothesis) - least)
            evidence = math.exp(-0.5 * min(max(worse, 0.0), 700.0))
            weight[hypothesis.effects] = max(weight.get(hypothesis.effects, 0.0), evidence)
        least_worse = max(min(nonparametric, default=math.inf), 0.0)
        share = weight[best.effects] / (sum(weight.values()) + math.exp(-0.5 * least_worse))
        if not best.effects:
            return share
        gain = self.search.score(Hypothesis((), best.timing)) - least
        return share * -math.expm1(-gain / WEAK_EVIDENCE)

    def delta_scores(self, best: Hypothesis) -> dict[Hypothesis, float]:
        """By how much competing models and larger alternatives are worse than the best."""
        return {**self.exploration.delta_scores(best), **self.exploration.larger_alternatives(best)}

    def share(self, best: Hypothesis) -> float:
        """How much of the squared residual of the base a hypothesis explains, from 0 to 1."""
        before = rmse(self.search.fit(Hypothesis((), best.timing)))
        return 1.0 - (rmse(self.search.fit(best)) / before) ** 2 if before > 0.0 else 0.0

    def advice(self, best: Hypothesis) -> str:
        """What to record next."""
        what = "what to record next"
        self._telling = self.in_time(WORDED_BY, what, lambda: self.telling_experiment(best), None)
        return advise(self.plant, self.strokes, self._telling)

    def telling_experiment(self, best: Hypothesis) -> Recommendation | None:
        """The recording that would tell the best hypothesis best from those of its size that do about as well."""
        candidates = {
            " + ".join(hypothesis.effects): self.search.fit(hypothesis)
            for hypothesis in self.exploration.competing_models(best)
        }
        few = dict(list(candidates.items())[:LARGEST_CLASS])
        return recommend(few, self.plant.experiments) if len(few) > 1 else None

    # -- tables --------------------------------------------------------------------------------------------------------

    def candidates(self, base: Hypothesis) -> list[Candidate]:
        """Everything tried, best first, at most thirty; fewer where the time is used up."""
        reference = self.search.score(base)
        found = []
        for hypothesis in sorted((h for h in self.exploration.tried() if h.effects), key=self.search.score)[:LISTED]:
            result = self.search.fit(hypothesis)
            held = self.in_time(WORDED_BY, "", functools.partial(self.on_holdout, result), None)
            if held is None and self.budget.spent > WORDED_BY * self.budget.seconds:
                break
            found.append(
                Candidate(
                    hypothesis.effects, hypothesis.timing, self.search.score(hypothesis) - reference, rmse(result),
                    math.nan if held is None else rmse(held),
                    {name: covariance_interval(result, name) for name in result.free},
                )
            )  # fmt: skip
        return found

    def on_holdout(self, result: Fit) -> Fit | None:
        """A fit on held-out data, with stamps as in the report."""
        return self.held_out.fit(result, timing=self._reported_timing)

    def state(self, result: Fit, *, profile: bool) -> State:
        """A fit with all that a report says of it."""
        held = self.in_time(WORDED_BY, "", lambda: self.on_holdout(result), None)
        intervals = {
            name: self.interval(result, name)
            if profile and ("." in name or result.is_collinear(name))
            else covariance_interval(result, name)
            for name in result.free
        }
        return State(result, held, rmse(result), math.nan if held is None else rmse(held), adequacy(result), intervals)

    def interval(self, result: Fit, name: str) -> Interval:
        """By profile likelihood; from the covariance where the time is used up."""
        what = f"the interval of {named_value(self.plant, name)[0]} by profile likelihood"
        work = functools.partial(profile_interval, result, name)
        found = self.in_time(WORDED_BY, what, work, None)
        return covariance_interval(result, name) if found is None else found[0]

    def in_time(self, share: float, what: str, work: Callable[[], Result], otherwise: Result) -> Result:
        """The work's result if it ends before this share of the time is used up; else it is noted as untried."""
        try:
            with self.budget.until(share):
                return work()
        except OutOfTimeError:
            if what:
                self.untried.append(what)
            return otherwise


class _NonparametricForces(NamedTuple):
    """Maps on top of the base, forces at one place in place of an effect, and both, best score first."""

    maps: list[NonparametricFit]
    local: list[NonparametricFit]
    best: list[NonparametricFit]
