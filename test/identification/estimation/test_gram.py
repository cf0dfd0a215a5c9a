"""Products of tall matrices, made in blocks."""

from __future__ import annotations

import numpy as np
import pytest

from valve_sim.identification.estimation.gram import ROWS, gram, orthonormal, sum_squares


@pytest.mark.parametrize("rows", [0, 1, ROWS - 1, ROWS, 5 * ROWS, 5 * ROWS + 7])
@pytest.mark.parametrize("columns", [0, 1, 19])
def test_it_is_the_product(rows: int, columns: int) -> None:
    random = np.random.default_rng(rows)
    left, right = random.standard_normal((rows, columns)), random.standard_normal((rows, 4))
    np.testing.assert_allclose(gram(left, right), left.T @ right, atol=1e-12)
    np.testing.assert_allclose(gram(left, right[:, 0]), left.T @ right[:, 0], atol=1e-12)
    assert sum_squares(right[:, 0]) == pytest.approx(float(right[:, 0] @ right[:, 0]), abs=1e-12)


@pytest.mark.parametrize("apart", [1.0, 1e-3, 1e-7, 0.0])
def test_a_basis_is_orthonormal_and_spans_the_same(apart: float) -> None:
    """Columns that nearly depend on each other, or do, too."""
    columns = np.random.default_rng(2).standard_normal((3 * ROWS + 5, 4))
    columns[:, 3] = columns[:, 0] + apart * columns[:, 3]
    columns /= np.linalg.norm(columns, axis=0)
    basis = orthonormal(columns)
    np.testing.assert_allclose(basis.T @ basis, np.eye(4), atol=1e-12)
    np.testing.assert_allclose(basis @ (basis.T @ columns), columns, atol=1e-12)
