"""Priors of everything that a fit frees: one object for each number, the same in fit, evidence and prediction.

A prior is a density of the coordinate z in which a fit searches (theory, eq. (27)). A fit minimises

    χ²(z) + Σ −2 ln π(z) + constant

by Gauss–Newton steps, for which each prior gives its cost, half the slope of that, and a curvature that is never
negative: of a Cauchy density that of the parabola which touches the cost from above (iteratively reweighted least
squares; Huber and Ronchetti, Robust Statistics, 2009, section 7.8). `log_density` is normalised, for the evidence.

`prior_of` is the only place where a prior is chosen. Amplitudes have Cauchy densities, because most effects of a
catalogue are small where they are there at all, and a few are large (Gelman, Bayesian Analysis 1, 2006, p. 515).
"""

from __future__ import annotations

import math
from collections.abc import Sequence
from dataclasses import dataclass
from typing import Final, NamedTuple

import numpy as np

from valve_sim.identification.plants.protocol import (
    Array,
    Plant,
    internal_bounds,
    internal_scale,
    to_internal,
)

SPREAD_OF_BASE: Final = 1.0
"""Standard deviation of the natural logarithm of a refitted value: within a factor of 7 of what is declared, 95 %."""
SMALLEST_SHARE: Final = 1e-6
"""Of the declared value, below which no log-normal value is searched: 14 of its standard deviations away."""
HALF: Final = 0.5
"""Mass of a symmetric density on one side of its centre."""
ROOT_TWO_PI: Final = math.sqrt(2.0 * math.pi)


class Pull(NamedTuple):
    """What a prior adds to a fit at one place: −2 ln π but for a constant, half its slope, and a curvature ≥ 0."""

    cost: float
    half_slope: float
    curvature: float


NO_PULL: Final = Pull(0.0, 0.0, 0.0)


@dataclass(frozen=True)
class Normal:
    """Known within a standard deviation: declared values with a tolerance, errors of a recording."""

    mean: float
    sigma: float

    def pull(self, at: float) -> Pull:
        """What it adds to a fit."""
        off = at - self.mean
        return Pull((off / self.sigma) ** 2, off / self.sigma**2, self.sigma**-2)

    def log_density(self, at: float) -> float:
        """Natural logarithm of the density."""
        return -0.5 * ((at - self.mean) / self.sigma) ** 2 - math.log(ROOT_TWO_PI * self.sigma)

    def log_densities(self, at: Array) -> Array:
        """(n,) natural logarithms of the density at (n,) places."""
        return -0.5 * np.square((at - self.mean) / self.sigma) - math.log(ROOT_TWO_PI * self.sigma)


@dataclass(frozen=True)
class Cauchy:
    """Probably within a scale of the centre, perhaps far away: amplitudes of effects, and wrong declared values.

    Attributes:
        centre: where nothing is changed. scale: half of the mass is within it.
        mass: of the symmetric density that is within the range: 1, or 1/2 where the range begins at the centre.
    """

    centre: float
    scale: float
    mass: float = 1.0

    def pull(self, at: float) -> Pull:
        """What it adds to a fit."""
        off = at - self.centre
        curvature = 2.0 / (self.scale**2 + off**2)
        return Pull(2.0 * math.log1p((off / self.scale) ** 2), curvature * off, curvature)

    def log_density(self, at: float) -> float:
        """Natural logarithm of the density."""
        return -math.log(math.pi * self.scale * self.mass) - math.log1p(((at - self.centre) / self.scale) ** 2)

    def log_densities(self, at: Array) -> Array:
        """(n,) natural logarithms of the density at (n,) places."""
        return -math.log(math.pi * self.scale * self.mass) - np.log1p(np.square((at - self.centre) / self.scale))


@dataclass(frozen=True)
class LogNormal:
    """Known by its order of magnitude: dampings. The evidence is worked out in the logarithm, as the cost is."""

    median: float
    sigma: float = SPREAD_OF_BASE

    def pull(self, at: float) -> Pull:
        """What it adds to a fit."""
        off = math.log(at / self.median) / self.sigma
        return Pull(off**2, off / (self.sigma * at), (self.sigma * at) ** -2)

    def log_density(self, at: float) -> float:
        """Natural logarithm of the density of the value itself."""
        off = math.log(at / self.median) / self.sigma
        return -0.5 * off**2 - math.log(ROOT_TWO_PI * self.sigma * at)


@dataclass(frozen=True)
class Even:
    """Anywhere within a range: what shapes an effect, whose coordinate is a logarithm."""

    lower: float
    upper: float

    def pull(self, at: float) -> Pull:
        """Nothing."""
        return NO_PULL

    def log_density(self, at: float) -> float:
        """Natural logarithm of the density."""
        return -math.log(self.upper - self.lower)


@dataclass(frozen=True)
class Elsewhere:
    """The prior is stated elsewhere: of a smooth curve's coefficients, or by other data of the same machine."""

    def pull(self, at: float) -> Pull:
        """Nothing."""
        return NO_PULL

    def log_density(self, at: float) -> float:
        """Nothing."""
        return 0.0


Prior = Normal | Cauchy | LogNormal | Even | Elsewhere


def prior_of(plant: Plant, name: str) -> Prior:
    """The prior of a freed parameter, in the coordinate in which it is searched.

    Args:
        plant: the machine. name: of a refitted value, of a declared value that may be wrong, or `<effect>.<parameter>`.

    Raises:
        KeyError: there is no such parameter.
    """
    parameter, declared = plant.parameter(name), plant.declared(name)
    lower, upper = internal_bounds(parameter)
    centre = to_internal(parameter, declared)
    is_shape = parameter.off is None and "." in name
    if name in plant.base and declared > 0.0 and parameter.lower >= 0.0:
        return LogNormal(declared) if centre == declared else Normal(centre, SPREAD_OF_BASE)
    if is_shape and math.isfinite(upper - lower) and not parameter.infinite_at_upper and parameter.lower > 0.0:
        return Even(lower, upper)
    scale = internal_scale(parameter)
    if is_shape and parameter.infinite_at_upper:
        # Of a rate: slower ones, down to none at all, are as likely as faster ones.
        return Cauchy(lower, scale, HALF)
    return Cauchy(centre, scale, 1.0 if lower < centre < upper else HALF)


def pulls_of(priors: Sequence[Prior], at: Array) -> Array:
    """(3, k) what priors add to a fit at (k,) coordinates: costs, half of their slopes, and curvatures."""
    found = [own.pull(place) for own, place in zip(priors, at.tolist(), strict=True)]
    return np.array(found, dtype=np.float64).reshape(-1, 3).T


def log_density_of(priors: Sequence[Prior], at: Array) -> float:
    """Natural logarithm of the density of independent priors at (k,) coordinates."""
    return math.fsum(own.log_density(place) for own, place in zip(priors, at.tolist(), strict=True))


def lowest(prior: Prior) -> float:
    """Where the support of a prior begins, in the search coordinate."""
    return SMALLEST_SHARE * prior.median if isinstance(prior, LogNormal) else -math.inf
