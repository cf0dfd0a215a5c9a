"""What a fit cannot follow of a change of its residuals, and what χ² gains where that is let free: to first order."""

from __future__ import annotations

from typing import Final

import numpy as np

from valve_sim.identification.estimation.gram import gram, orthonormal
from valve_sim.identification.estimation.result import Fit
from valve_sim.identification.plants.protocol import Array

MOVES_NOTHING: Final = 1e-6
"""Standard deviations, over all samples: a direction that changes the residual by less is ignored."""
DEPENDENT: Final = 1e-8
"""Of the largest power of some directions: what is below it is a combination of the others."""


class OrthogonalProjector:
    """Projection onto what is orthogonal to a fit's parameters and nuisances, with their priors.

    Args:
        base: the fit; its rows are those that were fitted.
    """

    def __init__(self, base: Fit) -> None:
        roots = np.sqrt(base.pulls[2])
        self._problem = base.problem
        jacobian = base.problem.without_errors(base.derivatives.condensed())
        columns = np.vstack([jacobian, np.diag(roots)])
        size = np.sqrt(np.sum(np.square(columns), axis=0))
        pulled = base.pulls[1] / np.where(roots > 0.0, roots, 1.0)
        left = base.problem.without_errors(base.left.condensed()[:, None])[:, 0]
        self._residuals = np.concatenate([left, pulled])
        self._samples = len(jacobian)
        self._fitted = orthonormal(columns[:, size > 0.0] / size[size > 0.0])

    def along(self, change: Array) -> tuple[float, float]:
        """Of an (r,) change: the square of what the fit cannot follow, and its product with the residual."""
        left = self._left(change[:, None])
        return float(np.sum(np.square(left))), float(left[:, 0] @ self._residuals)

    def gain(self, directions: Array) -> float:
        """By how much χ² falls where the fit may move along (r, q) directions, too."""
        left = self._left(directions)
        powers, axes = np.linalg.eigh(gram(left, left))
        kept = (powers > MOVES_NOTHING**2) & (powers > DEPENDENT * powers[-1])
        pulls = axes[:, kept].T @ gram(left, self._residuals)
        return float(np.sum(np.square(pulls) / powers[kept]))

    def _left(self, directions: Array) -> Array:
        directions = self._problem.without_errors(directions)
        padded = np.vstack([directions, np.zeros((len(self._fitted) - self._samples, directions.shape[1]))])
        return np.asarray(padded - self._fitted @ (self._fitted.T @ padded))
