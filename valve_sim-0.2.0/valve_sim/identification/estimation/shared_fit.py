"""One machine fitted to many recordings, each by itself: a reduction of normal equations.

What recordings share is the machine; errors of clocks and stamps are each recording's own. At given values of the
machine, a recording estimates its own nuisances and gives the sum of squares, its gradient and its information with
these eliminated (the Schur complement of its normal equations, theory, eq. (83)). These add up over recordings, and the
sums are all that a Gauss-Newton step needs: no process holds more than one recording at a time, and the optimum is that
of all recordings in one fit.
"""

from __future__ import annotations

import math
from collections.abc import Callable, Mapping, Sequence
from dataclasses import replace
from typing import Final, NamedTuple

import numpy as np

from valve_sim.identification.estimation.descent import Descent, SolverOptions
from valve_sim.identification.estimation.gram import gram, sum_squares
from valve_sim.identification.estimation.problem import Problem
from valve_sim.identification.estimation.result import Fit, MachineKnowledge
from valve_sim.identification.estimation.solver import fit
from valve_sim.identification.plants.protocol import Array, Nuisance, Plant
from valve_sim.model import SimulationError

MOST_STEPS: Final = 60
SMALL: Final = 1e-4
"""Promised decrease of χ² at which the fit has converged: a hundredth of a standard error."""
_HERE: Final = SolverOptions(most=0)


class ReducedNormalEquations(NamedTuple):
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
    shares: Sequence[ReducedNormalEquations]
    chi2: float
    converged: bool


SharesAt = Callable[[Mapping[str, float]], Sequence[ReducedNormalEquations]]
"""The shares of all recordings at values of the machine, wherever they are worked out."""


def own_nuisances(problem: Problem) -> tuple[Nuisance, ...]:
    """What each recording estimates for itself: errors of clocks and of commands' stamps, and what varies by stroke."""
    return tuple(own for own in (*problem.nuisances, *problem.plant.timing_errors) if not own.is_of_machine)


def machine_nuisances(plant: Plant, free: Sequence[str]) -> tuple[Nuisance, ...]:
    """Declared values with a tolerance, but for those that are freed, by name or as the same thing."""
    return tuple(own for own in plant.nuisances if own.is_of_machine and not {own.name, own.same_as} & set(free))


def share_of(
    problem: Problem, free: Sequence[str], values: Mapping[str, float], own: Mapping[str, float]
) -> tuple[ReducedNormalEquations, Fit]:
    """A recording's share, and the fit from which it is: at these values, nuisances of the recording at their best.

    Args:
        problem: of this recording. free: parameters that are freed. values: of the machine.
        own: of the recording's nuisances, to start from.

    Raises:
        SimulationError: the machine cannot be simulated with these values.
    """
    ours, machine = own_nuisances(problem), machine_nuisances(problem.plant, free)
    best = fit(problem, (), own, nuisances=ours, fixed=values)
    there = fit(problem, free, {**values, **best.values}, nuisances=(*machine, *ours), effort=_HERE)
    shared = len(free) + len(machine)
    priors = np.array([1.0 / nuisance.sigma**2 for nuisance in (*machine, *ours)])
    off = np.array([there.values[nuisance.name] - nuisance.mean for nuisance in (*machine, *ours)])
    rows = problem.whitened(np.column_stack([there.derivatives.condensed(), there.left.condensed()]))
    jacobian, residuals = rows[:, :-1], rows[:, -1]
    gradient = gram(jacobian, residuals)
    gradient[shared:] += (priors * off)[len(machine) :]
    information = there.information.copy()
    # Of the machine's values the priors count once, not once for each recording.
    information[np.arange(shared), np.arange(shared)] -= there.pulls[2, :shared]
    between, inside = information[:shared, shared:], information[shared:, shared:]
    # What is left of the own nuisances' gradient is a step that is taken here.
    solved = np.linalg.solve(inside, np.column_stack([gradient[shared:], between.T]))
    chi2 = sum_squares(residuals) + float(priors[len(machine) :] @ np.square(off[len(machine) :]))
    share = ReducedNormalEquations(
        chi2 - float(gradient[shared:] @ solved[:, 0]),
        gradient[:shared] - between @ solved[:, 0],
        information[:shared, :shared] - between @ solved[:, 1:],
        {nuisance.name: there.values[nuisance.name] for nuisance in ours},
        problem.effective_samples,
    )
    return share, there


class DescentOverRecordings(Descent):
    """The search of a machine's values by the sums of its recordings' shares.

    Args:
        problem: of one of the recordings, for what is declared. free: parameters to free. shares_at: of all recordings.
    """

    holds_rows = False

    def __init__(self, problem: Problem, free: Sequence[str], shares_at: SharesAt) -> None:
        # Each share is whitened for the errors of its recording; there are no rows here.
        super().__init__(problem.with_errors(None), tuple(free), machine_nuisances(problem.plant, free), {}, None)
        self._shares_at, self._small = shares_at, SMALL
        self._shares: dict[bytes, Sequence[ReducedNormalEquations]] = {}

    def shares(self, at: Array) -> Sequence[ReducedNormalEquations]:
        """Of all recordings there.

        Raises:
            SimulationError: the machine cannot be simulated there.
        """
        key = at.tobytes()
        if key not in self._shares:
            # A step is accepted or not: two places are looked at by turns.
            kept = list(self._shares.items())[-1:]
            self._shares = {**dict(kept), key: self._shares_at(self.values(at))}
        return self._shares[key]

    def residuals(self, at: Array) -> Array | None:
        """(1,) the root of the sum of all χ², or None where the machine cannot be simulated."""
        try:
            total = sum(share.chi2 for share in self.shares(at))
        except SimulationError:
            return None
        return np.array([math.sqrt(total)]) if math.isfinite(total) else None

    def jacobian(self, at: Array, residuals: Array) -> Array:
        """None: shares hold the products of their derivatives."""
        return np.empty((0, len(at)))

    def normal(self, at: Array, residuals: Array, jacobian: Array) -> tuple[Array, Array]:
        """Information matrix and half the gradient of the criterion, priors of the machine included."""
        return self.summed(at, self.shares(at))

    def summed(self, at: Array, shares: Sequence[ReducedNormalEquations]) -> tuple[Array, Array]:
        """These of some of the shares."""
        information, gradient = np.zeros((len(at), len(at))), np.zeros(len(at))
        for share in shares:
            information += share.information
            gradient += share.gradient
        return self.with_priors(at, information, gradient)


def fit_shared(problem: Problem, free: Sequence[str], shares_at: SharesAt, start: Mapping[str, float]) -> Shared:
    """Fit the machine to all recordings.

    Args:
        problem: of one of the recordings, for what is declared. free: parameters to free.
        shares_at: of all recordings. start: values of the machine to begin at; what is missing begins as declared.

    Raises:
        SimulationError: the declared machine cannot be simulated.
    """
    search = DescentOverRecordings(problem, free, shares_at)
    end = search.descend(search.start(start), SolverOptions(most=MOST_STEPS))
    return Shared(search.values(end.at), search.shares(end.at), end.cost, end.converged)


def as_fit(problem: Problem, free: Sequence[str], found: Shared) -> Fit:
    """The fit to the first recording that knows what all others say: its values and covariance are those of all.

    Args:
        problem: of the first recording. free: parameters that were freed. found: the fit to all.
    """
    machine = machine_nuisances(problem.plant, free)
    search = DescentOverRecordings(problem, free, lambda values: found.shares)
    at = search.start(found.values)
    information, gradient = search.summed(at, found.shares[1:])
    names = (*free, *(nuisance.name for nuisance in machine))
    size = 1.0 / np.sqrt(np.maximum(np.diag(information), 1e-300))
    centre = at - size * np.linalg.lstsq(information * np.outer(size, size), size * gradient, rcond=1e-12)[0]
    nuisances = (*machine, *own_nuisances(problem))
    start = {**found.values, **found.shares[0].own}
    known = MachineKnowledge(names, centre, information)
    result = fit(problem, free, start, nuisances=nuisances, prior=known)
    return replace(result, converged=result.converged and found.converged)
