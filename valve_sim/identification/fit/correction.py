"""Which correction predicts strokes that it has not seen, whatever its names: theory, section 9.

    score every set that was fitted, and one smooth curve in its place: ln of the error of each condition, left out
    the posterior's set, where its form is right, its class sure, and nothing predicts clearly better; else
    the smallest set within one standard error of the best; a curve only where it takes a tenth more off
    applied where the error of unseen conditions falls by a third, decisively, and real refits say the same

Correcting needs no belief in the form; naming does, and is left to the posterior and to `grades`.
"""

from __future__ import annotations

import math
from collections.abc import Callable, Iterable, Mapping, Sequence
from dataclasses import dataclass, replace
from typing import Final, Literal, NamedTuple

import numpy as np
from scipy.special import stdtrit

from valve_sim.identification.fit.descent import Descended, descend
from valve_sim.identification.fit.fitter import Tried
from valve_sim.identification.fit.gaussian import Gaussian, Sizes
from valve_sim.identification.fit.held_out import machine_values
from valve_sim.identification.fit.left_out import (
    LeftOut,
    Part,
    expected_log_rms,
    left_by,
    left_out,
    parts_of,
    predicting,
    response_in_motion,
)
from valve_sim.identification.fit.model import Model
from valve_sim.identification.fit.posterior import EVEN, SURE, Decision, Set
from valve_sim.identification.fit.remains import Place, place_of
from valve_sim.identification.fit.score_test import log_gains
from valve_sim.identification.fit.search import Search, added, without
from valve_sim.identification.fit.starts import starts_of
from valve_sim.identification.plants.protocol import Array, Plant, primary_channels
from valve_sim.model import SimulationError

FALLS: Final = math.log(1.5)
"""Ln of the factor by which a correction without names that are sure must lower the error of unseen conditions."""
DECISIVE: Final = 2.0
"""Standard errors by which a fall, or a curve's advantage, must differ from nothing."""
CURVE_TAKES: Final = 0.1
"""Ln of the error that a curve must take off beyond the best set of names: a tenth."""
CURVE_SIZE: Final = 4
"""Numbers that a smooth curve is worth, whatever its splines."""
MATTERS: Final = math.log(1.05)
"""Ln of the factor between errors, below which they are equal, however small its standard error."""
SWAPS: Final = 4
"""Look-alikes of each member, by the score test, that are fitted in its place."""
COMPARED: Final = 4
"""Sets that predict as well, of which it is asked how far they differ on other commands."""
ROUNDS: Final = 2
"""Of swaps, where these change the choice."""
SWAPPED: Final = 12
"""Linearisations of a set in which one member was swapped."""
OWN_STEPS: Final = 6
"""Linearisations by which the errors of a stroke's own recording follow it."""
WORTH_A_STEP: Final = 1.0
"""Fall of the criterion from which one more is made."""


class Score(NamedTuple):
    """How well a set predicts what it has not seen: (g,) ln of the error of each part; how many numbers it frees."""

    logs: Array
    size: int

    def rise(self, other: Score) -> tuple[float, float]:
        """Mean over parts by which the other's errors are larger, as a logarithm, and its standard error."""
        apart = other.logs - self.logs
        return float(np.mean(apart)), float(np.std(apart, ddof=1)) / math.sqrt(len(apart))


Scores = Mapping[Set, Score]


def is_curve(names: Set) -> bool:
    """Whether a set is a smooth curve in place of names."""
    return any(name.startswith("curve(") for name in names)


# -- the rule ----------------------------------------------------------------------------------------------------------


class Choice(NamedTuple):
    """What the rule says.

    Attributes:
        names: the set. by: what has chosen it. is_applied: whether it is to be used.
    """

    names: Set
    by: Literal["posterior", "prediction"]
    is_applied: bool


def near(scores: Scores) -> list[Set]:
    """The sets that predict as well as the best within one standard error, the best first."""
    best = min(scores, key=lambda names: _mean_log(scores[names]))

    def is_near(names: Set) -> bool:
        rise, error = scores[best].rise(scores[names])
        return rise <= max(error, MATTERS)

    return sorted(filter(is_near, scores), key=lambda names: _mean_log(scores[names]))


def _mean_log(score: Score) -> float:
    return float(np.mean(score.logs))


def by_prediction(scores: Scores) -> Set:
    """The smallest set near the best, if it is decisively better than none; a curve where it is clearly better yet."""
    named = {names: score for names, score in scores.items() if not is_curve(names)}
    found = _smallest(named)
    curve = _smallest(scores)
    if is_curve(curve):
        rise, error = scores[curve].rise(scores[found])
        if rise > max(CURVE_TAKES, DECISIVE * error):
            return curve
    return found


def _smallest(scores: Scores) -> Set:
    size = min(scores[names].size for names in near(scores))
    # One that is near because its errors scatter gives way to a better one that is as small.
    found = min((names for names in scores if scores[names].size <= size), key=lambda names: _mean_log(scores[names]))
    rise, error = scores[found].rise(scores[()])
    return found if found == () or rise > max(DECISIVE * error, MATTERS) else ()


def falls(scores: Scores, names: Set) -> bool:
    """Whether a set lowers the error of unseen parts by a third, and decisively."""
    rise, error = scores[names].rise(scores[()])
    return rise >= FALLS and rise > DECISIVE * error


def chosen(scores: Scores, decision: Decision) -> Choice:
    """The correction.

    Args:
        scores: of all that was fitted, of nothing among them; none where nothing could be left out.
        decision: of the posterior.
    """
    is_sure = decision.kind in ("none", "effects") or (decision.unnamed <= EVEN and decision.probability >= SURE)
    if is_sure and (not scores or agrees(scores, decision.names)):
        return Choice(decision.names, "posterior", bool(decision.names))
    names = by_prediction(scores) if scores else ()
    return Choice(names, "prediction", bool(names) and falls(scores, names))


def agrees(scores: Scores, names: Set) -> bool:
    """Whether unseen parts do not speak against a set: it is not plainly worse than the best, nor than nothing.

    Where the form is right the posterior is the sharper test: few parts that scatter do not overrule it.
    """
    if names not in scores:
        return False
    return not any(is_worse(scores[names], scores[one]) for one in (near(scores)[0], ()))


def is_worse(score: Score, than: Score) -> bool:
    """Whether a set errs more than another one, by Student's t of the paired differences at 95 %."""
    rise, error = than.rise(score)
    return rise > max(MATTERS, float(stdtrit(len(score.logs) - 1, 0.975)) * error)


# -- what is scored ----------------------------------------------------------------------------------------------------


class Scoring:
    """Sets of a finished search with their predictions of what is left out, and further ones.

    Args:
        search: that has ended.

    Attributes:
        parts: what is left out in turn. tried, left, scores: by set. cut_short: what the budget did not allow.
    """

    def __init__(self, search: Search) -> None:
        self.search, self.parts = search, parts_of(search.problem)
        self.tried: dict[Set, Tried] = {}
        self.left: dict[Set, LeftOut] = {}
        self.scores: dict[Set, Score] = {}
        self.cut_short: list[str] = []
        for names, tried in search.tried.items():
            self.add(names, tried)
        if () not in self.scores:
            self.parts, self.scores = [], {}

    def add(self, names: Set, tried: Tried) -> None:
        """Score a set, if it was fitted to its end."""
        if not (tried.is_fitted and math.isfinite(tried.plain)):
            return
        self.tried[names] = tried
        if not self.parts:
            return
        try:
            self.left[names] = left_out(tried.fit.gaussian, self.parts)
        except np.linalg.LinAlgError:
            return
        hypotheses = self.search.fitter.hypotheses
        size = sum(CURVE_SIZE if is_curve((name,)) else len(hypotheses[name].frees) for name in names)
        self.scores[names] = Score(self.left[names].log_rms, size)

    def _is_cut_short(self, what: str) -> bool:
        if not self.search.problem.budget.is_used_up:
            return False
        if what not in self.cut_short:
            self.cut_short.append(what)
        return True

    def add_swaps(self, names: Set) -> None:
        """What would do in place of each member of a set, or without it."""
        fitter = self.search.fitter
        for member in names:
            rest = without(names, member)
            if self._is_cut_short("look-alikes"):
                return
            if rest not in self.tried:
                self._fit(rest, [self.tried[names].values])
            if rest not in self.tried:
                continue
            prior = fitter.rivals.log_prior
            gains = {
                name: gain + prior(added(rest, name))[0]
                for name, gain in log_gains(fitter, rest, self.tried[rest]).items()
            }
            likely = sorted((one for one in gains if one != member), key=lambda one: -gains[one])[:SWAPS]
            known = [one for one in fitter.hypotheses[member].confused_with if one in gains and one not in names]
            for other in dict.fromkeys((*likely, *known)):
                swapped = added(rest, other)
                if swapped in self.tried or self._is_cut_short("look-alikes"):
                    continue
                starts = starts_of(fitter, swapped, rest, self.tried[rest])
                self._fit(swapped, [start.values for start in starts])

    def _fit(self, names: Set, starts: Iterable[Mapping[str, float]]) -> None:
        fitter = self.search.fitter
        fits = [fitter.descended(fitter.model(names), start, most=SWAPPED) for start in starts]
        fit = min((one for one in fits if one is not None), key=lambda one: one.cost, default=None)
        if fit is not None:
            self.add(names, fitter.weighed(names, fit, spreads=False))

    def add_curves(self) -> None:
        """One smooth curve after the other in place of names."""
        if self.search.fitter.curves and not self._is_cut_short("smooth curves"):
            for name, tried in self.search.curves.items():
                self.add((name,), tried)


# -- real refits -------------------------------------------------------------------------------------------------------


class Errors(NamedTuple):
    """Sums of squares of the response in motion less what is predicted, in its unit, and how many samples."""

    squares: float
    samples: int


def refitted_errors(fit: Descended, parts: Sequence[Part]) -> list[Errors]:
    """Each part predicted by a fit to the others.

    Args:
        fit: to all data, from where the others begin. parts: what is left out in turn.

    Raises:
        SimulationError: a fit to the others cannot be simulated.
        numpy.linalg.LinAlgError: the others do not determine what is freed.
    """
    return [_refitted(fit.gaussian, part) for part in parts]


def _refitted(fit: Gaussian, part: Part) -> Errors:
    model, problem = fit.model, fit.model.problem
    others = problem.restricted(part.takes(problem, inside=False)).condensed()
    rest = descend(Model(others, model.unknowns, model.held), fit.z, fit.sizes).gaussian
    z, coefficients = _own_at_best(model, rest, fit.sizes)
    left = residuals_at(model, z, coefficients)
    squares, count = 0.0, 0
    takes = part.takes(problem, inside=True)
    for index in primary_channels(problem.plant):
        channel = problem.plant.channels[index]
        counted = takes(index, channel.group)
        moving = counted & ~channel.quiet
        used = left[index][moving if moving.any() else counted]
        squares, count = squares + float(used @ used), count + len(used)
    return Errors(squares, count)


def _own_at_best(model: Model, rest: Gaussian, sizes: Sizes) -> tuple[Array, Array]:
    """(k,) coordinates and (q,) coefficients, of which a part's own follow its data and all else stays as in `rest`.

    One step is not enough where stamps or a clock are far off: times act on motion by its bends.
    """
    z, here, least, coefficients = rest.z, rest.z, math.inf, np.empty(0)
    for _ in range(OWN_STEPS):
        whole = Gaussian(model, z, model.linearise(z), sizes)
        if not whole.cost < least - WORTH_A_STEP:
            break
        here, least, move = z, whole.cost, predicting(whole, rest, np.zeros(rest.count))
        z, coefficients = np.clip(z + move[: rest.count], rest.lower, rest.upper), move[rest.count :]
    return here, coefficients


def residuals_at(model: Model, z: Array, coefficients: Array) -> list[Array]:
    """What each channel shows less the prediction and the errors of its sensor, in its unit.

    Raises:
        SimulationError: the machine cannot be simulated there.
    """
    columns, plant = model.problem.columns, model.problem.plant
    every = np.zeros(len(columns.unknowns))
    every[[own.column for own in model.linear]] = coefficients
    found = []
    for index, shown in enumerate(plant.predict(model.values(z))):
        left = plant.channels[index].data - shown
        own = columns.samples.get(index)
        if own is not None and own.shape[1]:
            left = left - own @ every[columns.first[index] : columns.first[index] + own.shape[1]]
        found.append(left)
    return found


# -- the outcome -------------------------------------------------------------------------------------------------------


class ConditionError(NamedTuple):
    """Errors of the strokes of one condition, predicted without them, in the response's unit.

    Attributes:
        words: the condition. before, after: of the declared model, refitted, and of the corrected one.
    """

    words: str
    before: float
    after: float


class ChannelMisfit(NamedTuple):
    """What a kind of channel leaves in motion, in its unit: the noise, and before and after, all strokes fitted."""

    noise: float
    before: float
    after: float


class Elsewhere(NamedTuple):
    """Commands that were not recorded.

    Attributes:
        words: what they are. moved: rms by which the correction changes the response there, in its unit.
        spread: rms of how far other sets that predict as well differ from it there.
    """

    words: str
    moved: float
    spread: float


@dataclass(frozen=True)
class Correction:
    """A correction by prediction.

    Attributes:
        names: what is corrected, or the name of a curve; what would be, where it is not applied.
        by: what has chosen it. is_applied: whether it is to be used.
        conditions: errors of what is left out. is_refitted: whether by real refits, and not from the sums alone.
        noise: of the response, in its unit. predicted: what the posterior expects of the error after.
        alternatives: other sets that predict as well. spread: rms of how far these differ on the recorded strokes.
        channels: by kind. scores, tried: of all sets. parts: what was left out.
        cut_short: what the budget did not allow.
        elsewhere: of commands that nobody recorded, where other sets predict as well.
    """

    names: Set
    by: Literal["posterior", "prediction"]
    is_applied: bool
    conditions: tuple[ConditionError, ...]
    is_refitted: bool
    noise: float
    predicted: float
    alternatives: tuple[Set, ...]
    spread: float
    channels: Mapping[str, ChannelMisfit]
    scores: Scores
    tried: Mapping[Set, Tried]
    parts: tuple[Part, ...] = ()
    cut_short: tuple[str, ...] = ()
    elsewhere: tuple[Elsewhere, ...] = ()

    @property
    def fit(self) -> Tried:
        """The fit of what is applied, else of the declared model."""
        return self.tried[self.names if self.is_applied else ()]

    @property
    def place(self) -> Place | None:
        """Where in the motion that fit leaves most; None where no place stands out, and of a long recording."""
        return None if self.fit.fit.gaussian.model.problem.is_long else place_of(self.fit)

    @property
    def before(self) -> float:
        """Error of unseen conditions of the declared model, refitted: their geometric mean; nan without conditions."""
        return _mean(own.before for own in self.conditions)

    @property
    def after(self) -> float:
        """The same of the corrected model."""
        return _mean(own.after for own in self.conditions)

    @property
    def best(self) -> float:
        """The same of the set that predicts best, by the sums; nan without conditions."""
        if not self.scores:
            return math.nan
        leads, here = (_mean_log(self.scores[names]) for names in (near(self.scores)[0], self.names))
        return self.after * math.exp(leads - here)

    @property
    def share(self) -> float:
        """The part of the misfit beyond noise that it removes on unseen conditions; nan where there is none."""
        gap = self.before - self.noise
        return (self.before - self.after) / gap if gap > 0.0 else math.nan


def elsewhere(tried: Mapping[Set, Tried], names: Set, others: Sequence[Set], plant: Plant) -> tuple[Elsewhere, ...]:
    """How far a correction is to be believed on commands that a plant knows and nobody has recorded.

    Args:
        tried: the fits by set. names: the correction. others: sets that predict as well. plant: that was recorded.
    """
    values = [machine_values(tried[own].result) for own in ((), names, *others[:COMPARED])]
    found = []
    for experiment in plant.experiments:
        try:
            declared, here, *alike = [_response(experiment.simulated(own)) for own in values]
        except SimulationError:
            continue
        spread = math.sqrt(float(np.mean([np.mean(np.square(own - here)) for own in alike]))) if alike else 0.0
        found.append(Elsewhere(experiment.words, math.sqrt(float(np.mean(np.square(declared - here)))), spread))
    return tuple(found)


def _response(plant: Plant) -> Array:
    return np.concatenate([plant.channels[index].data for index in primary_channels(plant)])


def _mean(errors: Iterable[float]) -> float:
    logs = [math.log(max(error, 1e-300)) for error in errors]
    return math.exp(math.fsum(logs) / len(logs)) if logs else math.nan


def correct(search: Search, decision: Decision, confirms: Callable[[Tried, Tried], bool]) -> Correction:
    """The correction that a finished search allows.

    Args:
        search: that has ended. decision: of its posterior.
        confirms: whether held-out strokes confirm that the second fit predicts far better than the first.
    """
    scoring = Scoring(search)
    choice = chosen(scoring.scores, decision)
    if scoring.scores:
        for _ in range(ROUNDS if choice.names else 0):
            scoring.add_swaps(choice.names)
            before, choice = choice, chosen(scoring.scores, decision)
            if choice.names == before.names:
                break
        if decision.unnamed > EVEN:
            scoring.add_curves()
            choice = chosen(scoring.scores, decision)
    found = _outcome(scoring, choice)
    return found if found.is_applied else _confirmed(scoring, found, decision, confirms)


def _confirmed(
    scoring: Scoring, found: Correction, decision: Decision, confirms: Callable[[Tried, Tried], bool]
) -> Correction:
    """The correction that held-out strokes confirm, where left-out ones do not: the one found, or the posterior's.

    (Where each stroke has errors of its own, such as stamps that scatter, these follow what the model lacks; and full
    strokes hide what partial lifts show.) What raises the error of left-out strokes is not helped by held-out ones.
    """
    declared, names = scoring.tried[()], decision.names
    if found.names and found.after < found.before and confirms(declared, scoring.tried[found.names]):
        return replace(found, is_applied=True)
    # Refits cost most, and are made last.
    is_other = names not in ((), found.names) and agrees(scoring.scores, names)
    if is_other and confirms(declared, scoring.tried[names]):
        other = _outcome(scoring, Choice(names, "prediction", is_applied=False))
        if other.after < other.before:
            return replace(other, is_applied=True)
    return found


def _outcome(scoring: Scoring, choice: Choice) -> Correction:
    search, parts, names = scoring.search, scoring.parts, choice.names
    if names not in scoring.tried:
        scoring.tried[names] = search.tried[names]
    noise = search.problem.noise
    by_sums = {
        one: [noise.innovation * math.exp(log) for log in scoring.scores[one].logs.tolist()]
        for one in ((), names)
        if one in scoring.scores
    }
    errors, is_refitted = by_sums, False
    is_applied = choice.is_applied
    if names and parts and not scoring._is_cut_short("refits without each condition"):
        real = {one: _refits(scoring.tried[one].fit, parts) for one in ((), names)}
        if all(real.values()):
            errors, is_refitted = {one: list(own) for one, own in real.items()}, True
            confirmed = {one: Score(np.log(own), 0) for one, own in errors.items()}
            is_applied &= (
                falls(confirmed, names) if choice.by == "prediction" else not is_worse(confirmed[names], confirmed[()])
            )
    conditions = [
        ConditionError(part.words, before, after)
        for part, before, after in zip(parts, errors.get((), []), errors.get(names, []), strict=False)
    ]
    alternatives = [one for one in near(scoring.scores) if one != names] if scoring.scores else []
    return Correction(
        names, choice.by, is_applied, tuple(conditions), is_refitted, noise.sigma, _predicted(scoring, names),
        tuple(alternatives), noise.innovation * _spread(scoring, names, alternatives), _channels(scoring, names),
        scoring.scores, scoring.tried, tuple(parts), tuple(scoring.cut_short),
        elsewhere(scoring.tried, names, alternatives, search.problem.plant) if is_applied and alternatives else (),
    )  # fmt: skip


def _refits(fit: Descended, parts: Sequence[Part]) -> list[float]:
    """Errors of real refits, in the response's unit; none where one fails."""
    try:
        found = refitted_errors(fit, parts)
    except (SimulationError, np.linalg.LinAlgError):
        return []
    return [math.sqrt(max(own.squares, 1e-300) / own.samples) for own in found]


def _predicted(scoring: Scoring, names: Set) -> float:
    """What the posterior expects of the error of unseen conditions, in the response's unit; nan where it cannot say.

    That is where there are none, and where all but one of them do not determine what is freed.
    """
    if names not in scoring.scores:
        return math.nan
    tried = scoring.tried[names]
    tau = tried.spread.tau if tried.spread.log_evidence > tried.plain else 0.0
    try:
        logs = expected_log_rms(tried.fit.gaussian, scoring.parts, tau)
    except np.linalg.LinAlgError:
        return math.nan
    return scoring.search.problem.noise.innovation * math.exp(float(np.mean(logs)))


def _spread(scoring: Scoring, names: Set, alternatives: Sequence[Set]) -> float:
    """Rms of how far other sets that predict as well differ from a set, in standard deviations of the noise."""
    if not alternatives:
        return 0.0
    seen = response_in_motion(scoring.search.problem)
    here = left_by(scoring.tried[names].fit.gaussian)
    apart = [(left_by(scoring.tried[one].fit.gaussian) - here)[seen] for one in alternatives]
    return math.sqrt(float(np.mean([np.mean(np.square(own)) for own in apart])))


def _channels(scoring: Scoring, names: Set) -> dict[str, ChannelMisfit]:
    """What each kind of channel leaves in motion, before and after; nothing is said of a long recording."""
    problem = scoring.search.problem
    if problem.is_long:
        return {}
    places, found = problem.rows.places, dict[str, ChannelMisfit]()
    kinds = np.array([own.kind for own in problem.plant.channels])[places.channel]
    left = [left_by(scoring.tried[one].fit.gaussian) for one in ((), names)]
    for kind, noise in problem.noises.items():
        rows = (kinds == kind) & places.moves
        rows = rows if rows.any() else kinds == kind
        if rows.any():
            before, after = (noise.innovation * math.sqrt(float(np.mean(np.square(own[rows])))) for own in left)
            found[kind] = ChannelMisfit(noise.sigma, before, after)
    return found
