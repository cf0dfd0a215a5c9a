"""The score test of every hypothesis that a fit leaves out: the odds that adding it would have, to first order.

The sensitivity to an effect is one simulation with a little of it on. What the fit can do of it is projected out; the
rest says where the effect's amplitude would come to, how certain it would be, and with its prior what the evidence
would gain (Rao's score test, with Laplace's volume). It costs one simulation for each effect, size and shape.
"""

from __future__ import annotations

import math
from dataclasses import replace
from typing import Final, NamedTuple

import numpy as np

from valve_sim.identification.fit.fitter import Fitter, Tried
from valve_sim.identification.fit.gaussian import Gaussian
from valve_sim.identification.fit.posterior import Set
from valve_sim.identification.fit.priors import HALF, Cauchy, Normal, Prior
from valve_sim.identification.fit.starts import SMALL, Near, switched_on
from valve_sim.identification.fit.unknown import Hypothesis, Unknown, released
from valve_sim.identification.plants.protocol import Array
from valve_sim.model import SimulationError

SIZES: Final = (SMALL, 1.0)
"""Trial sizes of a switch, in scales: near off, and large enough for a contact that rebounds above a speed."""
MOVES_NOTHING: Final = 1e-12
"""Information, in inverse squares of the move, of a direction that changes nothing."""
UNKNOWN: Final = 1e-6
"""Of a tolerance's information, below which the data say nothing of a declared value."""
GRID: Final = 400
"""Points of an integral over a coordinate, for what the data say of it and for its prior each."""
WIDE: Final = 8.0
"""Half-width of the range of integration, in standard deviations and in scales."""


class Move(NamedTuple):
    """A switch of a hypothesis that was moved: its name, which, and by how much in its coordinate."""

    name: str
    switch: Unknown
    by: float


def log_gains(fitter: Fitter, base: Set, tried: Tried) -> dict[str, float]:
    """Gain of ln p by each hypothesis not in a fitted set, to first order; the largest over sizes and shapes."""
    gaussian = tried.fit.gaussian
    found: dict[str, float] = {}
    columns: list[Array] = []
    moves: list[Move] = []
    for name, own in fitter.hypotheses.items():
        if name in base:
            continue
        loosened = _loosened(gaussian, own)
        if loosened:
            found[name] = sum(_released(gaussian, place, own) for place in loosened)
            continue
        found[name] = -math.inf
        moved = [pair for size in SIZES for pair in moved_by(fitter, base, tried, own, Near((size,), has_signs=True))]
        moved += tangents(fitter, base, tried, own)
        columns += [change for _, change in moved]
        moves += [move for move, _ in moved]
    if not columns:
        return found
    squares, pulls = gaussian.beyond(np.column_stack(columns))
    for place, move in enumerate(moves):
        power = float(squares[place, place])
        if power > MOVES_NOTHING:
            gain = _gain(move, power, float(pulls[place]))
            found[move.name] = max(found[move.name], gain)
    return found


def _loosened(gaussian: Gaussian, own: Hypothesis) -> list[int]:
    """Places of the declared values with a tolerance that a hypothesis takes for wrong."""
    moving, names = gaussian.model.moving, {one.name for one in own.frees}
    return [place for place, one in enumerate(moving) if one.is_tolerated and names & {one.name, *one.replaces}]


def moved_by(fitter: Fitter, base: Set, tried: Tried, own: Hypothesis, near: Near) -> list[tuple[Move, Array]]:
    """Each switch of a hypothesis moved alone, in each shape, with the (r,) change of the residuals.

    Args:
        fitter: of the problem. base, tried: a set that was fitted. own: what is added to it. near: by how much.
    """
    model = fitter.model(tuple(sorted((*base, own.name))), has_columns=False)
    left, off, found = tried.fit.gaussian.sums.left, own.off(), []
    for switch in [one for one in own.frees if one.is_switch]:
        alone = replace(own, frees=tuple(one for one in own.frees if one is switch or not one.is_switch))
        for values in switched_on(alone, near):
            by = switch.coordinate(values[switch.name]) - switch.start
            try:
                change = model.residuals(model.at({**tried.values, **off, **values})) - left
            except SimulationError:
                continue
            if by != 0.0:
                found.append((Move(own.name, switch, by), change))
    return found


def tangents(fitter: Fitter, base: Set, tried: Tried, own: Hypothesis) -> list[tuple[Move, Array]]:
    """Each switch of a hypothesis at off, moved by its scale along the derivative, where the plant knows that.

    Along a move in which residuals bend a clock or a scale would seem to follow less of an effect than it does.
    Arguments: see `moved_by`.
    """
    model = fitter.model(tuple(sorted((*base, own.name))), has_columns=False)
    z, found = model.at({**tried.values, **own.off()}), []
    for switch in [one for one in own.frees if one.is_switch]:
        by = switch.scale if switch.start + switch.scale <= switch.upper else -switch.scale
        try:
            change = model.tangent(z, model.index[switch.name])
        except SimulationError:  # it cannot be simulated so near off
            continue
        if change is not None:
            found.append((Move(own.name, switch, by), by * change))
    return found


def _gain(move: Move, power: float, pull: float) -> float:
    """Ln p that a switch would gain, its prior included."""
    estimate, sigma = -pull / power * move.by, abs(move.by) / math.sqrt(power)
    return log_bayes_factor(move.switch.prior, move.switch.start, estimate, sigma, move.by)


def log_bayes_factor(prior: Prior, off: float, estimate: float, sigma: float, direction: float) -> float:
    """Ln of ∫ π(z) L(z) dz over L(off), L a Gaussian likelihood: what ln p gains by an effect.

    Args:
        prior: π, of the coordinate z. off: z where the effect does nothing.
        estimate, sigma: where L is greatest, measured from there, and its standard deviation.
        direction: towards which side z may go, where it may go to one only.
    """
    is_one_sided = isinstance(prior, Cauchy) and prior.mass == HALF
    low, high = (off, math.inf) if direction > 0.0 else (-math.inf, off)
    ends = (low, high) if is_one_sided else (-math.inf, math.inf)
    found = log_mean(prior, off + estimate, sigma, ends, off)
    return found + math.log(math.sqrt(2.0 * math.pi) * sigma) + 0.5 * (estimate / sigma) ** 2


def log_mean(prior: Prior, estimate: float, sigma: float, ends: tuple[float, float], centre: float) -> float:
    """Ln of ∫ π(z) N(z; estimate, σ) dz between two ends: what a Gaussian likelihood makes of a prior."""
    scale = prior.scale if isinstance(prior, Cauchy) else sigma
    steps = np.linspace(-WIDE, WIDE, GRID)
    at = np.unique(np.clip(np.concatenate([estimate + sigma * steps, centre + scale * steps]), *ends))
    if len(at) < 2:
        return -math.inf
    if isinstance(prior, Cauchy | Normal):
        logs = prior.log_densities(at)
    else:
        logs = np.array([prior.log_density(z) for z in at.tolist()])
    logs = logs - 0.5 * np.square((at - estimate) / sigma) - math.log(math.sqrt(2.0 * math.pi) * sigma)
    gaps = np.diff(at)
    weights = 0.5 * np.concatenate([gaps[:1], gaps[1:] + gaps[:-1], gaps[-1:]])
    most = float(np.max(logs))
    return most + math.log(float(weights @ np.exp(logs - most))) if math.isfinite(most) else -math.inf


def _released(gaussian: Gaussian, place: int, own: Hypothesis) -> float:
    """Gain of ln p where a declared value is taken for wrong: the wider prior in place of its tolerance's."""
    one = gaussian.model.moving[place]
    wide = released(one, own.frees)
    assert isinstance(one.prior, Normal)
    sigma, mean = one.prior.sigma, one.prior.mean
    of_data = 1.0 / float(gaussian.covariance[place, place]) - sigma**-2
    if wide is None or of_data < UNKNOWN * sigma**-2:
        return -math.inf
    spread = of_data**-0.5
    estimate = mean + (float(gaussian.z[place]) - mean) * (1.0 + 1.0 / (of_data * sigma**2))
    low = mean if wide.mass == HALF else max(-math.inf, one.lower)
    high = min(one.upper, min((freed.claimed[1] for freed in own.frees if freed.name == one.name), default=math.inf))
    before = Normal(mean, math.hypot(spread, sigma)).log_density(estimate)
    return log_mean(wide, estimate, spread, (low, high), mean) - before
