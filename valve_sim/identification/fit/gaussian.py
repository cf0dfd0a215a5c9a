"""Everything after one linearisation: sums of squares of [J | B | e], priors, and what follows from both.

About a place z the criterion is

    Q(d) = c + 2 gᵀ d + dᵀ M d

over steps d of what moves and of coefficients of columns, with the data's products and the priors' curvatures in M.
From it follow the steps of a descent, the evidence (Laplace's, within the ranges), the sizes of groups, covariances,
and what an addition would gain; and, with a random process in the covariance of the residuals, all of these beside
something without a name. Columns are at their best wherever the rest is: they are taken out by a Schur complement.
(Theory, eqs. (36) to (40).)
"""

from __future__ import annotations

import copy
import math
from collections.abc import Iterable, Mapping
from functools import cached_property
from typing import Final, NamedTuple

import numpy as np
from numpy.typing import NDArray
from scipy.linalg.lapack import dpotrf, dpotri, dpotrs
from scipy.special import logsumexp

from valve_sim.identification.fit.evidence import log_volume
from valve_sim.identification.fit.gram import gram
from valve_sim.identification.fit.model import Model, Sums
from valve_sim.identification.fit.priors import Normal, Prior, log_density_of, pulls_of
from valve_sim.identification.fit.process import LENGTHS, LOG_PRIOR_OF_TAU, SMALLEST, TAUS, Cell, Process
from valve_sim.identification.fit.unknown import Group
from valve_sim.identification.plants.protocol import Array

NO_INFORMATION: Final = 1e-290
"""Information below which an unknown has no influence at all."""
BELOW_PEAK: Final = 12.0
"""Difference of ln p from the most probable τ, beyond which others count for nothing."""
SWEEPS: Final = 4
"""Over the groups, when their sizes are sought."""
LITTLE: Final = (0.0, 1e-12, 1e-9, 1e-6, 1e-3)
"""Added to a unit diagonal where rounding shows."""

Sizes = Mapping[str, float]


def factored(matrix: Array) -> Array:
    """(k, k) Cholesky's factor of a positive matrix of about unit diagonal; a little is added where rounding shows.

    Raises:
        numpy.linalg.LinAlgError: it is not positive.
    """
    for little in LITTLE:
        factor, failed = dpotrf(matrix + little * np.eye(len(matrix)) if little else matrix, lower=1)
        if not failed:
            return np.asarray(factor)
    raise np.linalg.LinAlgError("the information is not positive")


class MachineKnowledge(NamedTuple):
    """What other data say of the machine: (k,) names and coordinates, and (k, k) their information, priors included."""

    names: tuple[str, ...]
    coordinates: Array
    information: Array


class OfSizes(NamedTuple):
    """Ln of likelihood and of prior on the grid of a group's sizes, (n,) each."""

    likelihood: Array
    prior: Array


class Spread(NamedTuple):
    """The evidence with something unnamed beside a model.

    Attributes:
        log_evidence: summed over τ and ℓ. cell: the most probable. tau: its posterior mean.
    """

    log_evidence: float
    cell: Cell
    tau: float


class Gaussian:
    """A linearised model with its priors.

    Args:
        model: what was linearised. z: (k,) where. sums: there.
        sizes: of groups, by name; those that are missing have their scale. known: what other data say of the machine.

    Attributes:
        M, g, c: as above. products: of the data. count: k.
    """

    def __init__(self, model: Model, z: Array, sums: Sums, sizes: Sizes, known: MachineKnowledge | None = None) -> None:
        self.model, self.z, self.sums, self.sizes, self.known = model, np.asarray(z), sums, dict(sizes), known
        self.products, self.count = sums.products, len(model.moving)
        self.lower, self.upper = model.lower, model.upper
        k = self.count
        self.priors: list[Prior] = [
            Normal(own.prior.mean, self.size(own.group)) if own.group and isinstance(own.prior, Normal) else own.prior
            for own in model.moving
        ]
        self.pulls = pulls_of(self.priors, self.z)
        self.M, self.g = self.products[:-1, :-1].copy(), self.products[:-1, -1].copy()
        curvature = np.zeros(len(self.M))
        curvature[:k] = self.pulls[2]
        curvature[k:] = [self.size(own.group) ** -2 for own in model.linear]
        self.M[np.diag_indices(len(self.M))] += curvature
        self.g[:k] += self.pulls[1]
        self.c = float(self.products[-1, -1]) + sums.constant + float(self.pulls[0].sum())
        if known is not None:
            off, information = self._beyond_known(known)
            self.M[:k, :k] += information
            self.g[:k] += information @ off
            self.c += float(off @ information @ off)

    def _beyond_known(self, known: MachineKnowledge) -> tuple[Array, Array]:
        """(k,) how far z is from what other data say, and (k, k) their information."""
        off, information = np.zeros(self.count), np.zeros((self.count, self.count))
        places = [self.model.index[name] for name in known.names]
        off[places] = self.z[places] - known.coordinates
        information[np.ix_(places, places)] = known.information
        return off, information

    def size(self, group: Group | None) -> float:
        """The size of a group."""
        return 1.0 if group is None else self.sizes.get(group.name, group.scale)

    def resized(self, sizes: Sizes) -> Gaussian:
        """With other sizes of some groups."""
        same = Gaussian(self.model, self.z, self.sums, {**self.sizes, **sizes}, self.known)
        return same if self.products is self.sums.products else same._less(self.sums.products - self.products)

    def beside(self, process: Process, cell: Cell) -> Gaussian:
        """With a process in the covariance of the residuals."""
        rotated = process.rotated(self.sums, cell.length)
        return self._less(gram(rotated, process.shrinkage(cell)[:, None] * rotated))

    def _less(self, products: Array) -> Gaussian:
        """With a part of the data's products taken away; all that follows from priors stays."""
        same = copy.copy(self)
        for name in ("reduced", "log_evidence", "inverse", "best", "covariance"):
            same.__dict__.pop(name, None)
        same.products = self.products - products
        same.M, same.g = self.M - products[:-1, :-1], self.g - products[:-1, -1]
        same.c = self.c - float(products[-1, -1])
        return same

    # -- without the columns -------------------------------------------------------------------------------------------

    @cached_property
    def reduced(self) -> tuple[Array, Array, float, float]:
        """Information (k, k), half gradient (k,), criterion, and ½ ln |M| of the columns, these at their best."""
        k = self.count
        if k == len(self.M):
            return self.M, self.g, self.c, 0.0
        scale = 1.0 / np.sqrt(np.diag(self.M)[k:])
        factor = factored(self.M[k:, k:] * np.outer(scale, scale))
        cross = scale[:, None] * np.column_stack([self.M[k:, :k], self.g[k:]])
        less = cross.T @ dpotrs(factor, cross, lower=1)[0]
        half_log = float(np.sum(np.log(np.diag(factor)))) - float(np.sum(np.log(scale)))
        return self.M[:k, :k] - less[:k, :k], self.g[:k] - less[:k, k], self.c - float(less[k, k]), half_log

    @property
    def cost(self) -> float:
        """The criterion here, columns at their best."""
        return self.reduced[2]

    def step(self, damping: float = 0.0, held: NDArray[np.bool_] | None = None) -> tuple[Array, float]:
        """(k,) the damped step within the ranges, and the decrease of the criterion that it promises.

        Args:
            damping: λ of theory, eq. (29). held: (k,) what does not move.
        """
        information, gradient, _, _ = self.reduced
        diagonal = np.diag(information)
        out = ((self.z <= self.lower) & (gradient > 0.0)) | ((self.z >= self.upper) & (gradient < 0.0))
        out |= diagonal < NO_INFORMATION
        out = out if held is None else out | held
        size, move = 1.0 / np.sqrt(np.where(diagonal < NO_INFORMATION, 1.0, diagonal)), np.zeros(self.count)
        normal = information * np.outer(size, size)
        normal[np.diag_indices(self.count)] *= 1.0 + damping
        normal[np.diag_indices(self.count)] += 1e-12
        for _ in range(self.count):
            free, ends = np.flatnonzero(~out), np.flatnonzero(out)
            if not len(free):
                break
            rest = gradient[free] + information[np.ix_(free, ends)] @ move[ends]
            move[free] = -size[free] * np.linalg.solve(normal[np.ix_(free, free)], size[free] * rest)
            beyond = ~out & ((self.z + move < self.lower) | (self.z + move > self.upper))
            if not beyond.any():
                break
            move[beyond] = np.clip(self.z + move, self.lower, self.upper)[beyond] - self.z[beyond]
            out |= beyond
        return move, max(0.0, -float(2.0 * gradient @ move + move @ information @ move))

    @cached_property
    def inverse(self) -> Array:
        """(k + q, k + q) M⁻¹; nothing of what has no influence at all, which stays where it is."""
        diagonal = np.diag(self.M)
        alive = diagonal > NO_INFORMATION
        scale = np.where(alive, 1.0 / np.sqrt(np.where(alive, diagonal, 1.0)), 0.0)
        unit = self.M * np.outer(scale, scale)
        unit[~alive, ~alive] = 1.0
        inverse, _ = dpotri(factored(unit), lower=1)
        return np.asarray((np.tril(inverse) + np.tril(inverse, -1).T) * np.outer(scale, scale))

    @cached_property
    def best(self) -> Array:
        """(k + q,) the step to where all is at its best, whatever the ranges."""
        return np.asarray(-self.inverse @ self.g)

    @property
    def left_at_best(self) -> Array:
        """(r,) residuals there, to first order."""
        k = self.count
        return np.asarray(self.sums.left + self.sums.moved[:, :-1] @ self.best[:k] + self.sums.fixed @ self.best[k:])

    @cached_property
    def covariance(self) -> Array:
        """(k, k) of what moves: theory, eq. (31).

        Directions that nothing determines have a huge variance; an unknown without any influence has an infinite one,
        and no correlation.
        """
        information = self.reduced[0]
        diagonal = np.diag(information)
        alive = diagonal > NO_INFORMATION
        scale = 1.0 / np.sqrt(diagonal[alive])
        values, axes = np.linalg.eigh(information[np.ix_(alive, alive)] * np.outer(scale, scale))
        found = np.diag(np.where(alive, 0.0, np.inf))
        found[np.ix_(alive, alive)] = (axes / np.maximum(values, 1e-14)) @ axes.T * np.outer(scale, scale)
        return found

    # -- evidence ------------------------------------------------------------------------------------------------------

    @cached_property
    def log_evidence(self) -> float:
        """Ln p(data | model) for these sizes: Laplace's approximation about the best place that one step reaches."""
        information, gradient, cost, half_log = self.reduced
        move, gain = self.step()
        at = self.z + move
        volume = log_volume(
            information, gradient + information @ move, np.column_stack([at - self.lower, self.upper - at])
        )
        of_priors = log_density_of(self.priors, self.z) + 0.5 * float(self.pulls[0].sum())
        if self.known is not None:
            values = np.linalg.eigvalsh(self.known.information)
            values = values[values > 1e-14 * values[-1:]]  # of none, where other data say nothing
            of_priors += 0.5 * float(np.sum(np.log(values))) - 0.5 * len(values) * math.log(2.0 * math.pi)
        of_columns = -math.fsum(math.log(self.size(own.group)) for own in self.model.linear)
        return -0.5 * (cost - gain) + of_priors + volume + of_columns - half_log

    # -- sizes of groups -----------------------------------------------------------------------------------------------

    @cached_property
    def groups(self) -> dict[str, tuple[Group, NDArray[np.intp]]]:
        """By name the groups whose size the data say, with the places of their unknowns."""
        found: dict[str, tuple[Group, list[int]]] = {}
        for place, own in enumerate(self.model.unknowns):
            if own.group is not None and own.group.is_learned:
                found.setdefault(own.group.name, (own.group, []))[1].append(place)
        return {name: (group, np.array(places, dtype=np.intp)) for name, (group, places) in found.items()}

    def by_size(self, group: Group, places: NDArray[np.intp], sizes: Array | None = None) -> OfSizes:
        """Ln of likelihood, less that of none, and of the prior, by a group's sizes, those of others as they are.

        With all else at its best the data say of the group's coefficients b what −½ bᵀ F b + fᵀ b says: in the
        eigenvectors of F each size is a sum.

        Args:
            group: which. places: of its unknowns. sizes: (n,); default its grid.
        """
        grid = group.grid if sizes is None else sizes
        sigma, size = self.inverse[np.ix_(places, places)], self.size(group)
        means = np.array([own.prior.mean if isinstance(own.prior, Normal) else 0.0 for own in self.model.unknowns])
        at = (np.concatenate([self.z, np.zeros(len(self.M) - self.count)]) - means)[places] + self.best[places]
        shares, axes = np.linalg.eigh(sigma / size**2)  # of the prior's variance, what the data leave
        shares = np.clip(shares, 1e-14, 1.0)
        values, pull = (1.0 / shares - 1.0) / size**2, axes.T @ at / (shares * size**2)
        squares = np.square(grid)[:, None]
        terms = squares * pull**2 / (1.0 + squares * values) - np.log1p(squares * values)
        return OfSizes(0.5 * terms.sum(axis=1), group.log_prior(grid))

    def with_best_sizes(self, names: Iterable[str] | None = None) -> Gaussian:
        """With the most probable sizes of some groups, or of all, one group after the other."""
        chosen = None if names is None else set(names)
        found = self
        for _ in range(SWEEPS):
            before = dict(found.sizes)
            for name, (group, places) in self.groups.items():
                if chosen is None or name in chosen:
                    logs = found.by_size(group, places)
                    size = float(group.grid[int(np.argmax(logs.likelihood + logs.prior))])
                    if size != found.size(group):
                        found = found.resized({name: size})
            if before == found.sizes:
                break
        return found

    def log_integral(self, names: Iterable[str] | None = None) -> float:
        """Ln of the integral over the sizes of some groups, over the integrand here; `log_evidence` is without it."""
        chosen = None if names is None else set(names)
        total = 0.0
        for name, (group, places) in self.groups.items():
            if chosen is None or name in chosen:
                logs = self.by_size(group, places)
                here = self.by_size(group, places, np.array([self.size(group)]))
                total += _log_integral(group, logs) - float(here.likelihood[0])
        return total

    def probabilities(self) -> dict[str, float]:
        """Of each group, that it is there at all: Z/(Z + L(0))."""
        return {
            name: 1.0 / (1.0 + math.exp(-min(_log_integral(group, self.by_size(group, places)), 700.0)))
            for name, (group, places) in self.groups.items()
        }

    @cached_property
    def spread_of_sizes(self) -> Array:
        """(k, k) what not knowing the sizes adds to the covariance: mean excess and spread of estimates over each."""
        k, found = self.count, np.zeros((self.count, self.count))
        means = np.array([own.prior.mean if isinstance(own.prior, Normal) else 0.0 for own in self.model.unknowns])
        at = np.concatenate([self.z, np.zeros(len(self.M) - k)]) - means + self.best
        for group, places in self.groups.values():
            logs = self.by_size(group, places)
            weights = logs.likelihood + logs.prior + np.log(group.grid)
            weights = np.exp(weights - logsumexp(weights))
            values, axes = np.linalg.eigh(self.inverse[np.ix_(places, places)])
            change = group.grid**-2.0 - self.size(group) ** -2  # of the precision
            change[change == 0.0] = 1e-300
            factors = -1.0 / (1.0 / change[:, None] + values)
            along = self.inverse[:k, places] @ axes
            shifts = (factors * (axes.T @ at[places])) @ along.T
            found += (along * (weights @ factors)) @ along.T + shifts.T @ (weights[:, None] * shifts)
        return found

    # -- beside a process, and beside what is not in it ----------------------------------------------------------------

    def spread(self, process: Process) -> Spread:
        """The evidence with something unnamed beside the model, summed over τ and ℓ."""
        if not process.blocks:
            return Spread(self.log_evidence, SMALLEST, 0.0)
        logs, row = np.full((len(TAUS), len(LENGTHS)), -np.inf), 0
        for length in range(len(LENGTHS)):
            rotated = process.rotated(self.sums, length)

            def log_at(row: int, rotated: Array = rotated, length: int = length) -> float:
                cell = Cell(float(TAUS[row]), length)
                there = self._less(gram(rotated, process.shrinkage(cell)[:, None] * rotated))
                found = there.log_evidence - 0.5 * float(process.log_determinants(cell).sum())
                logs[row, length] = found + LOG_PRIOR_OF_TAU[row] - math.log(len(LENGTHS))
                return float(logs[row, length])

            # One peak, near that of the length before: beyond it nothing counts.
            most, start = log_at(row), row
            for way in (1, -1):
                at = start + way
                while 0 <= at < len(TAUS) and log_at(at) > most - BELOW_PEAK:
                    if logs[at, length] > most:
                        most, row = float(logs[at, length]), at
                    at += way
        total = float(logsumexp(logs))
        best = np.unravel_index(int(np.argmax(logs)), logs.shape)
        mean = float(np.exp(logs - total).sum(axis=1) @ TAUS)
        return Spread(total, Cell(float(TAUS[int(best[0])]), int(best[1])), mean)

    def beyond(self, columns: Array) -> tuple[Array, Array]:
        """(q, q), (q,): products of (r, q) further columns, and with the residuals, of what nothing here can follow."""
        moved, fixed = gram(self.sums.moved, columns), self.sums.fixed.onto(columns)
        cross = np.vstack([moved[:-1], fixed])
        solved = self.inverse @ np.column_stack([cross, self.g])
        return gram(columns, columns) - cross.T @ solved[:, :-1], moved[-1] - cross.T @ solved[:, -1]


def _log_integral(group: Group, logs: OfSizes) -> float:
    """Ln of ∫ L(s)/L(0) p(s) ds; densities are of s over the scale, and the grid is even in its logarithm."""
    step = math.log(group.grid[1] / group.grid[0])
    return float(logsumexp(logs.likelihood + logs.prior + np.log(group.grid / group.scale))) + math.log(step)
