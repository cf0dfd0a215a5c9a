"""The square root of a covariance: steps of one standard deviation along its principal axes."""

from __future__ import annotations

from typing import Final

import numpy as np
from numpy.typing import NDArray

Array = NDArray[np.float64]

ROUNDING: Final = 1e-12
"""Eigenvalues of a covariance with a unit diagonal, below this share of the largest: rounding, and no axes."""


def covariance_root(covariance: Array) -> Array:
    """(k, r) S with S Sᵀ = C, one column for each principal axis, the narrowest first.

    Values differ by ten orders of magnitude; scaled by their standard deviations they compare. What is not known at
    all (infinite) or exactly (0) is 0 in all columns.
    """
    known = np.isfinite(np.diag(covariance))
    kept = np.where(np.outer(known, known), covariance, 0.0)
    sigmas = np.sqrt(np.maximum(np.diag(kept), 0.0))
    scale = np.where(sigmas > 0.0, sigmas, 1.0)
    sizes, directions = np.linalg.eigh(kept / np.outer(scale, scale))
    axes = sizes > ROUNDING * max(float(sizes[-1]), 0.0) if len(sizes) else np.zeros(0, dtype=bool)
    return np.asarray(scale[:, None] * directions[:, axes] * np.sqrt(sizes[axes]))
