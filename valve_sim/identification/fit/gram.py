"""Gram matrices of tall matrices: many samples, few parameters.

NumPy's BLAS runs a product of twenty thousand rows in several threads, which wait for each other for longer than they
work. Products of this size are therefore computed in blocks, each too small for BLAS to start threads.
"""

from __future__ import annotations

import math
from typing import Final

import numpy as np

from valve_sim.identification.plants.protocol import Array

ROWS: Final = 128
"""Rows of a block. OpenBLAS keeps a product of up to 2¹⁸ multiplications in one thread: 45 columns by 45."""


def gram(left: Array, right: Array) -> Array:
    """leftᵀ right.

    Args:
        left: (n, k). right: (n, m), or (n,).

    Returns:
        (k, m), or (k,). What is too large to be squared is infinite or no number, which is for the caller to refuse.
    """
    if right.ndim == 1:
        return np.asarray(gram(left, right[:, None])[:, 0])
    count = len(left) // ROWS
    whole = count * ROWS
    blocks = left[:whole].reshape(count, ROWS, left.shape[1]).transpose(0, 2, 1)
    with np.errstate(over="ignore", invalid="ignore"):
        product = np.matmul(blocks, right[:whole].reshape(count, ROWS, right.shape[1])).sum(axis=0)
        return np.asarray(product + left[whole:].T @ right[whole:])


def sum_squares(values: Array) -> float:
    """Sum of squares of (n,) values; infinite where they are too large to be squared."""
    with np.errstate(over="ignore"):
        return float(np.sum(np.square(values)))


def root_mean_square(values: Array) -> float:
    """√(mean of squares), in the unit of the values; nan where there are none."""
    return math.sqrt(float(np.mean(np.square(values)))) if len(values) else math.nan
