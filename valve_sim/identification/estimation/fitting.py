"""Output-error fits on whitened residuals: bounded Gauss–Newton with Levenberg's damping, and what they are worth.

The criterion is χ² = Σ e² + Σ (nuisance / prior)², e the whitened residual. Its score, for comparing models, is

    S = χ²/f + k ln N + Σ ln(1 + σ_j² I_j)

with k freed parameters, N samples (copies of one reading count once), f the factor by which slow noise discounts
evidence, and for each nuisance the Occam factor of its prior σ_j and information I_j (Laplace; MacKay 2003, chapter
28). A difference of 10 in S is what METHOD calls ΔBIC 10.
"""

from __future__ import annotations

import copy
import math
from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass, field, replace
from typing import Final

import numpy as np
from numpy.typing import NDArray
from scipy.special import chdtri

from valve_sim.identification.estimation.budget import Budget
from valve_sim.identification.estimation.column_groups import columns_decouple, group_columns
from valve_sim.identification.estimation.gram import gram, sum_squares
from valve_sim.identification.estimation.noise import Noise, estimate_noise, noise_of_residuals, still_runs, stretches
from valve_sim.identification.plants.protocol import (
    Array,
    Nuisance,
    Plant,
    from_internal,
    internal_bounds,
    internal_scale,
    internal_slope,
    judged_channels,
    to_internal,
)
from valve_sim.model import SimulationError

Mask = Callable[[int, NDArray[np.int64]], NDArray[np.bool_]]

DIFFERENCE: Final = 2e-3
"""Step of a difference quotient, in natural sizes of its parameter."""
NUISANCE_DIFFERENCE: Final = 1e-6
"""s: likewise for times."""
MOST_ITERATIONS: Final = 40
CONVERGED: Final = 1e-2
"""A fit has converged when a step would lower χ² by less than this: a tenth of a standard error."""
LARGEST_DAMPING: Final = 1e4
"""Levenberg's, in units of the information: beyond it no step helps and the fit stands still."""
NO_INFORMATION: Final = 1e-290
"""Information below which a parameter moves nothing at all."""
SMALLEST_SHARE: Final = 1e-14
"""Of the information, scaled to ones on its diagonal, that a direction can have and still be told from rounding."""
FEW: Final = 4
"""So many nuisances have their derivatives renewed in every step; those of more are kept while they serve."""
COLLINEAR: Final = 100.0
"""Variance of a parameter over what it would be if all others were known, beyond which directions are nearly flat."""
CHI2_RISE_95: Final = float(chdtri(1, 0.05))
"""By how much χ² rises at the ends of a 95 % interval: 3.84. (scipy.stats would take half a second to load.)"""
LONGEST_RUN: Final = 4
"""Identical readings in a row, beyond which a coarse sensor repeats one reading."""


class Problem:
    """Measured channels, their noise, and which samples take part.

    Args:
        plant: the machine and its data.
        takes_part: (channel index, (n,) groups) → (n,) mask of samples that are fitted; default all.
        noises: noise by kind of channel; default estimated from the channels.
        budget: of the fits to it; default no limit.
    """

    def __init__(
        self,
        plant: Plant,
        takes_part: Mask | None = None,
        noises: Mapping[str, Noise] | None = None,
        budget: Budget | None = None,
    ) -> None:
        self.plant = plant
        self.budget = budget or Budget.unlimited()
        kinds = {channel.kind for channel in plant.channels}
        self.noises = dict(noises) if noises is not None else {
            kind: estimate_noise([channel for channel in plant.channels if channel.kind == kind])
            for kind in sorted(kinds)
        }  # fmt: skip
        self._weights = [self._weight(index, takes_part) for index in range(len(plant.channels))]
        self.samples = sum(int(np.count_nonzero(weight)) for weight in self._weights)
        self.effective_samples = float(sum(np.sum(np.minimum(weight, 1.0) ** 2) for weight in self._weights))
        self.variance_inflation = max(noise.variance_inflation for noise in self.noises.values())

    def restricted(self, takes_part: Mask) -> Problem:
        """The same data and noise with other samples taking part."""
        return Problem(self.plant, takes_part, self.noises, self.budget)

    def with_inflated_noise(self, kind: str, factor: float) -> Problem:
        """The same with the noise of a kind of channel taken to be so many times as large."""
        doubted = {
            name: replace(noise, innovation=factor * noise.innovation)
            for name, noise in self.noises.items()
            if name == kind
        }
        return self.with_noises(doubted)

    def with_noise_of(self, result: Fit) -> Problem:
        """The same with the noise of what is never still taken from what a fit leaves of it."""
        shown = self.plant.predict(result.values)
        pieces: dict[str, list[Array]] = {kind: [] for kind, noise in self.noises.items() if noise.samples == 0}
        for index, channel in enumerate(self.plant.channels):
            for group in np.unique(channel.group) if channel.kind in pieces else ():
                chosen = (channel.group == group) & (self.weight(index) > 0.0)
                pieces[channel.kind].append((channel.data - shown[index])[chosen])
        learned = {kind: noise_of_residuals(found, self.noises[kind]) for kind, found in pieces.items()}
        return self.with_noises({**self.noises, **learned})

    def with_noises(self, noises: Mapping[str, Noise]) -> Problem:
        """The same data and samples with other noise."""
        same = copy.copy(self)
        same.noises = {kind: noises.get(kind, noise) for kind, noise in self.noises.items()}
        same.variance_inflation = max(noise.variance_inflation for noise in same.noises.values())
        return same

    @property
    def noise(self) -> Noise:
        """That of the response in which errors are reported."""
        return self.noise_of(judged_channels(self.plant)[0])

    def noise_of(self, index: int) -> Noise:
        """The noise of a channel."""
        return self.noises[self.plant.channels[index].kind]

    def weight(self, index: int) -> Array:
        """(n,) how much each sample of a channel counts; 0 where it takes no part."""
        return self._weights[index]

    def reach(self, nuisance: Nuisance) -> NDArray[np.bool_]:
        """(n,) which of the residuals a nuisance acts on."""
        low, high = nuisance.during
        acts_on = nuisance.channels or range(len(self.plant.channels))
        return np.concatenate(
            [
                (low <= channel.times) & (channel.times < high) & (index in acts_on)
                for index, channel in enumerate(self.plant.channels)
            ]
        )

    def residuals(self, values: Mapping[str, float]) -> Array:
        """Whitened, weighted residuals of all channels in a row (measured − predicted).

        Raises:
            OutOfTimeError: the time for fits is used up.
            SimulationError: the machine cannot be simulated with these values.
        """
        self.budget.check()
        shown = self.plant.predict(values)
        return np.concatenate(
            [
                self.noise_of(index).whiten(channel.data - prediction) * weight
                for index, (channel, prediction, weight) in enumerate(
                    zip(self.plant.channels, shown, self._weights, strict=True)
                )
            ]
        )

    def _weight(self, index: int, takes_part: Mask | None) -> Array:
        channel = self.plant.channels[index]
        weight = np.ones(len(channel.data))
        noise = self.noise_of(index)
        if noise.step > 0.0 and noise.is_coarse:
            # A coarse sensor at rest repeats one reading; a thousand copies are not a thousand measurements. The runs
            # are the declared model's: weights by the readings themselves lean on their errors, which with 1 µm of
            # noise and 5 µm steps puts the dampings 0.16 standard errors off.
            runs = still_runs(np.round(self.plant.predict({})[index] / noise.step))
            weight = np.where(runs > LONGEST_RUN, 1.0 / np.sqrt(runs), weight)
            for start, stop in stretches(channel.quiet):
                weight[start:stop] = np.minimum(weight[start:stop], 1.0 / math.sqrt(stop - start))
        if takes_part is not None:
            weight = np.where(takes_part(index, channel.group), weight, 0.0)
        return weight


@dataclass(frozen=True, eq=False)
class Fit:
    """The outcome of one fit; equal to itself only, so that what is worked out of it can be remembered by it.

    Attributes:
        problem: what was fitted.
        free: names of the freed parameters. nuisances: of the nuisances estimated along.
        values: every freed parameter and nuisance at the optimum, in its unit.
        chi2: criterion at the optimum, nuisance priors included.
        residuals: whitened residuals there.
        jacobian: (n, k + m) d(residuals)/d(search coordinate), nuisances last.
        information: (k + m, k + m), priors included.
        converged: whether the last step was small enough.
    """

    problem: Problem
    free: tuple[str, ...]
    nuisances: tuple[Nuisance, ...]
    values: dict[str, float]
    chi2: float
    residuals: Array
    jacobian: Array
    information: Array
    converged: bool
    coordinates: Array = field(repr=False)

    @property
    def covariance(self) -> Array:
        """(k + m, k + m) of the search coordinates, slow noise included; directions the data do not hold are huge.

        A parameter without any influence has infinite variance and no correlation.
        """
        diagonal = np.diag(self.information)
        alive = diagonal > NO_INFORMATION
        scale = 1.0 / np.sqrt(diagonal[alive])
        sizes, directions = np.linalg.eigh(self.information[np.ix_(alive, alive)] * np.outer(scale, scale))
        inverse = (directions / np.maximum(sizes, SMALLEST_SHARE)) @ directions.T
        covariance = np.diag(np.where(alive, 0.0, np.inf))
        covariance[np.ix_(alive, alive)] = inverse * np.outer(scale, scale) * self.problem.variance_inflation
        return covariance

    @property
    def score(self) -> float:
        """S of the module's page: smaller is better, by 10 is decisive."""
        occam = 0.0
        for index, nuisance in enumerate(self.nuisances, start=len(self.free)):
            occam += math.log(max(1.0, nuisance.sigma**2 * float(self.information[index, index])))
        variance_inflation = self.problem.variance_inflation
        return self.chi2 / variance_inflation + len(self.free) * math.log(self.problem.effective_samples) + occam

    @property
    def evidence(self) -> float:
        """−2 ln of the evidence, but for a constant: χ²/f + ln det(1 + D I D / f) (Laplace).

        D has the natural sizes of the freed parameters, and σ of the nuisances: how large each may be before the data
        are seen. A parameter that the data hardly hold costs hardly anything here, and ln N in the score.
        """
        plant, variance_inflation = self.problem.plant, self.problem.variance_inflation
        sizes = [internal_scale(plant.parameter(name)) for name in self.free]
        sigmas = [nuisance.sigma for nuisance in self.nuisances]
        spread = np.array([*sizes, *sigmas])
        # The priors of the nuisances are the ones of 1 + D I D: I is what the data alone say.
        of_data = self.information - np.diag([0.0] * len(sizes) + [1.0 / sigma**2 for sigma in sigmas])
        _, volume = np.linalg.slogdet(np.eye(len(spread)) + of_data * np.outer(spread, spread) / variance_inflation)
        return self.chi2 / variance_inflation + float(volume)

    def stderr(self, name: str) -> float:
        """Standard error of a freed parameter in its own unit; inf where the data do not hold it."""
        index = self.free.index(name)
        error = math.sqrt(max(0.0, float(self.covariance[index, index])))
        slope = internal_slope(self.problem.plant.parameter(name), float(self.coordinates[index]))
        return error * slope

    def is_collinear(self, name: str) -> bool:
        """Whether others can take its place so nearly that a parabola no longer says how far it reaches.

        Dampings are, beside an asymmetric friction that has dampings of its own for both directions.
        """
        index = self.free.index(name)
        known, variance = float(self.information[index, index]), float(self.covariance[index, index])
        return math.isfinite(variance) and known * variance > COLLINEAR * self.problem.variance_inflation

    def correlation(self) -> Array:
        """(k, k) of the freed parameters."""
        k = len(self.free)
        covariance = self.covariance[:k, :k]
        error = np.sqrt(np.diag(covariance))
        correlation = np.asarray(np.where(np.isfinite(covariance), covariance, 0.0) / np.outer(error, error))
        np.fill_diagonal(correlation, 1.0)
        return correlation

    def on_bound(self, name: str) -> str | None:
        """'lower' or 'upper' if a parameter sits on that bound, by its search coordinate; being endless is no bound."""
        parameter = self.problem.plant.parameter(name)
        lower, upper = internal_bounds(parameter)
        at = float(self.coordinates[self.free.index(name)])
        scale = 1e-9 * max(abs(at), internal_scale(parameter))
        if parameter.infinite_at_upper and at - lower <= scale:
            return None
        return "lower" if at - lower <= scale else "upper" if upper - at <= scale else None


def fit(
    problem: Problem,
    free: Sequence[str],
    start: Mapping[str, float],
    *,
    nuisances: Sequence[Nuisance] = (),
    fixed: Mapping[str, float] | None = None,
    robust: Sequence[float] = (),
) -> Fit:
    """Minimise χ² from one start.

    Args:
        problem: data and noise.
        free: parameters to free.
        start: values to start from, by name; what is missing starts at its declared value (nuisances at 0).
        nuisances: estimated along, with their priors.
        fixed: further values to hold, e.g. an effect's parameter in a profile.
        robust: scales in σ of a Cauchy loss that is used first, one after the other, to leave wrong basins.
    """
    search = _Search(problem, tuple(free), tuple(nuisances), dict(fixed or {}))
    at = search.start(start)
    for scale in robust:
        at, *_ = search.descend(at, scale)
    at, chi2, residuals, jacobian, information, converged = search.descend(at, math.inf)
    return Fit(
        problem, tuple(free), tuple(nuisances), search.values(at), chi2, residuals, jacobian, information,
        converged, at,
    )  # fmt: skip


def rmse(result: Fit) -> float:
    """Root mean square of measured less predicted response over the samples that take part, in its unit."""
    plant, problem = result.problem.plant, result.problem
    squares, count = 0.0, 0
    predictions = plant.predict(result.values)
    for index in judged_channels(plant):
        takes_part = problem.weight(index) > 0.0
        squares += float(np.sum(np.square((plant.channels[index].data - predictions[index])[takes_part])))
        count += int(np.count_nonzero(takes_part))
    return math.sqrt(squares / max(1, count))


class _Search:
    """One minimisation: coordinates in natural sizes, bounds, difference quotients."""

    def __init__(
        self, problem: Problem, free: tuple[str, ...], nuisances: tuple[Nuisance, ...], fixed: dict[str, float]
    ) -> None:
        self.problem, self.free, self.nuisances, self.fixed = problem, free, nuisances, fixed
        self.parameters = [problem.plant.parameter(name) for name in free]
        bounds = [internal_bounds(parameter) for parameter in self.parameters]
        self.lower = np.array([low for low, _ in bounds] + [-20.0 * n.sigma for n in nuisances])
        self.upper = np.array([high for _, high in bounds] + [20.0 * n.sigma for n in nuisances])
        scales = [internal_scale(parameter) for parameter in self.parameters]
        self.steps = np.array([DIFFERENCE * s for s in scales] + [NUISANCE_DIFFERENCE] * len(nuisances))
        self.prior = np.array([0.0] * len(free) + [1.0 / n.sigma**2 for n in nuisances])
        self._reach = [problem.reach(nuisance) for nuisance in nuisances]
        self._groups = group_columns(self._reach)
        self._nuisance_columns: Array | None = None

    def start(self, values: Mapping[str, float]) -> Array:
        plant = self.problem.plant
        coordinates = [
            to_internal(parameter, values.get(name, plant.declared(name)))
            for name, parameter in zip(self.free, self.parameters, strict=True)
        ]
        coordinates += [values.get(nuisance.name, 0.0) for nuisance in self.nuisances]
        return np.clip(np.array(coordinates, dtype=np.float64), self.lower, self.upper)

    def values(self, at: Array) -> dict[str, float]:
        values = dict(self.fixed)
        for name, parameter, coordinate in zip(self.free, self.parameters, at, strict=False):
            values[name] = from_internal(parameter, float(coordinate))
        for nuisance, coordinate in zip(self.nuisances, at[len(self.free) :], strict=True):
            values[nuisance.name] = float(coordinate)
        return values

    def residuals(self, at: Array) -> Array | None:
        """Residuals, or None where the model cannot be simulated."""
        try:
            residuals = self.problem.residuals(self.values(at))
        except SimulationError:
            return None
        return residuals if np.all(np.isfinite(residuals)) else None

    def jacobian(self, at: Array, residuals: Array) -> Array:
        """Forward differences, away from the bound ahead; the columns of many nuisances are kept while they do."""
        columns = [self._column(at, index, residuals) for index in range(len(self.free))]
        if self._nuisance_columns is None:
            self._nuisance_columns = self._columns_of_nuisances(at, residuals)
        return np.column_stack([*columns, self._nuisance_columns])

    def _columns_of_nuisances(self, at: Array, residuals: Array) -> Array:
        columns = np.zeros((len(residuals), len(self.nuisances)))
        for group in self._groups:
            indices = [len(self.free) + index for index in group]
            columns[:, group] = self._columns_at_once(at, indices, residuals)
        return columns

    def _columns_at_once(self, at: Array, indices: list[int], residuals: Array) -> Array:
        """Of nuisances that have samples of their own, by one run; by one for each where they reach beyond them."""
        if len(indices) > 1:
            moved, steps = at.copy(), self.steps[indices]
            moved[indices] += np.where(at[indices] + steps > self.upper[indices], -steps, steps)
            there = self.residuals(moved)
            masks = [self._reach[index - len(self.free)] for index in indices]
            if there is not None and columns_decouple(there - residuals, masks):
                return np.where(np.column_stack(masks), (there - residuals)[:, None] / (moved - at)[indices], 0.0)
        return np.column_stack([self._column(at, index, residuals) for index in indices])

    def _column(self, at: Array, index: int, residuals: Array) -> Array:
        step = self.steps[index]
        if abs(at[index]) > 0.0 and index < len(self.free):
            step = max(step, 1e-5 * abs(at[index]))
        for size in (step, -step, 0.1 * step, -0.1 * step):
            moved = at.copy()
            moved[index] = min(max(at[index] + size, self.lower[index]), self.upper[index])
            actual = moved[index] - at[index]
            there = self.residuals(moved) if actual != 0.0 else None
            if there is not None:
                return np.asarray((there - residuals) / actual)
        return np.zeros(len(residuals))

    def descend(self, at: Array, cauchy: float) -> tuple[Array, float, Array, Array, Array, bool]:
        """Gauss–Newton with Levenberg's damping, variables on a bound held while they push outwards."""
        residuals = self.residuals(at)
        if residuals is None:
            raise SimulationError("the model cannot be simulated at the start of the fit")
        damping, converged = 1e-4, False
        cost = self._cost(at, residuals, cauchy)
        jacobian = self.jacobian(at, residuals)
        is_stale = False
        information, gradient = self._normal(at, residuals, jacobian, cauchy)
        for _ in range(MOST_ITERATIONS):
            move, gain = self._step(at, information, gradient, damping)
            if gain < CONVERGED:
                converged = True
                break
            candidate = np.clip(at + move, self.lower, self.upper)
            there = self.residuals(candidate)
            new_cost = self._cost(candidate, there, cauchy) if there is not None else math.inf
            if there is not None and new_cost < cost:
                converged = cost - new_cost < CONVERGED
                damping = max(1e-9, damping * (0.1 if cost - new_cost > 0.5 * gain else 0.5))
                if len(self.nuisances) <= FEW or cost - new_cost > 0.01 * cost:
                    self._nuisance_columns = None
                is_stale = self._nuisance_columns is not None
                at, residuals, cost = candidate, there, new_cost
                jacobian = self.jacobian(at, residuals)
            elif is_stale:
                self._nuisance_columns = None
                jacobian = self.jacobian(at, residuals)
                is_stale = False
            else:
                damping *= 10.0
                converged = damping > LARGEST_DAMPING
            if converged:
                break
            information, gradient = self._normal(at, residuals, jacobian, cauchy)
        if math.isfinite(cauchy):
            information, _ = self._normal(at, residuals, jacobian, math.inf)
        return at, cost, residuals, jacobian, information, converged

    def _normal(self, at: Array, residuals: Array, jacobian: Array, cauchy: float) -> tuple[Array, Array]:
        """Information matrix and half the gradient of the criterion, priors included."""
        if math.isfinite(cauchy):
            weighted = jacobian / (1.0 + np.square(residuals / cauchy))[:, None]
        else:
            weighted = jacobian
        return gram(weighted, jacobian) + np.diag(self.prior), gram(weighted, residuals) + self.prior * at

    def _cost(self, at: Array, residuals: Array, cauchy: float) -> float:
        prior = float(self.prior @ np.square(at))
        if not math.isfinite(cauchy):
            return sum_squares(residuals) + prior
        return float(cauchy**2 * np.sum(np.log1p(np.square(residuals / cauchy)))) + prior

    def _step(self, at: Array, information: Array, gradient: Array, damping: float) -> tuple[Array, float]:
        """The damped step within bounds, and the decrease that it promises."""
        scale = np.maximum(np.diag(information), 1e-300)
        held = ((at <= self.lower) & (gradient > 0)) | ((at >= self.upper) & (gradient < 0)) | (scale <= NO_INFORMATION)
        move = np.zeros(len(at))
        for _ in range(len(at)):
            moving = ~held
            if not np.any(moving):
                break
            size = 1.0 / np.sqrt(scale[moving])
            normal = information[np.ix_(moving, moving)] * np.outer(size, size)
            normal[np.diag_indices_from(normal)] *= 1.0 + damping
            normal[np.diag_indices_from(normal)] += 1e-12
            rest = gradient[moving] + information[np.ix_(moving, held)] @ move[held]
            move[moving] = -size * np.linalg.solve(normal, size * rest)
            beyond = moving & ((at + move < self.lower) | (at + move > self.upper))
            if not np.any(beyond):
                break
            move[beyond] = np.clip(at[beyond] + move[beyond], self.lower[beyond], self.upper[beyond]) - at[beyond]
            held = held | beyond
        gain = -float(2.0 * gradient @ move + move @ information @ move)
        return move, max(gain, 0.0)


@dataclass(frozen=True)
class Interval:
    """A value with its uncertainty, in the parameter's unit.

    Attributes:
        value, stderr: from the covariance. low, high: 95 % interval; infinite where the data do not close it.
        remark: why it is wide or one-sided, or empty.
    """

    value: float
    stderr: float
    low: float
    high: float
    remark: str = ""

    def to_json(self) -> dict[str, object]:
        """As in report.json; infinities become null, which JSON has."""
        finite = [bound if math.isfinite(bound) else None for bound in (self.low, self.high)]
        value = self.value if math.isfinite(self.value) else None
        stderr = self.stderr if math.isfinite(self.stderr) else None
        entry: dict[str, object] = {"value": value, "stderr": stderr, "ci95": finite}
        if self.remark:
            entry["remark"] = self.remark
        return entry


def covariance_interval(result: Fit, name: str) -> Interval:
    """The 95 % interval from the covariance at the optimum, cut at the parameter's range."""
    plant = result.problem.plant
    parameter = plant.parameter(name)
    index = result.free.index(name)
    at = float(result.coordinates[index])
    half = 1.959964 * math.sqrt(max(0.0, float(result.covariance[index, index])))
    lower, upper = internal_bounds(parameter)
    ends = sorted(from_internal(parameter, end) for end in (max(lower, at - half), min(upper, at + half)))
    return Interval(result.values[name], result.stderr(name), ends[0], ends[1])


def profile_interval(result: Fit, name: str, *, points: int = 12) -> tuple[Interval, list[tuple[float, float]]]:
    """The 95 % interval by profile likelihood: where χ², all others refitted, has risen by 3.84.

    Args:
        result: a converged fit.
        name: one of its freed parameters.
        points: how many refits to spend on each side.

    Returns:
        the interval, and the profile as (value, rise of χ²) pairs in ascending order of value.
    """
    parameter = result.problem.plant.parameter(name)
    index = result.free.index(name)
    at = float(result.coordinates[index])
    lower, upper = internal_bounds(parameter)
    level = CHI2_RISE_95 * result.problem.variance_inflation
    spread = math.sqrt(max(0.0, float(result.covariance[index, index])))
    natural = internal_scale(parameter)
    spread = min(spread, 10.0 * max(natural, abs(at))) if spread > 0 else natural
    curve = [(at, 0.0)]
    ends: list[float] = []
    remark = ""
    for sign, bound in ((-1.0, lower), (1.0, upper)):
        end, side = _profile_side(result, index, at, sign, bound, spread, level, points)
        curve.extend(side)
        if end is None:
            remark = "the profile stays flat: these data do not hold it"
            ends.append(sign * math.inf if math.isinf(bound) else bound)
        else:
            ends.append(end)
    values = sorted(from_internal(parameter, end) for end in ends)
    if parameter.infinite_at_upper and values[1] >= parameter.upper:
        remark = "it may be too long to be seen in these data"
    pairs = sorted((from_internal(parameter, where), rise) for where, rise in curve)
    return Interval(result.values[name], result.stderr(name), values[0], values[1], remark), pairs


def _profile_side(
    result: Fit, index: int, at: float, sign: float, bound: float, spread: float, level: float, points: int
) -> tuple[float | None, list[tuple[float, float]]]:
    """One side of a profile: the coordinate where χ² has risen by `level`, or None if it never does."""
    name = result.free[index]
    parameter = result.problem.plant.parameter(name)
    others = tuple(other for other in result.free if other != name)
    warm = dict(result.values)
    curve: list[tuple[float, float]] = []
    inside, outside = (at, 0.0), None
    step = 1.96 * spread
    for _ in range(points):
        if outside is None:
            where = inside[0] + sign * step
            step *= 2.0
            if (where - bound) * sign >= 0.0:
                where = bound
        else:
            # χ² is nearly a parabola: its root is where the square root of the rise is linear.
            low, high = math.sqrt(max(inside[1], 0.0)), math.sqrt(outside[1])
            share = (math.sqrt(level) - low) / (high - low) if high > low else 0.5
            where = inside[0] + min(max(share, 0.05), 0.95) * (outside[0] - inside[0])
        if where == inside[0]:
            return (bound if where == bound else None), curve
        fixed = {name: from_internal(parameter, where)}
        refit = fit(result.problem, others, warm, nuisances=result.nuisances, fixed=fixed)
        rise = refit.chi2 - result.chi2
        curve.append((where, rise))
        if rise < level:
            inside, warm = (where, rise), refit.values
            if where == bound:
                return (None if rise < 0.1 * level else bound), curve
        else:
            outside = (where, rise)
        if outside is not None and (abs(rise - level) < 0.02 * level or abs(outside[0] - inside[0]) < 1e-3 * spread):
            return where, curve
    return (None if outside is None else outside[0]), curve
