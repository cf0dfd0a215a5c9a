"""How large an effect would have to be to be named.

An effect of size a, alone beside a fit that lacks nothing, is estimated as a or more in half of the recordings like
this one, with the standard error σ that it has beside all that the fit frees; π is its prior. It is named where the
posterior gives it `SURE` against nothing:

    ln ∫ π(z) exp(−(z − a)²/2σ² + a²/2σ²) dz + ln P(effect) − ln P(nothing) = ln SURE/(1 − SURE)

The limit is the a that solves this (theory, section 10). σ is that of a small effect: an effect that shows little while
it is small, as a rebound that only begins above a speed, has no limit here.
"""

from __future__ import annotations

import math
from collections.abc import Mapping
from typing import Final

from valve_sim.identification.estimation.linearised import OrthogonalProjector
from valve_sim.identification.estimation.result import Fit
from valve_sim.identification.plants.protocol import (
    EffectChoice,
    Nuisance,
    from_internal,
    internal_bounds,
    to_internal,
)
from valve_sim.identification.selection.posterior import SURE, Rivals
from valve_sim.identification.selection.score_test import (
    log_bayes_factor,
    released_spread,
    standard_errors,
)
from valve_sim.model import Parameter

Limits = Mapping[str, Mapping[str, float]]
"""Limits by effect and by the parameter that switches it, SI."""
SEARCHED: Final = 200
"""Largest number of bisections."""


def detection_limits(result: Fit, rivals: Rivals) -> dict[str, dict[str, float]]:
    """The smallest effects that would be named beside a fit in half of such recordings, each alone.

    Returns:
        By effect and parameter, SI: by how much the parameter would have to differ from where it does nothing; of one
        that does nothing at infinity, its value. inf where nothing within its range would be named.
    """
    outside = OrthogonalProjector(result)
    found: dict[str, dict[str, float]] = {}
    for name, effect in result.problem.plant.effects.items():
        if set(effect.free_names()) & set(result.free):
            continue
        needed = math.log(SURE / (1.0 - SURE)) + rivals.log_prior(())[0] - rivals.log_prior((name,))[0]
        sigmas = _sigmas(result, outside, effect)
        found[name] = {
            switch.name: _Limit(result, effect, switch, sigmas.get(switch.name, math.inf)).size(needed)
            for switch in effect.parameters
            if switch.off is not None
        }
    return found


def _released(result: Fit) -> dict[str, Nuisance]:
    """Declared values with a tolerance, by their names and by what is the same thing."""
    return {name: own for own in result.nuisances if own.is_of_machine for name in (own.name, own.same_as) if name}


def _sigmas(result: Fit, outside: OrthogonalProjector, effect: EffectChoice) -> dict[str, float]:
    """Standard error of each switch in its search coordinate; of a released value, its tolerance included."""
    released, found = _released(result), standard_errors(result, outside, effect)
    for switch in effect.parameters:
        own = released.get(effect.free_name(switch))
        if own is not None and own.unit == switch.unit:
            found[switch.name] = released_spread(result, own)
    return found


class _Limit:
    """The limit of one switch of an effect, whose search coordinate has the standard error `sigma`."""

    def __init__(self, result: Fit, effect: EffectChoice, switch: Parameter, sigma: float) -> None:
        assert switch.off is not None
        self._result, self._switch, self._sigma, self._name = result, switch, sigma, effect.free_name(switch)
        self._parameter = result.problem.plant.parameter(self._name)
        self._off, (lower, upper) = to_internal(self._parameter, switch.off), internal_bounds(self._parameter)
        self._most = max(self._off - lower, upper - self._off)
        self._sign = 1.0 if upper - self._off >= self._off - lower else -1.0

    def size(self, needed: float) -> float:
        """By how far its value is off where it does nothing, for so much of ln p; inf where nothing is enough."""
        found = self._linear(needed) if 0.0 < self._sigma < math.inf else math.inf
        if found > self._most or math.isinf(found):
            return math.inf
        value, off = from_internal(self._parameter, self._off + self._sign * found), self._switch.off
        assert off is not None
        return value if math.isinf(off) else abs(value - off)

    def _is_enough(self, size: float, sigma: float, needed: float) -> bool:
        prior = self._result.problem.prior(self._name)
        return log_bayes_factor(prior, self._off, self._sign * size, sigma, self._sign) >= needed

    def _linear(self, needed: float) -> float:
        """The limit in the search coordinate, where what is shown grows in proportion."""
        low, high = 0.0, self._sigma
        while high <= self._most and not self._is_enough(high, self._sigma, needed):
            high *= 2.0
        for _ in range(SEARCHED):
            middle = 0.5 * (low + high)
            low, high = (low, middle) if self._is_enough(middle, self._sigma, needed) else (middle, high)
        return high
