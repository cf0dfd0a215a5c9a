"""One descent: Gauss–Newton with Levenberg's damping, within ranges; columns of errors are always at their best."""

from __future__ import annotations

import math
from collections.abc import Callable
from dataclasses import dataclass
from typing import Final, NamedTuple

import numpy as np
from numpy.typing import NDArray

from valve_sim.identification.fit.gaussian import Gaussian, MachineKnowledge, Sizes
from valve_sim.identification.fit.model import Model
from valve_sim.identification.fit.process import Cell, Process
from valve_sim.identification.plants.protocol import Array
from valve_sim.model import SimulationError

CONVERGED: Final = 1e-2
"""Of the criterion: a step that would lower it by less is none. A tenth of a standard error."""
FAR: Final = 100.0
"""Criterion of a sample, 10 σ, from which declared values with tolerances are held: against such misfits no tolerance
counts, and steps far beyond what is linear would take them to their bounds, from where none leads back."""
FAR_WITH_GAS: Final = 10.0
"""The same of a valve with gas, of which refitted values are held first, too: a plunger that creeps open delays the
pressure as a smaller orifice or a larger volume would."""
PRUNED: Final = 10.0
"""Times the last decrease, or the next that is promised, beyond which a goal is out of reach: each decrease is smaller
than the one before, and where by a tenth of it, all that are left come to ten. (Not asked of a
damped step: a fit that begins with these gains more later.)"""
FEWEST: Final = 2
"""Linearisations before it is asked whether a goal can still be reached."""
MOST: Final = 40
FIRST_DAMPING: Final = 1e-3
LARGEST_DAMPING: Final = 1e4
"""Of λ in theory, eq. (29): beyond it no step lowers the criterion."""


class Beside(NamedTuple):
    """A process in the covariance of the residuals, at a cell."""

    process: Process
    cell: Cell


@dataclass(frozen=True)
class Descended:
    """Where a descent ended.

    Attributes:
        gaussian: there. converged: whether nothing is left to be gained.
        least: a bound of the criterion, had it gone on. damping: λ of the next step.
    """

    gaussian: Gaussian
    converged: bool
    least: float
    damping: float

    @property
    def cost(self) -> float:
        """The criterion."""
        return self.gaussian.cost


def descend(
    model: Model,
    z: Array,
    sizes: Sizes,
    *,
    most: int = MOST,
    goal: float = math.inf,
    beside: Beside | None = None,
    known: MachineKnowledge | None = None,
    damping: float = FIRST_DAMPING,
) -> Descended:
    """Lower the criterion from a place.

    Args:
        model: what is freed. z: (k,) where it begins. sizes: of groups of errors.
        most: linearisations. goal: a criterion that is of interest: what cannot reach it is given up.
        beside: something unnamed. known: what other data say of the machine. damping: λ at first.

    Raises:
        SimulationError: the machine cannot be simulated where it begins.
    """

    def there(at: Array) -> Gaussian:
        found = Gaussian(model, at, model.linearise(at), sizes, known)
        return found if beside is None else found.beside(*beside)

    here = there(np.clip(z, model.lower, model.upper))
    if known is None:
        for held in _held_first(here):
            here = _lowered(here, there, Effort(most, damping=damping), held).gaussian
    return _lowered(here, there, Effort(most, goal, damping))


class Effort(NamedTuple):
    """How far a descent is carried: most linearisations, the goal that is of interest, and λ at first."""

    most: int
    goal: float = math.inf
    damping: float = FIRST_DAMPING


def _lowered(
    here: Gaussian, there: Callable[[Array], Gaussian], effort: Effort, held: NDArray[np.bool_] | None = None
) -> Descended:
    """Lower the criterion from a place, some coordinates held."""
    decrease, least, damping = 0.0, -math.inf, effort.damping
    for made in range(1, effort.most):
        move, gain = here.step(damping, held)
        least = here.cost - PRUNED * max(gain, decrease)
        if gain < CONVERGED:
            return Descended(here, converged=True, least=here.cost, damping=damping)
        if made >= FEWEST and damping <= FIRST_DAMPING and least > effort.goal:
            break
        found = _tried(there, np.clip(here.z + move, here.lower, here.upper))
        if found is None or not found.cost < here.cost:
            damping *= 10.0
            if damping > LARGEST_DAMPING:
                return Descended(here, converged=True, least=here.cost, damping=damping)
            continue
        decrease, here = here.cost - found.cost, found
        damping = max(1e-9, damping * (0.1 if decrease > 0.5 * gain else 0.5))
        if decrease < CONVERGED:
            return Descended(here, converged=True, least=here.cost, damping=damping)
    return Descended(here, converged=False, least=least, damping=damping)


def _tried(there: Callable[[Array], Gaussian], at: Array) -> Gaussian | None:
    """The model at a place; None where it cannot be simulated."""
    try:
        found = there(at)
        return found if math.isfinite(found.cost) else None
    except (SimulationError, np.linalg.LinAlgError):
        return None


def _held_first(here: Gaussian) -> list[NDArray[np.bool_]]:
    """(k,) masks of what is held while far more than noise is left, one after the other; none where it is not."""
    model, samples = here.model, here.model.problem.effective_samples
    has_gas = model.problem.plant.short_step is not None
    tolerated = np.array([own.is_tolerated for own in model.moving], dtype=bool)
    if not tolerated.any() or here.cost <= (FAR_WITH_GAS if has_gas else FAR) * samples:
        return []
    base = set(model.problem.plant.base)
    dampings = np.array([own.name in base for own in model.moving], dtype=bool)
    return [tolerated | dampings, dampings] if has_gas else [tolerated]
