"""How large an effect would have to be to be named: what "nothing is missing" is worth.

An effect of size a, alone beside a fit that lacks nothing, is estimated as a or more in half of the recordings like
this one, with the standard error σ that it has beside all that the fit frees; π is its prior. It is named where the
posterior gives it `SURE` against nothing:

    ln ∫ π(z) exp(−(z − a)²/2σ² + a²/2σ²) dz + ln P(effect) − ln P(nothing) = ln SURE/(1 − SURE)

The limit is the a that solves this (theory, section 10).
"""

from __future__ import annotations

import math
from collections.abc import Mapping
from typing import Final

from valve_sim.identification.estimation.result import Fit
from valve_sim.identification.plants.protocol import (
    EffectChoice,
    Nuisance,
    from_internal,
    internal_bounds,
    to_internal,
)
from valve_sim.identification.selection.posterior import SURE, Rivals
from valve_sim.identification.selection.score_test import Outside, log_bayes_factor, released_spread, standard_errors
from valve_sim.model import Parameter

Limits = Mapping[str, Mapping[str, float]]
"""By effect and by parameter that switches it, SI."""
SEARCHED: Final = 200
"""Bisections at most."""


def detection_limits(result: Fit, rivals: Rivals) -> dict[str, dict[str, float]]:
    """The smallest effects that would be named beside a fit in half of such recordings, each alone.

    Args:
        result: of the declared model, which lacks nothing. rivals: what may be missing.

    Returns:
        By effect and parameter, SI: by how much the parameter would have to differ from where it does nothing; of one
        that does nothing at infinity, its value. inf where nothing within its range would be named.
    """
    outside = Outside(result)
    found: dict[str, dict[str, float]] = {}
    for name, effect in result.problem.plant.effects.items():
        if set(effect.free_names()) & set(result.free):
            continue
        needed = math.log(SURE / (1.0 - SURE)) + rivals.log_prior(())[0] - rivals.log_prior((name,))[0]
        sigmas = _sigmas(result, outside, effect)
        found[name] = {
            switch.name: _limit(result, effect, switch, sigmas.get(switch.name, math.inf), needed)
            for switch in effect.parameters
            if switch.off is not None
        }
    return found


def _sigmas(result: Fit, outside: Outside, effect: EffectChoice) -> dict[str, float]:
    """Standard error of each switch in its search coordinate; of a released value, its tolerance included."""
    released: dict[str, Nuisance] = {
        name: own for own in result.nuisances if own.is_of_machine for name in (own.name, own.same_as) if name
    }
    found = standard_errors(result, outside, effect)
    for switch in effect.parameters:
        own = released.get(effect.free_name(switch))
        if own is not None and own.unit == switch.unit:
            found[switch.name] = released_spread(result, own)
    return found


def _limit(result: Fit, effect: EffectChoice, switch: Parameter, sigma: float, needed: float) -> float:
    """The limit of one switch, by how far its value is off where it does nothing."""
    if not math.isfinite(sigma) or sigma == 0.0:
        return math.inf
    parameter = result.problem.plant.parameter(effect.free_name(switch))
    assert switch.off is not None
    off, (lower, upper) = to_internal(parameter, switch.off), internal_bounds(parameter)
    prior = result.problem.prior(effect.free_name(switch))
    low, high = 0.0, sigma
    most = max(off - lower, upper - off)
    sign = 1.0 if upper - off >= off - lower else -1.0
    while log_bayes_factor(prior, off, sign * high, sigma, sign) < needed:
        high *= 2.0
        if high > most:
            return math.inf
    for _ in range(SEARCHED):
        middle = 0.5 * (low + high)
        is_enough = log_bayes_factor(prior, off, sign * middle, sigma, sign) >= needed
        low, high = (low, middle) if is_enough else (middle, high)
    if math.isinf(switch.off):
        return from_internal(parameter, off + sign * high)
    return abs(from_internal(parameter, off + sign * high) - switch.off)
