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

ORTHOGONAL: Final = 1e-12
"""Largest product of two columns of a basis that is orthonormal."""

ROUNDING: Final = 1e-15
"""Share of an information that rounding leaves."""


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


def orthonormal(columns: Array) -> Array:
    """(n, k) an orthonormal basis of the span of (n, k) columns of about unit length.

    By Cholesky factors of their Gram matrix, twice, the second to orthogonality by 16 digits (CholeskyQR2; Yamamoto,
    Nakatsukasa, Yanagisawa and Fukaya, Electron. Trans. Numer. Anal. 44, 2015, p. 306), which needs no threads either;
    by Householder's reflections where the columns depend on each other.
    """
    basis = columns
    try:
        for _ in range(2):
            factor = np.linalg.cholesky(gram(basis, basis))
            basis = _times(basis, np.linalg.inv(factor).T)
    except np.linalg.LinAlgError:
        return np.asarray(np.linalg.qr(columns)[0])
    error = float(np.max(np.abs(gram(basis, basis) - np.eye(basis.shape[1])), initial=0.0))
    return basis if error < ORTHOGONAL else np.asarray(np.linalg.qr(columns)[0])


def _times(tall: Array, square: Array) -> Array:
    """Tall square, (n, k) and (k, k), in blocks."""
    product = np.empty_like(tall)
    for start in range(0, len(tall), ROWS):
        product[start : start + ROWS] = tall[start : start + ROWS] @ square
    return product


def sum_squares(values: Array) -> float:
    """Sum of squares of (n,) values; infinite where they are too large to be squared."""
    with np.errstate(over="ignore"):
        return float(np.sum(np.square(values)))


def root_mean_square(values: Array) -> float:
    """√(mean of squares), in the unit of the values; nan where there are none."""
    return math.sqrt(float(np.mean(np.square(values)))) if len(values) else math.nan


def information_less(whole: Array, part: Array) -> Array:
    """(k, k) information without a part of it, (k, k); along no direction less than rounding leaves of the whole."""
    scale = np.sqrt(np.maximum(np.diag(whole), np.finfo(float).tiny))
    left = (whole - part) / np.outer(scale, scale)
    # Where a part is more than the whole, both are rounding, which must not be divided by next to nothing.
    is_rounding = np.diag(part) > 2.0 * np.diag(whole)
    left[is_rounding] = left[:, is_rounding] = 0.0
    values, vectors = np.linalg.eigh(0.5 * (left + left.T))
    return np.asarray((vectors * np.maximum(values, ROUNDING)) @ vectors.T * np.outer(scale, scale))
