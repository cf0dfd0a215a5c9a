"""Close the loop: trace the residual to the missing effect, add it, report the error before and after.

The declared model is refitted, sets of effects are fitted beside it (`selection.search`), and the posterior over all of
them (`selection.posterior`) says what is missing, or that something without a name acts. Held-out strokes are predicted
with everything that training has estimated; they may raise the odds of something unnamed, and nothing else.
"""

from __future__ import annotations

import math
from collections.abc import Callable, Mapping, Sequence
from dataclasses import replace
from typing import Final, NamedTuple

import numpy as np
from numpy.typing import NDArray

from valve_sim.identification.diagnosis.experiment_design import Recommendation, recommend
from valve_sim.identification.diagnosis.outcome import Candidate, Diagnosis, Rival, State, Verdict, Worth
from valve_sim.identification.fit.budget import Budget
from valve_sim.identification.fit.correction import FALLS, Correction, correct, is_curve
from valve_sim.identification.fit.curves import Unexplained, unexplained
from valve_sim.identification.fit.descent import MOST
from valve_sim.identification.fit.detection_limits import detection_limits
from valve_sim.identification.fit.fitter import Tried
from valve_sim.identification.fit.grades import Grade, grades, kind_of, without_support
from valve_sim.identification.fit.held_out import HeldOut, predicted
from valve_sim.identification.fit.intervals import Interval, covariance_interval, profile_interval
from valve_sim.identification.fit.noise import Noise
from valve_sim.identification.fit.posterior import (
    EVEN,
    LARGEST_CLASS,
    Decision,
    Grounds,
    Posterior,
    Set,
    leader_of,
)
from valve_sim.identification.fit.problem import Mask, Problem, shows_rest
from valve_sim.identification.fit.residual_tests import adequacy
from valve_sim.identification.fit.result import Fit, fit, rmse
from valve_sim.identification.fit.search import DOUBTFUL, Progress, Search, words
from valve_sim.identification.fit.starts import all_near_off
from valve_sim.identification.fit.unknown import unknowns_of
from valve_sim.identification.plants.hold_out import held_out_strokes
from valve_sim.identification.plants.protocol import Plant, finite_prediction, strokes_of_plant
from valve_sim.identification.plants.recording_errors import COMMAND_TIME
from valve_sim.identification.plants.stroke_choice import choose_strokes
from valve_sim.identification.plants.valve import ValvePlant
from valve_sim.model import SimulationError, Valve
from valve_sim.recordings import Trace
from valve_sim.recordings.checking import check_traces

__all__ = ["Candidate", "Diagnosis", "DiagnosisSession", "State", "Verdict", "begin", "diagnose", "diagnose_plant"]

SAMPLES_EACH: Final = 10
"""Samples for each parameter, below which a model with all effects would explain noise, too."""
NOISIER: Final = 1.5
"""Times what the best model leaves, beyond which the noise that was taken from the largest one is too much of it."""
WORSE: Final = 1.05
"""Times the error of separate strokes, from which a correction makes them worse and is not applied."""
LISTED: Final = 12
"""Most candidates in the report."""


def diagnose(
    traces: Sequence[Trace],
    holdout: Sequence[Trace],
    valve: Valve,
    progress: Progress | None = None,
    budget: Budget | None = None,
) -> Diagnosis:
    """Trace the residual of a declared valve to the effect it lacks.

    Args:
        traces: training data; of very many samples some strokes are chosen.
        holdout: other recordings of the same valve, or none: strokes are held out inside.
        valve: the declared valve.
        progress: told what is being tried, and the fraction done.
        budget: how much work it may do; default as much as it takes.

    Raises:
        SimulationError: the declared valve cannot be simulated.
        TraceError: a recording has columns that cannot be used, say with NaN in them.
    """
    check_traces(traces)
    if holdout:
        check_traces(holdout)
    fitted, choice = choose_strokes(traces)
    others = ValvePlant(choose_strokes(holdout)[0], valve) if holdout else None
    found = diagnose_plant(ValvePlant(fitted, valve), others, progress, budget)
    return replace(found, choice=choice)


def diagnose_plant(
    plant: Plant, holdout: Plant | None, progress: Progress | None = None, budget: Budget | None = None
) -> Diagnosis:
    """Trace the residual of any plant to the effect it lacks.

    Raises:
        SimulationError: the declared model cannot be simulated.
    """
    return begin(plant, holdout, progress, budget).end()


def begin(
    plant: Plant,
    holdout: Plant | None = None,
    progress: Progress | None = None,
    budget: Budget | None = None,
    *,
    least: Mapping[str, float] | None = None,
    known: Mapping[str, Noise] | None = None,
    held: Mapping[str, float] | None = None,
) -> DiagnosisSession:
    """The first part of `diagnose_plant`: the declared model, refitted.

    Args:
        plant, holdout, progress, budget: as there.
        least: standard deviations by kind of channel, which count where the data show less noise.
        known: noise by kind of channel, which counts where the machine is never still for long enough to show it.
        held: sizes of errors of the recordings that are known, by `columns.known_name`.

    Raises:
        SimulationError: the declared model cannot be simulated.
    """
    budget = budget or Budget.unlimited()
    for one in (plant,) if holdout is None else (plant, holdout):
        finite_prediction(one, {})
    return _begun(plant, holdout, progress, budget, (least or {}, known or {}, held or {}))


def _begun(
    plant: Plant,
    holdout: Plant | None,
    progress: Progress | None,
    budget: Budget,
    given: tuple[Mapping[str, float], Mapping[str, Noise], Mapping[str, float]],
    restless: frozenset[str] = frozenset(),
) -> DiagnosisSession:
    """The declared model, refitted; restless: kinds of channel that move also where they look still."""
    least, known, held = given
    say = progress or (lambda what, fraction: None)
    train_mask, holdout_mask = _split(plant) if holdout is None else (None, None)
    problem = Problem(plant, train_mask, budget=budget)
    problem = problem.without_rest(restless)
    never_still = [kind for kind, noise in problem.noises.items() if noise.samples == 0]
    problem = _with_least(problem.with_noises({kind: known[kind] for kind in never_still if kind in known}), least)
    unknown = [kind for kind in never_still if kind not in known]
    is_guessed = bool(unknown)
    while is_guessed:
        say("noise, by what all effects together leave", 0.0)
        guess, problem = problem.noises, problem.with_noise_left_by(_largest_fit(problem).values)
        # A fit beside noise that is guessed much too large ends early.
        is_guessed = any(guess[kind].sigma > NOISIER * problem.noises[kind].sigma for kind in unknown)
    held_out = None
    if holdout is not None:
        held_out = Problem(holdout, budget=budget).with_noises({kind: problem.noises[kind] for kind in never_still})
        held_out = _with_least(held_out, least)
    elif holdout_mask is not None:
        held_out = problem.restricted(holdout_mask)
    reads_at_rest = not held or shows_rest(plant)
    search = Search(problem.condensed(), progress, held, reads_at_rest=reads_at_rest)
    search.fit_declared()
    # Noise that is told counts as it is told.
    if found := problem.moves_at_rest(search.tried[()].values) - least.keys() - known.keys():
        return _begun(plant, holdout, progress, budget, given, restless | found)

    def again(noises: Mapping[str, Noise]) -> DiagnosisSession:
        return _begun(plant, holdout, progress, budget, (least, {**known, **noises}, held), restless)

    return DiagnosisSession(search, HeldOut(held_out), say, again if unknown else None)


class VerdictWithIntervals(NamedTuple):
    """A verdict, and the intervals of what it frees, by name."""

    verdict: Verdict
    intervals: Mapping[str, Interval]


class DiagnosisSession:
    """A diagnosis of which the declared model has been fitted, and nothing else tried yet.

    Args:
        search: of the training data. held_out: what is predicted. say: told what is being done, and the fraction done.
        again: starts again with this noise by kind of channel; None where the data themselves have shown the noise.
    """

    def __init__(
        self,
        search: Search,
        held_out: HeldOut,
        say: Progress,
        again: Callable[[Mapping[str, Noise]], DiagnosisSession] | None = None,
    ) -> None:
        self._search, self._held_out, self._say, self._again = search, held_out, say, again
        self._plant = search.problem.plant
        self._strokes = len(strokes_of_plant(self._plant))

    @property
    def declared(self) -> Fit:
        """The refitted declared model."""
        return self._search.tried[()].result

    def name(self) -> VerdictWithIntervals:
        """Search and decide: the verdict with its intervals, without the further contents of a report."""
        self._run(is_full=False)
        decision = self._decided().decision
        result = self._fit_of(decision)
        exact = covariance_interval if decision.unnamed > DOUBTFUL else _profile
        return VerdictWithIntervals(
            self._posterior_verdict(decision), {name: exact(result, name) for name in result.free}
        )

    def end(self, *, is_full: bool = False) -> Diagnosis:
        """Search, decide, and describe the result.

        Args:
            is_full: whether every effect is fitted where the declared model leaves nothing to be found, too.
        """
        self._run(is_full=is_full)
        grounds = self._decided()
        posterior, decision = grounds.posterior, grounds.decision
        self._say("what predicts unseen strokes", 0.9)
        correction = correct(self._search, decision, self._lowers_held_out_error)
        if without_support(correction, grades(correction, decision, posterior)):
            correction = replace(correction, is_applied=False)
        self._say("intervals", 0.95)
        fitter, declared = self._search.fitter, self._search.tried[()]
        result = fitter.settled(correction.fit).widened()
        if correction.is_applied and decision.unnamed > EVEN:
            result = result.allowing(fitter.process, result.gaussian.spread(fitter.process).cell)
        # Before and after are compared with the same errors of the recordings: else these would hide what was missing.
        base = result if correction.fit is declared else fitter.settled(declared, result.gaussian.sizes).widened()
        before = self._state(base, profile=False)
        after = before if result is base else self._state(result, profile=True)
        if after.holdout_rmse > WORSE * before.holdout_rmse:
            # Separate strokes have the last word.
            correction, result = replace(correction, is_applied=False), base
            after = before
        graded = grades(correction, decision, posterior)
        verdict = self._verdict(decision, correction, graded)
        if verdict.kind == "unknown":
            base = base.allowing(fitter.process, declared.spread.cell)
            after = before = self._state(base, profile=False, tau=declared.spread.tau)
        has_no_name = verdict.kind == "unknown" or (verdict.kind == "partly" and decision.unnamed > EVEN)
        maps = self._unexplained() if has_no_name else ()
        limits = detection_limits(fitter, declared) if verdict.kind == "none" else {}
        budget = self._search.problem.budget
        untried = [*self._search.untried, *self._search.impossible]
        return Diagnosis(
            self._plant, before, after, verdict, self._candidates(posterior), posterior.inclusion(),
            maps[0] if maps else None, maps,
            tuple(channel.name for channel in self._plant.channels), self._recommendation(verdict, decision),
            self._held_out_gain(base, result), (*map(words, untried), *correction.cut_short),
            budget.spent, budget.strokes, limits, self._rivals(posterior, decision, result), grounds=grounds,
            correction=correction, grades=graded,
            impossible={words(names): why for names, why in self._search.impossible.items()},
        )  # fmt: skip

    def _run(self, *, is_full: bool) -> None:
        """Search; where the best model leaves far less than was taken for noise, once more with that as noise.

        Of a machine that is never still the noise is what the largest model leaves. A fit of all effects at once may
        end far from where one of them alone does, and its noise then hides whatever else is missing.
        """
        self._search.run(is_full=is_full)
        while self._again is not None and not self._search.problem.budget.is_used_up:
            problem = self._search.problem
            best = max(self._search.tried.values(), key=lambda entry: entry.plain).result
            left = problem.with_noise_left_by(best.values).noises
            quieter = {kind: own for kind, own in left.items() if NOISIER * own.sigma < problem.noises[kind].sigma}
            if not quieter:
                break
            known = {kind: own for kind, own in problem.noises.items() if own.samples == 0}
            restarted = self._again({**known, **quieter})
            self._search, self._held_out = restarted._search, restarted._held_out
            self._search.run(is_full=is_full)

    # -- what is claimed -----------------------------------------------------------------------------------------------

    def _decided(self) -> Grounds:
        """The table of evidence from which the verdict follows, with held-out odds."""
        posterior = self._search.posterior()
        best = leader_of({names: share.total for names, share in posterior.shares.items()}, posterior.fitted)
        found = self._search.tried[best].result
        self._held_out.learn_errors(found)
        raised = {best: self._held_out.log_odds_of_unnamed(found)}
        return Grounds(
            self._search.rivals,
            self._search.table(raised[best]),
            raised,
            {name: len(choice.parameters) for name, choice in self._plant.effects.items()},
        )

    def _fit_of(self, decision: Decision) -> Fit:
        """The corrected model: what is named, or the refitted declared model where nothing is."""
        return self.declared if decision.kind == "unknown" else self._search.tried[decision.names].result

    def _share(self, result: Fit) -> float:
        """How much of the squared error of the declared model beyond noise a fit explains, from 0 to 1."""
        before, after = self._left(self.declared), self._left(result)
        return min(1.0, max(0.0, 1.0 - after / before)) if before > 0.0 else 0.0

    def _left(self, result: Fit) -> float:
        """The squared error of a fit beyond noise."""
        return max(float(rmse(result)) ** 2 - float(self._search.problem.noise.sigma) ** 2, 0.0)

    def _worth(self, names: Set) -> dict[str, Worth]:
        """How much of the squared error each of some named effects explains."""
        left = {frozenset(key): self._left(tried.result) for key, tried in self._search.tried.items()}
        declared, whole = left[frozenset()], left[frozenset(names)]
        gains: dict[str, float] = {}
        for name in names:
            alone, without = left.get(frozenset([name])), left.get(frozenset(names) - {name})
            orders = [declared - alone] if alone is not None else []
            orders += [without - whole] if without is not None else []
            if not orders:
                return {}
            gains[name] = max(0.0, sum(orders) / len(orders))
        total = sum(gains.values())
        if declared <= 0.0 or total <= 0.0:
            return {}
        return {
            name: Worth(gain / total, float(np.minimum(1.0, left.get(frozenset([name]), math.nan) / declared)))
            for name, gain in gains.items()
        }

    def _verdict(self, decision: Decision, correction: Correction, graded: tuple[Grade, ...]) -> Verdict:
        """What is claimed of a correction."""
        ended = self._search.problem.budget.is_used_up and bool(self._search.untried or correction.cut_short)
        names, others, probability = decision.names, decision.others, decision.probability
        if correction.is_applied:
            names = () if is_curve(correction.names) else correction.names
            if names != decision.names:
                others = {one.effect: one.alike for one in graded}
                probability = min((one.probability for one in graded), default=decision.unnamed)
        kind = kind_of(correction, graded, decision)
        if ended and kind == "unknown":
            kind = "insufficient"  # what was not tried may have a name
        share = self._share(correction.fit.result if correction.is_applied else self._search.tried[names].result)
        worth = self._worth(names) if names in self._search.tried else {}
        return Verdict(kind, names, others, probability, decision.unnamed, share, self._strokes, worth, ended)

    def _posterior_verdict(self, decision: Decision) -> Verdict:
        """The verdict of the posterior alone."""
        ended = self._search.problem.budget.is_used_up and bool(self._search.untried)
        return Verdict(
            decision.kind, decision.names, decision.others, decision.probability, decision.unnamed,
            self._share(self._search.tried[decision.names].result), self._strokes, self._worth(decision.names), ended,
        )  # fmt: skip

    # -- what a report has beside --------------------------------------------------------------------------------------

    def _state(self, result: Fit, *, profile: bool, tau: float = 0.0) -> State:
        """A fit with its errors, test and intervals."""
        here = predicted(result, result, tau)
        there = self._held_out.predicted(result, tau)
        intervals = {
            name: _profile(result, name)
            if profile and ("." in name or result.is_collinear(name))
            else covariance_interval(result, name)
            for name in result.free
        }
        return State(
            result, None if there is None else there.fit, here.rmse, math.nan if there is None else there.rmse,
            here.deviation, math.nan if there is None else there.deviation, here.bands,
            {} if there is None else there.bands, adequacy(result), intervals,
        )  # fmt: skip

    def _lowers_held_out_error(self, declared: Tried, corrected: Tried) -> bool:
        """Whether a fit lowers the error of held-out strokes by a third."""
        fits = [self._held_out.fit(own.result) for own in (declared, corrected)]
        errors = [math.log(rmse(own)) for own in fits if own is not None]
        return len(errors) == len(fits) and errors[0] - errors[1] >= FALLS

    def _held_out_gain(self, base: Fit, result: Fit) -> float:
        """Ln of how much more probable a fit makes held-out strokes than the declared model."""
        before, after = self._held_out.log_density(base), self._held_out.log_density(result)
        return math.nan if before is None or after is None else after - before

    def _candidates(self, posterior: Posterior) -> tuple[Candidate, ...]:
        """Every set of effects that was fitted, the most probable first, at most `LISTED`."""
        base, found = self._search.tried[()], []
        ordered = sorted((names for names in self._search.tried if names), key=lambda n: -posterior.shares[n].total)
        for names in ordered[:LISTED]:
            tried, share = self._search.tried[names], posterior.shares[names]
            result = tried.result
            there = self._held_out.fit(result)
            timing = any(own.number == COMMAND_TIME for own in result.nuisances)
            found.append(
                Candidate(
                    names, timing, share.total, share.unnamed, tried.plain, -2.0 * (tried.plain - base.plain),
                    rmse(result), math.nan if there is None else rmse(there),
                    {name: covariance_interval(result, name) for name in result.free},
                )
            )  # fmt: skip
        return tuple(found)

    def _unexplained(self) -> tuple[Unexplained, ...]:
        """What the declared model leaves without a name, as forces, the one that explains most of it first."""
        return unexplained(self._search.fitter, self._search.tried[()], self._search.curves)

    def _near(self, decision: Decision) -> list[Set]:
        """The named effects, and the look-alikes of each."""
        found = [decision.names]
        for name, others in decision.others.items():
            for other in others:
                names = tuple(sorted({*decision.names, other} - {name}))
                if names in self._search.tried:
                    found.append(names)
        return found[:LARGEST_CLASS]

    def _recommendation(self, verdict: Verdict, decision: Decision) -> Recommendation | None:
        """The recording that separates the competing models best."""
        if not verdict.is_open:
            return None
        candidates = {" + ".join(names): self._search.tried[names].result for names in self._near(decision)}
        return recommend(candidates, self._plant.experiments) if len(candidates) > 1 else None

    def _rivals(self, posterior: Posterior, decision: Decision, result: Fit) -> tuple[Rival, ...]:
        """What competes with the corrected model, where positions follow from a fit.

        Beside the declared model, which stands where something unnamed acts, the nearest names compete as well.
        """
        if not self._plant.follows_positions or decision.kind == "none":
            return ()
        near, is_declared = self._near(decision), decision.kind == "unknown"
        best, found = posterior.shares[() if is_declared else decision.names].total, []
        for names in near if is_declared and decision.names else near[1:]:
            share = posterior.shares[names].total
            weight = share / best if share < best else 1.0
            other = self._search.tried[names].result
            found.append(Rival(other, self._held_out.fit(other), weight))
        return tuple(found)


def _profile(result: Fit, name: str) -> Interval:
    return profile_interval(result, name)[0]


def _with_least(problem: Problem, least: Mapping[str, float]) -> Problem:
    """A problem with white noise of at least these standard deviations."""
    known = problem.noises.items()
    quiet = {kind: noise for kind, noise in known if noise.samples and noise.sigma < least.get(kind, 0.0)}
    return problem.with_noises(
        {kind: Noise(least[kind], least[kind], (), noise.step, noise.samples) for kind, noise in quiet.items()}
    )


def _largest_fit(problem: Problem) -> Fit:
    """The declared model with all effects on: no effect of the catalogue explains its residual.

    The residual of the declared model alone contains the effects that it lacks, and as noise would hide them: beside
    friction a constant force would never be found. (Mallows' Cp takes its variance from the full model, too.)
    """
    unknowns = unknowns_of(problem.plant)
    declared = [*unknowns.base, *unknowns.known]
    base = fit(problem, declared, {}, most=MOST)
    effects = [own for own in unknowns.hypotheses.values() if own.choice is None or not own.choice.is_declared]
    every = [*declared, *(one for own in effects for one in own.frees)]
    if problem.samples < SAMPLES_EACH * sum(own.is_freed for own in every):
        return base
    start = all_near_off(problem, effects, base.values)
    if start is None:
        return base
    replaced = {name for own in effects for one in own.frees for name in (one.name,)}
    try:
        largest = fit(problem, [own for own in every if own.is_freed or not replaced & {*own.replaces}], start)
    except SimulationError:
        return base
    return min(base, largest, key=rmse)


def _split(plant: Plant) -> tuple[Mask | None, Mask | None]:
    """Masks for training and held-out strokes, or None twice when there are too few strokes to hold any out."""
    held = held_out_strokes(plant)
    if not held:
        return None, None

    def is_held(index: int, groups: NDArray[np.integer]) -> NDArray[np.bool_]:
        recording = plant.channels[index].recording
        return np.isin(groups, [group for number, group in held if number == recording])

    return (lambda index, groups: ~is_held(index, groups)), is_held
