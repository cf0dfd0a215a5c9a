"""The outcome of a fit: values, what the data say of them, and the evidence of the model: theory, section 4."""

from __future__ import annotations

import functools
import math
from collections.abc import Callable, Mapping
from dataclasses import dataclass, field
from typing import Final, NamedTuple

import numpy as np

from valve_sim.identification.estimation.evidence import log_volume
from valve_sim.identification.estimation.gram import gram
from valve_sim.identification.estimation.priors import Prior, log_density_of, pulls_of
from valve_sim.identification.estimation.problem import Problem
from valve_sim.identification.estimation.smoothing import Smoothness
from valve_sim.identification.estimation.structured_noise import shown_by
from valve_sim.identification.plants.protocol import (
    Array,
    Nuisance,
    from_internal,
    internal_bounds,
    internal_scale,
    internal_slope,
    primary_channels,
)

FIRST_DAMPING: Final = 1e-4
"""Of λ in theory, eq. (29), at the start of a fit."""
NO_INFORMATION: Final = 1e-290
"""Information below which a parameter has no influence at all."""
SMALLEST_SHARE: Final = 1e-14
"""Smallest eigenvalue of the information, scaled to a unit diagonal, that is not rounding error."""
COLLINEAR: Final = 100.0
"""Variance of a parameter, over that if all others were known, beyond which it is collinear: theory, eq. (34)."""


class MachineKnowledge(NamedTuple):
    """What a fit says of the values of a machine, for fits to other data of it.

    Attributes:
        names: (k,) freed parameters, then declared values with a tolerance.
        coordinates: (k,) where they are. information: (k, k) about there, their priors included.
    """

    names: tuple[str, ...]
    coordinates: Array
    information: Array


class Rows:
    """What a fit has for each sample, or for each row that was fitted; worked out when asked for, and then kept.

    It is by far the largest part of a fit, and may be dropped.

    Args:
        every: works out (n,) or (n, k + m) of each sample.
        fitted: works out the same of the rows that were fitted, where these are fewer; None: they are not.
        known: (r,) or (r, k + m) of the rows that were fitted, where they are at hand.
    """

    def __init__(self, every: Callable[[], Array], fitted: Callable[[], Array] | None, known: Array | None) -> None:
        self._every, self._fitted = every, fitted
        self._known_every = known if fitted is None else None
        self._known = known

    def array(self) -> Array:
        """(n,) or (n, k + m)."""
        found = self._known_every
        if found is None:
            self._known_every = found = self._every()
        return found

    def condensed(self) -> Array:
        """(r,) or (r, k + m) of the rows that were fitted."""
        if self._fitted is None:
            return self.array()
        found = self._known
        if found is None:
            self._known = found = self._fitted()
        return found

    @property
    def at_hand(self) -> Array | None:
        """(r,) or (r, k + m) of the rows that were fitted, if they need not be worked out."""
        return self._known_every if self._fitted is None else self._known

    def drop(self) -> None:
        """Free the memory."""
        self._known_every = self._known = None


@dataclass(frozen=True, eq=False)
class Fit:
    """The outcome of one fit; hashed by identity for caching.

    Attributes:
        problem: what was fitted.
        free: names of the freed parameters. nuisances: of the nuisances estimated along.
        values: every freed parameter and nuisance at the optimum, in its unit.
        chi2: criterion at the optimum, nuisance priors included.
        left: whitened residuals there. derivatives: of the residuals there. Of a long recording neither is at hand.
        information: (k + m, k + m), priors included.
        converged: whether the last step was small enough.
        coordinates: (k + m,) where they were searched. priors: (k + m) of these.
        slopes: (k + m,) half the gradient of the criterion there: not 0 where a coordinate is on the end of its range.
        room: (k + m, 2) how far the range goes on below and above.
        smooth: the curve among what was freed, with its prior, which `chi2` and `information` include.
        damping: λ of theory, eq. (29), of the next step.
        chi2_lower_bound: χ² that it can be expected to come to, at the least.
        further: (k + m, k + m) what the covariance of the recordings' errors adds to that of the fit; None: nothing.
    """

    problem: Problem
    free: tuple[str, ...]
    nuisances: tuple[Nuisance, ...]
    values: dict[str, float]
    chi2: float
    left: Rows
    derivatives: Rows
    information: Array
    converged: bool
    coordinates: Array = field(repr=False)
    priors: tuple[Prior, ...] = field(repr=False)
    slopes: Array = field(repr=False)
    room: Array = field(repr=False)
    smooth: Smoothness | None = None
    damping: float = FIRST_DAMPING
    chi2_lower_bound: float = -math.inf
    further: Array | None = field(default=None, repr=False)

    @functools.cached_property
    def names(self) -> list[str]:
        """(k + m) of what was estimated: what was freed, and nuisances."""
        return [*self.free, *(nuisance.name for nuisance in self.nuisances)]

    @functools.cached_property
    def of_machine(self) -> list[int]:
        """Indices among `names` of what belongs to the machine, and not to its recordings."""
        count = len(self.free)
        return [*range(count), *(count + at for at, own in enumerate(self.nuisances) if own.is_of_machine)]

    @functools.cached_property
    def of_recordings(self) -> list[int]:
        """Indices of all others: errors of the recordings."""
        return sorted({*range(len(self.names))} - {*self.of_machine})

    def values_at(self, at: Array) -> dict[str, float]:
        """Values by name at (k + m,) search coordinates, which are kept within their ranges; what is held stays."""
        inside = np.clip(at, self.coordinates - self.room[:, 0], self.coordinates + self.room[:, 1]).tolist()
        found = {**self.values, **dict(zip(self.names, inside, strict=True))}
        for name in self.free:
            found[name] = from_internal(self.problem.plant.parameter(name), found[name])
        return found

    @property
    def residuals(self) -> Array:
        """(n,) whitened residuals of all channels in a row."""
        return self.left.array()

    @property
    def unexplained(self) -> Array:
        """(n,) of the residuals what the errors of the recordings leave."""
        left, errors = self.residuals, self.problem.errors
        if errors is None:
            return left
        shown = shown_by(errors, self.recording)
        rows = self.problem.every_row.whitened_columns({at: own[:, None] for at, own in shown.items()})
        found = left.copy()
        for where, own in rows.values():
            found[where] -= own[:, 0]
        return found

    @property
    def jacobian(self) -> Array:
        """(n, k + m) d(residuals)/d(internal coordinate), nuisances last."""
        return self.derivatives.array()

    @functools.cached_property
    def recording(self) -> Mapping[int, Array]:
        """(q,) coefficients of the errors of the recordings as this fit sees them, by channel."""
        errors = self.problem.error_rows
        return {} if errors is None else errors.estimates(self.left.condensed())

    def shown(self) -> list[Array]:
        """What each channel shows by this fit: the plant's prediction, and the errors of the recordings."""
        shown = self.problem.plant.predict(self.values)
        return [seen + own for seen, own in zip(shown, self.errors_of(self.left.condensed()), strict=True)]

    def errors_of(self, residuals: Array) -> list[Array]:
        """(n,) of each channel: what the sensors' errors add to it, given (r,) residuals of the fitted rows."""
        found = [np.zeros(len(channel.data)) for channel in self.problem.plant.channels]
        rows, errors = self.problem.error_rows, self.problem.errors
        if rows is not None and errors is not None:
            for channel, own in shown_by(errors, rows.estimates(residuals)).items():
                found[channel] = own
        return found

    def variance_of_errors(self) -> list[Array]:
        """(n,) of each channel: the variance of what the recordings' errors add to it."""
        found = [np.zeros(len(channel.data)) for channel in self.problem.plant.channels]
        rows, errors = self.problem.error_rows, self.problem.errors
        if rows is not None and errors is not None:
            for channel, covariance in rows.covariances.items():
                columns = errors.columns[channel].samples
                found[channel] = np.einsum("ij,ij->i", columns @ covariance, columns)
        return found

    @functools.cached_property
    def covariance(self) -> Array:
        """(k + m, k + m) of the internal coordinates: theory, eq. (31).

        Directions that the data do not determine have a huge variance; a parameter without any influence has an
        infinite one, and no correlation.
        """
        diagonal = np.diag(self.information)
        alive = diagonal > NO_INFORMATION
        scale = 1.0 / np.sqrt(diagonal[alive])
        sizes, directions = np.linalg.eigh(self.information[np.ix_(alive, alive)] * np.outer(scale, scale))
        inverse = (directions / np.maximum(sizes, SMALLEST_SHARE)) @ directions.T
        covariance = np.diag(np.where(alive, 0.0, np.inf))
        covariance[np.ix_(alive, alive)] = inverse * np.outer(scale, scale)
        return covariance if self.further is None else covariance + self.further

    def widening(self, name: str) -> float:
        """By how much the variance of a freed parameter is larger because the recordings' errors are estimates."""
        index = self.free.index(name)
        variance = float(self.covariance[index, index])
        if self.further is None or not math.isfinite(variance):
            return 1.0
        return variance / max(variance - float(self.further[index, index]), 1e-300)

    @property
    def machine(self) -> MachineKnowledge:
        """What is known of the machine when the errors of the recordings are estimated along: the Schur complement."""
        own, others = self.of_machine, self.of_recordings
        between = self.information[np.ix_(own, others)]
        known = self.information[np.ix_(own, own)]
        if len(others):
            known = known - between @ np.linalg.solve(self.information[np.ix_(others, others)], between.T)
        return MachineKnowledge(tuple(self.names[index] for index in own), self.coordinates[own], known)

    @property
    def deviations(self) -> Array:
        """(m,) by how much each nuisance is off the mean of its prior, in standard deviations of that."""
        return np.array([(self.values[own.name] - own.mean) / own.sigma for own in self.nuisances])

    @functools.cached_property
    def pulls(self) -> Array:
        """(3, k + m) what the priors add where the fit is: costs, half of their slopes, and curvatures."""
        return pulls_of(self.priors, self.coordinates)

    @functools.cached_property
    def log_evidence(self) -> float:
        """Natural logarithm of the evidence ln p(data | model), but for a constant of the data: theory, eq. (41).

        Laplace's approximation about the optimum, with the share of the Gaussian that lies within the ranges.
        """
        misfit = self.chi2 - math.fsum(self.pulls[0].tolist()) - self._penalty
        densities = log_density_of(self.priors, self.coordinates)
        found = -0.5 * misfit + densities + log_volume(self.information, self.slopes, self.room)
        found += self.problem.log_constant
        return found if self.smooth is None else found + self.smooth.log_density(self.coordinates[self.curve])

    @property
    def effective_parameters(self) -> float:
        """How many parameters were freed; of a smooth curve's, those that the data determine: theory, eq. (52)."""
        if self.smooth is None:
            return float(len(self.free))
        curve = self.curve
        return len(self.free) - float(np.sum(self.covariance[np.ix_(curve, curve)] * self.smooth.precision))

    def covariance_of_curve(self) -> Array:
        """(K, K) of the coefficients of the smooth curve: what bands are drawn from."""
        if self.smooth is None:
            return np.empty((0, 0))
        where = np.array(self.curve, dtype=np.int64)
        of_data = self.information.copy()
        of_data[np.ix_(where, where)] -= self.smooth.precision
        rows = self.problem.whitened(np.column_stack([self.derivatives.condensed(), self.left.condensed()]))
        gradient = gram(rows[:, :-1], rows[:, -1]) + self.pulls[1]
        return self.smooth.covariance(of_data, gradient, self.coordinates, where)

    @property
    def curve(self) -> list[int]:
        """Indices of the smooth curve's coefficients; none without a curve."""
        return [] if self.smooth is None else [self.free.index(name) for name in self.smooth.names]

    @property
    def _penalty(self) -> float:
        """The share of a smooth curve's prior in the criterion."""
        if self.smooth is None:
            return 0.0
        at = self.coordinates[self.curve]
        return float(at @ self.smooth.precision @ at)

    def stderr(self, name: str) -> float:
        """Standard error of a freed parameter in its own unit; inf where the data do not determine it."""
        index = self.free.index(name)
        error = math.sqrt(max(0.0, float(self.covariance[index, index])))
        slope = internal_slope(self.problem.plant.parameter(name), float(self.coordinates[index]))
        return error * slope

    def is_collinear(self, name: str) -> bool:
        """Whether other parameters can nearly take its place, so that a parabola does not describe its interval.

        Dampings are collinear with those of an asymmetric friction, which has one for each direction.
        """
        index = self.free.index(name)
        known, variance = float(self.information[index, index]), float(self.covariance[index, index])
        return math.isfinite(variance) and known * variance > COLLINEAR

    def correlation(self) -> Array:
        """(k, k) of the freed parameters."""
        k = len(self.free)
        covariance = self.covariance[:k, :k]
        error = np.sqrt(np.diag(covariance))
        correlation = np.asarray(np.where(np.isfinite(covariance), covariance, 0.0) / np.outer(error, error))
        np.fill_diagonal(correlation, 1.0)
        return correlation

    def on_bound(self, name: str) -> str | None:
        """'lower' or 'upper' if a parameter is on that bound, in its internal coordinate; infinity is none."""
        parameter = self.problem.plant.parameter(name)
        lower, upper = internal_bounds(parameter)
        at = float(self.coordinates[self.free.index(name)])
        scale = 1e-9 * max(abs(at), internal_scale(parameter))
        if parameter.infinite_at_upper and at - lower <= scale:
            return None
        return "lower" if at - lower <= scale else "upper" if upper - at <= scale else None


def rmse(result: Fit) -> float:
    """Root mean square of measured less predicted response over the samples that take part, in its unit."""
    return _root_mean_square(result, lambda weight: np.asarray(weight > 0.0, dtype=np.float64))


def effective_rmse(result: Fit) -> float:
    """Root mean square with each sample's weight in the fit, in its unit: to compare models of one recording.

    A coarse sensor at rest repeats one rounding error. Where its copies counted each, a model that puts the plunger at
    the reading would have a smaller error than the true one, whatever it predicts of the motion.
    """
    return _root_mean_square(result, np.square)


def _root_mean_square(result: Fit, share: Callable[[Array], Array]) -> float:
    plant, problem = result.problem.plant, result.problem
    squares, total = 0.0, 0.0
    predictions = result.shown()
    for index in primary_channels(plant):
        shares = share(problem.weight(index))
        squares += float(shares @ np.square(plant.channels[index].data - predictions[index]))
        total += float(np.sum(shares))
    return math.sqrt(squares / total) if total > 0.0 else 0.0
