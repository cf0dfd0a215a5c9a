"""The score test of every effect that a fit leaves out: the odds that adding it would have, to first order.

An effect's sensitivity is one simulation with a little of it on. What the fit's own parameters and nuisances can do of
it is projected out; the rest says where the effect's amplitude would come to, how certain it would be, and with its
prior what the evidence would gain (Rao's score test, with Laplace's volume). It costs one simulation for each effect,
size and shape: enough to say that nothing is left to be found.
"""

from __future__ import annotations

import itertools
import math
from collections.abc import Iterator
from typing import Final, NamedTuple

import numpy as np

from valve_sim.identification.estimation.descent import STANDING, along
from valve_sim.identification.estimation.linearised import MOVES_NOTHING, OrthogonalProjector
from valve_sim.identification.estimation.priors import HALF, Cauchy, Normal, Prior
from valve_sim.identification.estimation.result import Fit
from valve_sim.identification.plants.protocol import (
    SMALL_MOVE,
    Array,
    EffectChoice,
    Nuisance,
    is_two_sided,
    perturbed,
    to_internal,
)
from valve_sim.model import Parameter, SimulationError

SHAPES: Final = (1.0, 0.2, 5.0)
"""Trial values of a parameter that shapes an effect but does not switch it on, in prior scales."""
SIZES: Final = (SMALL_MOVE, 1.0)
"""Trial values of a switch, in prior scales: near off, and large enough for a contact that rebounds above a speed."""
GRID: Final = 400
"""Points of the integral over a released value, for what the data say of it and for its prior each."""
WIDE: Final = 8.0
"""Half-width of the range of integration, in standard deviations and in prior scales."""


class Addition(NamedTuple):
    """The estimate of a switch of an effect, to first order.

    Attributes:
        gain: ln p would gain so much by the data, at its best place. log_price: ln of what its prior takes of that.
        sigma: standard error of its search coordinate.
    """

    gain: float
    log_price: float
    sigma: float

    @property
    def log_gain(self) -> float:
        """The gain of ln p, all terms together."""
        return self.gain + self.log_price


NOTHING: Final = Addition(0.0, -math.inf, math.inf)


def log_gains(result: Fit) -> dict[str, float]:
    """Gain of ln p by each effect that is not in a fit, to first order; the largest over sizes and shapes."""
    outside = OrthogonalProjector(result)
    gains = {}
    for name, effect in result.problem.plant.effects.items():
        if set(effect.free_names()) & set(result.free):
            continue
        released = [_released(result, own, effect) for own in result.nuisances if _stands_for(own, effect)]
        if released:
            gains[name] = sum(released)
            continue
        found = [
            _log_gain(result, outside, effect, moves) for size in SIZES for moves in moves_of(result, effect, size)
        ]
        gains[name] = max(found, default=-math.inf)
    return gains


def standard_errors(result: Fit, outside: OrthogonalProjector, effect: EffectChoice) -> dict[str, float]:
    """Of each switch of an effect alone, while it is small, in its search coordinate; infinite of what shows nothing.

    Its shape is as first expected. Of the signs that it may have, and of a small move and the tangent where the plant
    knows it, that counts which shows less: a move along which the residuals bend shows more than the effect does.
    """
    found: dict[str, float] = {}
    for moves in itertools.islice(moves_of(result, effect), 2 if _has_two_signs(effect) else 1):
        for move in moves:
            changes = [move, *_tangent(result, effect, move)]
            sigmas = [_addition(result, outside, effect, one).sigma for one in changes]
            sigma = max(filter(math.isfinite, sigmas), default=math.inf)
            found[move.switch.name] = max(found.get(move.switch.name, 0.0), sigma)
    return found


def _tangent(base: Fit, effect: EffectChoice, move: Move) -> list[Move]:
    """A move as the derivative at off has it; none where the plant does not know that."""
    name = effect.free_name(move.switch)
    direction = along(name, base.problem.plant.parameter(name), move.off)
    if direction is STANDING:
        return []
    values = {**base.values, **switched_on(effect, move.switch, 0.0)}
    try:
        columns, known = base.problem.rows.sensitivities(values, [direction])
    except SimulationError:
        return []
    return [move._replace(change=columns[:, 0] * move.by)] if known[0] else []


def _has_two_signs(effect: EffectChoice) -> bool:
    return all(is_two_sided(switch) for switch in effect.parameters if switch.off is not None)


class Move(NamedTuple):
    """A switch that was moved a little.

    Attributes:
        switch: which. off, by: its search coordinate where it is off, and by how much it was moved.
        change: (r,) of the residuals that were fitted.
    """

    switch: Parameter
    off: float
    by: float
    change: Array


def moves_of(base: Fit, effect: EffectChoice, size: float = SMALL_MOVE) -> Iterator[list[Move]]:
    """For each shape of an effect, and each sign that it may have, its switches moved by some prior scales each."""
    has_shape = any(parameter.off is None for parameter in effect.parameters)
    switches = [parameter for parameter in effect.parameters if parameter.off is not None]
    # A force that opens lifts a plunger without load off its seat, and one that closes does not.
    signs = (1.0, -1.0) if _has_two_signs(effect) else (1.0,)
    rows, left = base.problem.rows, base.left.condensed()
    for shape, sign in itertools.product(SHAPES if has_shape else SHAPES[:1], signs):
        found = []
        for switch in switches:
            values = switched_on(effect, switch, sign * size, shape)
            parameter = base.problem.plant.parameter(effect.free_name(switch))
            off = to_internal(parameter, switch.off if switch.off is not None else 0.0)
            by = to_internal(parameter, values[effect.free_name(switch)]) - off
            try:
                found.append(Move(switch, off, by, rows.residuals({**base.values, **values}) - left))
            except SimulationError:
                continue
        if found:
            yield found


def switched_on(effect: EffectChoice, switch: Parameter, size: float, shape: float = 1.0) -> dict[str, float]:
    """An effect of which one switch is moved by so many prior scales and the others are off; shapes in theirs."""

    def value(parameter: Parameter) -> float:
        if parameter.off is None:
            return min(max(shape * parameter.prior_scale, parameter.lower), parameter.upper)
        return perturbed(parameter, parameter.off, size) if parameter is switch else parameter.off

    return {effect.free_name(parameter): value(parameter) for parameter in effect.parameters}


def _log_gain(result: Fit, outside: OrthogonalProjector, effect: EffectChoice, moves: list[Move]) -> float:
    """The most that one of the switches, or all together, would gain."""
    alone = [_addition(result, outside, effect, move) for move in moves]
    most = max(one.log_gain for one in alone)
    if len(moves) == 1:
        return most
    together = outside.gain(np.column_stack([move.change for move in moves]))
    return max(most, 0.5 * together + sum(one.log_price for one in alone))


def _addition(result: Fit, outside: OrthogonalProjector, effect: EffectChoice, move: Move) -> Addition:
    power, seen = outside.along(move.change)
    if power <= MOVES_NOTHING**2:
        # What shows nothing is as probable as it was, and no rival of anything.
        return NOTHING
    prior = result.problem.prior(effect.free_name(move.switch))
    sigma, steps = abs(move.by) / math.sqrt(power), -seen / power
    gain = 0.5 * steps**2 * power
    return Addition(gain, log_bayes_factor(prior, move.off, steps * move.by, sigma, move.by) - gain, sigma)


def log_bayes_factor(prior: Prior, off: float, estimate: float, sigma: float, direction: float) -> float:
    """Ln of ∫ π(z) L(z) dz over L(off), L a Gaussian likelihood: what ln p gains by an effect.

    Args:
        prior: π, of the search coordinate z. off: z where the effect does nothing.
        estimate, sigma: where L is greatest, measured from there, and its standard deviation.
        direction: towards which side z may go, where it may go to one only.
    """
    scale = prior.scale if isinstance(prior, Cauchy) else sigma
    steps = np.linspace(-WIDE, WIDE, GRID)
    places = np.concatenate([estimate + sigma * steps, scale * steps])
    if isinstance(prior, Cauchy) and prior.mass == HALF:
        places = np.concatenate([[0.0], places[places * direction > 0.0]])
    at = np.unique(places)
    logs = _log_densities(prior, off + at)
    logs -= 0.5 * np.square((at - estimate) / sigma)
    most = float(np.max(logs))
    density = np.exp(logs - most)
    mass = 0.5 * float(np.diff(at) @ (density[1:] + density[:-1]))
    return most + math.log(max(mass, 1e-300)) + 0.5 * (estimate / sigma) ** 2


def _log_densities(prior: Prior, at: Array) -> Array:
    """(n,) ln of a prior's density; those of amplitudes and of declared values are worked out at once."""
    if isinstance(prior, Cauchy | Normal):
        return prior.log_densities(at)
    return np.array([prior.log_density(place) for place in at.tolist()])


def _stands_for(own: Nuisance, effect: EffectChoice) -> bool:
    """Whether a nuisance is a declared value that an effect takes for wrong, by its name or as the same thing."""
    return own.is_of_machine and bool({own.name, own.same_as} & set(effect.free_names()))


def released_spread(result: Fit, own: Nuisance) -> float:
    """By how much what the data alone say of a declared value differs from it by chance, its tolerance included.

    Infinite where they say nothing.
    """
    of_data = _information_of_data(result, own)
    return math.hypot(1.0 / math.sqrt(of_data), own.sigma) if of_data > 0.0 else math.inf


def _information_of_data(result: Fit, own: Nuisance) -> float:
    """The information of the data alone on a declared value, all else at its best; 0 where there is none."""
    index = len(result.free) + result.nuisances.index(own)
    information = 1.0 / float(result.covariance[index, index]) - own.sigma**-2
    return information if information > MOVES_NOTHING * own.sigma**-2 else 0.0


def _released(result: Fit, own: Nuisance, effect: EffectChoice) -> float:
    """Gain of ln p where a declared value is taken as wrong: the wider prior in place of its tolerance's."""
    of_data = _information_of_data(result, own)
    if of_data == 0.0:
        return -math.inf
    sigma = 1.0 / math.sqrt(of_data)
    estimate = own.mean + (result.values[own.name] - own.mean) * (1.0 + 1.0 / (of_data * own.sigma**2))
    after = _prior_of_released(result, own, effect)
    # The data may know it a thousand times better than its tolerance or worse: both widths are resolved.
    steps, scale = np.linspace(-WIDE, WIDE, GRID), after.scale if isinstance(after, Cauchy) else own.sigma
    places = np.concatenate([estimate + sigma * steps, own.mean + scale * steps])
    low, high = _range_of(own, effect, float(np.min(places)), float(np.max(places)))
    if high <= low:
        return -math.inf
    at = np.unique(np.clip(places, low, high))
    density = np.exp(_log_densities(after, at) - 0.5 * np.square((at - estimate) / sigma))
    before = Normal(own.mean, math.hypot(sigma, own.sigma)).log_density(estimate)
    mass = 0.5 * float(np.diff(at) @ (density[1:] + density[:-1]))
    return math.log(max(mass, 1e-300)) - before - math.log(math.sqrt(2.0 * math.pi) * sigma)


def _prior_of_released(result: Fit, own: Nuisance, effect: EffectChoice) -> Prior:
    """The prior of the value where it is taken for wrong, in the value's own unit."""
    prior = result.problem.prior(effect.free_names()[0] if own.same_as in effect.free_names() else own.name)
    if not isinstance(prior, Cauchy):
        return prior
    scale = prior.scale / abs(own.same_slope) if own.same_as in effect.free_names() else prior.scale
    return Cauchy(own.mean, scale, prior.mass)


def _range_of(own: Nuisance, effect: EffectChoice, low: float, high: float) -> tuple[float, float]:
    """Where the released value may be: of an effect that only adds, above what is declared."""
    if own.same_as in effect.free_names():
        parameter = next(one for one in effect.parameters if effect.free_name(one) == own.same_as)
        if parameter.off is not None and parameter.lower == parameter.off:
            return max(low, own.mean), high
    return max(low, own.lower), min(high, own.upper)
