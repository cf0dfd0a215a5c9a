"""How large an effect would have to be to be named.

An effect of size a, alone beside a fit that lacks nothing, is estimated as a or more in half of the recordings like
this one, with the standard error σ that it has beside all that the fit frees; π is its prior. It is named where the
posterior gives it `SURE` against nothing:

    ln ∫ π(z) exp(−(z − a)²/2σ² + a²/2σ²) dz + ln P(effect) − ln P(nothing) = ln SURE/(1 − SURE)

The limit is the a that solves this (theory, section 10). σ is that of an effect of this size. Where one shows much
more while it is smaller, as the least friction holds a plunger that creeps, that is no part of it; one that shows
little while it is small, as a rebound that only begins above a speed, has no limit here.
"""

from __future__ import annotations

import math
from collections.abc import Mapping
from typing import Final

import numpy as np

from valve_sim.identification.fit.fitter import Fitter, Tried
from valve_sim.identification.fit.gaussian import Gaussian
from valve_sim.identification.fit.posterior import SURE
from valve_sim.identification.fit.priors import Normal
from valve_sim.identification.fit.score_test import MOVES_NOTHING, log_bayes_factor, moved_by, tangents
from valve_sim.identification.fit.starts import SMALL, Near
from valve_sim.identification.fit.unknown import Hypothesis, Unknown
from valve_sim.model import SimulationError

Limits = Mapping[str, Mapping[str, float]]
"""Limits by effect and by the parameter that switches it, SI."""
WIDER: Final = 1.1
"""Times a standard error, from which another one counts."""
ROUNDS: Final = 4
"""Times that a standard error is worked out at the limit that it gives."""
FINE: Final = 1e-6
"""Relative width at which a bisection ends."""


def detection_limits(fitter: Fitter, tried: Tried) -> dict[str, dict[str, float]]:
    """The smallest effects that would be named beside the refitted declared model in half of such recordings.

    Returns:
        By effect and parameter, SI: by how much the parameter would have to differ from where it does nothing; of one
        that does nothing at infinity, its value. inf where nothing within its range would be named.
    """
    free, rivals = set(tried.result.free), fitter.rivals
    found: dict[str, dict[str, float]] = {}
    for name, own in fitter.hypotheses.items():
        if free & {one.name for one in own.frees}:
            continue
        needed = math.log(SURE / (1.0 - SURE)) + rivals.log_prior(())[0] - rivals.log_prior((name,))[0]
        sigmas = _sigmas(fitter, tried, own)
        found[name] = {
            _short(one): _limit(fitter, tried, own, (one, sigmas.get(one.name, math.inf), needed))
            for one in own.frees
            if one.is_switch
        }
    return found


def _limit(fitter: Fitter, tried: Tried, own: Hypothesis, of: tuple[Unknown, float, float]) -> float:
    """How large a switch has to be, with the standard error that it has when it is so large.

    Args:
        of: the switch, its standard error where it is small, in its coordinate, and what is needed of ln p.
    """
    switch, sigma, needed = of
    size = _size(switch, sigma, needed)
    for _ in range(ROUNDS if not own.is_declared_value else 0):
        if math.isinf(size):
            break
        there = _sigma_at(fitter, tried, own, switch, switch.value(switch.start + size))
        if there < WIDER * sigma:
            break
        sigma = there
        size = _size(switch, sigma, needed)
    if math.isinf(size):
        return math.inf
    value, off = switch.value(switch.start + size), switch.value(switch.start)
    return value if math.isinf(off) else abs(value - off)


def _short(own: Unknown) -> str:
    return own.name.partition(".")[2] or own.name


def _sigmas(fitter: Fitter, tried: Tried, own: Hypothesis) -> dict[str, float]:
    """Standard error of each small switch alone, in its coordinate; of a released value with its tolerance.

    Of the signs that it may have, and of a small move and the tangent, that counts which shows less: along a move in
    which the residuals bend an effect would show more than it does.
    """
    gaussian, found = tried.fit.gaussian, dict[str, float]()
    near = Near((SMALL,), has_shapes=False, has_signs=True)
    moved = [*moved_by(fitter, (), tried, own, near), *tangents(fitter, (), tried, own)]
    if moved:
        squares, _ = gaussian.beyond(np.column_stack([change for _, change in moved]))
        for (move, _), power in zip(moved, np.diag(squares).tolist(), strict=True):
            if power > MOVES_NOTHING:
                name = move.switch.name
                found[name] = max(found.get(name, 0.0), abs(move.by) / math.sqrt(power))
    for place, one in enumerate(gaussian.model.moving):
        for switch in own.frees:
            is_same = one.is_tolerated and switch.name in (one.name, *one.replaces) and one.unit == switch.unit
            if is_same and isinstance(one.prior, Normal):
                of_data = 1.0 / float(gaussian.covariance[place, place]) - one.prior.sigma**-2
                known = math.hypot(of_data**-0.5, one.prior.sigma) if of_data > 1e-6 * one.prior.sigma**-2 else math.inf
                found[switch.name] = known
    return found


def _sigma_at(fitter: Fitter, tried: Tried, own: Hypothesis, switch: Unknown, value: float) -> float:
    """Standard error of a switch beside all that the fit frees, where it has a value; 0 where that is not known."""
    there = {**own.off(), switch.name: value}
    model, freed = fitter.model((), there), fitter.model((own.name,))
    try:
        z = model.at(tried.values)
        column = freed.tangent(freed.at({**tried.values, **there}), freed.index[switch.name])
        if column is None:
            return 0.0
        power = float(Gaussian(model, z, model.linearise(z), fitter.sizes).beyond(column[:, None])[0][0, 0])
    except SimulationError:
        return 0.0
    return 1.0 / math.sqrt(power) if power * switch.scale**2 > MOVES_NOTHING else 0.0


def _size(own: Unknown, sigma: float, needed: float) -> float:
    """By how far a coordinate is off where it does nothing, for so much of ln p; inf where nothing is enough."""
    most = max(own.start - own.lower, own.upper - own.start)
    sign = 1.0 if own.upper - own.start >= own.start - own.lower else -1.0
    if not 0.0 < sigma < math.inf:
        return math.inf

    def is_enough(size: float) -> bool:
        return log_bayes_factor(own.prior, own.start, sign * size, sigma, sign) >= needed

    low, high = 0.0, sigma
    while high <= most and not is_enough(high):
        high *= 2.0
    while high - low > FINE * high:
        middle = 0.5 * (low + high)
        low, high = (low, middle) if is_enough(middle) else (middle, high)
    return math.inf if high > most or math.isinf(high) else sign * high
