"""One machine fitted to many recordings, each by itself: a reduction of normal equations.

What recordings share is the machine; errors of clocks and stamps are each recording's own. At given values of the
machine, a recording estimates its own nuisances and gives the sum of squares, its gradient and its information with
these eliminated (the Schur complement of its normal equations, theory, eq. (83)). These add up over recordings, and the
sums are all that a Gauss-Newton step needs: no process holds more than one recording at a time, and the optimum is that
of all recordings in one fit.
"""

from __future__ import annotations

from collections.abc import Callable, Mapping, Sequence
from typing import Final, NamedTuple

import numpy as np

from valve_sim.identification.estimation.descent import LARGEST_DAMPING, Descent, Effort
from valve_sim.identification.estimation.gram import gram, sum_squares
from valve_sim.identification.estimation.problem import Problem
from valve_sim.identification.estimation.result import FIRST_DAMPING, Fit, MachineKnowledge
from valve_sim.identification.estimation.solver import fit
from valve_sim.identification.plants.protocol import Array, Nuisance, Plant
from valve_sim.model import SimulationError

MOST_STEPS: Final = 60
SMALL: Final = 1e-4
"""Promised decrease of χ² at which the fit has converged: a hundredth of a standard error."""
_HERE: Final = Effort(most=0)


class Share(NamedTuple):
    """What one recording says of its machine, at some values of that.

    Attributes:
        chi2: of its residuals and of its own nuisances, these at their best.
        gradient: (k,) half of its derivative by the machine's internal coordinates. information: (k, k).
        own: values of its own nuisances. samples: that count.
    """

    chi2: float
    gradient: Array
    information: Array
    own: dict[str, float]
    samples: float


class Shared(NamedTuple):
    """A fit to all recordings.

    Attributes:
        values: of the machine. shares: of the recordings there, in their order. chi2: priors of the machine included.
        converged: whether the last step was small enough.
    """

    values: dict[str, float]
    shares: Sequence[Share]
    chi2: float
    converged: bool


SharesAt = Callable[[Mapping[str, float]], Sequence[Share]]
"""The shares of all recordings at values of the machine, wherever they are worked out."""


def own_nuisances(plant: Plant) -> tuple[Nuisance, ...]:
    """Errors of the recordings: of clocks, of what was read from a voltage, and of every command's stamp."""
    return tuple(own for own in (*plant.nuisances, *plant.timing_errors) if not own.is_of_machine)


def machine_nuisances(plant: Plant, free: Sequence[str]) -> tuple[Nuisance, ...]:
    """Declared values with a tolerance, but for those that are freed, by name or as the same thing."""
    return tuple(own for own in plant.nuisances if own.is_of_machine and not {own.name, own.same_as} & set(free))


def share_of(problem: Problem, free: Sequence[str], values: Mapping[str, float], own: Mapping[str, float]) -> Share:
    """A recording's share.

    Args:
        problem: of this recording. free: parameters that are freed. values: of the machine.
        own: of the recording's nuisances, to start from.

    Raises:
        SimulationError: the machine cannot be simulated with these values.
    """
    plant = problem.plant
    ours, machine = own_nuisances(plant), machine_nuisances(plant, free)
    best = fit(problem, (), own, nuisances=ours, fixed=values)
    there = fit(problem, free, {**values, **best.values}, nuisances=(*machine, *ours), effort=_HERE)
    shared = len(free) + len(machine)
    priors = np.array([1.0 / nuisance.sigma**2 for nuisance in (*machine, *ours)])
    off = np.array([there.values[nuisance.name] - nuisance.mean for nuisance in (*machine, *ours)])
    gradient = gram(there.jacobian, there.residuals)
    gradient[shared:] += (priors * off)[len(machine) :]
    information = there.information.copy()
    # Of the machine's values the priors count once, not once for each recording.
    curvatures = [own.pull(float(at)).curvature for own, at in zip(there.priors, there.coordinates, strict=True)]
    information[np.arange(shared), np.arange(shared)] -= curvatures[:shared]
    between, inside = information[:shared, shared:], information[shared:, shared:]
    # What is left of the own nuisances' gradient is a step that is taken here.
    solved = np.linalg.solve(inside, np.column_stack([gradient[shared:], between.T]))
    chi2 = sum_squares(there.residuals) + float(priors[len(machine) :] @ np.square(off[len(machine) :]))
    return Share(
        chi2 - float(gradient[shared:] @ solved[:, 0]),
        gradient[:shared] - between @ solved[:, 0],
        information[:shared, :shared] - between @ solved[:, 1:],
        {nuisance.name: there.values[nuisance.name] for nuisance in ours},
        problem.effective_samples,
    )


def fit_shared(problem: Problem, free: Sequence[str], shares_at: SharesAt) -> Shared:
    """Fit the machine to all recordings.

    Args:
        problem: of one of the recordings, for what is declared. free: parameters to free.
        shares_at: of all recordings.

    Raises:
        SimulationError: the declared machine cannot be simulated.
    """
    search = Descent(problem, tuple(free), machine_nuisances(problem.plant, free), {}, None)
    at, damping, converged = search.start({}), FIRST_DAMPING, False
    shares = shares_at(search.values(at))
    chi2 = _chi2(search, at, shares)
    for _ in range(MOST_STEPS):
        information, gradient = _normal(search, at, shares)
        move, gain = search.step(at, information, gradient, damping)
        if gain < SMALL:
            converged = True
            break
        there = np.clip(at + move, search.lower, search.upper)
        try:
            new = shares_at(search.values(there))
        except SimulationError:
            new = []
        if new and _chi2(search, there, new) < chi2:
            at, shares, chi2 = there, new, _chi2(search, there, new)
            damping = max(1e-9, 0.1 * damping)
        else:
            damping *= 10.0
            if damping > LARGEST_DAMPING:
                # Rounding, or own nuisances that are known no better, hide what is left to gain.
                converged = gain < 1.0
                break
    return Shared(search.values(at), shares, chi2, converged)


def _chi2(search: Descent, at: Array, shares: Sequence[Share]) -> float:
    return sum(share.chi2 for share in shares) + float(np.sum(search.pulls(at)[0]))


def _normal(search: Descent, at: Array, shares: Sequence[Share]) -> tuple[Array, Array]:
    of_priors, slopes = _prior_alone(search, at)
    information = np.sum([share.information for share in shares], axis=0) + of_priors
    return information, np.sum([share.gradient for share in shares], axis=0) + slopes


def as_fit(problem: Problem, free: Sequence[str], found: Shared) -> Fit:
    """The fit to the first recording that knows what all others say: its values and covariance are those of all.

    Args:
        problem: of the first recording. free: parameters that were freed. found: the fit to all.
    """
    machine = machine_nuisances(problem.plant, free)
    search = Descent(problem, tuple(free), machine, {}, None)
    at = search.start(found.values)
    information, gradient = _normal(search, at, found.shares[1:]) if found.shares[1:] else _prior_alone(search, at)
    names = (*free, *(nuisance.name for nuisance in machine))
    size = 1.0 / np.sqrt(np.maximum(np.diag(information), 1e-300))
    centre = at - size * np.linalg.lstsq(information * np.outer(size, size), size * gradient, rcond=1e-12)[0]
    nuisances = (*machine, *own_nuisances(problem.plant))
    start = {**found.values, **found.shares[0].own}
    return fit(problem, free, start, nuisances=nuisances, prior=MachineKnowledge(names, centre, information))


def _prior_alone(search: Descent, at: Array) -> tuple[Array, Array]:
    _, half_slopes, curvatures = search.pulls(at)
    return np.diag(curvatures), half_slopes
