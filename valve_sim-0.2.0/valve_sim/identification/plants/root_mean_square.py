"""The size of errors, for all rooms."""

from __future__ import annotations

import math

import numpy as np
from numpy.typing import NDArray


def root_mean_square(values: NDArray[np.float64]) -> float:
    """√(mean of squares), in the unit of the values; nan where there are none."""
    return math.sqrt(float(np.mean(np.square(values)))) if len(values) else math.nan
