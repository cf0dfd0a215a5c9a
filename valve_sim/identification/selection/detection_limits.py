"""How large an effect would have to be to show in these data: what "nothing is missing" is worth.

A fit that lacks an effect of size a misses the data by a s, to first order, where s is the effect's sensitivity less
what the fit's own parameters and nuisances can do of it (as in the score test). An effect is decisive where this gains
10 in the score S, theory, eq. (41), beyond the price of its k parameters:

    a² ‖s‖² / f = 10 + k ln N
"""

from __future__ import annotations

import math
from collections.abc import Mapping
from typing import Final

from valve_sim.identification.estimation.descent import STANDING, along
from valve_sim.identification.estimation.gram import sum_squares
from valve_sim.identification.estimation.result import Fit
from valve_sim.identification.plants.protocol import (
    SMALL_MOVE,
    EffectChoice,
    internal_bounds,
    internal_scale,
    to_internal,
)
from valve_sim.identification.selection.score_test import Outside, release_of, switched_on
from valve_sim.identification.selection.table import DECISIVE
from valve_sim.model import Parameter, SimulationError

Limits = Mapping[str, Mapping[str, float]]
"""By effect and by parameter that switches it, SI."""
LARGE_MOVE: Final = 1.0
"""Prior scales: how the change grows from a small move to this one says whether it is one of the first order at all."""
LEAST_POWER, MOST_POWER = 0.8, 2.2
"""Of a move, by which the change must grow. A contact that only rebounds above a speed has none."""

LEAST_SHARE: Final = 0.1
"""Of what an effect changes, that the fit cannot follow, for a difference quotient to show it."""


def detection_limits(result: Fit) -> dict[str, dict[str, float]]:
    """The smallest effects that would have been decisive beside a fit, each alone, its shape as first expected.

    Returns:
        By effect and parameter, SI: by how much the parameter would have to differ from where it does nothing; of one
        that does nothing at infinity, its value. inf where nothing within its range would have shown, nan where the
        first order says nothing.

    Raises:
        OutOfTimeError: the time is used up.
    """
    outside, found = Outside(result), {}
    for name, effect in result.problem.plant.effects.items():
        if set(effect.free_names()) & set(result.free):
            continue
        found[name] = {
            switch.name: _limit(result, outside, effect, switch)
            for switch in effect.parameters
            if switch.off is not None
        }
    return found


def _limit(result: Fit, outside: Outside, effect: EffectChoice, switch: Parameter) -> float:
    """By what a little of it changes, or by its release where it is the same thing as a value with a tolerance."""
    released = release_of(result, effect.free_name(switch))
    if released is not None and released.unit == switch.unit:
        off = math.sqrt((DECISIVE + released.price) * result.problem.variance_inflation / released.share)
        return _within_range(switch, off * released.tolerance)
    if effect.is_declared_value:
        return math.inf
    price = len(effect.free_names()) * math.log(result.problem.effective_samples)
    decisive = math.sqrt((DECISIVE + price) * result.problem.variance_inflation)
    slope = _slope(result, outside, effect, switch)
    if slope > 0.0:
        return _within_range(switch, decisive / slope)
    small, large = (_distance(result, outside, effect, switch, size) for size in (SMALL_MOVE, LARGE_MOVE))
    if not 0.0 < small < large:
        return math.nan
    # It goes by its switch, by the inverse of that, or by a square.
    power = math.log(large / small) / math.log(LARGE_MOVE / SMALL_MOVE)
    if not LEAST_POWER < power < MOST_POWER:
        return math.nan
    return _within_range(switch, SMALL_MOVE * (decisive / small) ** (1.0 / power) * internal_scale(switch))


def _slope(result: Fit, outside: Outside, effect: EffectChoice, switch: Parameter) -> float:
    """What one of the search's coordinate changes, in standard deviations, by the plant's derivatives; 0: not known.

    A difference quotient leaves a rest at every contact, even of what the fit can follow wholly.
    """
    assert switch.off is not None
    name = effect.free_name(switch)
    direction = along(name, switch, to_internal(switch, switch.off))
    if direction is STANDING:
        return 0.0
    try:
        columns, known = result.problem.sensitivities(
            {**result.values, **switched_on(effect, switch, 0.0)}, [direction]
        )
    except SimulationError:
        return 0.0
    return outside.distance(columns[:, 0]) if known[0] else 0.0


def _distance(result: Fit, outside: Outside, effect: EffectChoice, switch: Parameter, size: float) -> float:
    """By how many standard deviations so many prior scales of one switch change what the fit cannot follow.

    0 where a quotient cannot tell, because the fit can follow nearly all of it.
    """
    try:
        moved = result.problem.residuals({**result.values, **switched_on(effect, switch, size)}) - result.residuals
    except SimulationError:
        return 0.0
    found = outside.distance(moved)
    return found if found > LEAST_SHARE * math.sqrt(sum_squares(moved)) else 0.0


def _within_range(switch: Parameter, move: float) -> float:
    """A move of the search's coordinate as a change of the value; inf where it leads out of the range."""
    assert switch.off is not None
    lower, upper = internal_bounds(switch)
    at = to_internal(switch, switch.off)
    if move > max(at - lower, upper - at):
        return math.inf
    return 1.0 / move if math.isinf(switch.off) else move
