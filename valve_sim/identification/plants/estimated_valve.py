"""The valve that a fit describes, whose standard errors are its tolerances."""

from __future__ import annotations

import math
from collections.abc import Mapping, Sequence
from dataclasses import replace

import numpy as np

from valve_sim.identification.plants.protocol import Array, Estimate
from valve_sim.identification.plants.tolerances import of_gas
from valve_sim.identification.plants.valve_model import ValveModel
from valve_sim.model import CATALOGUE, DECLARED, Parameter, Tolerances, Valve
from valve_sim.model.gas import GAS
from valve_sim.model.parameters import POLYNOMIAL_NAMES
from valve_sim.model.tolerances import TOLERATED, tolerance_rule


def estimated_valve(model: ValveModel, estimate: Estimate) -> Valve:
    """The valve with the values of a fit; its tolerances are their standard errors, and a covariance.

    A valve whose declared values were exact stays one of exact values.
    """
    valve, declared_tolerances = model.with_values(estimate.values), model.valve.tolerances
    if declared_tolerances.is_exact:
        return valve
    names, covariance = model.propagated(estimate.names, estimate.covariance)
    sigmas = dict(zip(names, np.sqrt(np.maximum(np.diag(covariance), 0.0)).tolist(), strict=True))
    if "moving_mass" in names:
        sigmas["moving_mass"] = _of_the_difference(names, covariance)
    declared = {name: sigmas[name] for name in TOLERATED if _is_tolerance(sigmas.get(name, 0.0), DECLARED[name])}
    tolerances = Tolerances(
        declared, _of_the_polynomial(names, covariance), _of_effects(sigmas, valve, model.of_effects), _of_gas(sigmas),
        declared_tolerances.sensor,
    )  # fmt: skip
    return replace(valve, tolerances=tolerances)


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


def _of_effects(
    sigmas: Mapping[str, float], valve: Valve, of_effects: Mapping[str, tuple[str, str]]
) -> dict[str, dict[str, float]]:
    """Of the effects that the valve has on, by name and parameter."""
    found: dict[str, dict[str, float]] = {}
    for name, sigma in sigmas.items():
        effect, parameter = of_effects.get(name, ("", ""))
        if effect in valve.effects and CATALOGUE[effect].named:
            rule = tolerance_rule(CATALOGUE[effect].parameter(parameter))
            if 0.0 < sigma <= rule.upper and math.isfinite(sigma):
                found.setdefault(effect, {})[parameter] = sigma
    return found
