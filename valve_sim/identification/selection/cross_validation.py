"""Leave-one-stroke-out cross-validation of a fit, from the Jacobian that it holds: theory, eq. (44).

A refit without a stroke is one Gauss–Newton step away from the fit to all: with the residuals e, the Jacobian J and the
information I = JᵀJ + priors at the optimum, leaving out stroke s moves the coordinates by

    δ = (I − J_sᵀ J_s)⁻¹ J_sᵀ e_s,    so that it is predicted with the residuals e_s + J_s δ = (1 − J_s I⁻¹ J_sᵀ)⁻¹ e_s

(Cook and Weisberg, Residuals and Influence in Regression, 1982). What only that stroke determines is not known from the
others: nuisances such as an error of its command's stamp go back to their priors and are estimated on it again, as on
any recording, and freed parameters go back to what changes nothing.
"""

from __future__ import annotations

import math
from dataclasses import dataclass
from typing import Final

import numpy as np
from numpy.typing import NDArray

from valve_sim.identification.estimation.gram import gram, information_less, sum_squares
from valve_sim.identification.estimation.problem import Problem
from valve_sim.identification.estimation.result import Fit
from valve_sim.identification.plants.hold_out import Stroke, in_order_of_conditions
from valve_sim.identification.plants.protocol import Array, internal_bounds, internal_scale, to_internal

MOST_FOLDS: Final = 16
"""Of more strokes than this several are left out at once."""
LOCAL: Final = 1e-3
"""Share of a nuisance's information outside a fold, below which only that fold determines it."""
WIDE: Final = 10.0
"""Prior scales: standard deviation about its neutral value of a parameter that the other strokes do not determine."""


@dataclass(frozen=True)
class CrossValidation:
    """What a fit predicts of each stroke when it is fitted to the others.

    Attributes:
        residuals: (n,) whitened, of every sample that takes part; 0 elsewhere.
        rise: by how much the criterion of the strokes, priors of their own nuisances included, exceeds that of the fit;
            at least 0, as it is at an optimum. A fit that has come to none, of which one step leads far, must not
            pass for a prediction that is better than the fit.
        folds: how many strokes, or sets of strokes, were left out in turn.
    """

    residuals: Array
    rise: float
    folds: int

    @property
    def sum_squares(self) -> float:
        """Of the residuals."""
        return sum_squares(self.residuals)


def folds_of(problem: Problem) -> list[NDArray[np.bool_]]:
    """For each stroke that takes part, (n,) which residuals are its own; of many strokes, several in a fold.

    These are of different conditions, as far as there are so many: a fold does not hold all strokes of one.
    """
    strokes = problem.strokes
    count = int(strokes.max(initial=-1)) + 1
    if count <= MOST_FOLDS:
        return [strokes == one for one in range(count)]
    taking_part = _strokes_taking_part(problem)
    rank = {stroke: place for place, stroke in enumerate(in_order_of_conditions(problem.plant, taking_part))}
    fold_of = np.array([rank[stroke] % MOST_FOLDS for stroke in taking_part])
    fold = np.where(strokes < 0, -1, fold_of[strokes])
    return [fold == one for one in range(min(count, MOST_FOLDS))]


def _strokes_taking_part(problem: Problem) -> list[Stroke]:
    """(recording, group) of the strokes that take part, in the order of their numbers."""
    channels = enumerate(problem.plant.channels)
    return sorted(
        {
            (channel.recording, group)
            for index, channel in channels
            for group in np.unique(channel.group[problem.weight(index) > 0.0]).tolist()
        }
    )


def cross_validate(result: Fit) -> CrossValidation | None:
    """Predict each stroke from the others, to first order about the fit; None where there is one stroke only."""
    folds = folds_of(result.problem)
    if len(folds) < 2:
        return None
    residuals, rise = np.zeros(len(result.residuals)), 0.0
    movable, pull = _movable(result), gram(result.jacobian, result.residuals)
    for fold in folds:
        columns, before = result.jacobian[fold], result.residuals[fold]
        own = len(result.free) + own_nuisances(result, fold)
        shared = np.flatnonzero(movable & ~np.isin(np.arange(len(movable)), own))
        moved = before + columns[:, shared] @ _without(result, fold, shared, pull[shared])
        after, cost = _refitted(result, columns[:, own], before, moved, own)
        residuals[fold] = after
        rise += sum_squares(after) - sum_squares(before) + cost
    return CrossValidation(residuals, max(rise, 0.0), len(folds))


def predicts_better(smaller: CrossValidation, larger: CrossValidation, variance_inflation: float) -> bool:
    """Whether the larger model predicts strokes left out better by more than 2 standard errors: theory, eq. (46)."""
    gain = sum_squares(smaller.residuals) - sum_squares(larger.residuals)
    apart = sum_squares(smaller.residuals - larger.residuals)
    # If the larger model is true, the gain is `apart` on average, with standard deviation 2 √apart.
    return gain > 4.0 * math.sqrt(variance_inflation * apart)


def own_nuisances(result: Fit, fold: NDArray[np.bool_]) -> NDArray[np.intp]:
    """Indices of the nuisances that only the samples of a fold determine."""
    k = len(result.free)
    variance = np.array([nuisance.sigma**2 for nuisance in result.nuisances])
    of_data = np.diag(result.information)[k:] - 1.0 / variance
    elsewhere = of_data - np.sum(np.square(result.jacobian[fold, k:]), axis=0)
    return np.flatnonzero(elsewhere <= LOCAL * of_data)


def _movable(result: Fit) -> NDArray[np.bool_]:
    """Which coordinates a refit could move: those that the data show, and not held by a bound."""
    alive = np.diag(result.information) > 1e-290
    alive[: len(result.free)] &= np.array([result.on_bound(name) is None for name in result.free], dtype=bool)
    return alive


def _without(result: Fit, fold: NDArray[np.bool_], shared: NDArray[np.intp], pull: Array) -> Array:
    """By how much the shared coordinates move when the samples of a fold are left out; `pull` is that of all."""
    k, plant = len(result.free), result.problem.plant
    columns = result.jacobian[fold][:, shared]
    information = information_less(result.information[np.ix_(shared, shared)], gram(columns, columns))
    # At the optimum all samples and priors cancel. Where there is no prior the others' pull is not taken from the fold,
    # turned round: what is left of a fit's last step would move what the others do not determine.
    curve = () if result.smooth is None else result.smooth.names
    own = gram(columns, result.residuals[fold])
    has_prior = np.array([index >= k or result.free[index] in curve for index in shared])
    gradient = np.where(has_prior, -own, pull - own)
    at, lower, upper = result.coordinates[shared], np.full(len(shared), -math.inf), np.full(len(shared), math.inf)
    for row, index in enumerate(shared[shared < k]):
        parameter = plant.parameter(result.free[index])
        lower[row], upper[row] = internal_bounds(parameter)
        # A shape has no neutral value, and stays as it is where nothing determines it.
        neutral = at[row] if "." in result.free[index] and parameter.off is None else to_internal(
            parameter, plant.declared(result.free[index])
        )  # fmt: skip
        # Where the value is far beyond its prior scale, the pull must not move what the others do determine.
        weak = 1.0 / (WIDE * max(internal_scale(parameter), abs(at[row] - neutral))) ** 2
        information[row, row] += weak
        gradient[row] += weak * (at[row] - neutral)
    size = 1.0 / np.sqrt(np.diag(information))
    move = -size * np.linalg.solve(information * np.outer(size, size), size * gradient)
    return np.asarray(np.clip(at + move, lower, upper) - at)


def _refitted(result: Fit, columns: Array, before: Array, moved: Array, own: NDArray[np.intp]) -> tuple[Array, float]:
    """Residuals with the strokes' own nuisances estimated on them again, and the change of the priors' cost."""
    if not len(own):
        return moved, 0.0
    variance = np.array([result.nuisances[index - len(result.free)].sigma ** 2 for index in own])
    # At the optimum the pull of the data and of the prior cancel: that is how far each is from its prior's mean.
    away = -variance * gram(columns, before)
    curvature = gram(columns, columns) + np.diag(1.0 / variance)
    pull = gram(columns, moved - before)
    try:
        change = -np.linalg.solve(curvature, pull)
    except np.linalg.LinAlgError:
        # Rounding takes two nuisances for one, far from the data (a leak into a dead end, by the outlet's pressure).
        change = -np.asarray(np.linalg.lstsq(curvature, pull, rcond=1e-13)[0])
    cost = float(np.sum((np.square(away + change) - np.square(away)) / variance))
    return moved + columns @ change, cost
