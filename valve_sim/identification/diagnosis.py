"""Close the loop: trace the residual to the missing effect, add it, report the error before and after.

The method follows METHOD.md: base fit, test of what is left, refit of the whole catalogue inside the simulator,
forward selection with swaps and backward elimination, ambiguity class, hold-out, force maps for what has no name.
Where it departs: effects, timing errors and force maps are compared on one scale, the score S of `fitting`, and
timing errors of single commands pay the Occam factor of their prior instead of being tried last.
"""

from __future__ import annotations

import math
from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from typing import Final

import numpy as np
from numpy.typing import NDArray

from valve_sim.identification.adequacy import Adequacy, adequacy
from valve_sim.identification.calibration import calibrated
from valve_sim.identification.current_form import doubt_of_current
from valve_sim.identification.exploration import LARGEST_CLASS, LIKELY, Exploration
from valve_sim.identification.false_alarm import FalseAlarm, false_alarm
from valve_sim.identification.fitting import Fit, Interval, Mask, Problem, covariance_interval, profile_interval, rmse
from valve_sim.identification.held_out import HeldOut
from valve_sim.identification.nameless import Unexplained, describe, fit_local_forces, fit_maps, on_top, where
from valve_sim.identification.next_recording import Recommendation, recommend
from valve_sim.identification.plant import ForceMap, Plant
from valve_sim.identification.search import DECISIVE, Hypothesis, Progress, Search
from valve_sim.identification.valve_plant import ValvePlant
from valve_sim.model import Valve
from valve_sim.traces import Trace

EVERY_FOURTH: Final = 4
"""Of the strokes is held out where no hold-out bag is given."""
WEAK_EVIDENCE: Final = 30.0
"""Gain of S at which a name is still as doubtful as 63 %; at five detection limits the gain is some hundreds."""
MOSTLY: Final = 0.5
"""Held-out error with named effects over that without, below which they are named beside an unexplained remainder."""
MOST_FALSE_ALARMS: Final = 0.01
"""Probability that the search finds as much in noise alone, beyond which nothing is claimed."""


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
class Diagnosis:
    """The outcome of `diagnose_plant`; `telling` is the experiment that `record_next` advises, where one is known."""

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
    telling: Recommendation | None = None

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
    exploration = _begun(plant, holdout, progress)
    return _Conclusion(exploration).conclude(exploration.explore())


def _begun(plant: Plant, holdout: Plant | None, progress: Progress | None) -> Exploration:
    """What is fitted and what is held out, with nothing tried yet."""
    train_mask, holdout_mask = _split(plant) if holdout is None else (None, None)
    problem = Problem(plant, train_mask)
    # Believed to the last milliampere, a current of another form would bend the motion to it.
    doubt = doubt_of_current(problem)
    problem = problem.doubting("current", doubt)
    held_out = None
    if holdout is not None:
        held_out = Problem(holdout).doubting("current", doubt)
    elif holdout_mask is not None:
        held_out = problem.restricted(holdout_mask)
    return Exploration(Search(problem, progress), HeldOut(plant, held_out))


class _Conclusion:
    """What an exploration comes to: the claim, what it leaves, and the words."""

    def __init__(self, exploration: Exploration) -> None:
        self.exploration, self.search, self.held_out = exploration, exploration.search, exploration.held_out
        self.plant = exploration.plant
        self._reported_timing = False
        self._telling: Recommendation | None = None

    def conclude(self, explored: Hypothesis) -> Diagnosis:
        """Judge the best that was explored, and word it."""
        search, is_adequate = self.search, self.exploration.is_adequate
        best, alarm = self.claimed(explored)
        base = Hypothesis((), best.timing)
        base_fit, best_fit = search.fit(base), search.fit(best)
        is_explained = is_adequate(base) and not self.is_refuted(base)
        maps = [] if is_explained else fit_maps(search, base_fit)
        can_tell = is_adequate(best) and _stroke_count(self.plant) > 1
        local_forces = fit_local_forces(search, best) if can_tell else []
        nameless = sorted([*maps, *local_forces], key=lambda pair: pair[1].score)
        map_wins = bool(nameless) and nameless[0][1].score < best_fit.score - DECISIVE
        is_unknown = map_wins or not is_adequate(best) or self.is_refuted(best)
        self._reported_timing = self.held_out.needs_timing(best_fit)
        after_fit, unexplained = best_fit, None
        if is_unknown:
            remainder = fit_maps(search, best_fit) if best.effects else maps
            options = [best_fit, *(fitted for _, fitted in (*nameless[:1], *remainder[:1]))]
            after_fit = min(options, key=self.held_out.error)
            if nameless and nameless[0] in local_forces:
                unexplained = describe(*nameless[0], base_fit)
            else:
                choice, map_fit = remainder[0]
                unexplained = describe(choice, on_top(choice, best_fit) if best.effects else map_fit, best_fit)
        search.say("intervals", 0.99)
        after = self.state(after_fit, profile=not is_unknown)
        names_most = is_unknown and not map_wins and self.explains_most(base_fit, best_fit)
        verdict, record_next = self.judge(best, is_unknown, names_most, nameless)
        return Diagnosis(
            self.plant, self.state(base_fit, profile=False), after, verdict, tuple(self.candidates(base)),
            unexplained, tuple(describe(choice, result, base_fit) for choice, result in maps), record_next,
            alarm, tuple(channel.name for channel in self.plant.channels), self._telling,
        )  # fmt: skip

    def claimed(self, best: Hypothesis) -> tuple[Hypothesis, FalseAlarm]:
        """What of the best explored survives rivals, held-out data and the bootstrap; the base where nothing does."""
        exploration, search = self.exploration, self.search
        if not exploration.is_adequate(best):
            best = exploration.eliminate(exploration.best_on_hold_out(best))
        if best.effects:
            exploration.polish_near(best)
            best = next(filter(exploration.is_claimable, exploration.rivals(best)), best)
        base = Hypothesis((), best.timing)
        if best.effects and not self.held_out.earns(search.fit(base), search.fit(best)):
            best = base
        search.say("what the same search finds in noise alone", 0.88)
        alarm = false_alarm(search.fit(base), search.fit(best))
        if best.effects and exploration.is_adequate(best) and alarm.probability > MOST_FALSE_ALARMS:
            best = base
        return best, alarm

    def is_refuted(self, hypothesis: Hypothesis) -> bool:
        """Whether it leaves more than noise of held-out data; dampings of a single stroke are too uncertain to say."""
        is_founded = bool(hypothesis.effects) or _stroke_count(self.plant) > 1
        return is_founded and self.exploration.fails_hold_out(hypothesis)

    def explains_most(self, base: Fit, best: Fit) -> bool:
        """Whether named effects more than halve the held-out error, so that what is left is a remainder of theirs."""
        return best is not base and self.held_out.error(best) < MOSTLY * self.held_out.error(base)

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
        places = [f"a force at {where(choice, fitted)} alone" for (choice, fitted), worse in rivals if worse < DECISIVE]
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
        self._telling = self.telling_experiment(best)
        return advise(_stroke_count(self.plant), self._telling)

    def telling_experiment(self, best: Hypothesis) -> Recommendation | None:
        """The recording that would tell the best hypothesis best from those of its size that do about as well."""
        candidates = {
            " + ".join(hypothesis.effects): self.search.fit(hypothesis) for hypothesis in self.exploration.rivals(best)
        }
        few = dict(list(candidates.items())[:LARGEST_CLASS])
        return recommend(few, self.plant.experiments) if len(few) > 1 else None

    def share(self, best: Hypothesis) -> float:
        """How much of the squared residual of the base a hypothesis explains, from 0 to 1."""
        return 1.0 - (rmse(self.search.fit(best)) / rmse(self.search.fit(Hypothesis((), best.timing)))) ** 2

    def alternatives(self, best: Hypothesis, member: str) -> tuple[str, ...]:
        """Effects that would do in place of a member: rivals, and its look-alikes with more parameters."""
        rest = best.without(member)

        def in_its_place(hypotheses: Sequence[Hypothesis]) -> list[str]:
            names = [name for hypothesis in hypotheses for name in hypothesis.effects]
            sets = {hypothesis.effects for hypothesis in hypotheses}
            return [name for name in names if name != member and rest.adding(name).effects in sets]

        rivals = in_its_place(self.exploration.rivals(best))
        likely = [hypothesis for hypothesis, worse in self.exploration.richer(best).items() if worse < LIKELY]
        return tuple(dict.fromkeys([*rivals, *in_its_place(likely)]))

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
        least = self.search.score(best)
        standings = {**self.exploration.standings(best), **self.exploration.richer(best)}
        weight: dict[tuple[str, ...], float] = {}
        for hypothesis in self.exploration.tried():
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
        listed = sorted((h for h in self.exploration.tried() if h.effects), key=self.search.score)[:30]
        found = []
        for hypothesis in listed:
            result = self.search.fit(hypothesis)
            held = self.held_out.fit(result, timing=self._reported_timing)
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
        held = self.held_out.fit(result, timing=self._reported_timing)
        intervals = {
            name: profile_interval(result, name)[0]
            if profile and ("." in name or result.is_entangled(name))
            else covariance_interval(result, name)
            for name in result.free
        }
        return State(result, held, rmse(result), math.nan if held is None else rmse(held), adequacy(result), intervals)


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
        f"{advice}; of single pulses {telling.experiment.words} tells most: {telling.repeats} of them set {one} and "
        f"{other} apart by {math.sqrt(telling.repeats) * telling.separation:.0f} standard deviations, others by more."
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
