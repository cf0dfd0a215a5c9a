"""Output-error fits on whitened residuals: bounded Gauss–Newton with Levenberg's damping."""

from __future__ import annotations

import contextlib
import functools
from collections.abc import Mapping, Sequence
from typing import Final

import numpy as np

from valve_sim.identification.estimation.descent import (
    WHOLE,
    Descent,
    DescentInSums,
    End,
    NotInPieces,
    SolverOptions,
)
from valve_sim.identification.estimation.gram import sum_squares
from valve_sim.identification.estimation.problem import Problem
from valve_sim.identification.estimation.result import Fit, MachineKnowledge, Rows
from valve_sim.identification.estimation.smoothing import Smoothness
from valve_sim.identification.plants.protocol import Array, Nuisance, short_step_of

FAR: Final = 100.0
"""χ² of a sample, 10 σ, beyond which declared values are held at first. Of ten recordings of valves with gas every fit
from 30 σ or more ended with declared values at their bounds; from below 10 σ holding them first changed nothing."""
FAR_WITH_GAS: Final = 10.0
"""χ² of a sample, 3 σ, beyond which dampings are held as well: a recording that lacks nothing began at 5.6 σ, and with
dampings free its fit ended 240 in χ² above where it ends if they are held first."""

MOST_NUISANCES: Final = 64
"""Nuisances of a fit in sums: beyond, as with an error of each command's stamp, most derivatives are 0, and are better
held in columns."""

_OfFit = tuple[tuple[str, ...], tuple[Nuisance, ...], dict[str, float], "MachineKnowledge | Smoothness | None"]


def fit(
    problem: Problem,
    free: Sequence[str],
    start: Mapping[str, float] | Fit,
    *,
    nuisances: Sequence[Nuisance] = (),
    fixed: Mapping[str, float] | None = None,
    effort: SolverOptions = WHOLE,
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
    values, whole = search.values(end.at), problem.without_limit().with_every_row()
    known = (end.residuals, end.jacobian) if search.holds_rows and problem.rows is search.rows else (None, None)
    left, derivatives = _rows(whole, problem.without_limit(), of_fit, end.at, values, known)
    return Fit(
        problem, tuple(free), estimated, values, end.cost, left, derivatives, end.information, end.converged, end.at,
        tuple(search.priors), end.gradient, np.column_stack([end.at - search.lower, search.upper - end.at]),
        search.smooth, end.damping, end.chi2_lower_bound,
    )  # fmt: skip


def _rows(
    whole: Problem, fitted: Problem, of_fit: _OfFit, at: Array, values: dict[str, float],
    known: tuple[Array | None, Array | None],
) -> tuple[Rows, Rows]:  # fmt: skip
    """Residuals and derivatives at an end, of each sample and of the rows that were fitted."""
    has_fewer = fitted.rows is not fitted.every_row
    left = Rows(
        functools.partial(whole.residuals, values),
        functools.partial(fitted.rows.residuals, values) if has_fewer else None,
        known[0],
    )
    derivatives = Rows(
        lambda: Descent(whole, *of_fit).jacobian(at, left.array()),
        (lambda: Descent(fitted, *of_fit).jacobian(at, left.condensed())) if has_fewer else None,
        known[1],
    )
    return left, derivatives


def _descended(
    problem: Problem, of_fit: _OfFit, start: Mapping[str, float] | Fit, effort: SolverOptions
) -> tuple[Descent, End]:
    """The search and where it ended; of many residuals without holding them, where that can be."""
    if problem.is_long and len(of_fit[1]) <= MOST_NUISANCES:
        with contextlib.suppress(NotInPieces):
            return _from_start(DescentInSums, problem, of_fit, start, effort)
    return _from_start(Descent, problem, of_fit, start, effort)


def _from_start(
    kind: type[Descent], problem: Problem, of_fit: _OfFit, start: Mapping[str, float] | Fit, effort: SolverOptions
) -> tuple[Descent, End]:
    search = kind(problem, *of_fit)
    if isinstance(start, Fit):
        return search, search.descend(start.coordinates, effort, start)
    at = search.start(start if effort.is_near else _nearer(kind, problem, of_fit, start, effort))
    return search, search.descend(at, effort)


def _nearer(
    kind: type[Descent], problem: Problem, of_fit: _OfFit, start: Mapping[str, float], effort: SolverOptions
) -> Mapping[str, float]:
    """A start, or one from which far less is left of the data.

    Against errors of many times the noise no tolerance counts: steps far beyond what is linear would take declared
    values to their bounds, from where none leads back. So all else is fitted first. With gas dampings are held as well,
    until the declared values have been fitted, too: a plunger that creeps open delays the pressure as a smaller orifice
    or a larger volume would, and from there none leads back either. Before a trial these are trials as well, or would
    take most of its time.
    """
    free, estimated, fixed, prior = of_fit
    declared = {own.name: start.get(own.name, own.mean) for own in estimated if own.is_of_machine}
    if not declared or isinstance(prior, MachineKnowledge):
        return start
    plant, far, dampings, until = problem.plant, FAR, dict[str, float](), SolverOptions(most=effort.most)
    if short_step_of(plant):
        far = FAR_WITH_GAS
        dampings = {name: start.get(name, plant.declared(name)) for name in plant.base}
        dampings = {name: value for name, value in dampings.items() if name in free}
    rest = tuple(name for name in free if name not in dampings)
    others = tuple(own for own in estimated if not own.is_of_machine)
    first = kind(problem, rest, others, {**fixed, **dampings, **declared}, prior)
    at = first.start(start)
    residuals = first.residuals(at)
    if residuals is None or sum_squares(residuals) <= far * problem.effective_samples:
        return start
    nearer = {**start, **first.values(first.descend(at, until).at)}
    if not dampings:
        return nearer
    then = kind(problem, rest, estimated, {**fixed, **dampings}, prior)
    return {**nearer, **then.values(then.descend(then.start(nearer), until).at)}
