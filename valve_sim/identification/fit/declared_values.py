"""Estimates of declared values that have a tolerance."""

from __future__ import annotations

import math
from collections.abc import Sequence
from typing import Final, NamedTuple

import numpy as np

from valve_sim.identification.fit.result import Fit
from valve_sim.identification.plants.protocol import Array, Estimate, Nuisance, internal_slope
from valve_sim.identification.plants.tolerances import MAIN_MASS

BEYOND: Final = 3.0
"""Tolerances beyond which a declared value is reported as off, which chance alone causes once in 370."""


APART: Final = 2.0
"""Standard errors of an estimate within which it does not differ from what is declared."""


class DeclaredValue(NamedTuple):
    """A declared value that is known within a tolerance.

    Attributes:
        name: as declared; `<effect>.<parameter>` of a declared effect, `attraction[k]` of the polynomial along the k-th
            axis of its covariance. unit: SI.
        value, tolerance: as declared; of `moving_mass`, the tolerance is of what it exceeds pilot_mass by.
        estimate, stderr: from the data and the tolerance together.
        deviation, spread: of the estimate, and its standard error, in tolerances; of `moving_mass`, of what it exceeds
            pilot_mass by.
    """

    name: str
    unit: str
    value: float
    tolerance: float
    estimate: float
    stderr: float
    deviation: float
    spread: float

    @property
    def is_out(self) -> bool:
        """Whether it is off by more than chance explains, and by more than its own error."""
        return abs(self.deviation) > BEYOND and self.is_apart

    @property
    def is_apart(self) -> bool:
        """Whether the estimate differs from what is declared by more than its own error."""
        return abs(self.deviation) > APART * self.spread


def declared_values(result: Fit) -> tuple[DeclaredValue, ...]:
    """Every declared value with a tolerance, in the order of the plant's nuisances; none where all are exact."""
    plant, names, covariance = result.problem.plant, *_machine(result)
    found = []
    for own in plant.nuisances:
        if own.same_as in names:
            found.append(_by_effect(result, own, covariance[names.index(own.same_as)][names.index(own.same_as)]))
        elif own.is_of_machine and own.name in names:
            at = names.index(own.name)
            estimate, variance = result.values[own.name], float(covariance[at, at])
            deviation, spread = (estimate - own.mean) / own.sigma, math.sqrt(max(0.0, variance)) / own.sigma
            name, value = own.name, own.mean
            if name == MAIN_MASS:
                pilot = names.index("pilot_mass") if "pilot_mass" in names else None
                name, value = "moving_mass", plant.declared("moving_mass")
                estimate += result.values.get("pilot_mass", plant.declared("pilot_mass"))
                if pilot is not None:
                    variance += float(covariance[pilot, pilot] + 2.0 * covariance[pilot, at])
            stderr = math.sqrt(max(0.0, variance))
            found.append(DeclaredValue(name, own.unit, value, own.sigma, estimate, stderr, deviation, spread))
    return tuple(found)


def _by_effect(result: Fit, own: Nuisance, variance: float) -> DeclaredValue:
    """A declared value that a freed effect stands for: the effect adds to it, divides it or takes its place."""
    found, error = result.values[own.same_as], math.sqrt(max(0.0, float(variance)))
    neutral = result.problem.plant.declared(own.same_as)
    if own.name == "reference_voltage":
        estimate, stderr = own.mean * neutral / found, own.mean * neutral / found**2 * error
    else:
        added = 0.0 if own.name == "pickup_velocity_ratio" else own.mean - neutral
        estimate, stderr = found + added, error
    deviation = (estimate - own.mean) / own.sigma
    return DeclaredValue(own.name, own.unit, own.mean, own.sigma, estimate, stderr, deviation, stderr / own.sigma)


def out_of_tolerance(values: Sequence[DeclaredValue]) -> list[str]:
    """The names of those that are off by more than `BEYOND` tolerances, and by more than their own error."""
    return [value.name for value in values if value.is_out]


def estimate_of(result: Fit) -> Estimate:
    """What a fit says of the machine."""
    return Estimate(result.values, *_machine(result))


def _machine(result: Fit) -> tuple[list[str], Array]:
    """Names of what was estimated of the machine, and its covariance in the unit of each."""
    own = result.of_machine
    covariance = result.covariance[np.ix_(own, own)]
    slopes = np.ones(len(own))
    for at, name in enumerate(result.free):
        slopes[at] = internal_slope(result.problem.plant.parameter(name), float(result.coordinates[at]))
    slopes = np.where(np.isfinite(slopes), slopes, 0.0)
    return [result.names[at] for at in own], np.where(np.isfinite(covariance), covariance, 0.0) * np.outer(
        slopes, slopes
    )
