"""Estimates of declared values that have a tolerance, and the valve with these."""

from __future__ import annotations

import math
from collections.abc import Mapping, Sequence
from dataclasses import replace
from typing import Final, NamedTuple

import numpy as np

from valve_sim.identification.fit.result import Fit
from valve_sim.identification.plants.protocol import Array, Nuisance, internal_slope
from valve_sim.identification.plants.tolerances import MAIN_MASS, of_gas
from valve_sim.identification.plants.valve import ValvePlant
from valve_sim.model import CATALOGUE, DECLARED, Parameter, Tolerances, Valve
from valve_sim.model.gas import GAS
from valve_sim.model.parameters import POLYNOMIAL_NAMES
from valve_sim.model.tolerances import TOLERATED, tolerance_rule

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


def estimated_valve(result: Fit, plant: ValvePlant) -> Valve:
    """The valve with the values of a fit; its tolerances are their standard errors, and a covariance.

    A valve whose declared values were exact stays one of exact values.
    """
    valve = plant.with_values(result.values)
    if plant.valve.tolerances.is_exact:
        return valve
    names, covariance = plant.propagated(*_machine(result))
    sigmas = dict(zip(names, np.sqrt(np.maximum(np.diag(covariance), 0.0)).tolist(), strict=True))
    if "moving_mass" in names:
        sigmas["moving_mass"] = _of_the_difference(names, covariance)
    declared = {name: sigmas[name] for name in TOLERATED if _is_tolerance(sigmas.get(name, 0.0), DECLARED[name])}
    tolerances = Tolerances(
        declared, _of_the_polynomial(names, covariance), _of_effects(sigmas, valve), _of_gas(sigmas),
        plant.valve.tolerances.sensor,
    )  # fmt: skip
    return replace(valve, tolerances=tolerances)


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


def _is_tolerance(sigma: float, rule: Parameter) -> bool:
    return 0.0 < sigma <= tolerance_rule(rule).upper


def _of_gas(sigmas: Mapping[str, float]) -> dict[str, float]:
    """Of the numbers of the group `gas` that were estimated."""
    found = {name: sigmas.get(of_gas(name), 0.0) for name in GAS}
    return {name: sigma for name, sigma in found.items() if _is_tolerance(sigma, GAS[name])}


def _of_the_difference(names: Sequence[str], covariance: Array) -> float:
    """Standard error of moving_mass − pilot_mass."""
    moving = names.index("moving_mass")
    slopes = np.zeros(len(names))
    slopes[moving] = 1.0
    if "pilot_mass" in names:
        slopes[names.index("pilot_mass")] = -1.0
    return math.sqrt(max(0.0, float(slopes @ covariance @ slopes)))


def _of_the_polynomial(names: Sequence[str], covariance: Array) -> tuple[tuple[float, ...], ...] | None:
    """(4, 4), or None where its terms were not estimated."""
    known = [name for name in POLYNOMIAL_NAMES if name in names]
    if not known:
        return None
    whole = np.zeros((len(POLYNOMIAL_NAMES),) * 2)
    into, of = [POLYNOMIAL_NAMES.index(name) for name in known], [names.index(name) for name in known]
    whole[np.ix_(into, into)] = covariance[np.ix_(of, of)]
    return tuple(tuple(row) for row in (0.5 * (whole + whole.T)).tolist())


def _of_effects(sigmas: Mapping[str, float], valve: Valve) -> dict[str, dict[str, float]]:
    """Of the effects that the valve has on, by name and parameter."""
    found: dict[str, dict[str, float]] = {}
    for name, sigma in sigmas.items():
        effect, dot, parameter = name.partition(".")
        if dot and effect in valve.effects and CATALOGUE[effect].named:
            rule = tolerance_rule(CATALOGUE[effect].parameter(parameter))
            if 0.0 < sigma <= rule.upper and math.isfinite(sigma):
                found.setdefault(effect, {})[parameter] = sigma
    return found
