"""How far a freed parameter may be from its value: 95 % intervals from the covariance and by profile likelihood."""

from __future__ import annotations

import enum
import math
from dataclasses import dataclass
from typing import Final, NamedTuple

import numpy as np
from scipy.special import chdtri

from valve_sim.identification.fit.descent import descend
from valve_sim.identification.fit.result import Fit
from valve_sim.identification.plants.protocol import Array
from valve_sim.model import SimulationError

CHI2_RISE_95: Final = float(chdtri(1, 0.05))
"""By how much χ² rises at the ends of a 95 % interval: 3.84. (scipy.stats would take half a second to load.)"""
HALF_WIDTH_95: Final = math.sqrt(CHI2_RISE_95)
"""Standard errors from the middle of a 95 % interval to its end."""
POINTS: Final = 12
"""Refits that are spent on each side of a profile."""
FLAT: Final = 0.1
"""Share of that rise below which a profile is flat."""


class Unbounded(enum.Enum):
    """Why data do not bound a parameter."""

    FLAT_PROFILE = enum.auto()
    """χ² hardly rises as far as its range goes."""
    MAY_BE_INFINITE = enum.auto()
    """It may be infinite, as a time constant that is longer than the recording."""


@dataclass(frozen=True)
class Interval:
    """A value with its standard error, in the parameter's unit.

    Attributes:
        value, stderr: from the covariance. low, high: 95 % interval; infinite where the data do not bound it.
        unbounded: why it is wide or one-sided, if it is.
    """

    value: float
    stderr: float
    low: float
    high: float
    unbounded: Unbounded | None = None


def covariance_interval(result: Fit, name: str) -> Interval:
    """The 95 % interval from the covariance at the optimum, cut at the parameter's range."""
    own, place = result.unknown(name), result.names.index(name)
    at = float(result.coordinates[place])
    half = HALF_WIDTH_95 * math.sqrt(max(0.0, float(result.covariance[place, place])))
    ends = sorted(own.value(end) for end in (max(own.lower, at - half), min(own.upper, at + half)))
    return Interval(result.values[name], result.stderr(name), ends[0], ends[1])


def profile_interval(result: Fit, name: str) -> tuple[Interval, list[tuple[float, float]]]:
    """The 95 % interval by profile likelihood: where χ², all others refitted, has risen by 3.84: theory, eq. (33).

    Returns:
        the interval, and the profile as (value, rise of χ²) pairs in ascending order of value.
    """
    own, place = result.unknown(name), result.names.index(name)
    at, spread = float(result.coordinates[place]), math.sqrt(max(0.0, float(result.covariance[place, place])))
    spread = min(spread, 10.0 * max(own.scale, abs(at))) if spread > 0.0 else own.scale
    # χ² is that of known sizes of the recordings' errors.
    walk = _Walk(result, name, at, spread, CHI2_RISE_95 * result.widening(name), _slopes_along(result, place))
    low, high = _side(walk, -1.0, own.lower), _side(walk, 1.0, own.upper)
    ends = sorted(own.value(side.end) for side in (low, high))
    unbounded = None
    if not (low.is_closed or high.is_closed) and (low.is_flat or high.is_flat):
        unbounded = Unbounded.FLAT_PROFILE
    elif own.parameter is not None and own.parameter.infinite_at_upper and ends[1] >= own.parameter.upper:
        unbounded = Unbounded.MAY_BE_INFINITE
    curve = [*low.curve, (at, 0.0), *high.curve]
    pairs = sorted((own.value(where), rise) for where, rise in curve)
    return Interval(result.values[name], result.stderr(name), ends[0], ends[1], unbounded), pairs


class _Walk(NamedTuple):
    """Along a profile: whose, from which coordinate with which first guess of a standard error, up to which rise.

    Attributes:
        slopes: (k,) how all others go along with the parameter, each always at its best.
    """

    result: Fit
    name: str
    at: float
    spread: float
    level: float
    slopes: Array


def _slopes_along(result: Fit, place: int) -> Array:
    """(k,) Cov(·, own)/Var(own); 0 where nothing is known."""
    own, variance = result.covariance[place], float(result.covariance[place, place])
    if not math.isfinite(variance) or variance <= 0.0:
        return np.zeros(len(own))
    return np.where(np.isfinite(own), own, 0.0) / variance


class _Side(NamedTuple):
    """One side of a profile, in the coordinate.

    Attributes:
        end: where the interval ends. is_closed: whether χ² has risen by the level there; otherwise it is the end of the
            range, or of what can be simulated. is_flat: whether χ² has hardly risen there.
        curve: (coordinate, rise of χ²) pairs.
    """

    end: float
    is_closed: bool
    is_flat: bool
    curve: list[tuple[float, float]]


def _side(walk: _Walk, sign: float, bound: float) -> _Side:
    """One side of a profile: out until χ² has risen by the level, and back to where it has."""
    at, spread, level = walk.at, walk.spread, walk.level
    warm = walk.result.coordinates
    curve: list[tuple[float, float]] = []
    inside, outside = (at, 0.0), None
    step = HALF_WIDTH_95 * spread
    for _ in range(POINTS):
        if outside is None:
            where = inside[0] + sign * step
            step *= 2.0
            if (where - bound) * sign >= 0.0:
                where = bound
        else:
            where = inside[0] + _share(inside[1], outside[1], level) * (outside[0] - inside[0])
        if where == inside[0]:
            return _Side(where, is_closed=False, is_flat=False, curve=curve)
        rise, reached = _rise(walk, where, warm + walk.slopes * (where - inside[0]))
        if math.isfinite(rise):
            curve.append((where, rise))
        if rise < level:
            inside, warm = (where, rise), reached
            if where == bound:
                return _Side(bound, is_closed=False, is_flat=rise < FLAT * level, curve=curve)
        else:
            outside = (where, rise)
        if outside is not None and (abs(rise - level) < 0.02 * level or abs(outside[0] - inside[0]) < 1e-3 * spread):
            return _Side(where, math.isfinite(outside[1]), inside[1] < FLAT * level, curve)
    if outside is None:
        return _Side(sign * math.inf if math.isinf(bound) else bound, is_closed=False, is_flat=True, curve=curve)
    return _Side(outside[0], math.isfinite(outside[1]), inside[1] < FLAT * level, curve)


def _share(inside: float, outside: float, level: float) -> float:
    """How far to go from one rise of χ², below the level, to another one, above it.

    χ² is nearly a parabola: its root is where the square root of the rise is linear.
    """
    if math.isinf(outside):
        return 0.5
    low, high = math.sqrt(max(inside, 0.0)), math.sqrt(outside)
    share = (math.sqrt(level) - low) / (high - low) if high > low else 0.5
    return min(max(share, 0.05), 0.95)


def _rise(walk: _Walk, where: float, warm: Array) -> tuple[float, Array]:
    """The rise of χ² with the parameter held, and (k,) all coordinates; infinite where nothing can be simulated."""
    result, place = walk.result, walk.result.names.index(walk.name)
    model = result.without(walk.name, where)
    others = np.delete(np.clip(warm, result.gaussian.lower, result.gaussian.upper), place)
    try:
        refit = descend(model, others, result.gaussian.sizes)
    except (SimulationError, np.linalg.LinAlgError):
        return math.inf, warm
    of_likelihood = result.chi2 - result.gaussian.priors[place].pull(walk.at).cost
    return refit.cost - of_likelihood, np.insert(refit.gaussian.z, place, where)
