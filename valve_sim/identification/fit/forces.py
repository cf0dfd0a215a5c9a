"""What has no name, as a force through the simulator, beside a fit: theory, section 7.

A discrepancy of what is shown (`process`) can be imitated by no valve, so that names which imitate a force that has
none look right beside it. So something unnamed may be a force, too: a Gaussian process of each kind of smooth curve
that the plant knows, over x, x·u², v, x·v and t·v, and over time, in each motion by itself. It is added linearly: with
C = J K_s the change of the residuals by the coefficients of the curve's B-splines, of covariance s² K, ln p grows by

    ½ Σ s² p²/(1 + s² λ) − ½ Σ ln(1 + s² λ)

in the eigenvectors of what the data say of them and the fit cannot follow; summed over sizes s and lengths.
"""

from __future__ import annotations

import contextlib
import math
from typing import Final

import numpy as np
from scipy.special import logsumexp

from valve_sim.identification.fit.fitter import LINEAR, SPLINES, Fitter, Tried
from valve_sim.identification.fit.gaussian import Gaussian
from valve_sim.identification.fit.problem import Problem
from valve_sim.identification.plants.protocol import Array, Direction, ForceMap
from valve_sim.model import SimulationError

LENGTHS: Final = (0.03, 0.1, 0.4)
"""Of the range of a curve: over which its force changes."""
SIZES: Final = 2.0 ** np.arange(-11.0, 1.0)
"""Standard deviations of the force, in units of what a force may be: 0.25 mN to 0.5 N of a valve held by 2.5 N."""
USUAL: Final = 0.1
"""In the same units: half of all forces without a name are smaller."""
LOG_PRIOR: Final = np.log(2.0 / math.pi / USUAL / (1.0 + (SIZES / USUAL) ** 2) * SIZES * math.log(2.0))
"""A half-Cauchy density on the grid, whose logarithm is even."""
EDGE: Final = 3
"""B-splines at each end that reach beyond: those of a motion act in it alone."""
REST: Final = 2e-3
"""s without motion, after which a motion is another one."""
SHORTEST: Final = 1e-3
"""s: shorter motions show no force that changes."""
MOST_MOTIONS: Final = 24
"""Motions, of those recorded, in which a force over time is sought."""
LITTLE: Final = 1e-9
"""Added to the diagonal of a covariance of equal splines."""
ROUNDING: Final = 1e-9
"""Of the largest square of the columns: what is left of less, after all that the fit can follow, is rounding."""


Forces = list[tuple[Array, list[Array]]]
"""By kind: (r, q) change of the residuals by each B-spline at the largest size, and (q, q) covariances by length."""


def forces_beside(fitter: Fitter, tried: Tried) -> Forces:
    """Every kind of force that the plant knows, beside a fit; of a long recording none is looked for.

    Sets that leave as little move alike, so that one of them stands for all.
    """
    found = []
    for own in () if fitter.problem.is_long else fitter.problem.plant.force_maps:
        with contextlib.suppress(SimulationError):
            found.append(_columns(fitter, tried, own))
    return found


def log_evidence_beside(fitter: Fitter, tried: Tried, forces: Forces) -> float:
    """Ln p(data | set, something unnamed that is a force), every kind of it equally probable; −∞ where none is known.

    Args:
        fitter: of the problem. tried: the set, fitted so well that what is left changes it little.
        forces: beside a set that is as near.
    """
    logs = [_log_evidence(fitter, tried, *own) for own in forces]
    return float(logsumexp(logs)) - math.log(len(fitter.problem.plant.force_maps)) if logs else -math.inf


def is_near(tried: Tried) -> bool:
    """Whether a fit leaves so little that something unnamed beside it is worked out in one step."""
    return tried.spread.tau <= LINEAR


def _log_evidence(fitter: Fitter, tried: Tried, columns: Array, covariances: list[Array]) -> float:
    """Ln p with one kind of force, whose place the errors of the recordings may take, and it theirs."""
    suited = tried.fit.gaussian.with_best_sizes(fitter.learned)
    none = {name: float(group.grid[0]) for name, (group, _) in suited.groups.items() if name in set(fitter.learned)}
    try:
        found = [
            one.log_evidence + gain(one, columns, covariances)
            for one in (suited, *([suited.resized(none)] if none else []))
        ]
        # That sizes of errors are estimated lowers ln p by as much beside a force as without one.
        return max(found) + suited.log_integral(fitter.learned)
    except np.linalg.LinAlgError:
        return -math.inf


def gain(gaussian: Gaussian, columns: Array, covariances: list[Array]) -> float:
    """What ln p grows by with (r, q) further columns, whose coefficients have one of some covariances."""
    squares, pulls = gaussian.beyond(columns)
    most, logs = float(np.max(np.sum(np.square(columns), axis=0))), []
    for covariance in covariances:
        root = np.linalg.cholesky(covariance + LITTLE * np.eye(len(covariance)))
        values, axes = np.linalg.eigh(root.T @ squares @ root)
        is_seen = values > ROUNDING * most
        along, sizes = np.square(axes.T @ (root.T @ pulls))[is_seen], np.square(SIZES)[:, None]
        grown = 1.0 + sizes * values[is_seen]
        logs.append(0.5 * np.sum(sizes * along / grown - np.log(grown), axis=1) + LOG_PRIOR)
    return float(logsumexp(logs)) - math.log(len(logs))


def _columns(fitter: Fitter, tried: Tried, own: ForceMap) -> tuple[Array, list[Array]]:
    """(r, q) change of the residuals by each B-spline at the largest size, and (q, q) covariances by length."""
    if own.variable != "t":
        columns = _tangents(fitter, tried, own, own.low, own.high)
        return columns, [_covariance(SPLINES, length) for length in LENGTHS]
    inside, strokes, found = slice(EDGE, SPLINES - EDGE), fitter.problem.rows.places.stroke, []
    for stroke, begins, ends in _motions(fitter.problem) if own.ends else ():
        beyond = EDGE * (ends - begins) / (SPLINES - 3 - 2 * EDGE)
        columns = _tangents(fitter, tried, own, begins - beyond, ends + beyond)[:, inside]
        found.append(np.where((strokes == stroke)[:, None], columns, 0.0))
    if not found:
        raise SimulationError("nothing moves for long enough")
    alone = [_covariance(SPLINES, length)[inside, inside] for length in LENGTHS]
    return np.hstack(found), [np.asarray(np.kron(np.eye(len(found)), one), dtype=np.float64) for one in alone]


def _covariance(count: int, length: float) -> Array:
    places = np.arange(count) / (count - 3.0)
    return np.asarray(np.exp(-0.5 * np.square((places[:, None] - places) / length)))


def _tangents(fitter: Fitter, tried: Tried, own: ForceMap, low: float, high: float) -> Array:
    """(r, c) derivatives of the residuals by the coefficients of a curve from low to high, which is nowhere."""
    names = own.coefficients[:SPLINES]
    values = tried.fit.gaussian.model.values(tried.fit.gaussian.z)
    values |= {**own.fixed, **dict(zip(own.ends, (low, high), strict=False)), **dict.fromkeys(names, 0.0)}
    directions = [Direction({name: fitter.scale_of(own)}, 1e-6) for name in names]
    values[own.count] = float(len(names))
    found, is_known = fitter.problem.rows.linearised(values, directions)
    if not is_known.all():
        raise SimulationError("the derivative by an added force is not known")
    return np.ascontiguousarray(found[:, :-1])


def _motions(problem: Problem) -> list[tuple[int, float, float]]:
    """Motions: the number of the stroke, beginning and end, s; of many some."""
    places, found = problem.rows.places, []
    for stroke in np.unique(places.stroke[places.moves]).tolist():
        times = np.unique(places.time[places.moves & (places.stroke == stroke)])
        for own in np.split(times, np.flatnonzero(np.diff(times) > REST) + 1):
            if own[-1] - own[0] > SHORTEST:
                found.append((stroke, float(own[0]), float(own[-1])))
    return found[:: max(1, math.ceil(len(found) / MOST_MOTIONS))]
