"""The outcome of a fit: values, what the data say of them, and the evidence of the model: theory, section 4."""

from __future__ import annotations

import functools
import math
from collections.abc import Callable, Iterable, Mapping, Sequence
from dataclasses import dataclass, replace
from typing import Final

import numpy as np

from valve_sim.identification.fit.descent import MOST, Descended, descend
from valve_sim.identification.fit.gaussian import Gaussian, MachineKnowledge, Sizes, factored
from valve_sim.identification.fit.model import Model
from valve_sim.identification.fit.problem import Problem
from valve_sim.identification.fit.process import Cell, Process
from valve_sim.identification.fit.unknown import Unknown
from valve_sim.identification.plants.protocol import Array, Nuisance, primary_channels

COLLINEAR: Final = 100.0
"""Variance of a parameter, over that if all others were known, beyond which it is collinear: theory, eq. (34)."""
AT_END: Final = 1e-9
"""Of a scale, within which a parameter is on the bound of its range."""


@dataclass(frozen=True, eq=False)
class Fit:
    """The outcome of one fit; hashed by identity for caching.

    Attributes:
        gaussian: the linearised model where the fit ended. converged: whether nothing was left to be gained.
        is_widened: whether the covariance allows for the sizes of the recordings' errors being estimates.
        beside: the same with something unnamed beside it, which the covariance allows for; None: nothing is.
    """

    gaussian: Gaussian
    converged: bool
    is_widened: bool = False
    beside: Gaussian | None = None

    @classmethod
    def of(cls, descended: Descended) -> Fit:
        """The outcome of a descent."""
        return cls(descended.gaussian, descended.converged)

    @property
    def model(self) -> Model:
        """What was freed."""
        return self.gaussian.model

    @property
    def problem(self) -> Problem:
        """Data and noise."""
        return self.model.problem

    @property
    def coordinates(self) -> Array:
        """(k,) where what moves a run has been found."""
        return self.gaussian.z

    @functools.cached_property
    def free(self) -> tuple[str, ...]:
        """Names of what was refitted; these come first among all coordinates."""
        return tuple(own.name for own in self.model.moving if own.is_freed and not own.slopes)

    @functools.cached_property
    def nuisances(self) -> tuple[Nuisance, ...]:
        """What was estimated along, each with the standard deviation of its prior."""
        return tuple(
            own.nuisance if own.group is None else own.nuisance._replace(sigma=self.gaussian.size(own.group))
            for own in self.model.moving
            if own.nuisance is not None and not own.is_freed
        )

    @functools.cached_property
    def names(self) -> list[str]:
        """(k,) of all coordinates."""
        return [own.name for own in self.model.moving]

    @functools.cached_property
    def values(self) -> dict[str, float]:
        """The values of a run, by name: what was freed and estimated, and what was held."""
        return self.model.values(self.coordinates)

    @property
    def chi2(self) -> float:
        """The criterion, priors included, errors of sensors at their best."""
        return self.gaussian.cost

    @property
    def log_evidence(self) -> float:
        """Ln p(data | model) for the sizes of the recordings' errors that it has: theory, eq. (41)."""
        return self.gaussian.log_evidence

    @functools.cached_property
    def of_machine(self) -> list[int]:
        """Places among the coordinates of what belongs to the machine, and not to its recordings."""
        return [place for place, own in enumerate(self.model.moving) if own.of_machine]

    @functools.cached_property
    def of_recordings(self) -> list[int]:
        """Places of all others: errors of the recordings."""
        return [place for place, own in enumerate(self.model.moving) if not own.of_machine]

    def values_at(self, at: Array) -> dict[str, float]:
        """Values by name at (k,) coordinates, which are kept within their ranges; what is held stays."""
        inside = np.clip(at, self.gaussian.lower, self.gaussian.upper)
        return self.model.values(inside)

    # -- what is left --------------------------------------------------------------------------------------------------

    @functools.cached_property
    def residuals(self) -> Array:
        """(n,) whitened residuals of each sample of all channels in a row."""
        return self.problem.residuals(self.model.values(self.coordinates))

    @property
    def unexplained(self) -> Array:
        """(n,) of the residuals what the errors of the recordings leave."""
        found = self.residuals.copy()
        columns = {index: own[:, None] for index, own in enumerate(self.added)}
        for where, rows in self.problem.every_row.whitened_columns(columns).values():
            found[where] -= rows[:, 0]
        return found

    def shown(self) -> list[Array]:
        """What each channel shows by this fit: the plant's prediction, and the errors of the recordings."""
        shown = self.problem.plant.predict(self.model.values(self.coordinates))
        return [seen + own for seen, own in zip(shown, self.added, strict=True)]

    @functools.cached_property
    def _of_columns(self) -> Array:
        """(q, q) covariance of the coefficients of columns, all else held."""
        k = self.gaussian.count
        own = self.gaussian.M[k:, k:]
        scale = 1.0 / np.sqrt(np.diag(own))
        inverse = np.linalg.inv(factored(own * np.outer(scale, scale)))
        return np.asarray(inverse.T @ inverse * np.outer(scale, scale)) if len(own) else own

    @functools.cached_property
    def coefficients(self) -> Array:
        """(q,) of columns of errors, at their best where the fit is."""
        return np.asarray(-self._of_columns @ self.gaussian.g[self.gaussian.count :])

    @functools.cached_property
    def added(self) -> list[Array]:
        """(n,) of each channel: what the errors of its sensor add to it."""
        return self.shown_by(self.coefficients)

    def shown_by(self, coefficients: Array, errors: Iterable[str] | None = None) -> list[Array]:
        """(n,) of each channel: what (q,) coefficients of columns add to it; those of some errors, or of all."""
        columns, chosen = self.problem.columns, None if errors is None else set(errors)
        whole = np.zeros(len(columns.unknowns))
        for own, value in zip(self.model.linear, coefficients.tolist(), strict=True):
            if chosen is None or (own.group is not None and own.group.error in chosen):
                whole[own.column] = value
        found = [np.zeros(len(channel.data)) for channel in self.problem.plant.channels]
        for channel, samples in columns.samples.items():
            first = columns.first[channel]
            found[channel] = samples @ whole[first : first + samples.shape[1]]
        return found

    def errors_following(self, change: Array) -> list[Array]:
        """(n,) of each channel: what its errors add where (r,) residuals have changed so."""
        return self.shown_by(-self._of_columns @ self.gaussian.sums.fixed.onto(change))

    def variance_of_errors(self) -> list[Array]:
        """(n,) of each channel: the variance of what the errors of its sensor add to it."""
        columns, places = self.problem.columns, [own.column for own in self.model.linear]
        found = [np.zeros(len(channel.data)) for channel in self.problem.plant.channels]
        for channel, samples in columns.samples.items():
            first = columns.first[channel]
            own = [at for at, place in enumerate(places) if first <= place < first + samples.shape[1]]
            seen = samples[:, [places[at] - first for at in own]]
            found[channel] = np.einsum("ij,ij->i", seen @ self._of_columns[np.ix_(own, own)], seen)
        return found

    # -- what the data say of the values -------------------------------------------------------------------------------

    @functools.cached_property
    def information(self) -> Array:
        """(k, k) of the coordinates, priors included, errors of sensors at their best."""
        return self.gaussian.reduced[0]

    @functools.cached_property
    def covariance(self) -> Array:
        """(k, k) of the coordinates: theory, eq. (31)."""
        found = (self.beside or self.gaussian).covariance
        return found + self.further if self.is_widened else found

    @functools.cached_property
    def further(self) -> Array:
        """(k, k) what the sizes of the recordings' errors being estimates adds to the covariance."""
        found = self.gaussian.spread_of_sizes
        # Sizes whose own coordinates they are have no say in their own errors.
        values, axes = np.linalg.eigh(0.5 * (found + found.T))
        return np.asarray((axes * np.maximum(values, 0.0)) @ axes.T)

    def widened(self) -> Fit:
        """The same fit, its covariance allowing for the sizes of the recordings' errors being estimates."""
        return replace(self, is_widened=True) if self.gaussian.groups else self

    def allowing(self, process: Process, cell: Cell) -> Fit:
        """The same fit, its covariance allowing for something unnamed at its most probable size."""
        return replace(self, beside=self.gaussian.beside(process, cell)) if process.blocks else self

    def widening(self, name: str) -> float:
        """By how much its variance is larger for the sizes of errors being estimates, and for something unnamed."""
        place = self.names.index(name)
        variance, known = float(self.covariance[place, place]), float(self.gaussian.covariance[place, place])
        return max(1.0, variance / max(known, 1e-300)) if math.isfinite(variance) and math.isfinite(known) else 1.0

    @property
    def machine(self) -> MachineKnowledge:
        """What is known of the machine when the errors of the recordings are estimated along: the Schur complement."""
        own, others = self.of_machine, self.of_recordings
        between = self.information[np.ix_(own, others)]
        known = self.information[np.ix_(own, own)]
        if others:
            known = known - between @ np.linalg.solve(self.information[np.ix_(others, others)], between.T)
        return MachineKnowledge(tuple(self.names[place] for place in own), self.coordinates[own], known)

    @property
    def deviations(self) -> Array:
        """(m,) by how much each nuisance is off the mean of its prior, in standard deviations of that."""
        return np.array([(self.values[own.name] - own.mean) / own.sigma for own in self.nuisances])

    @property
    def effective_parameters(self) -> float:
        """How many parameters were freed; of smooth curves, those that the data determine: theory, eq. (52)."""
        of_prior = np.array([own.is_freed and own.group is not None for own in self.model.moving])
        shares = np.diag(self.gaussian.covariance)[of_prior] * self.gaussian.pulls[2][of_prior]
        return len(self.free) - float(np.sum(shares))

    def unknown(self, name: str) -> Unknown:
        """What was freed or estimated under a name."""
        return self.model.moving[self.names.index(name)]

    def stderr(self, name: str) -> float:
        """Standard error of a freed parameter in its own unit; inf where the data do not determine it."""
        place = self.names.index(name)
        error = math.sqrt(max(0.0, float(self.covariance[place, place])))
        return error * abs(self.model.moving[place].slope(float(self.coordinates[place])))

    def is_collinear(self, name: str) -> bool:
        """Whether other parameters can nearly take its place, so that a parabola does not describe its interval.

        Dampings are collinear with those of an asymmetric friction, which has one for each direction.
        """
        place = self.names.index(name)
        known, variance = float(self.information[place, place]), float(self.covariance[place, place])
        return math.isfinite(variance) and known * variance > COLLINEAR

    def correlation(self) -> Array:
        """(f, f) of the freed parameters."""
        count = len(self.free)
        covariance = self.covariance[:count, :count]
        error = np.sqrt(np.diag(covariance))
        correlation = np.asarray(np.where(np.isfinite(covariance), covariance, 0.0) / np.outer(error, error))
        np.fill_diagonal(correlation, 1.0)
        return correlation

    def on_bound(self, name: str) -> str | None:
        """'lower' or 'upper' if a parameter is on that bound, in its coordinate; infinity is none."""
        own, at = self.unknown(name), float(self.coordinates[self.names.index(name)])
        scale = AT_END * max(abs(at), own.scale)
        if own.parameter is not None and own.parameter.infinite_at_upper and at - own.lower <= scale:
            return None
        return "lower" if at - own.lower <= scale else "upper" if own.upper - at <= scale else None

    def without(self, name: str, at: float) -> Model:
        """What was freed, but one parameter, which is held at a coordinate: a point of its profile."""
        own = self.unknown(name)
        rest = [other for other in self.model.unknowns if other.name != name]
        held = {**self.model.held, **{key: own.value(at) * by for key, by in (own.slopes or {name: 1.0}).items()}}
        return Model(self.problem, rest, held)


def fit(
    problem: Problem,
    unknowns: Sequence[Unknown],
    start: Mapping[str, float],
    *,
    held: Mapping[str, float] | None = None,
    sizes: Sizes | None = None,
    known: MachineKnowledge | None = None,
    most: int = MOST,
) -> Fit:
    """Lower the criterion from one start.

    Args:
        problem: data and noise. unknowns: what is freed, but for what is held.
        start: values to start from, by name; what is missing starts where nothing has been estimated.
        held: values of a run that are fixed.
        sizes: of groups of errors; those that are missing have their scale, and what is as good as none is left out.
        known: what other data say of the machine, beside the priors. most: linearisations.

    Raises:
        SimulationError: the machine cannot be simulated where it starts.
    """
    held = dict(held or {})
    sizes = dict(sizes or {})
    free = [own for own in unknowns if not {own.name, *own.replaces} & held.keys() and own.is_there(sizes)]
    free.sort(key=lambda own: not own.is_freed)
    model = Model(problem, free, held)
    return Fit.of(descend(model, model.at(start), sizes, most=most, known=known))


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
