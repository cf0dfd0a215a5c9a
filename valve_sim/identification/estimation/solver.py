"""Output-error fits on whitened residuals: bounded Gauss–Newton with Levenberg's damping."""

from __future__ import annotations

import contextlib
import functools
import math
from collections.abc import Mapping, Sequence

from valve_sim.identification.estimation.descent import WHOLE, Descent, Effort, End
from valve_sim.identification.estimation.descent_in_sums import DescentInSums, NotInPieces
from valve_sim.identification.estimation.problem import Problem
from valve_sim.identification.estimation.result import Fit, MachineKnowledge, Rows
from valve_sim.identification.estimation.smoothing import Smoothness
from valve_sim.identification.plants.protocol import Array, Nuisance

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
            in_sums = DescentInSums(problem, *of_fit)
            return in_sums, _from_start(in_sums, start, effort)
    search = Descent(problem, *of_fit)
    return search, _from_start(search, start, effort)


def _from_start(search: Descent, start: Mapping[str, float] | Fit, effort: Effort) -> End:
    if isinstance(start, Fit):
        return search.descend(start.coordinates, math.inf, effort, start)
    at = search.start(start)
    for scale in effort.robust:
        at = search.descend(at, scale).at
    return search.descend(at, math.inf, effort)


def _jacobian_of(problem: Problem, of_fit: _OfFit, at: Array, left: Rows) -> Array:
    return Descent(problem, *of_fit).jacobian(at, left.array())
