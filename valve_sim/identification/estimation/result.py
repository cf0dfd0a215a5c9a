"""What a fit found, and how certain it is: standard errors, correlations, and scores for comparing models.

The criterion is χ² = Σ e² + Σ (nuisance / prior)², e the whitened residual. Its score, for comparing models, is

    S = χ²/f + k ln N + Σ ln max(1, σ_j² I_j)

with k freed parameters, N samples (copies of one reading count once), f the factor by which slow noise discounts
evidence, and for each nuisance the Occam factor of its prior σ_j and information I_j (Laplace; MacKay 2003, chapter
28): theory, eqs. (26) and (41). A difference of 10 in S is decisive: odds of 150 to 1.

A declared value that is freed although it has a tolerance σ is one that is taken for wrong. It is no parameter of
unknown size: its prior is ten times as wide as its tolerance, so that it is charged ln max(1, 100 σ² I) in place of
ln N. Where the data determine it, this is ln 100 = 4.6 more than the nuisance that it takes the place of, and it is
decisive from √14.6 = 3.8 tolerances on: theory, eq. (82).
"""

from __future__ import annotations

import functools
import math
from collections.abc import Callable
from dataclasses import dataclass, field
from typing import Final, NamedTuple

import numpy as np
from scipy import special

from valve_sim.identification.estimation.gram import gram
from valve_sim.identification.estimation.problem import Problem
from valve_sim.identification.estimation.smoothing import Smoothness
from valve_sim.identification.plants.protocol import (
    RELEASED,
    Array,
    Nuisance,
    internal_bounds,
    internal_scale,
    internal_slope,
    judged_channels,
    released_tolerances,
)

FIRST_DAMPING: Final = 1e-4
"""Of λ in theory, eq. (29), at the start of a fit."""
NO_INFORMATION: Final = 1e-290
"""Information below which a parameter has no influence at all."""
SMALLEST_SHARE: Final = 1e-14
"""Smallest eigenvalue of the information, scaled to a unit diagonal, that is not rounding error."""
DETERMINED: Final = 2.0
"""Information of data and prior together, over that of the prior, from which on the data say more than the prior."""
REFUTED: Final = 1e-3
"""Probability of larger errors of the stamps, below which their prior is taken to be too narrow."""
MOSTLY: Final = 0.5
"""Share of a gain that is most of it."""
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
    """What a fit has for each sample: by far its largest part, which may be dropped. It is worked out when asked for.

    Args:
        found: (n,) or (n, k + m); None where it is dropped already. again: works it out again.
        few: the same of the rows that were fitted, where these are fewer.

    Attributes:
        few: of the rows that were fitted; None where it is dropped.
    """

    def __init__(self, found: Array | None, again: Callable[[], Array], few: Array | None = None) -> None:
        self._found = found
        self._again = again
        self.few = found if few is None else few

    def array(self) -> Array:
        """(n,) or (n, k + m)."""
        found = self._found
        if found is None:
            self._found = found = self._again()
        return found

    @property
    def is_at_hand(self) -> bool:
        """Whether it need not be worked out."""
        return self._found is not None

    def drop(self) -> None:
        """Free the memory."""
        self._found = self.few = None


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
        smooth: the curve among what was freed, with its prior, which `chi2` and `information` include.
        damping: λ of theory, eq. (29), of the next step. reach: χ² that it can be expected to come to, at the least.
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
    smooth: Smoothness | None = None
    damping: float = FIRST_DAMPING
    reach: float = -math.inf

    @property
    def residuals(self) -> Array:
        """(n,) whitened residuals of all channels in a row."""
        return self.left.array()

    @property
    def jacobian(self) -> Array:
        """(n, k + m) d(residuals)/d(internal coordinate), nuisances last."""
        return self.derivatives.array()

    @functools.cached_property
    def covariance(self) -> Array:
        """(k + m, k + m) of the internal coordinates, variance inflation included: theory, eq. (31).

        Directions that the data do not determine have a huge variance; a parameter without any influence has an
        infinite one, and no correlation.
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
    def machine(self) -> MachineKnowledge:
        """What is known of the machine when the errors of the recordings are estimated along: theory, eq. (83)."""
        is_of_machine = [True] * len(self.free) + [nuisance.is_of_machine for nuisance in self.nuisances]
        own, others = np.flatnonzero(is_of_machine), np.flatnonzero(~np.array(is_of_machine))
        between = self.information[np.ix_(own, others)]
        known = self.information[np.ix_(own, own)]
        if len(others):
            known = known - between @ np.linalg.solve(self.information[np.ix_(others, others)], between.T)
        names = [*self.free, *(nuisance.name for nuisance in self.nuisances)]
        return MachineKnowledge(tuple(names[index] for index in own), self.coordinates[own], known)

    @property
    def deviations(self) -> Array:
        """(m,) by how much each nuisance is off the mean of its prior, in standard deviations of that."""
        return np.array([(self.values[own.name] - own.mean) / own.sigma for own in self.nuisances])

    @property
    def chi2_of_declared(self) -> float:
        """What declared values off their tolerances add to the criterion."""
        pairs = zip(self.deviations, self.nuisances, strict=True)
        return float(sum(deviation**2 for deviation, own in pairs if own.is_of_machine))

    @property
    def chi2_of_recordings(self) -> float:
        """What errors of clocks and of stamps add to the criterion."""
        return float(np.sum(np.square(self.deviations))) - self.chi2_of_declared

    @functools.cached_property
    def stamp_variance(self) -> float:
        """Mean square of the errors of the commands' stamps, in their prior's variances; 1 where it may be that.

        Only those count that the data determine. Stamps of a live node are off by far more than their prior says, and
        then so may be what else is wrong with the clocks.
        """
        stamps = [own in self.problem.plant.timing_errors for own in self.nuisances]
        sigmas = np.array([own.sigma for own in self.nuisances])
        known = np.diag(self.information)[len(self.free) :] * np.square(sigmas) > DETERMINED
        squares = np.square(self.deviations)[np.array(stamps, dtype=bool) & known]
        if special.chdtrc(max(1, len(squares)), float(np.sum(squares))) > REFUTED:
            return 1.0
        return float(np.mean(squares))

    @functools.cached_property
    def score(self) -> float:
        """The score S, theory, eq. (41): smaller is better, a difference of 10 is decisive."""
        occam = 0.0
        for index, nuisance in enumerate(self.nuisances, start=len(self.free)):
            occam += math.log(max(1.0, nuisance.sigma**2 * float(self.information[index, index])))
        misfit = (self.chi2 - self._penalty) / self.problem.variance_inflation
        released = released_tolerances(self.problem.plant)
        for index, name in enumerate(self.free):
            if name in released:
                width = RELEASED * released[name]
                occam += math.log(max(1.0, width**2 * float(self.information[index, index])))
        unknown = self.effective_parameters - sum(name in released for name in self.free)
        return misfit + unknown * math.log(self.problem.effective_samples) + occam

    @property
    def effective_parameters(self) -> float:
        """How many parameters were freed; of a smooth curve's, those that the data determine: theory, eq. (52)."""
        if self.smooth is None:
            return float(len(self.free))
        curve = self._curve
        fitted = self.covariance[np.ix_(curve, curve)] / self.problem.variance_inflation
        return len(self.free) - float(np.sum(fitted * self.smooth.precision))

    def covariance_of_curve(self) -> Array:
        """(K, K) of the coefficients of the smooth curve: what bands are drawn from."""
        if self.smooth is None:
            return np.empty((0, 0))
        where = np.array(self._curve, dtype=np.int64)
        of_data = self.information.copy()
        of_data[np.ix_(where, where)] -= self.smooth.precision
        priors = np.array([0.0] * len(self.free) + [own.sigma**-2 for own in self.nuisances])
        means = np.array([0.0] * len(self.free) + [own.mean for own in self.nuisances])
        gradient = gram(self.jacobian, self.residuals) + priors * (self.coordinates - means)
        return self.smooth.covariance(of_data, gradient, self.coordinates, where, self.problem.variance_inflation)

    @property
    def _curve(self) -> list[int]:
        """Indices of the smooth curve's coefficients; none without a curve."""
        return [] if self.smooth is None else [self.free.index(name) for name in self.smooth.names]

    @property
    def _penalty(self) -> float:
        """What a smooth curve's prior adds to the criterion."""
        if self.smooth is None:
            return 0.0
        at = self.coordinates[self._curve]
        return float(at @ self.smooth.precision @ at)

    @property
    def evidence(self) -> float:
        """−2 ln of the evidence, but for a constant: χ²/f + ln det(1 + D I D / f), theory, eq. (42).

        D has the prior scales of the freed parameters, and σ of the nuisances: how large each may be before the data
        are seen. A parameter that the data hardly determine costs hardly anything here, and ln N in the score.
        """
        plant, variance_inflation = self.problem.plant, self.problem.variance_inflation
        sizes = [internal_scale(plant.parameter(name)) for name in self.free]
        sigmas = [nuisance.sigma for nuisance in self.nuisances]
        spread = np.array([*sizes, *sigmas])
        # The priors of the nuisances are the ones of 1 + D I D, so that I is the information of the data alone.
        of_data = self.information - np.diag([0.0] * len(sizes) + [1.0 / sigma**2 for sigma in sigmas])
        if self.smooth is not None:
            of_data[np.ix_(self._curve, self._curve)] -= self.smooth.precision
        _, volume = np.linalg.slogdet(np.eye(len(spread)) + of_data * np.outer(spread, spread) / variance_inflation)
        return self.chi2 / variance_inflation + float(volume)

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
        """'lower' or 'upper' if a parameter is on that bound, in its internal coordinate; infinity is none."""
        parameter = self.problem.plant.parameter(name)
        lower, upper = internal_bounds(parameter)
        at = float(self.coordinates[self.free.index(name)])
        scale = 1e-9 * max(abs(at), internal_scale(parameter))
        if parameter.infinite_at_upper and at - lower <= scale:
            return None
        return "lower" if at - lower <= scale else "upper" if upper - at <= scale else None


def is_relief(smaller: Fit, larger: Fit) -> bool:
    """Whether most of what a larger model gains is that declared values stay nearer to what is declared.

    The smaller one predicts as well then, with values that their tolerances make incredible: no prediction of strokes
    that are left out, or held out, can show the difference.
    """
    gain = smaller.chi2 - larger.chi2
    return smaller.chi2_of_declared - larger.chi2_of_declared > MOSTLY * gain > 0.0


def rmse(result: Fit) -> float:
    """Root mean square of measured less predicted response over the samples that take part, in its unit."""
    return _root_mean_square(result, lambda weight: np.asarray(weight > 0.0, dtype=np.float64))


def effective_rmse(result: Fit) -> float:
    """The same with each sample's weight in the fit, in its unit: to compare models of one recording.

    A coarse sensor at rest repeats one rounding error. Where its copies counted each, a model that puts the plunger at
    the reading would have a smaller error than the true one, whatever it predicts of the motion.
    """
    return _root_mean_square(result, np.square)


def _root_mean_square(result: Fit, share: Callable[[Array], Array]) -> float:
    plant, problem = result.problem.plant, result.problem
    squares, total = 0.0, 0.0
    predictions = plant.predict(result.values)
    for index in judged_channels(plant):
        shares = share(problem.weight(index))
        squares += float(shares @ np.square(plant.channels[index].data - predictions[index]))
        total += float(np.sum(shares))
    return math.sqrt(squares / total) if total > 0.0 else 0.0
