"""Can the catalogue explain the coil current? Tested on the current alone, before any fit to the motion.

A current is known to milliamperes and drives the plungers: where no effect of the catalogue has its form (a driver that
regulates it, eddy currents that grow as the gap closes), a joint fit would bias the motion towards it. So its noise is
inflated by what the effects that change it leave: theory, eq. (54).
"""

from __future__ import annotations

import math
from collections.abc import Sequence
from typing import Final

import numpy as np

from valve_sim.identification.estimation.budget import OutOfTimeError
from valve_sim.identification.estimation.problem import Problem
from valve_sim.identification.estimation.result import Fit
from valve_sim.identification.plants.protocol import Array, EffectChoice, perturbed
from valve_sim.identification.selection.hypotheses import Search
from valve_sim.identification.selection.table import DECISIVE, Hypothesis
from valve_sim.model import SimulationError

UNEXPLAINED: Final = 1.5
"""Standard deviations, root mean square, by which effects miss a current whose form is another: on the campaign's
plant of the declared form they miss it by at most 1.04; on the one with back-EMF, which was not among them then, by
2.6 to 11."""
MOST_EFFECTS: Final = 4
"""More effects of the coil at once could explain any current."""
MOVES_NOTHING: Final = 1e-3
"""Standard deviations: an effect that changes no sample of the current by more is no effect of the coil."""


def current_noise_inflation(problem: Problem) -> float:
    """The factor on the noise of the current: 1, or its whitened residual where its form is another."""
    left = current_left(problem)
    return left if left > UNEXPLAINED else 1.0


def current_left(problem: Problem) -> float:
    """Root mean square of the current's whitened residual with the best effects; 0 without a current.

    Effects that move the current are added while they are decisive, and errors of the commands' stamps are tried.
    """
    is_actuation = [channel.role == "actuation" for channel in problem.plant.channels]
    if not any(is_actuation):
        return 0.0
    search = Search(problem.restricted(lambda index, groups: problem.weight(index) * is_actuation[index] > 0.0))
    best = Hypothesis(())
    search.fit(best)
    try:
        return _left(search)
    except OutOfTimeError:
        # What was not tried may explain it: without time, the noise is inflated by the residual of the declared model.
        return _missed(search.fit(best))


def _left(search: Search) -> float:
    """The residual with errors of the stamps, or with the effects that explain most of the current."""
    best = Hypothesis(())
    if _missed(search.fit(best)) <= UNEXPLAINED:
        return _missed(search.fit(best))
    # Tried first: for a current without noise every effect is decisive where late stamps are the cause.
    timed = _missed(search.fit(best._replace(timing=True)))
    if timed <= UNEXPLAINED:
        return timed
    names = _of_the_coil(search.problem, search.fit(best))
    while len(best.effects) < MOST_EFFECTS:
        further = [best.adding(name) for name in names if name not in best.effects]
        candidate = search.best(further) if further else best
        if candidate == best or search.score(candidate) > search.score(best) - DECISIVE:
            break
        best = candidate
    timed = _missed(search.fit(best._replace(timing=True)))
    return timed if timed <= UNEXPLAINED else _missed(search.fit(best))


def _missed(result: Fit) -> float:
    """Root mean square of whitened residuals."""
    return math.sqrt(float(np.sum(np.square(result.residuals))) / max(1, result.problem.samples))


def _of_the_coil(problem: Problem, base: Fit) -> Sequence[str]:
    """The effects that change the current."""
    return [
        name for name, effect in problem.plant.effects.items()
        if np.max(np.abs(_with(problem, base, effect) - base.residuals)) > MOVES_NOTHING
    ]  # fmt: skip


def _with(problem: Problem, base: Fit, effect: EffectChoice) -> Array:
    """Residuals with a small amount of an effect."""
    values = {
        effect.free_name(parameter): parameter.prior_scale
        if parameter.off is None
        else perturbed(parameter, base.values.get(effect.free_name(parameter), parameter.off))
        for parameter in effect.parameters
    }
    try:
        return problem.residuals({**base.values, **values})
    except SimulationError:
        return base.residuals
