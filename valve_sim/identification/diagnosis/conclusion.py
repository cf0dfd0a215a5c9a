"""From the explored hypotheses to a diagnosis: the claim, its residual, and the verdict's numbers, within the budget.

The claim is drawn from training strokes alone. Then held-out strokes are opened: they can refute it, and then no other
name takes its place. One rule precedes all others: what is claimed or written never has a larger error than the
refitted declared model, neither on fitted nor on held-out data. Where it would, or where the time is too short to tell,
the declared model stands.
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
from valve_sim.identification.estimation.gram import sum_squares
from valve_sim.identification.estimation.intervals import Interval, covariance_interval, profile_interval
from valve_sim.identification.estimation.result import Fit, is_relief, rmse
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
from valve_sim.identification.selection.held_out import ALIKE, SAME, HeldOut
from valve_sim.identification.selection.hypotheses import DECISIVE, Hypothesis
from valve_sim.identification.selection.residual_tests import adequacy
from valve_sim.identification.selection.stepwise import LARGEST_CLASS, LIKELY, Exploration

WEAK_EVIDENCE: Final = 30.0
"""Scale of eq. (51): a gain of S that is this large lowers a claim's share by the factor 0.63; at five detection limits
the gain is some hundreds."""
HALVED: Final = 0.5
"""Error with named effects over that without, of strokes left out in turn and of held-out ones, below which they are
named beside an unexplained remainder."""
MOST_FALSE_ALARMS: Final = 0.01
"""Probability that the search finds as much in noise alone, beyond which nothing is claimed."""
COMPARED_BY, CLAIMED_BY, MAPPED_BY, WORDED_BY = 0.75, 0.87, 0.92, 0.96
"""Shares of the time by which models are compared, the claim is checked, force maps are fitted, and all is written."""
LISTED: Final = 30
"""Candidates in the report, the best."""

Result = TypeVar("Result")


class Conclusion:
    """Draws the conclusion from what was explored.

    Args:
        exploration: what was tried. held_out: what judges the claim.
    """

    def __init__(self, exploration: Exploration, held_out: HeldOut) -> None:
        self.exploration, self.search, self.held_out = exploration, exploration.search, held_out
        self.criteria = exploration.criteria
        self.plant, self.budget = exploration.plant, exploration.search.problem.budget
        self.strokes = len(strokes_of_plant(self.plant))
        self.untried: list[str] = []
        self.refuted: set[Hypothesis] = set()
        self._reported_timing = False
        self._telling: Recommendation | None = None

    def conclude(self, explored: Hypothesis) -> Diagnosis:
        """Check the best hypothesis, and describe what it comes to."""
        chosen, alarm = self.claimed(explored)
        base_fit = self.search.fit(Hypothesis((), chosen.timing))
        nonparametric = self.nonparametric_forces(chosen, base_fit)
        best, is_unknown, names_most = self.judged(chosen, nonparametric)
        best_fit = self.search.fit(best)
        after_fit, unexplained = best_fit, None
        if is_unknown:
            after_fit, unexplained = self.remainder(best_fit, base_fit, nonparametric, names_effects=names_most)
        self._reported_timing = self.held_out.needs_timing(best_fit)
        base = Hypothesis((), best.timing)
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
            tuple(channel.name for channel in self.plant.channels), self._telling, untried, self.held_out.looks,
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
            best = exploration.eliminate(exploration.best_claimable())
        if best.effects:
            exploration.polish_near(best)
            best = next(filter(exploration.is_claimable, exploration.competing_models(best)), best)
        return best

    def kept(self, best: Hypothesis) -> tuple[Hypothesis, FalseAlarm]:
        """The best if its error is not larger than the base's and it is no false alarm; else the base."""
        base = Hypothesis((), best.timing)
        base_fit, best_fit = self.search.fit(base), self.search.fit(best)
        slack = ALIKE if is_relief(base_fit, best_fit) else SAME
        if rmse(best_fit) > (1.0 + slack) * rmse(base_fit):
            best, best_fit = base, base_fit
        alarm = false_alarm(base_fit, best_fit)
        if best.effects and self.exploration.is_adequate(best) and alarm.probability > MOST_FALSE_ALARMS:
            best = base
        return best, alarm

    # -- the judgement -------------------------------------------------------------------------------------------------

    def judged(self, best: Hypothesis, nonparametric: _NonparametricForces) -> tuple[Hypothesis, bool, bool]:
        """What stands when held-out data are opened; whether something is left; whether names are claimed beside it."""
        base = Hypothesis((), best.timing)
        base_fit, best_fit = self.search.fit(base), self.search.fit(best)
        map_wins = bool(nonparametric.best) and nonparametric.best[0].fit.score < best_fit.score - DECISIVE
        is_white = self.exploration.is_adequate(best)
        what = f"whether {best} holds" if best.effects else ""
        others = self.competing(best) if is_white else []
        fits = [best_fit, *map(self.search.fit, others)]
        opened = self.in_time(WORDED_BY, what, lambda: self.held_out.open(base_fit, *fits), None)
        if opened is None:
            return base, not self.exploration.is_adequate(base), False
        of_base, of_best, *of_others = opened
        self.refuted.update(
            other for other, judgement in zip(others, of_others, strict=True) if judgement.refutes_names
        )
        # Dampings of a single stroke are too uncertain to tell.
        is_refuted = (bool(best.effects) or self.strokes > 1) and not of_best.is_white
        if best.effects and not of_best.is_gain:
            best, is_refuted = base, not of_base.is_white or not self.exploration.is_adequate(base)
        # What held-out data refute is no claim, however much it explains; a remainder known before may stay beside one.
        names_most = bool(best.effects) and not map_wins and not is_white and not of_best.ratio >= HALVED
        names_most = names_most and self.halves_error(base_fit, best_fit)
        is_unknown = map_wins or not is_white or is_refuted
        return best, is_unknown, names_most

    def competing(self, best: Hypothesis) -> list[Hypothesis]:
        """The few nearest to the best: each claims to explain the data about as well, and is judged likewise."""
        nothing: dict[Hypothesis, float] = {}
        worse = self.in_time(WORDED_BY, "", functools.partial(self.delta_scores, best), nothing)
        return sorted((h for h in worse if h != best), key=worse.__getitem__)[: 2 * LARGEST_CLASS]

    def halves_error(self, base: Fit, best: Fit) -> bool:
        """Whether named effects more than halve the error of training strokes that are left out in turn."""
        with_names, without = self.criteria.cross_validation(best), self.criteria.cross_validation(base)
        if with_names is None or without is None:
            return False
        return sum_squares(with_names.residuals) < HALVED**2 * sum_squares(without.residuals)

    # -- what has no name ----------------------------------------------------------------------------------------------

    def nonparametric_forces(self, best: Hypothesis, base_fit: Fit) -> _NonparametricForces:
        """Nonparametric forces on the base, where it does not explain all, and in place of members of the best."""
        base = Hypothesis((), best.timing)
        is_explained = self.exploration.is_adequate(base)
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
            left = nonparametric.maps if best_fit is base_fit else []
            left = left or fit_maps(self.search, best_fit)
        options = [] if names_effects else [*nonparametric.best[:1], *left[:1]]
        chosen = min(options, key=lambda entry: self.criteria.score(entry.fit), default=None)
        if chosen is not None and self.is_sound(chosen.fit, best_fit, base_fit):
            return chosen.fit, describe(chosen.choice, chosen.fit, base_fit)
        if not left:
            return best_fit, None
        shown = self.in_time(WORDED_BY, "", lambda: on_top(left[0].choice, best_fit), left[0].fit)
        return best_fit, describe(left[0].choice, shown, best_fit)

    def is_sound(self, result: Fit, best: Fit, base: Fit) -> bool:
        """Whether a force map explains more than the best, and held-out data do not speak against it."""
        if self.criteria.score(result) >= self.criteria.score(best) or rmse(result) > (1.0 + SAME) * rmse(base):
            return False
        opened = self.in_time(WORDED_BY, "", lambda: self.held_out.open(base, result), None)
        return opened is not None and not opened[1].is_larger

    def nonparametric_competitors(
        self, best: Hypothesis, nonparametric: Sequence[NonparametricFit]
    ) -> list[tuple[NonparametricFit, float]]:
        """Nonparametric forces with a score near the best, and by how much they are worse.

        A nonparametric force need not explain more to make a name uncertain.
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

        likely = [
            hypothesis for hypothesis, worse in self.exploration.larger_alternatives(best).items() if worse < LIKELY
        ]
        stand = [h for h in (*self.exploration.competing_models(best), *likely) if h not in self.refuted]
        return tuple(dict.fromkeys(in_its_place(stand)))

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
            if (set(hypothesis.effects) > set(best.effects) and best.effects) or hypothesis in self.refuted:
                continue
            worse = delta_scores.get(hypothesis, self.search.score(hypothesis) - least)
            evidence = math.exp(-0.5 * min(max(worse, 0.0), 700.0))
            weight[hypothesis.effects] = max(weight.get(hypothesis.effects, 0.0), evidence)
        for name, gain in self.exploration.screened.items():
            weight[(name,)] = math.exp(0.5 * gain)
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
            if hypothesis not in self.refuted
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
