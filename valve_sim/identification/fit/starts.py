"""Where a fit of a set starts what its last hypothesis frees: near off, far from it, and with all else as declared."""

from __future__ import annotations

import itertools
import math
from collections.abc import Iterable, Iterator, Mapping, Sequence
from typing import Final, NamedTuple

import numpy as np

from valve_sim.identification.fit.fitter import Fitter, Tried
from valve_sim.identification.fit.gram import sum_squares
from valve_sim.identification.fit.model import Model
from valve_sim.identification.fit.posterior import Set
from valve_sim.identification.fit.priors import Normal
from valve_sim.identification.fit.problem import Problem
from valve_sim.identification.fit.unknown import Hypothesis, Unknown
from valve_sim.identification.plants.protocol import Array
from valve_sim.model import SimulationError

SMALL: Final = 0.05
"""Start, in scales of a switch, near off: it follows the gradient."""
LARGE: Final = (0.5, 1.5, 3.0)
"""Starts far from off."""
FROM_DECLARED: Final = (0.5, 1.0, 2.0, 4.0, 8.0, 16.0, 32.0)
"""Starts with all else as declared: a strong effect that is left out bends all else away."""
SHAPES: Final = (1.0, 0.2, 5.0)
"""Starts, in scales, of what shapes an effect but does not switch it."""
EXPLAINS: Final = 2.0 / 3.0
"""Cost with an effect over that without, both with all else as declared, below which a fit starts from there, too."""
INCREDIBLE: Final = 5.0
"""Tolerances by which a declared value is off, beyond which a fit lacks something and starts as declared, too."""
ROBUST: Final = 20.0
"""σ: scale of the cost by which starts are ranked, so that one impact at another time does not decide."""


class Start(NamedTuple):
    """Where a fit begins: the cost by which it is ranked, and values by name."""

    cost: float
    values: dict[str, float]


def robust_cost(model: Model, values: Mapping[str, float]) -> float:
    """The cost by which starts are ranked; infinite where the machine cannot be simulated, or squares overflow."""
    rows = model.problem.rows
    try:
        left = model.residuals(model.at(values))
    except SimulationError:
        return math.inf
    # Readings of a row that stands for many scatter by far less than the scale, where the logarithm is linear.
    with np.errstate(over="ignore"):
        found = float(np.sum(rows.counts * np.log1p(np.square(left / ROBUST) / rows.counts)))
    return found + rows.constant / ROBUST**2


class Near(NamedTuple):
    """How a hypothesis is switched on: sizes of its switches in scales, shapes of the rest, and both signs."""

    sizes: Sequence[float] = (SMALL,)
    has_shapes: bool = True
    has_signs: bool = False


def switched_on(own: Hypothesis, near: Near) -> Iterator[dict[str, float]]:
    """Values of what a hypothesis frees, its switches so far from off, in each shape."""
    switches = [one for one in own.frees if one.is_switch]
    both = near.has_signs and len(switches) == 1 and switches[0].lower < switches[0].start < switches[0].upper
    pairs = len(switches) == 2 and len(near.sizes) > 1
    each = list(itertools.product(near.sizes, repeat=2)) if pairs else [(size,) * len(switches) for size in near.sizes]
    for sizes, sign, shape in itertools.product(each, (1.0, -1.0) if both else (1.0,), _shapes(own, near.has_shapes)):
        left = iter(sizes)
        found = {one.name: _at(one, sign * next(left) if one.is_switch else math.nan, shape) for one in own.frees}
        yield found


Shape = float | Mapping[str, float]
"""A factor on what shapes an effect, or values of its thresholds by name."""


def _shapes(own: Hypothesis, has_shapes: bool) -> Sequence[Shape]:
    """The shapes from which a hypothesis is started: factors of scales, or places of its thresholds."""
    places = {} if own.choice is None else own.choice.places
    if places:
        most = max(len(found) for found in places.values())
        chosen = [{name: found[min(at, len(found) - 1)] for name, found in places.items()} for at in range(most)]
        return chosen if has_shapes else chosen[len(chosen) // 2 : len(chosen) // 2 + 1]
    return SHAPES if has_shapes and not all(one.is_switch for one in own.frees) else SHAPES[:1]


def _at(own: Unknown, size: float, shape: Shape) -> float:
    """The value of what a hypothesis frees: of a switch so many scales from off."""
    if isinstance(shape, Mapping) and own.name in shape:
        return shape[own.name]
    factor = shape if isinstance(shape, float) else 1.0
    if not own.is_switch:
        assert own.parameter is not None
        return min(max(own.parameter.prior_scale * factor, own.parameter.lower), own.parameter.upper)
    z = own.start + size * own.scale
    if not own.lower <= z <= own.upper:
        z = own.start - size * own.scale
    return own.value(min(max(z, own.lower), own.upper))


def starts_of(fitter: Fitter, names: Set, rest: Set, warm: Tried) -> list[Start]:
    """Starts of a set, the best of each kind.

    Args:
        fitter: of the problem. names: the set. rest: it without one name, which was fitted. warm: that fit.
    """
    (name,) = set(names) - set(rest)
    own, model, values = fitter.hypotheses[name], fitter.model(names, has_columns=False), warm.values
    if own.is_declared_value:
        return [Start(robust_cost(model, values), values)]

    def best_of(starts: Iterable[Mapping[str, float]]) -> Start:
        ranked = [Start(robust_cost(model, one), dict(one)) for one in starts]
        return min(ranked, key=lambda one: one.cost)

    known = {one.name: values[one.name] for other in rest for one in fitter.hypotheses[other].frees}
    is_saddle = any(one.is_switch and math.isinf(one.value(one.start)) for one in own.frees)
    found = (
        []
        if is_saddle
        else [best_of({**values, **one} for one in switched_on(own, Near(has_shapes=bool(_places(own)))))]
    )
    found.append(best_of({**values, **one} for one in switched_on(own, Near(LARGE, has_signs=True))))
    if own.choice is not None and own.choice.start:
        found.append(best_of([{**values, **own.choice.start}]))
    declared = best_of({**known, **one} for one in switched_on(own, Near(FROM_DECLARED, has_signs=True)))
    off = robust_cost(model, {**known, **own.off()})
    if is_lost(warm) or declared.cost < EXPLAINS * off:
        found.append(declared)
    return found


def _places(own: Hypothesis) -> bool:
    return own.choice is not None and bool(own.choice.places)


def is_lost(tried: Tried) -> bool:
    """Whether a fit has refitted declared values to what their tolerances make incredible."""
    gaussian = tried.fit.gaussian
    return any(
        own.is_tolerated and isinstance(own.prior, Normal) and abs(z - own.prior.mean) > INCREDIBLE * own.prior.sigma
        for own, z in zip(gaussian.model.moving, gaussian.z.tolist(), strict=True)
    )


def polished(fitter: Fitter, names: Set, tried: Tried) -> Iterator[dict[str, float]]:
    """Starts from which the best set is fitted again: other shapes, and around where it ended.

    Contacts that come and go make shallow local minima near the global one.
    """
    gaussian, random = tried.fit.gaussian, np.random.default_rng(len(names))
    for name in names:
        if name in fitter.hypotheses and not fitter.hypotheses[name].is_declared_value:
            for one in switched_on(fitter.hypotheses[name], Near()):
                yield {**tried.values, **one}
    scales = np.array([own.scale for own in gaussian.model.moving])
    spreads = np.minimum(np.sqrt(np.maximum(np.diag(gaussian.covariance), 0.0)), scales)
    moves = np.array([own.is_freed for own in gaussian.model.moving])
    for scatter in (1.0, 3.0, 10.0):
        z: Array = gaussian.z + np.where(moves, scatter * spreads * random.standard_normal(len(spreads)), 0.0)
        yield gaussian.model.named(np.clip(z, gaussian.lower, gaussian.upper))


WORSE: Final = 2.0
"""Times the sum of squares without effects, up to which all of them together make nothing much worse: one that begins
with the wrong sign may lead to the right one."""


def all_near_off(problem: Problem, effects: Sequence[Hypothesis], warm: Mapping[str, float]) -> dict[str, float] | None:
    """All effects together, so near off that they make nothing much worse; None where even the nearest do.

    Each may be small beside what drives the machine and all of them together not, most of all where scales are as
    large as of another machine: a fit that begins far beyond the data is slow to simulate and does not come back.
    """

    def squares(values: Mapping[str, float]) -> float:
        try:
            return sum_squares(problem.rows.residuals(values))
        except SimulationError:
            return math.inf

    most = WORSE * squares(warm)
    for share in (1.0, 0.1, 0.01, 0.001):
        near = Near((share * SMALL,), has_shapes=False)
        start = dict(warm)
        for own in effects:
            start |= next(switched_on(own, near))
        if squares(start) <= most:
            return start
    return None
