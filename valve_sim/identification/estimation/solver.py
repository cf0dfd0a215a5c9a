"""Output-error fits on whitened residuals: bounded Gauss–Newton with Levenberg's damping."""

from __future__ import annotations

import contextlib
import functools
import math
from collections.abc import Mapping, Sequence
from typing import Final

from valve_sim.identification.estimation.descent import WHOLE, Descent, Effort, End
from valve_sim.identification.estimation.descent_in_sums import DescentInSums, NotInPieces
from valve_sim.identification.estimation.gram import sum_squares
from valve_sim.identification.estimation.problem import Problem
from valve_sim.identification.estimation.result import Fit, MachineKnowledge, Rows
from valve_sim.identification.estimation.smoothing import Smoothness
from valve_sim.identification.plants.protocol import Array, Nuisance, ShortSteps

FAR: Final = 100.0
"""χ² of a sample, 10 σ, beyond which declared values are held at first. Of ten recordings of valves with gas every fit
from 30 σ or more ended with declared values at their bounds; from below 10 σ holding them first changed nothing."""

_OfFit = tuple[tuple[str, ...], tuple[Nuisance, ...], dict[str, float], "MachineKnowledge | Smoothness | None"]


def fit(
    problem: Problem,
    free: Sequence[str],
    start: Mapping[str, float] | Fit,
    *,
    nuisances: Sequence[Nuisance] = (),
    fixed: Mapping[str, float] | None = None,
    effort: Effort = WHOLE,
    prior: MachineKnowledge | Smoothness | None = None,
) -> Fit:
    """Minimise χ² from one start.

    Args:
        problem: data and noise.
        free: parameters to free.
        start: values to start from, by name; what is missing starts at its declared value (nuisances at their mean).
            Or a fit of the same that ended early, to go on with it: by the derivatives and the damping that it has.
        nuisances: estimated along, with their priors, but for what is freed or held, by name or as the same thing.
        fixed: further values to hold, e.g. an effect's parameter in a profile.
        effort: how far it is carried; one that ends early has not converged.
        prior: beside those of the nuisances: what other data of the same machine say, in place of these; or that a
            curve among what is freed is smooth, whose weights are chosen along.
    """
    settled = {*free, *(fixed or {})}
    estimated = tuple(own for own in nuisances if not {own.name, own.same_as} & settled)
    of_fit = (tuple(free), estimated, dict(fixed or {}), prior)
    search, end = _descended(problem, of_fit, start, effort)
    values, whole = search.values(end.at), problem.without_limit()
    left = Rows(end.residuals if search.holds_rows else None, functools.partial(whole.residuals, values))
    again = functools.partial(_jacobian_of, whole, of_fit, end.at, left)
    derivatives = Rows(end.jacobian if search.holds_rows else None, again)
    return Fit(
        problem, tuple(free), estimated, values, end.cost, left, derivatives, end.information, end.converged, end.at,
        search.smooth, end.damping, end.reach,
    )  # fmt: skip


def _descended(
    problem: Problem, of_fit: _OfFit, start: Mapping[str, float] | Fit, effort: Effort
) -> tuple[Descent, End]:
    """The search and where it ended; of many residuals without holding them, where that can be."""
    if problem.is_long and not effort.robust:
        with contextlib.suppress(NotInPieces):
            return _from_start(DescentInSums, problem, of_fit, start, effort)
    return _from_start(Descent, problem, of_fit, start, effort)


def _from_start(
    kind: type[Descent], problem: Problem, of_fit: _OfFit, start: Mapping[str, float] | Fit, effort: Effort
) -> tuple[Descent, End]:
    search = kind(problem, *of_fit)
    if isinstance(start, Fit):
        return search, search.descend(start.coordinates, math.inf, effort, start)
    at = search.start(_nearer(kind, problem, of_fit, start))
    for scale in effort.robust:
        at = search.descend(at, scale).at
    return search, search.descend(at, math.inf, effort)


def _nearer(kind: type[Descent], problem: Problem, of_fit: _OfFit, start: Mapping[str, float]) -> Mapping[str, float]:
    """A start, or one from which far less is left of the data, with the declared values of the given one.

    Against errors of many times the noise no tolerance counts: steps far beyond what is linear would take declared
    values to their bounds, from where none leads back. So all else is fitted first.
    """
    free, estimated, fixed, prior = of_fit
    held = {own.name: start.get(own.name, own.mean) for own in estimated if own.is_of_machine}
    if not held or isinstance(prior, MachineKnowledge):
        return start
    others = tuple(own for own in estimated if not own.is_of_machine)
    plant = problem.plant
    if isinstance(plant, ShortSteps) and plant.short_step:
        # Dampings as well: with gas a plunger that creeps open delays the pressure as a smaller orifice would, and from
        # there none leads back (two recordings into a dead end, one of them of a valve that lacks nothing).
        held |= {name: start.get(name, plant.declared(name)) for name in plant.base if name in free}
        free = tuple(name for name in free if name not in held)
    search = kind(problem, free, others, {**fixed, **held}, prior)
    at = search.start(start)
    residuals = search.residuals(at)
    if residuals is None or sum_squares(residuals) <= FAR * problem.variance_inflation * problem.effective_samples:
        return start
    return {**start, **search.values(search.descend(at, math.inf).at)}


def _jacobian_of(problem: Problem, of_fit: _OfFit, at: Array, left: Rows) -> Array:
    return Descent(problem, *of_fit).jacobian(at, left.array())
