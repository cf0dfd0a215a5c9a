"""A fitted model, linearised: its evidence with errors of any sizes in the recording, and the best sizes.

All that is needed of the rows is one Gram matrix of [J, B, e]: derivatives J along what was fitted and what may move
besides, columns B of the recording's errors, residuals e. With w = (d, b), priors P of precision (s⁻² for b) and
M = AᵀA + P (theory, "The errors of a recording"),

    ln p(data | E, s) = −½ (e·e − gᵀ M⁻¹ g) + ½ Σ ln P − ½ ln |M| + ln p(s)
    ∂/∂ ln s          = Σ w²/s² + Σ (M⁻¹)ᵢᵢ/s² − n + ∂ ln p(s)/∂ ln s

which is maximised over ln s by L-BFGS.

An `OrthogonalProjector` says, to first order, what a fit cannot follow of a change of its residuals, and what χ² gains
where that is let free.
"""

from __future__ import annotations

import functools
import math
from collections.abc import Callable, Sequence
from typing import Any, Final, NamedTuple

import numpy as np
from numpy.typing import NDArray
from scipy.linalg.lapack import dpotrf, dpotri, dpotrs

from valve_sim.identification.estimation.evidence import log_volume
from valve_sim.identification.estimation.gram import gram, orthonormal
from valve_sim.identification.estimation.priors import Normal, log_density_of, pulls_of
from valve_sim.identification.estimation.result import Fit
from valve_sim.identification.estimation.structured_noise import ErrorRows, Group
from valve_sim.identification.plants.protocol import Array

MOST_UPDATES: Final = 60
"""Steps of L-BFGS."""
POINTS: Final = 13
"""Of the integral over a size: over its whole range, and about the most probable one, even in the logarithm.

Their number is odd: the most probable size is one of them, however sharply it is known.
"""
LOWER: Final = 10.0
"""By how much in ln p a size may be more probable than the best that was found, before it counts no more."""
NEARBY: Final = 1.0
"""Of the logarithm of a size: half the width of the latter."""
TINY: Final = 1e-12
"""Added to the diagonal of a scaled matrix: far below what rounding leaves of a direction that nothing determines."""
MOVES_NOTHING: Final = 1e-6
"""Standard deviations, over all samples: a direction that changes the residual by less is ignored."""
DEPENDENT: Final = 1e-8
"""Of the largest power of some directions: what is below it is a combination of the others."""


class Linearised:
    """A fit and its surroundings.

    Args:
        result: about which it is linearised.
        further: (r, q) changes of its residuals along what may move besides, each with the prior N(0, 1).

    Attributes:
        sizes: (g,) of the recording's errors as the fit has them; empty where there are none.
    """

    def __init__(self, result: Fit, further: Array | None = None) -> None:
        errors = result.problem.error_rows
        jacobian, left = result.derivatives.condensed(), result.left.condensed()
        moved = np.empty((len(left), 0)) if further is None else further
        self._result, self._errors, self._moved = result, errors, moved.shape[1]
        self._constant = -0.5 * self._moved * math.log(2.0 * math.pi) - 0.5 * result.problem.rows.constant
        nothing = np.empty((len(left), 0)), np.empty(0, dtype=np.intp)
        columns, owners = nothing if errors is None else errors.dense(len(left))
        self.sizes = np.empty(0) if errors is None else errors.noise.sizes
        # What errors add to a sensor, residuals have less.
        self._rows = (jacobian, moved, -columns, left[:, None])
        self._room = np.vstack([result.room, np.full((self._moved, 2), math.inf)])
        # Of a fit's coordinates and of the columns of errors after them: the group that the size of each is of.
        numbers = {} if errors is None else errors.noise.numbers
        self._varying = np.array(
            [-1] * len(result.free) + [numbers.get((own.group, own.error), -1) for own in result.nuisances]
        )
        self._owners = np.concatenate([self._varying, np.full(self._moved, -1), owners]).astype(np.intp)

    def rows(self, sizes: Array) -> Array:
        """(r, k + 1) derivatives and residuals, whitened for errors of these sizes."""
        jacobian, moved, _, left = self._rows
        whole = np.hstack([jacobian, moved, left])
        return whole if self._errors is None else self._sized(sizes).whiten(whole)

    def with_columns(self) -> Array:
        """(r, k + q + 1) derivatives, those along coefficients of errors, and residuals, not whitened for errors."""
        return np.hstack(self._rows)

    def log_constant(self, sizes: Array) -> float:
        """The terms of ln p from errors of these sizes, beyond those of `rows`."""
        return 0.0 if self._errors is None else self._sized(sizes).log_constant

    def _sized(self, sizes: Array) -> ErrorRows:
        """The errors of these sizes; the last ones are kept, since they are asked for one after another."""
        assert self._errors is not None
        if self._last is None or not np.array_equal(self._last.noise.sizes, sizes):
            self._last = self._errors.resized(sizes)
        return self._last

    _last: ErrorRows | None = None

    @functools.cached_property
    def _gram(self) -> Array:
        whole = self.with_columns()
        return gram(whole, whole)

    @functools.cached_property
    def best_sizes(self) -> Array:
        """(g,) the most probable sizes, beside what was fitted."""
        return self.sizes if self._errors is None else self.by_sizes().most_probable(self.sizes)

    @property
    def no_sizes(self) -> Array:
        """(g,) the smallest sizes that errors may have."""
        if self._errors is None:
            return self.sizes
        smallest = [own.bounds[0] for own in self._errors.noise.groups]
        return np.where(self.by_sizes().is_learned, smallest, self.sizes)

    def sizes_at_rest(self) -> Array:
        """(g,) the most probable sizes by the rows alone in which the machine is known to be still.

        Those that were read at rest before, beside another fit, are read again.
        """
        return self.at_rest().most_probable(self.sizes)

    def at_rest(self) -> BySizes:
        """What `by_sizes` estimates, from those rows alone in which the machine is known to be still."""
        whole = self.with_columns()[~self._result.problem.rows.places.moves]
        return self.by_sizes(gram(whole, whole), is_read=False)

    @functools.cached_property
    def log_integral(self) -> float:
        """Ln of what the integral over all sizes is of the evidence with the best."""
        return 0.0 if self._errors is None else self.by_sizes().log_integral(self.best_sizes)

    @property
    def integrated(self) -> float:
        """Ln p(data | model), integrated over the sizes of the recording's errors: what hypotheses are compared by."""
        return self.log_evidence(self.best_sizes) + self.log_integral

    def log_evidence(self, sizes: Array) -> float:
        """Ln p(data | model) with errors of these sizes, on the scale of `Fit.log_evidence`."""
        rows = self.rows(sizes)
        return float(self.evidence_of(sizes)(gram(rows, rows)[None])[0]) + self.log_constant(sizes)

    def evidence_of(self, sizes: Array) -> Callable[[Array], Array]:
        """What works that out from (n, k + 1, k + 1) Gram matrices of `rows`, but for the constant of the sizes."""
        result, count = self._result, self._moved
        priors = [
            own if number < 0 else Normal(0.0, float(sizes[number]))
            for own, number in zip(result.priors, self._varying.tolist(), strict=True)
        ]
        _, half_slopes, own_curvatures = pulls_of(priors, result.coordinates)
        curvatures = np.diag(np.append(own_curvatures, np.ones(count)))
        slopes = np.append(half_slopes, np.zeros(count))
        known = log_density_of(priors, result.coordinates) + self._constant
        if result.smooth is not None:
            where = np.array(result.curve, dtype=np.intp)
            curvatures[np.ix_(where, where)] += result.smooth.precision
            slopes[where] += result.smooth.precision @ result.coordinates[where]
            known += result.smooth.log_density(result.coordinates[where])
        return lambda of_all: _log_evidences(of_all, curvatures, slopes, self._room) + known

    def by_sizes(self, of_all: Array | None = None, *, is_read: bool = True) -> BySizes:
        """All that is estimated as a function of the sizes.

        Args:
            of_all: the Gram matrix of `with_columns`; None: its own. is_read: whether sizes read at rest are kept.
        """
        assert self._errors is not None
        of_all = self._gram if of_all is None else of_all
        result, count = self._result, len(self._result.coordinates)
        information, pull = of_all[:-1, :-1].copy(), of_all[:-1, -1].copy()
        # What has a size is counted from its prior's mean, and all else from where the fit is.
        at = np.zeros(len(self._owners))
        at[:count] = np.where(self._varying >= 0, result.coordinates, 0.0)
        pull -= information @ at
        is_fixed = self._owners < 0
        curvature, slope = np.ones(len(is_fixed)), np.zeros(len(is_fixed))
        _, slope[:count], curvature[:count] = result.pulls
        information[is_fixed, is_fixed] += curvature[is_fixed]
        pull[is_fixed] += slope[is_fixed]
        if result.smooth is not None:
            where = np.array(result.curve, dtype=np.intp)
            information[np.ix_(where, where)] += result.smooth.precision
            pull[where] += result.smooth.precision @ result.coordinates[where]
        groups = [own if is_read else own._replace(is_read=False) for own in self._errors.noise.groups]
        return BySizes(groups, self._owners, information, pull)


class _Solved(NamedTuple):
    """Where a linearised model is best for some sizes.

    Attributes:
        factor: Cholesky's, of M in units of `scale`. moves: (m,) the step to the optimum in these. scale: (m,).
        root: (m,) these units in units of the sizes. log_root: ½ ln |M| in units of the sizes. gain: −gᵀ M⁻¹ g.
    """

    factor: Array
    moves: Array
    scale: Array
    root: Array
    log_root: float
    gain: float


def _units(information: Array) -> Array:
    """(m,) of coordinates, in which the diagonal of an information matrix is 1; 1 of what nothing determines."""
    sizes = np.sqrt(np.diag(information))
    return np.asarray(np.where(sizes > 0.0, 1.0 / np.where(sizes > 0.0, sizes, 1.0), 1.0))


class BySizes:
    """A linearised model as a function of the sizes of the recording's errors.

    Args:
        groups: of coefficients. owners: (m,) the number of the group of each coordinate; −1 of what has no size.
        information: (m, m) of the data, with the priors of what has no size. pull: (m,) half the gradient, likewise.

    Attributes:
        is_estimated: (g,) whether a group has any coordinate: what is as good as none has been left out of the fit.
        is_learned: (g,) whether the size of such a group is learned.
    """

    def __init__(self, groups: Sequence[Group], owners: NDArray[np.intp], information: Array, pull: Array) -> None:
        self._groups, self._information, self._pull = groups, information, pull
        self._places = np.flatnonzero(owners >= 0)
        self._owners = owners[self._places]
        self._counts = np.bincount(self._owners, minlength=len(groups)).astype(np.float64)
        self._usual = _units(information)
        self.is_estimated = self._counts > 0.0
        self.is_learned = np.array([own.is_learned for own in groups]) & self.is_estimated

    def _solved(self, sizes: Array) -> _Solved:
        """M in units in which its diagonal is 1, and the step to the optimum."""
        # In units of the sizes the priors are ones, and nothing is divided by what is next to nothing.
        scale = self._usual.copy()
        scale[self._places] = sizes[self._owners]
        whole = self._information * np.outer(scale, scale)
        whole[self._places, self._places] += 1.0
        root = _units(whole)
        factor = _factored(whole * np.outer(root, root))
        target = scale * root * self._pull
        moves = -_solution(factor, target)
        log_root = float(np.sum(np.log(np.diag(factor)))) - float(np.sum(np.log(root)))
        return _Solved(factor, moves, scale * root, root, log_root, float(target @ moves))

    def cost(self, sizes: Array) -> float:
        """−ln p(data | sizes) p(sizes), but for what sizes do not change."""
        return self._cost(self._solved(sizes), sizes)

    def _cost(self, solved: _Solved, sizes: Array) -> float:
        pairs = zip(self._groups, sizes.tolist(), strict=True)
        prior = math.fsum(own.error.log_prior(size, own.scale) for own, size in pairs)
        return 0.5 * solved.gain + solved.log_root - prior

    def _cost_and_slope(self, sizes: Array) -> tuple[float, Array]:
        """The cost, and its derivative to the logarithm of each size."""
        solved, places = self._solved(sizes), self._places
        inverse, _ = dpotri(solved.factor, lower=1)
        spread = np.diag(inverse)[places]
        squares = (np.square(solved.moves[places]) + spread) * np.square(solved.root[places])
        known = np.bincount(self._owners, squares, minlength=len(sizes))
        pairs = zip(self._groups, sizes.tolist(), strict=True)
        slopes = np.array([own.error.log_slope(size, own.scale) for own, size in pairs])
        return self._cost(solved, sizes), self._counts - known - slopes

    def most_probable(self, start: Array) -> Array:
        """(g,) sizes of the least cost, from a start."""
        learned = self.is_learned
        if not learned.any():
            return start

        from scipy.optimize import minimize

        def by_logs(logs: Array) -> tuple[float, Array]:
            sizes = start.copy()
            sizes[learned] = np.exp(logs)
            cost, slope = self._cost_and_slope(sizes)
            return cost, slope[learned]

        limits = np.log([own.bounds for own in self._groups])[learned]
        usual = np.log([own.held for own in self._groups])[learned]
        options: Any = {"maxiter": MOST_UPDATES}
        # Errors that share what is left have more than one optimum.
        found = min(
            (
                minimize(by_logs, first, jac=True, method="L-BFGS-B", bounds=limits.tolist(), options=options)
                for first in (np.clip(np.log(start[learned]), *limits.T), usual)
            ),
            key=lambda one: float(one.fun),
        )
        sizes = start.copy()
        sizes[learned] = np.exp(found.x)
        return sizes

    def coefficients(self, sizes: Array, number: int) -> tuple[Array, Array]:
        """(q,) coefficients of a group, and (q, q) their covariance, beside all else that is estimated."""
        factor, moves, scale, *_ = self._solved(sizes)
        own = self._places[self._owners == number]
        covariance = _solution(factor, np.eye(len(scale))[:, own])[own]
        return moves[own] * scale[own], covariance * np.outer(scale[own], scale[own])

    def costs_of(self, sizes: Array, number: int, at: Array) -> Array:
        """(n,) costs of a group at (n,) sizes, all others kept.

        All else is taken out of the information of the group's coefficients once. In the eigenvectors of what is left,
        each size is a sum.
        """
        own = self._places[self._owners == number]
        rest = np.setdiff1d(np.arange(len(self._usual)), own)
        others = self._owners != number
        scale = self._usual.copy()
        scale[self._places] = sizes[self._owners]
        whole, pull = self._information * np.outer(scale, scale), scale * self._pull
        whole[self._places[others], self._places[others]] += 1.0
        root = _units(whole[np.ix_(rest, rest)])
        factor = _factored(whole[np.ix_(rest, rest)] * np.outer(root, root))
        between = root[:, None] * np.column_stack([whole[np.ix_(rest, own)], pull[rest]])
        solved = _solution(factor, between)
        left = whole[np.ix_(own, own)] - gram(between[:, :-1], solved[:, :-1])
        values, vectors = np.linalg.eigh(0.5 * (left + left.T))
        squares = np.square(vectors.T @ (pull[own] - gram(between[:, :-1], solved[:, -1])))
        values = np.maximum(values, 0.0)
        known = float(np.sum(np.log(np.diag(factor)))) - float(np.sum(np.log(root)))
        known -= 0.5 * float(between[:, -1] @ solved[:, -1])
        precisions = np.square(sizes[number] / at)[:, None]
        found = 0.5 * np.sum(np.log1p(values / precisions) - squares / (values + precisions), axis=1)
        pairs = zip(self._groups, sizes.tolist(), strict=True)
        priors = [group.error.log_prior(size, group.scale) for group, size in pairs]
        priors[number] = 0.0
        group = self._groups[number]
        of_sizes = np.array([group.error.log_prior(size, group.scale) for size in at.tolist()])
        return np.asarray(found + known - math.fsum(priors) - of_sizes)

    def log_integral(self, sizes: Array) -> float:
        """Ln of the product, over groups, of ∫ p(s) L(s | others) ds over p(s) L(s) at the best sizes."""
        most, total = self.cost(sizes), 0.0
        for number in np.flatnonzero(self.is_learned).tolist():
            scale = self._groups[number].scale
            low, high = self._groups[number].bounds
            logs = np.linspace(math.log(low), math.log(high), POINTS)
            nearby = math.log(sizes[number]) + np.linspace(-NEARBY, NEARBY, POINTS)
            logs = np.unique(np.clip(np.concatenate([logs, nearby]), logs[0], logs[-1]))
            at = np.exp(logs)
            rises = self.costs_of(sizes, number, at) - most
            density = np.exp(-np.maximum(rises, -LOWER)) * at / scale
            # The grid begins at next to nothing, of which the rest down to nothing is as probable.
            below = float(density[0])
            total += math.log(below + float(np.trapezoid(density, logs)))
        return total

    def estimates(self, sizes: Array, count: int) -> tuple[Array, Array]:
        """(count,) steps of the first coordinates to the optimum, and (count, count) their covariance."""
        factor, moves, scale, *_ = self._solved(sizes)
        covariance = _solution(factor, np.eye(len(scale))[:, :count])[:count]
        return moves[:count] * scale[:count], covariance * np.outer(scale[:count], scale[:count])


def _factored(matrix: Array) -> Array:
    """(k, k) Cholesky's factor of a matrix of about unit diagonal, with as little added to that as makes it positive.

    By LAPACK itself: what SciPy checks before takes longer than to factor so small a matrix.
    """
    for share in (TINY, 1e-10, 1e-8, 1e-6, float(len(matrix))):
        factor, failed = dpotrf(matrix + share * np.eye(len(matrix)), lower=1)
        if not failed:
            break
    return np.asarray(factor)


def _solution(factor: Array, right: Array) -> Array:
    """M⁻¹ of (k,) or (k, n), by Cholesky's factor of M."""
    return np.asarray(dpotrs(factor, right, lower=1)[0]) if len(factor) else right


def _log_evidences(of_all: Array, priors: Array, slopes: Array, room: Array) -> Array:
    """(n,) −½ of the least criterion of each of n linearised models, with its volume, but for what is constant.

    Args:
        of_all: (n, k + 1, k + 1) Gram matrices of derivatives and residuals. priors: (k, k) curvatures.
        slopes: (k,) half of the slopes of the priors. room: (k, 2) to the ends of the ranges.
    """
    found = -0.5 * of_all[:, -1, -1]
    if not len(slopes):
        return found
    information, pulls = of_all[:, :-1, :-1] + priors, of_all[:, :-1, -1] + slopes
    for place, (own, pull, move) in enumerate(
        zip(information, pulls, bounded_steps(information, pulls, room), strict=True)
    ):
        left = np.column_stack([room[:, 0] + move, room[:, 1] - move])
        ahead = own @ move
        gain = -float(2.0 * pull @ move + move @ ahead)
        found[place] += 0.5 * gain + log_volume(own, pull + ahead, left)
    return found


def bounded_steps(information: Array, pulls: Array, room: Array) -> Array:
    """(n, k) d of the least 2 gᵀ d + dᵀ A d within −room[:, 0] ≤ d ≤ room[:, 1], for each of n.

    Args:
        information: (n, k, k) A. pulls: (n, k) g. room: (k, 2).
    """
    count = pulls.shape[1]
    scale = 1.0 / np.sqrt(np.maximum(np.diagonal(information, axis1=1, axis2=2), np.finfo(float).tiny))
    normal = information * (scale[:, :, None] * scale[:, None, :]) + 1e-12 * np.eye(count)
    targets, low, high = scale * pulls, -room[:, 0] / scale, room[:, 1] / scale
    moves = -np.linalg.solve(normal, targets[:, :, None])[:, :, 0]
    for place in np.flatnonzero(((moves < low) | (moves > high)).any(axis=1)).tolist():
        moves[place] = _within(normal[place], targets[place], low[place], high[place])
    return np.asarray(moves * scale)


def _within(normal: Array, target: Array, low: Array, high: Array) -> Array:
    """(k,) d of the least 2 gᵀ d + dᵀ A d between two ends; ends are held one after another."""
    count = len(target)
    move, held = np.zeros(count), np.zeros(count, dtype=bool)
    for _ in range(count + 1):
        free = ~held
        if not free.any():
            break
        rest = target[free] + normal[np.ix_(free, held)] @ move[held]
        move[free] = -np.linalg.solve(normal[np.ix_(free, free)], rest)
        beyond = free & ((move < low) | (move > high))
        if not beyond.any():
            break
        move[beyond] = np.clip(move[beyond], low[beyond], high[beyond])
        held |= beyond
    return move


class OrthogonalProjector:
    """Projection onto what is orthogonal to a fit's parameters and nuisances, with their priors.

    Args:
        base: the fit; its rows are those that were fitted.
    """

    def __init__(self, base: Fit) -> None:
        roots = np.sqrt(base.pulls[2])
        self._problem = base.problem
        jacobian = base.problem.without_errors(base.derivatives.condensed())
        columns = np.vstack([jacobian, np.diag(roots)])
        size = np.sqrt(np.sum(np.square(columns), axis=0))
        pulled = base.pulls[1] / np.where(roots > 0.0, roots, 1.0)
        left = base.problem.without_errors(base.left.condensed()[:, None])[:, 0]
        self._residuals = np.concatenate([left, pulled])
        self._samples = len(jacobian)
        self._fitted = orthonormal(columns[:, size > 0.0] / size[size > 0.0])

    @property
    def residuals(self) -> Array:
        """(r,) whitened residuals, all that the fit frees at its best."""
        return np.asarray(self._residuals - self._fitted @ (self._fitted.T @ self._residuals))[: self._samples]

    def along(self, change: Array) -> tuple[float, float]:
        """Of an (r,) change: the square of what the fit cannot follow, and its product with the residual."""
        left = self._left(change[:, None])
        return float(np.sum(np.square(left))), float(left[:, 0] @ self._residuals)

    def gain(self, directions: Array) -> float:
        """By how much χ² falls where the fit may move along (r, q) directions, too."""
        left = self._left(directions)
        powers, axes = np.linalg.eigh(gram(left, left))
        kept = (powers > MOVES_NOTHING**2) & (powers > DEPENDENT * powers[-1])
        pulls = axes[:, kept].T @ gram(left, self._residuals)
        return float(np.sum(np.square(pulls) / powers[kept]))

    def _left(self, directions: Array) -> Array:
        directions = self._problem.without_errors(directions)
        padded = np.vstack([directions, np.zeros((len(self._fitted) - self._samples, directions.shape[1]))])
        return np.asarray(padded - self._fitted @ (self._fitted.T @ padded))
