"""How large an effect would have to be to be named: what "nothing is missing" is worth.

An effect of size a, alone beside a fit that lacks nothing, would raise ln p by ½ (a/σ)² in half of the recordings like
this one, σ its standard error beside all that the fit frees, and its prior would take ln (√(2π) σ π(a)) of that. It is
named where the posterior gives it `SURE` against nothing:

    ½ (a/σ)² + ln (√(2π) σ π(a)) + ln P(effect) − ln P(nothing) = ln SURE/(1 − SURE)

The limit is the a that solves this (theory, section 10).
"""

from __future__ import annotations

import math
from collections.abc import Mapping
from typing import Final

from valve_sim.identification.estimation.priors import Prior
from valve_sim.identification.estimation.result import Fit
from valve_sim.identification.plants.protocol import (
    EffectChoice,
    Nuisance,
    from_internal,
    internal_bounds,
    to_internal,
)
from valve_sim.identification.selection.posterior import SURE, Rivals
from valve_sim.identification.selection.score_test import Outside, released_spread, standard_errors
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
    while _margin(prior, off, sign * high, sigma) < needed:
        high *= 2.0
        if high > most:
            return math.inf
    for _ in range(SEARCHED):
        middle = 0.5 * (low + high)
        low, high = (low, middle) if _margin(prior, off, sign * middle, sigma) >= needed else (middle, high)
    if math.isinf(switch.off):
        return from_internal(parameter, off + sign * high)
    return abs(from_internal(parameter, off + sign * high) - switch.off)


def _margin(prior: Prior, off: float, by: float, sigma: float) -> float:
    """What ln p gains by an effect that is moved so far."""
    return 0.5 * (by / sigma) ** 2 + math.log(math.sqrt(2.0 * math.pi) * sigma) + prior.log_density(off + by)
