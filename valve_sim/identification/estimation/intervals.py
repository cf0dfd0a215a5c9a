"""How far a freed parameter may be from its value: 95 % intervals from the covariance and by profile likelihood."""

from __future__ import annotations

import math
from dataclasses import dataclass
from typing import Final, NamedTuple

from scipy.special import chdtri

from valve_sim.identification.estimation.result import Fit
from valve_sim.identification.estimation.solver import fit
from valve_sim.identification.plants.protocol import from_internal, internal_bounds, internal_scale

CHI2_RISE_95: Final = float(chdtri(1, 0.05))
"""By how much χ² rises at the ends of a 95 % interval: 3.84. (scipy.stats would take half a second to load.)"""


@dataclass(frozen=True)
class Interval:
    """A value with its uncertainty, in the parameter's unit.

    Attributes:
        value, stderr: from the covariance. low, high: 95 % interval; infinite where the data do not bound it.
        remark: why it is wide or one-sided, or empty.
    """

    value: float
    stderr: float
    low: float
    high: float
    remark: str = ""


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


def profile_interval(result: Fit, name: str, *, points: int = 12) -> tuple[Interval, list[tuple[float, float]]]:
    """The 95 % interval by profile likelihood: where χ², all others refitted, has risen by 3.84: theory, eq. (33).

    Args:
        result: a converged fit.
        name: one of its freed parameters.
        points: how many refits to spend on each side.

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
    walk = _Walk(result, name, at, spread, CHI2_RISE_95 * result.problem.variance_inflation, points)
    curve = [(at, 0.0)]
    ends: list[float] = []
    remark = ""
    for sign, bound in ((-1.0, lower), (1.0, upper)):
        end, side = _profile_side(walk, sign, bound)
        curve.extend(side)
        if end is None:
            remark = "the profile is flat: these data do not determine it"
            ends.append(sign * math.inf if math.isinf(bound) else bound)
        else:
            ends.append(end)
    values = sorted(from_internal(parameter, end) for end in ends)
    if parameter.infinite_at_upper and values[1] >= parameter.upper:
        remark = "it may be too long to be seen in these data"
    pairs = sorted((from_internal(parameter, where), rise) for where, rise in curve)
    return Interval(result.values[name], result.stderr(name), values[0], values[1], remark), pairs


class _Walk(NamedTuple):
    """Along a profile: whose, from which coordinate with which first guess of a standard error, up to which rise."""

    result: Fit
    name: str
    at: float
    spread: float
    level: float
    points: int


def _profile_side(walk: _Walk, sign: float, bound: float) -> tuple[float | None, list[tuple[float, float]]]:
    """One side of a profile: the coordinate where χ² has risen by `level`, or None if it never does."""
    result, name, at, spread, level, points = walk
    parameter = result.problem.plant.parameter(name)
    others = tuple(other for other in result.free if other != name)
    warm = dict(result.values)
    curve: list[tuple[float, float]] = []
    inside, outside = (at, 0.0), None
    step = 1.96 * spread
    for _ in range(points):
        if outside is None:
            where = inside[0] + sign * step
            step *= 2.0
            if (where - bound) * sign >= 0.0:
                where = bound
        else:
            # χ² is nearly a parabola: its root is where the square root of the rise is linear.
            low, high = math.sqrt(max(inside[1], 0.0)), math.sqrt(outside[1])
            share = (math.sqrt(level) - low) / (high - low) if high > low else 0.5
            where = inside[0] + min(max(share, 0.05), 0.95) * (outside[0] - inside[0])
        if where == inside[0]:
            return (bound if where == bound else None), curve
        fixed = {name: from_internal(parameter, where)}
        refit = fit(result.problem, others, warm, nuisances=result.nuisances, fixed=fixed)
        rise = refit.chi2 - result.chi2
        curve.append((where, rise))
        if rise < level:
            inside, warm = (where, rise), refit.values
            if where == bound:
                return (None if rise < 0.1 * level else bound), curve
        else:
            outside = (where, rise)
        if outside is not None and (abs(rise - level) < 0.02 * level or abs(outside[0] - inside[0]) < 1e-3 * spread):
            return where, curve
    return (None if outside is None else outside[0]), curve
