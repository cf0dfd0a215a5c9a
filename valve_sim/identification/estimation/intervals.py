"""How far a freed parameter may be from its value: 95 % intervals from the covariance and by profile likelihood."""

from __future__ import annotations

import enum
import math
from collections.abc import Mapping
from dataclasses import dataclass
from typing import Final, NamedTuple

from scipy.special import chdtri

from valve_sim.identification.estimation.result import Fit
from valve_sim.identification.estimation.solver import fit
from valve_sim.identification.plants.protocol import from_internal, internal_bounds, internal_scale, to_internal
from valve_sim.model import SimulationError

CHI2_RISE_95: Final = float(chdtri(1, 0.05))
"""By how much χ² rises at the ends of a 95 % interval: 3.84. (scipy.stats would take half a second to load.)"""

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
    plant = result.problem.plant
    parameter = plant.parameter(name)
    index = result.free.index(name)
    at = float(result.coordinates[index])
    half = 1.959964 * math.sqrt(max(0.0, float(result.covariance[index, index])))
    lower, upper = internal_bounds(parameter)
    ends = sorted(from_internal(parameter, end) for end in (max(lower, at - half), min(upper, at + half)))
    return Interval(result.values[name], result.stderr(name), ends[0], ends[1])


def profile_interval(result: Fit, name: str) -> tuple[Interval, list[tuple[float, float]]]:
    """The 95 % interval by profile likelihood: where χ², all others refitted, has risen by 3.84: theory, eq. (33).

    Returns:
        the interval, and the profile as (value, rise of χ²) pairs in ascending order of value.
    """
    parameter = result.problem.plant.parameter(name)
    index = result.free.index(name)
    at = float(result.coordinates[index])
    lower, upper = internal_bounds(parameter)
    spread = math.sqrt(max(0.0, float(result.covariance[index, index])))
    natural = internal_scale(parameter)
    spread = min(spread, 10.0 * max(natural, abs(at))) if spread > 0 else natural
    # χ² is that of known sizes of the recordings' errors.
    level = CHI2_RISE_95 * result.widening(name)
    walk = ProfileState(result, name, at, spread, level, _slopes_along(result, index))
    low, high = _profile_side(walk, -1.0, lower), _profile_side(walk, 1.0, upper)
    ends = sorted(from_internal(parameter, side.end) for side in (low, high))
    unbounded = None
    if not (low.is_closed or high.is_closed) and (low.is_flat or high.is_flat):
        unbounded = Unbounded.FLAT_PROFILE
    elif parameter.infinite_at_upper and ends[1] >= parameter.upper:
        unbounded = Unbounded.MAY_BE_INFINITE
    curve = [*low.curve, (at, 0.0), *high.curve]
    pairs = sorted((from_internal(parameter, where), rise) for where, rise in curve)
    return Interval(result.values[name], result.stderr(name), ends[0], ends[1], unbounded), pairs


class ProfileState(NamedTuple):
    """Along a profile: whose, from which coordinate with which first guess of a standard error, up to which rise.

    Attributes:
        slopes: by name, derivatives of the search coordinates of all others along it where χ² is quadratic.
    """

    result: Fit
    name: str
    at: float
    spread: float
    level: float
    slopes: Mapping[str, float]


def _slopes_along(result: Fit, index: int) -> dict[str, float]:
    """How all others go along with one parameter, if each is always at its best: Cov(·, own)/Var(own)."""
    own, variance = result.covariance[index], float(result.covariance[index, index])
    known = math.isfinite(variance) and variance > 0.0
    slopes = zip(result.names, own.tolist(), strict=True)
    return {name: by / variance for name, by in slopes if known and math.isfinite(by) and name != result.free[index]}


class _Side(NamedTuple):
    """One side of a profile, in the search coordinate.

    Attributes:
        end: where the interval ends. is_closed: whether χ² has risen by the level there; otherwise it is the end of the
            range, or of what can be simulated. is_flat: whether χ² has hardly risen there.
        curve: (coordinate, rise of χ²) pairs.
    """

    end: float
    is_closed: bool
    is_flat: bool
    curve: list[tuple[float, float]]


def _profile_side(walk: ProfileState, sign: float, bound: float) -> _Side:
    """One side of a profile: out until χ² has risen by the level, and back to where it has."""
    at, spread, level = walk.at, walk.spread, walk.level
    warm = dict(walk.result.values)
    curve: list[tuple[float, float]] = []
    inside, outside = (at, 0.0), None
    step = 1.96 * spread
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
        rise, values = _rise(walk, where, _gone_along(walk, warm, where - inside[0]))
        if math.isfinite(rise):
            curve.append((where, rise))
        if rise < level:
            inside, warm = (where, rise), values
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


def _gone_along(walk: ProfileState, values: Mapping[str, float], by: float) -> dict[str, float]:
    """Values a way further along a profile, where χ² is quadratic: a refit from there ends after a step or two."""
    there, plant = dict(values), walk.result.problem.plant
    for name, slope in walk.slopes.items():
        if name in walk.result.free:
            parameter = plant.parameter(name)
            lower, upper = internal_bounds(parameter)
            there[name] = from_internal(
                parameter, min(max(to_internal(parameter, values[name]) + slope * by, lower), upper)
            )
        else:
            there[name] = values[name] + slope * by
    return there


def _rise(walk: ProfileState, where: float, warm: Mapping[str, float]) -> tuple[float, dict[str, float]]:
    """The rise of χ² with the parameter held, and the other values; infinite where nothing can be simulated."""
    result, name = walk.result, walk.name
    others = tuple(other for other in result.free if other != name)
    fixed = {name: from_internal(result.problem.plant.parameter(name), where)}
    try:
        refit = fit(result.problem, others, warm, nuisances=result.nuisances, fixed=fixed)
    except SimulationError:
        return math.inf, dict(warm)
    return refit.chi2 - result.chi2, refit.values
