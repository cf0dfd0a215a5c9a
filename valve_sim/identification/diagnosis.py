"""Close the loop: trace the residual to the missing effect, add it, report the error before and after.

The method follows METHOD.md: base fit, test of what is left, refit of the whole catalogue inside the simulator,
forward selection with swaps and backward elimination, ambiguity class, hold-out, force maps for what has no name.
Where it departs: effects, timing errors and force maps are compared on one scale, the score S of `fitting`, and
timing errors of single commands pay the Occam factor of their prior instead of being tried last.
"""

from __future__ import annotations

import itertools
import math
from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from typing import Any, Final

import numpy as np
from numpy.typing import NDArray

from valve_sim.identification.adequacy import Adequacy, adequacy
from valve_sim.identification.calibration import calibrated
from valve_sim.identification.current_form import doubt_of_current
from valve_sim.identification.false_alarm import FalseAlarm, false_alarm
from valve_sim.identification.fitting import Fit, Interval, Mask, Problem, covariance_interval, fit, profile_interval
from valve_sim.identification.next_recording import Recommendation, recommend
from valve_sim.identification.plant import Array, ForceMap, Nuisance, Plant, to_search
from valve_sim.identification.predictive import surprise
from valve_sim.identification.search import DECISIVE, MOST_EFFECTS, Hypothesis, Progress, Search
from valve_sim.identification.side_by_side import side_by_side
from valve_sim.identification.valve_plant import ValvePlant
from valve_sim.model import SimulationError, Valve
from valve_sim.traces import Trace

BEAM: Final = 2
"""How many of the best hypotheses are extended by one more effect."""
LARGEST_CLASS: Final = 4
"""More names than this are no answer (MODEL section 6)."""
EVERY_FOURTH: Final = 4
"""Of the strokes is held out where no hold-out bag is given."""
WEAK_EVIDENCE: Final = 30.0
"""Gain of S at which a name is still as doubtful as 63 %; at five detection limits the gain is some hundreds."""
FAILS_HELD_OUT: Final = 1.2
"""Held-out error over noise beyond which a name is not believed; what errors of its parameters add stays below."""
HINT: Final = 0.02
"""P-value below which the search goes on: it costs seconds, where stopping early costs a wrong name."""
MOSTLY: Final = 0.5
"""Held-out error with named effects over that without, below which they are named beside an unexplained remainder."""
MOST_FALSE_ALARMS: Final = 0.01
"""Probability that the search finds as much in noise alone, beyond which nothing is claimed."""
NEARLY: Final = 40.0
"""Difference of S within which a better start may turn the tables."""
WORTH_A_LOOK: Final = 20
"""How many of the best hypotheses are tried on held-out data where none leaves only noise."""
EXCLUDES_OFF: Final = 1.96
"""Standard errors that an effect must be away from 'off'."""


@dataclass(frozen=True)
class Verdict:
    """What is claimed; the fields are those of report.json.

    `evidence` is the share of the claim in the evidence of all that was tried; `probability` is what a share of that
    size has been worth on the campaign.
    """

    kind: str
    effects: tuple[str, ...]
    confusable_with: Mapping[str, tuple[str, ...]]
    evidence: float
    probability: float
    summary: str


@dataclass(frozen=True)
class State:
    """A fitted model on training and held-out data.

    Attributes:
        fit: on the training data. holdout: the same values on held-out data, nuisances estimated; or None.
        train_rmse, holdout_rmse: m (or the channel's unit); nan where there is no hold-out.
        adequacy: of the training residuals. intervals: of every freed parameter.
    """

    fit: Fit
    holdout: Fit | None
    train_rmse: float
    holdout_rmse: float
    adequacy: Adequacy
    intervals: Mapping[str, Interval]


@dataclass(frozen=True)
class Candidate:
    """One hypothesis that was tried."""

    effects: tuple[str, ...]
    timing: bool
    delta_score: float
    train_rmse: float
    holdout_rmse: float
    intervals: Mapping[str, Interval]


@dataclass(frozen=True)
class Unexplained:
    """A remainder that no named effect explains, as the force map that explains most of it."""

    force_rms: float
    where: str
    variable: str
    at: tuple[float, ...]
    force: tuple[float, ...]
    gain: float


@dataclass(frozen=True)
class Diagnosis:
    """The outcome of `diagnose_plant`."""

    plant: Plant
    before: State
    after: State
    verdict: Verdict
    candidates: tuple[Candidate, ...]
    unexplained: Unexplained | None
    maps: tuple[Unexplained, ...]
    record_next: str
    false_alarm: FalseAlarm
    sources: tuple[str, ...] = ()

    @property
    def valve(self) -> Valve:
        """The corrected valve.

        Raises:
            TypeError: the plant is not a valve.
        """
        if not isinstance(self.plant, ValvePlant):
            raise TypeError("only a diagnosis of a valve has a corrected valve")
        return self.plant.with_values(self.after.fit.values)


def diagnose(
    traces: Sequence[Trace],
    holdout: Sequence[Trace],
    valve: Valve,
    progress: Progress | None = None,
) -> Diagnosis:
    """Trace the residual of a declared valve to the effect it lacks.

    Args:
        traces: training data. holdout: other recordings of the same valve, or none: strokes are held out inside.
        valve: the declared valve.
        progress: told what is being tried, and the fraction done.

    Raises:
        SimulationError: the declared valve cannot be simulated.
    """
    return diagnose_plant(ValvePlant(traces, valve), ValvePlant(holdout, valve) if holdout else None, progress)


def diagnose_plant(plant: Plant, holdout: Plant | None, progress: Progress | None = None) -> Diagnosis:
    """The same for any plant; `holdout` is the same machine with other data."""
    investigation = _Investigation(plant, holdout, progress)
    return investigation.conclude(investigation.explore())


class _Investigation:
    """One diagnosis under way: the training search, the held-out problem, and what was concluded so far."""

    def __init__(self, plant: Plant, holdout: Plant | None, progress: Progress | None) -> None:
        self.plant = plant
        train_mask, holdout_mask = _split(plant) if holdout is None else (None, None)
        problem = Problem(plant, train_mask)
        # Believed to the last milliampere, a current of another form would bend the motion to it.
        doubt = doubt_of_current(problem)
        problem = problem.doubting("current", doubt)
        self.search = Search(problem, progress)
        self.holdout: Problem | None = None
        if holdout is not None:
            self.holdout = Problem(holdout).doubting("current", doubt)
        elif holdout_mask is not None:
            self.holdout = problem.restricted(holdout_mask)
        self._held: dict[tuple[Fit, bool], Fit | None] = {}
        self._predictive: dict[tuple[Fit, bool, bool], float] = {}
        self._reported_timing = False

    # -- the search ------------------------------------------------------------------------------------------------

    def explore(self) -> Hypothesis:
        """Singles, then pairs and triples while something is left; returns the best claimable hypothesis."""
        search, names = self.search, list(self.plant.effects)
        search.fit(Hypothesis(()))
        search.fit_each([Hypothesis((name,)) for name in names], (0.0, 0.3))
        if self.deserves_another_look(self.best_claimable()):
            self._explore_timing(names)
        for count in range(2, MOST_EFFECTS + 1):
            best = self.best_claimable()
            # Stamps that err take up what friction delays, so two effects must have been tried beside them.
            hides_another = best.timing and len(best.effects) == 1 and count == 2
            if not self.deserves_another_look(best) and not hides_another:
                break
            if best.effects:
                search.polish(best)
            if not self._extend(count, names):
                break
        if not self.is_adequate(self.best_claimable()):
            self._extend_timing(names)
        self._drop_idle()
        return self.eliminate(self.best_claimable())

    def _drop_idle(self) -> None:
        """Where the best of all has members that do nothing, the rest was only short of a good start."""
        hypothesis = self.search.best(self._tried())
        while idle := [member for member in hypothesis.effects if not self._is_on(hypothesis, member)]:
            start = self.search.fit(hypothesis).values
            hypothesis = hypothesis.without(idle[0])
            self.search.refit(hypothesis, start)

    def _explore_timing(self, names: Sequence[str]) -> None:
        """Errors of the commands' stamps, where they explain more than any one effect does, or all that was left."""
        if not self.plant.timing_errors:
            return
        search = self.search
        best = sorted(filter(self.is_claimable, self._tried()), key=search.score)[:BEAM]
        timed = [Hypothesis((), True), *(hypothesis._replace(timing=True) for hypothesis in best)]
        search.fit(timed[0])
        search.fit_each(timed[1:], (0.3, 0.3))
        explain_more = search.score(search.best(timed)) < search.score(best[0]) - DECISIVE
        if explain_more or any(self.is_adequate(hypothesis) for hypothesis in timed):
            search.fit_each([Hypothesis((name,), timing=True) for name in names], (0.3, 0.5))

    def _extend_timing(self, names: Sequence[str]) -> None:
        """Pairs with errors of the stamps, where these explain more than a second effect does."""
        timed = [h for h in self._tried() if h.timing and len(h.effects) == 1 and self._has_effects_on(h)]
        if not timed:
            return
        start = self.search.best(timed)
        if self.search.score(start) > self.search.score(self.best_claimable()):
            return
        self.search.fit_each([start.adding(name) for name in names if name not in start.effects], (0.8, 0.9))

    def _extend(self, count: int, names: Sequence[str]) -> bool:
        """Add one more effect to the best few, swap members; whether that was decisive."""
        search = self.search
        smaller = [hypothesis for hypothesis in self._tried() if len(hypothesis.effects) == count - 1]
        smaller = sorted((h for h in smaller if not h.timing), key=self.merit)
        before = self.merit(self.best_claimable())
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
        return self.merit(self.best_claimable()) < before - DECISIVE

    def _swap(self, best: Hypothesis, names: Sequence[str]) -> Hypothesis:
        """Swap each member through the catalogue (METHOD: cured most wrong pairs)."""
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
            if costs_little or not self.earns_hold_out(self.search.fit(rest), self.search.fit(best)):
                return self.eliminate(rest)
        untimed = best._replace(timing=False)
        if best.timing and self.search.score(untimed) < self.search.score(best):
            return untimed
        return best

    def best_claimable(self) -> Hypothesis:
        """The hypothesis that predicts best of those whose effects are away from off and from bounds."""
        return min((h for h in self._tried() if self.is_claimable(h)), key=self.merit)

    def merit(self, hypothesis: Hypothesis) -> float:
        """What a hypothesis is worth to the search: its predictive score.

        Where no form is right, the score of the training data rewards what bends to them most, such as a pressure force
        that only acts there (on the plant of other form: 2.8 µm in training, 11 µm held out, where nothing has 10 µm).
        """
        result = self.search.fit(hypothesis)
        return self.predictive_score(result, timing=self.needs_timing(result), is_form_right=adequacy(result).is_white)

    def _tried(self) -> list[Hypothesis]:
        return list(self.search.fits)

    def is_adequate(self, hypothesis: Hypothesis) -> bool:
        """Whether nothing but noise is left of it."""
        return adequacy(self.search.fit(hypothesis)).is_white

    def fails_hold_out(self, hypothesis: Hypothesis) -> bool:
        """Whether a claimed effect leaves more than noise of held-out data: then the name is wrong or not all."""
        if not hypothesis.effects:
            return False
        result = self.search.fit(hypothesis)
        held = self.hold_out(result, timing=self.needs_timing(result))
        if held is None:
            return self.holdout is not None
        # Plainly too: where noise is coloured, whitening takes most of what is slow out of a residual, wrong or right.
        sigma = max(noise.sigma for kind, noise in held.problem.noises.items() if kind != "current")
        is_large = rmse(held) > FAILS_HELD_OUT * sigma
        return is_large or held.chi2 > FAILS_HELD_OUT**2 * held.problem.effective_samples

    def deserves_another_look(self, hypothesis: Hypothesis) -> bool:
        """Whether training or held-out data give any hint that something is left of it."""
        result = self.search.fit(hypothesis)
        if adequacy(result).p_value < HINT:
            return True
        if not hypothesis.effects:
            return False
        held = self.hold_out(result, timing=self.needs_timing(result))
        return self.holdout is not None and (held is None or not adequacy(held).is_white)

    def is_claimable(self, hypothesis: Hypothesis) -> bool:
        """A parameter on its bound names nothing, nor does an effect that may as well be off.

        Errors of the stamps are believed only where they leave nothing but noise: they bend to any mismatch.
        """
        return self._has_effects_on(hypothesis) and (not hypothesis.timing or self.is_adequate(hypothesis))

    def _has_effects_on(self, hypothesis: Hypothesis) -> bool:
        return all(self._is_on(hypothesis, name) for name in hypothesis.effects)

    def _is_on(self, hypothesis: Hypothesis, effect: str) -> bool:
        """Whether an effect is away from off, or would be missed though its parameters trade with each other."""
        result, away = self.search.fit(hypothesis), []
        for parameter in self.plant.effects[effect].parameters:
            name = f"{effect}.{parameter.name}"
            index = result.free.index(name)
            at = float(result.coordinates[index])
            if parameter.off is None:
                if result.on_bound(name) is not None:
                    return False
                continue
            off = to_search(parameter, parameter.off)
            if result.on_bound(name) is not None and not math.isclose(at, off, abs_tol=1e-12):
                return False
            error = math.sqrt(max(0.0, float(result.covariance[index, index])))
            away.append(abs(at - off) > EXCLUDES_OFF * error and at != off)
        rest = hypothesis.without(effect)
        is_missed = rest in self.search.fits and self.search.score(rest) > self.search.score(hypothesis) + DECISIVE
        return any(away) or is_missed

    # -- hold-out --------------------------------------------------------------------------------------------------

    def hold_out(self, result: Fit, *, timing: bool) -> Fit | None:
        """The same machine on held-out data: only the nuisances are estimated. None if it cannot be simulated there."""
        if self.holdout is None:
            return None
        key = (result, timing)
        if key not in self._held:
            plant = self.holdout.plant
            nuisances: tuple[Nuisance, ...] = (*plant.nuisances, *(plant.timing_errors if timing else ()))
            own = {nuisance.name for nuisance in (*self.plant.nuisances, *self.plant.timing_errors)}
            machine = {name: value for name, value in result.values.items() if name not in own}
            try:
                self._held[key] = fit(self.holdout, (), {}, nuisances=nuisances, fixed=machine)
            except SimulationError:
                self._held[key] = None
        return self._held[key]

    def needs_timing(self, result: Fit) -> bool:
        """Whether held-out data are compared with errors of their stamps estimated.

        They are where training needed them, and where the model is known to be wrong anyway: there a stroke that just
        lifts the valve, or just does not, would else decide everything.
        """
        timed = any(nuisance in self.plant.timing_errors for nuisance in result.nuisances)
        return bool(self.plant.timing_errors) and (timed or not adequacy(result).is_white)

    def earns_hold_out(self, simple: Fit, rich: Fit) -> bool:
        """Whether the richer model predicts held-out data better by more than 2 standard errors."""
        timing = self.needs_timing(rich)
        held_simple, held_rich = self.hold_out(simple, timing=timing), self.hold_out(rich, timing=timing)
        if held_simple is None or held_rich is None:
            return self.holdout is None or held_rich is not None
        gain = held_simple.chi2 - held_rich.chi2
        apart = float(np.sum(np.square(held_simple.residuals - held_rich.residuals)))
        # The gain of the truth is `apart` on average, with standard error 2 √apart.
        return gain > 4.0 * math.sqrt(apart)

    def predictive_score(self, result: Fit, *, timing: bool, is_form_right: bool) -> float:
        """S of the training data, and how surprising held-out data are to what was fitted.

        Where the form is wrong, no covariance says how far off it is, and plain χ² has to do.
        """
        if self.holdout is None:
            return result.score
        key = (result, timing, is_form_right)
        if key not in self._predictive:
            held = self.hold_out(result, timing=timing)
            if held is None:
                self._predictive[key] = math.inf
            else:
                self._predictive[key] = result.score + (surprise(result, held) if is_form_right else held.score)
        return self._predictive[key]

    def standings(self, best: Hypothesis) -> dict[Hypothesis, float]:
        """By how much each hypothesis of as many effects that comes near the best predicts worse, in S."""
        timing = self.needs_timing(self.search.fit(best))
        limit = self.search.score(best) + 2.0 * DECISIVE
        count = max(1, len(best.effects))
        near = [h for h in self._tried() if len(h.effects) == count and self.search.score(h) < limit]
        is_form_right = self.is_adequate(best)
        scores = {
            h: self.predictive_score(self.search.fit(h), timing=timing, is_form_right=is_form_right)
            for h in {best, *near}
        }
        return {h: scores[h] - scores[best] for h in near}

    def _polish_near(self, best: Hypothesis) -> None:
        """Give what may do as well as the best, and itself, the same chance: a fit from around each."""
        limit = self.search.score(best) + NEARLY
        near = [h for h in self._tried() if len(h.effects) == len(best.effects) and self.search.score(h) < limit]
        nearest = {best, *sorted(near, key=self.search.score)[:LARGEST_CLASS]}
        side_by_side(self.search.polish, list(nearest))

    def rivals(self, best: Hypothesis) -> list[Hypothesis]:
        """What does about as well as the best, itself included where it has effects; best first."""
        standings = self.standings(best)
        return sorted((h for h, worse in standings.items() if worse < DECISIVE), key=standings.__getitem__)

    def best_on_hold_out(self, best: Hypothesis) -> Hypothesis:
        """Of the few that are worth most, the one of the smallest plain error on held-out data."""
        few = sorted(filter(self.is_claimable, self._tried()), key=self.merit)[:WORTH_A_LOOK]
        if self.holdout is None or not few:
            return best
        return min(few, key=lambda hypothesis: self._held_out_error(self.search.fit(hypothesis)))

    # -- what has no name --------------------------------------------------------------------------------------------

    def fit_maps(self, base: Fit) -> list[tuple[ForceMap, Fit]]:
        """Force maps on top of a fit, best score first."""
        nuisance_names = {nuisance.name for nuisance in base.nuisances}
        own = {*base.free, *nuisance_names}
        others = {name: value for name, value in base.values.items() if name not in own}

        def fitted(choice: ForceMap) -> tuple[ForceMap, Fit]:
            free, fixed = (*base.free, *choice.free), {**others, **choice.held}
            return choice, fit(base.problem, free, base.values, nuisances=base.nuisances, fixed=fixed)

        maps = side_by_side(
            fitted, self.plant.force_maps, lambda choice: self.search.say(f"a force over {choice.variable}", 0.9)
        )
        return sorted(maps, key=lambda pair: pair[1].score)

    def fit_local_forces(self, best: Hypothesis) -> list[tuple[ForceMap, Fit]]:
        """A force at one place alone instead of each member of a hypothesis, best score first.

        It has as many parameters as the simplest effects. Where it does as well as a name, the data speak of one
        place only, and the name of the rest of the stroke by hope (on the campaign: a ripple or a vibration of half a
        millinewton that lifts the pilot plunger off its seat, as a constant force would).
        """
        places = [one for choice in self.plant.force_maps if choice.variable == "x" for one in choice.at_one_knot()]

        def fitted(instead: tuple[str, ForceMap]) -> list[tuple[ForceMap, Fit]]:
            member, choice = instead
            rest = self.search.fit(best.without(member))
            free = (*rest.free, *choice.free)
            try:
                return [(choice, fit(rest.problem, free, rest.values, nuisances=rest.nuisances, fixed=choice.held))]
            except SimulationError:
                return []

        found = side_by_side(fitted, list(itertools.product(best.effects, places)))
        return sorted(itertools.chain(*found), key=lambda pair: pair[1].score)

    def on_top(self, choice: ForceMap, base: Fit) -> Fit:
        """A force map with all else held, so that it shows what is left and trades nothing with friction or mass."""
        return fit(base.problem, choice.free, {}, fixed={**base.values, **choice.held})

    # -- the conclusion ----------------------------------------------------------------------------------------------

    def conclude(self, best: Hypothesis) -> Diagnosis:
        """Judge what was explored, and word it."""
        search = self.search
        if not self.is_adequate(best):
            best = self.eliminate(self.best_on_hold_out(best))
        if best.effects:
            self._polish_near(best)
            best = next(filter(self.is_claimable, self.rivals(best)), best)
        base = Hypothesis((), best.timing)
        base_fit, best_fit = search.fit(base), search.fit(best)
        earned = best.effects and self.earns_hold_out(base_fit, best_fit)
        if best.effects and not earned:
            best, best_fit = base, base_fit
        search.say("what the same search finds in noise alone", 0.88)
        alarm = false_alarm(base_fit, best_fit)
        if best.effects and self.is_adequate(best) and alarm.probability > MOST_FALSE_ALARMS:
            best, best_fit = base, base_fit
        fitted_maps = [] if self.is_adequate(base) else self.fit_maps(base_fit)
        named_score = search.score(best)
        can_tell = self.is_adequate(best) and _stroke_count(self.plant) > 1
        local_forces = self.fit_local_forces(best) if can_tell else []
        nameless = sorted([*fitted_maps, *local_forces], key=lambda pair: pair[1].score)
        map_wins = bool(nameless) and nameless[0][1].score < named_score - DECISIVE
        is_unknown = map_wins or not self.is_adequate(best) or self.fails_hold_out(best)
        self._reported_timing = self.needs_timing(best_fit)
        after_fit = best_fit
        remainder: list[tuple[ForceMap, Fit]] = []
        if is_unknown:
            remainder = self.fit_maps(best_fit) if best.effects else fitted_maps
            options = [best_fit, *(f for _, f in (*nameless[:1], *remainder[:1]))]
            after_fit = min(options, key=self._held_out_error)
        self.search.say("intervals", 0.99)
        after = self.state(after_fit, profile=not is_unknown)
        names_most = is_unknown and not map_wins and self.explains_most(base_fit, best_fit)
        verdict, record_next = self.judge(best, is_unknown, names_most, nameless)
        unexplained = None
        if is_unknown and nameless and nameless[0] in local_forces:
            unexplained = _describe(*nameless[0], base_fit)
        elif is_unknown:
            choice, map_fit = remainder[0]
            shape = self.on_top(choice, best_fit) if best.effects else map_fit
            unexplained = _describe(choice, shape, best_fit)
        return Diagnosis(
            self.plant, self.state(base_fit, profile=False), after, verdict, tuple(self.candidates(base)),
            unexplained, tuple(_describe(choice, result, base_fit) for choice, result in fitted_maps), record_next,
            alarm, tuple(channel.name for channel in self.plant.channels),
        )  # fmt: skip

    def _held_out_error(self, result: Fit) -> float:
        """Plain held-out error; where no form is right, whitening would hide what is slow in it. Else the score."""
        if self.holdout is None:
            return result.score
        held = self.hold_out(result, timing=self.needs_timing(result))
        return math.inf if held is None else rmse(held)

    def explains_most(self, base: Fit, best: Fit) -> bool:
        """Whether named effects more than halve the held-out error, so that what is left is a remainder of theirs."""
        return best is not base and self._held_out_error(best) < MOSTLY * self._held_out_error(base)

    def judge(
        self, best: Hypothesis, is_unknown: bool, names_most: bool, nameless: Sequence[tuple[ForceMap, Fit]]
    ) -> tuple[Verdict, str]:
        """The verdict, and what to record next; `nameless` are fits of forces without a name."""
        confusable = {name: self.alternatives(best, name) for name in best.effects}
        if is_unknown:
            confusable = {name: self.relatives(name, others) for name, others in confusable.items()}
        rivals = self.nameless_rivals(best, nameless)
        evidence = self.evidence(best, [worse for _, worse in rivals])
        doubtful = min(evidence, 0.5)
        strokes = _stroke_count(self.plant)
        too_wide = any(len(others) + 1 > LARGEST_CLASS for others in confusable.values())
        named = _listed(best.effects)
        if names_most:
            return Verdict(
                "effects", best.effects, confusable, evidence, doubtful,
                f"The model lacks {named}, {self.share(best):.1%} of the squared residual; a remainder is left that no "
                "catalogued effect explains.",
            ), self.advice(best)  # fmt: skip
        if is_unknown:
            nearest = f"; {named} comes nearest, with {self.share(best):.1%} of the squared residual" if named else ""
            return Verdict(
                "unknown", best.effects, confusable, evidence, doubtful,
                f"Something acts that no catalogued effect explains{nearest}.",
            ), self.advice(best)  # fmt: skip
        if strokes <= 1 or too_wide:
            why = "one stroke at one voltage cannot tell an effect from damping" if strokes <= 1 else (
                f"{1 + max(len(others) for others in confusable.values())} effects explain the data about equally well"
            )  # fmt: skip
            advice = self.advice(best)
            return Verdict("insufficient", best.effects, confusable, evidence, doubtful, f"{why}. {advice}"), advice
        if not best.effects:
            return Verdict(
                "none", (), {}, evidence, calibrated("none", evidence),
                "The declared model with refitted damping explains the data down to the noise.",
            ), ""  # fmt: skip
        others = sorted({other for names in confusable.values() for other in names})
        places = [
            f"a force at {_where(choice, fitted)} alone" for (choice, fitted), worse in rivals if worse < DECISIVE
        ]
        doubt = (
            f"; {_listed([*others, *places[:1]], 'or')} would explain the data about as well"
            if others or places
            else ""
        )
        return Verdict(
            "effects", best.effects, confusable, evidence, calibrated("effects", evidence),
            f"The model lacks {named}{doubt}.",
        ), self.advice(best) if others else ""  # fmt: skip

    def advice(self, best: Hypothesis) -> str:
        """What to record next."""
        return advise(_stroke_count(self.plant), self.telling_experiment(best))

    def telling_experiment(self, best: Hypothesis) -> Recommendation | None:
        """The recording that would tell the best hypothesis best from those of its size that do about as well."""
        candidates = {" + ".join(hypothesis.effects): self.search.fit(hypothesis) for hypothesis in self.rivals(best)}
        few = dict(list(candidates.items())[:LARGEST_CLASS])
        return recommend(few, self.plant.experiments) if len(few) > 1 else None

    def share(self, best: Hypothesis) -> float:
        """How much of the squared residual of the base a hypothesis explains, from 0 to 1."""
        return 1.0 - (rmse(self.search.fit(best)) / rmse(self.search.fit(Hypothesis((), best.timing)))) ** 2

    def alternatives(self, best: Hypothesis, member: str) -> tuple[str, ...]:
        """Effects that would do in place of a member."""
        rest = best.without(member)
        found = [
            name
            for hypothesis in self.rivals(best)
            for name in hypothesis.effects
            if name != member and hypothesis.effects == rest.adding(name).effects
        ]
        return tuple(dict.fromkeys(found))

    def relatives(self, name: str, found: Sequence[str]) -> tuple[str, ...]:
        """Names beside the best: where the form is wrong, scores mislead, and known confusions count too."""
        return tuple(dict.fromkeys([*found, *self.plant.effects[name].confused_with]))[: LARGEST_CLASS - 1]

    def nameless_rivals(
        self, best: Hypothesis, nameless: Sequence[tuple[ForceMap, Fit]]
    ) -> list[tuple[tuple[ForceMap, Fit], float]]:
        """Forces without a name that come near the best in S, and by how much they are worse.

        Held-out data are not asked: a force without a name need not predict better to make a name doubtful.
        """
        least = self.search.score(best)
        return [(pair, pair[1].score - least) for pair in nameless if pair[1].score < least + 2.0 * DECISIVE]

    def evidence(self, best: Hypothesis, nameless: Sequence[float]) -> float:
        """Share of the best set in all evidence but that for sets that merely extend it.

        Forces without a name have a share, too; `nameless` is by how much each is worse than the best
        set. A weak effect without a name is easily taken for a weak one with a name (measured on the campaign:
        at a tenth of a strong one, damping that varies with x passes for spring hardening), so weak evidence is
        never certain.
        """
        least, standings = self.search.score(best), self.standings(best)
        weight: dict[tuple[str, ...], float] = {}
        for hypothesis in self._tried():
            if set(hypothesis.effects) > set(best.effects) and best.effects:
                continue
            worse = standings.get(hypothesis, self.search.score(hypothesis) - least)
            evidence = math.exp(-0.5 * min(max(worse, 0.0), 700.0))
            weight[hypothesis.effects] = max(weight.get(hypothesis.effects, 0.0), evidence)
        least_worse = max(min(nameless, default=math.inf), 0.0)
        share = weight[best.effects] / (sum(weight.values()) + math.exp(-0.5 * least_worse))
        if not best.effects:
            return share
        gain = self.search.score(Hypothesis((), best.timing)) - least
        return share * -math.expm1(-gain / WEAK_EVIDENCE)

    def candidates(self, base: Hypothesis) -> list[Candidate]:
        """Everything tried, best first, at most thirty."""
        reference = self.search.score(base)
        listed = sorted((h for h in self._tried() if h.effects), key=self.search.score)[:30]
        found = []
        for hypothesis in listed:
            result = self.search.fit(hypothesis)
            held = self.hold_out(result, timing=self._reported_timing)
            intervals = {name: covariance_interval(result, name) for name in result.free}
            found.append(
                Candidate(
                    hypothesis.effects, hypothesis.timing, self.search.score(hypothesis) - reference,
                    rmse(result), math.nan if held is None else rmse(held), intervals,
                )
            )  # fmt: skip
        return found

    def state(self, result: Fit, *, profile: bool) -> State:
        """A fit with all that a report says of it."""
        held = self.hold_out(result, timing=self._reported_timing)
        intervals = {
            name: profile_interval(result, name)[0]
            if profile and ("." in name or result.is_entangled(name))
            else covariance_interval(result, name)
            for name in result.free
        }
        return State(result, held, rmse(result), math.nan if held is None else rmse(held), adequacy(result), intervals)


def rmse(result: Fit) -> float:
    """Root mean square of measured less predicted position (or force) over the samples that take part."""
    plant, problem = result.problem.plant, result.problem
    squares, count = 0.0, 0
    for index, (channel, shown) in enumerate(zip(plant.channels, plant.predict(result.values), strict=True)):
        if channel.kind == "current":
            continue
        takes_part = problem.weight(index) > 0.0
        squares += float(np.sum(np.square((channel.data - shown)[takes_part])))
        count += int(np.count_nonzero(takes_part))
    return math.sqrt(squares / max(1, count))


def advise(strokes: int, telling: Recommendation | None) -> str:
    """What to record next to tell effects apart (METHOD: releases, voltages and short pulses separate them)."""
    if strokes <= 1:
        advice = (
            "Record next: eight strokes with their releases at 7.5 to 14 V, about 30 ms on and 30 ms off, "
            "in one bag at 20 kHz"
        )
    else:
        advice = "Record next: strokes at voltages not used yet, a peak-and-hold stroke, and pulses of 3 to 5 ms"
    if telling is None:
        return f"{advice}."
    one, other = telling.pair
    return (
        f"{advice}; of single pulses {telling.experiment.words} tells most: it sets {one} and {other} apart by "
        f"{telling.separation:.0f} standard deviations, and others by more."
    )


def _listed(names: Sequence[str], last: str = "and") -> str:
    """Names as in a sentence: a, b and c."""
    return f" {last} ".join(part for part in (", ".join(names[:-1]), *names[-1:]) if part)


def _stroke_count(plant: Plant) -> int:
    return sum(int(channel.group.max()) + 1 for channel in plant.channels if channel.kind != "current")


def _split(plant: Plant) -> tuple[Mask | None, Mask | None]:
    """Masks for training and held-out strokes, or None twice when there are too few strokes to hold any out."""
    if _stroke_count(plant) < EVERY_FOURTH:
        return None, None

    def is_held(groups: NDArray[np.int64]) -> NDArray[np.bool_]:
        return np.asarray(groups % EVERY_FOURTH == EVERY_FOURTH - 2)

    return (lambda index, groups: ~is_held(groups)), (lambda index, groups: is_held(groups))


def _describe(choice: ForceMap, result: Fit, base: Fit) -> Unexplained:
    """A fitted force map in words: how large, and where it acts."""
    at, force = _curve(choice, result)
    return Unexplained(
        float(np.sqrt(np.mean(np.square(force)))), _where(choice, result), choice.variable, tuple(at.tolist()),
        tuple(force.tolist()), base.score - result.score,
    )  # fmt: skip


def _curve(choice: ForceMap, result: Fit) -> tuple[Array, Array]:
    """Knots of a fitted force map, and the force there, N."""
    at = np.linspace(choice.low, choice.high, len(choice.all_knots))
    return at, np.array([result.values[name] for name in choice.all_knots])


def _where(choice: ForceMap, result: Fit) -> str:
    """Where a fitted force map acts, in words."""
    at, force = _curve(choice, result)
    strong = np.flatnonzero(np.abs(force) >= 0.5 * np.max(np.abs(force)))
    low, high = at[max(0, strong[0] - 1)], at[min(len(at) - 1, strong[-1] + 1)]
    scale, unit = (1e3, "mm") if choice.unit == "m" else (1e3, "ms") if choice.unit == "s" else (1.0, "m/s")
    words = f"{choice.variable[0]} {scale * low:.3g} to {scale * high:.3g} {unit}"
    return words + (f", times {choice.variable[2:]}" if len(choice.variable) > 1 else "")


def to_json(diagnosis: Diagnosis) -> dict[str, Any]:
    """The content of report.json, MODEL section 6."""
    noise = next(noise for kind, noise in diagnosis.before.fit.problem.noises.items() if kind != "current")
    return {
        "schema": "valve_sim/diagnosis/1",
        "sources": list(diagnosis.sources),
        "noise_um": 1e6 * noise.sigma,
        "before": _state_json(diagnosis.before),
        "verdict": {
            "kind": diagnosis.verdict.kind,
            "effects": list(diagnosis.verdict.effects),
            "confusable_with": {name: list(others) for name, others in diagnosis.verdict.confusable_with.items()},
            "probability": diagnosis.verdict.probability,
            "evidence": diagnosis.verdict.evidence,
            "summary": diagnosis.verdict.summary,
        },
        "after": {**_state_json(diagnosis.after), "effects": _effects_json(diagnosis.after)},
        "candidates": [
            {
                "effect": " + ".join(candidate.effects),
                "effects": list(candidate.effects),
                "command_errors": candidate.timing,
                "delta_bic": candidate.delta_score,
                "rmse_um": {"train": 1e6 * candidate.train_rmse, "holdout": _number(1e6 * candidate.holdout_rmse)},
                "parameters": {name: interval.to_json() for name, interval in candidate.intervals.items()},
            }
            for candidate in diagnosis.candidates
        ],
        "unexplained": None if diagnosis.unexplained is None else _unexplained_json(diagnosis.unexplained),
        "force_maps": [_unexplained_json(entry) for entry in diagnosis.maps],
        "record_next": diagnosis.record_next or None,
        "false_alarm": diagnosis.false_alarm._asdict(),
    }


def _state_json(state: State) -> dict[str, Any]:
    return {
        "parameters": {name: i.to_json() for name, i in state.intervals.items() if "." not in name},
        "rmse_um": {"train": 1e6 * state.train_rmse, "holdout": _number(1e6 * state.holdout_rmse)},
        "white": state.adequacy.is_white,
        "chi2_per_sample": state.fit.chi2 / state.fit.problem.effective_samples,
        "test": {"p_value": state.adequacy.p_value, "worst": state.adequacy.worst},
    }


def _effects_json(state: State) -> dict[str, dict[str, Any]]:
    effects: dict[str, dict[str, Any]] = {}
    for name, interval in state.intervals.items():
        effect, dot, parameter = name.partition(".")
        if dot:
            effects.setdefault(effect, {})[parameter] = interval.to_json()
    for name, value in state.fit.values.items():
        effect, dot, parameter = name.partition(".")
        if dot and effect in effects and parameter not in effects[effect]:
            effects[effect][parameter] = {"value": value, "stderr": 0.0, "ci95": [value, value]}
    return effects


def _unexplained_json(entry: Unexplained) -> dict[str, Any]:
    return {
        "force_rms_n": entry.force_rms,
        "where": entry.where,
        "variable": entry.variable,
        "at": list(entry.at),
        "force": list(entry.force),
        "delta_bic": -entry.gain,
    }


def _number(value: float) -> float | None:
    return value if math.isfinite(value) else None
