"""Where a fit of a hypothesis starts the parameters of the effect that it adds: near off, far from it, as declared."""

from __future__ import annotations

import itertools
import math
from collections.abc import Callable, Iterable, Mapping, Sequence
from typing import Final

import numpy as np

from valve_sim.identification.estimation.gram import sum_squares
from valve_sim.identification.estimation.problem import Problem
from valve_sim.identification.estimation.result import Fit
from valve_sim.identification.plants.protocol import (
    EffectChoice,
    from_internal,
    internal_bounds,
    internal_scale,
    is_two_sided,
    to_internal,
)
from valve_sim.model import SimulationError
from valve_sim.model.parameters import Parameter

SMALL, LARGE = 0.05, (0.5, 1.5, 3.0)
"""Starts, in prior scales of a parameter: one near off, which follows the gradient, and some far from it."""
NEARER: Final = (SMALL, 0.1 * SMALL, 0.01 * SMALL, 0.001 * SMALL)
"""Starts, in prior scales, of all effects at once: the first that makes nothing much worse."""
WORSE: Final = 2.0
"""Times the cost without them, up to which it is not: an effect that begins with the wrong sign may lead to the right
one."""
FROM_DECLARED: Final = (0.5, 1.0, 2.0, 4.0, 8.0, 16.0, 32.0)
"""Starts, in prior scales, with all else as declared: a strong effect that is left out bends all else away."""
BETWEEN: Final = math.sqrt(2.0)
"""Factor by which the best of these is then refined."""
EXPLAINS: Final = 2.0 / 3.0
"""Cost with an effect over that without, both with all else as declared, below which a fit starts from there, too."""
SHAPES: Final = (1.0, 0.2, 5.0)
"""Starts, in prior scales, of parameters that shape an effect but do not switch it."""
ROBUST: Final = 20.0
"""σ: scale of the cost by which starts are ranked, so that one impact at another time does not decide."""

Shape = float | Mapping[str, float]
"""Of an effect: a factor on the prior scales of what shapes it, or values of its thresholds by free name."""
Cost = Callable[[Mapping[str, float]], float]
"""A function by which starts are ranked, such as `robust_cost`."""


def effect_starts(cost: Cost, effect: EffectChoice, warm: Mapping[str, float]) -> list[dict[str, float]]:
    """Where to start an effect's parameters from: near off, and the best of some larger sizes and other shapes."""
    if effect.is_declared_value:
        # Its tolerance has let it move already; there the smaller hypothesis has left it.
        return [{}]
    near = [] if _is_saddle(effect) else [_nearest_off(cost, effect, warm)]
    amplitudes = [parameter.off is not None for parameter in effect.parameters]
    choices = [
        _sizes(parameter) if is_amplitude else (1.0,)
        for parameter, is_amplitude in zip(effect.parameters, amplitudes, strict=True)
    ]
    combinations = (
        list(itertools.product(*choices)) if sum(amplitudes) <= 2 else [(size,) * len(choices) for size in LARGE]
    )
    shapes = _shapes(effect)
    far = [_start(effect, sizes, shape) for sizes in combinations for shape in shapes]
    return near + sorted(far, key=lambda start: cost({**warm, **start}))[: 1 if near and sum(amplitudes) == 1 else 2]


def starts_from_declared(cost: Cost, effect: EffectChoice, known: Mapping[str, float]) -> list[dict[str, float]]:
    """A start with all but effects as declared, where a further effect explains much from there; else none.

    A model that lacks a strong effect is refitted to dampings of 0 and values that its tolerances make incredible, and
    from there even the true size of the effect does not lead back.

    Args:
        cost: of values. effect: what is added. known: values of the effects that it is added to.
    """
    switches = [parameter for parameter in effect.parameters if parameter.off is not None]
    if effect.is_declared or not switches:
        return []
    has_two_signs = len(switches) == 1 and is_two_sided(switches[0])
    shapes = _shapes(effect)

    def start(size: float, shape: Shape) -> dict[str, float]:
        return {**known, **_start(effect, [size] * len(effect.parameters), shape)}

    def best_of(choices: Iterable[tuple[float, Shape]]) -> tuple[float, tuple[float, Shape]]:
        return min(((cost(start(*choice)), choice) for choice in choices), key=lambda found: found[0])

    signs = (1.0, -1.0) if has_two_signs else (1.0,)
    coarse = best_of(itertools.product([sign * size for sign in signs for size in FROM_DECLARED], shapes))
    most = EXPLAINS * cost(known)
    size, shape = coarse[1]
    finer = best_of([(size / BETWEEN, shape), (size * BETWEEN, shape)])
    least, choice = min(coarse, finer, key=lambda found: found[0])
    return [start(*choice)] if least < most else []


def robust_cost(problem: Problem, values: Mapping[str, float]) -> float:
    """The cost by which starts are ranked; infinite where the model cannot be simulated, or the squares overflow."""
    try:
        residuals = problem.rows.residuals(values)
    except SimulationError:
        return math.inf
    # Readings of a row that stands for many scatter by far less than the scale, where the logarithm is linear.
    counts, scatter = problem.rows.counts, problem.rows.constant / ROBUST**2
    with np.errstate(over="ignore"):
        return float(np.sum(counts * np.log1p(np.square(residuals / ROBUST) / counts))) + scatter


def squared_cost(problem: Problem, values: Mapping[str, float]) -> float:
    """The sum of squares of residuals; infinite where the model cannot be simulated, or the squares overflow."""
    try:
        return sum_squares(problem.rows.residuals(values))
    except SimulationError:
        return math.inf


def start_near_off(effect: EffectChoice, size: float = SMALL) -> dict[str, float]:
    """Its parameters where the effect is all but off, by this many prior scales."""
    return _start(effect, [size] * len(effect.parameters), 1.0)


def all_near_off(cost: Cost, effects: Iterable[EffectChoice], warm: Mapping[str, float]) -> dict[str, float] | None:
    """All effects together, so near off that they make nothing much worse; None where even the nearest do.

    Each may be small beside what drives the machine and all of them together not, most of all where scales are as
    large as of another machine: a fit that begins far beyond the data is slow to simulate and does not come back.
    """
    chosen, most = list(effects), WORSE * cost(warm)
    for size in NEARER:
        start = dict(warm)
        for effect in chosen:
            start.update(start_near_off(effect, size))
        if cost(start) <= most:
            return start
    return None


def starts_of_other_shapes(effect: EffectChoice) -> list[dict[str, float]]:
    """Its parameters near off, in each shape."""
    shapes = SHAPES if not effect.places else _shapes(effect)
    return [_start(effect, [SMALL] * len(effect.parameters), shape) for shape in shapes]


def _nearest_off(cost: Cost, effect: EffectChoice, warm: Mapping[str, float]) -> dict[str, float]:
    """Its parameters where the effect is all but off; a threshold where that changes most for the better."""
    if not effect.places:
        return start_near_off(effect)
    return min(starts_of_other_shapes(effect), key=lambda start: cost({**warm, **start}))


def _shapes(effect: EffectChoice) -> tuple[Shape, ...]:
    """The shapes from which an effect is started: factors of prior scales, or places of its thresholds."""
    if effect.places:
        most = max(len(places) for places in effect.places.values())
        return tuple(
            {name: places[min(index, len(places) - 1)] for name, places in effect.places.items()}
            for index in range(most)
        )
    return SHAPES if any(parameter.off is None for parameter in effect.parameters) else SHAPES[:1]


def scattered_starts(best: Fit, spreads: Sequence[float]) -> list[dict[str, float]]:
    """Values around a fit: contacts that come and go make shallow local minima near the global one.

    Args:
        best: the fit. spreads: standard errors by which starts are scattered, one each, with a seed of their own.
    """
    random, plant, found = np.random.default_rng(len(best.free)), best.problem.plant, []
    for spread in spreads:
        start = dict(best.values)
        for index, name in enumerate(best.free):
            parameter = plant.parameter(name)
            error = min(math.sqrt(max(0.0, float(best.covariance[index, index]))), internal_scale(parameter))
            at = float(best.coordinates[index]) + spread * error * float(random.standard_normal())
            lower, upper = internal_bounds(parameter)
            start[name] = from_internal(parameter, min(max(at, lower), upper))
        found.append(start)
    return found


def _is_saddle(effect: EffectChoice) -> bool:
    """Whether the gradient vanishes where the effect is off, so that a start there would stay."""
    return any(parameter.off is not None and math.isinf(parameter.off) for parameter in effect.parameters)


def _sizes(parameter: Parameter) -> list[float]:
    return [sign * size for size in LARGE for sign in ((1.0, -1.0) if is_two_sided(parameter) else (1.0,))]


def _start(effect: EffectChoice, sizes: Sequence[float], shape: Shape) -> dict[str, float]:
    places, factor = (shape, 1.0) if isinstance(shape, Mapping) else ({}, shape)
    found = {
        effect.free_name(parameter): _start_value(parameter, size, factor)
        for parameter, size in zip(effect.parameters, sizes, strict=True)
    }
    return {**found, **places}


def _start_value(parameter: Parameter, size: float, shape: float) -> float:
    if parameter.off is None:
        return min(max(parameter.prior_scale * shape, parameter.lower), parameter.upper)
    lower, upper = internal_bounds(parameter)
    off = to_internal(parameter, parameter.off)
    at = off + size * internal_scale(parameter)
    if not lower <= at <= upper:
        at = off - size * internal_scale(parameter)
    return from_internal(parameter, min(max(at, lower), upper))
