"""The descent of a fit to a long recording: residuals and derivatives are added up piece by piece, and never held."""

from __future__ import annotations

import math
from typing import Final

import numpy as np

from valve_sim.identification.estimation.descent import STANDING, Descent
from valve_sim.identification.estimation.problem import Problem
from valve_sim.identification.estimation.result import Fit, MachineKnowledge
from valve_sim.identification.estimation.smoothing import Smoothness
from valve_sim.identification.plants.protocol import Array, Nuisance
from valve_sim.model import SimulationError

MOST_NUISANCES: Final = 64
"""Beyond, as with an error of each command's stamp, most derivatives are 0: they are better held in columns."""


class NotInPieces(Exception):  # noqa: N818 -- internal: the fit is made as that of a short recording
    """A derivative is not known, or there are too many."""


class DescentInSums(Descent):
    """A `Descent` that sums over pieces of a recording; all its derivatives are those of the place.

    In place of the residuals stands one number with their sum of squares, and in place of the derivatives nothing: they
    are worked out where their products are asked for. Arguments as of `Descent`.
    """

    holds_rows = False

    def __init__(
        self,
        problem: Problem,
        free: tuple[str, ...],
        nuisances: tuple[Nuisance, ...],
        fixed: dict[str, float],
        prior: MachineKnowledge | Smoothness | None,
    ) -> None:
        if len(nuisances) > MOST_NUISANCES:
            raise NotInPieces
        super().__init__(problem, free, nuisances, fixed, prior)

    def begin(self, at: Array, begun: Fit | None) -> tuple[Array, Array]:
        """Begin a descent as `Descent` does; of a fit that is continued only its place is taken over."""
        return super().begin(at, None)

    def residuals(self, at: Array) -> Array | None:
        """(1,) the root of their sum of squares, or None where the model cannot be simulated."""
        try:
            sums = self.problem.sums(self.values(at), ())
        except SimulationError:
            return None
        if sums is None:
            raise NotInPieces
        return np.array([math.sqrt(sums.squares)]) if math.isfinite(sums.squares) else None

    def jacobian(self, at: Array, residuals: Array) -> Array:
        """None yet."""
        return np.empty((0, len(at)))

    def normal(self, at: Array, residuals: Array, jacobian: Array) -> tuple[Array, Array]:
        """Information matrix and half the gradient of the criterion, priors included but for that of a curve."""
        directions = [self.direction(at, [index]) for index in range(len(at))]
        if STANDING in directions:
            raise NotInPieces
        try:
            sums = self.problem.sums(self.values(at), directions)
        except SimulationError as error:
            raise NotInPieces from error
        if sums is None:
            raise NotInPieces
        return self.with_priors(at, sums.information, sums.gradient)
