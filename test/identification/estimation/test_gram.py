"""Products of tall matrices, made in blocks."""

from __future__ import annotations

import numpy as np
import pytest

from valve_sim.identification.estimation.gram import ROWS, gram, information_less, orthonormal, sum_squares


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


def test_information_less_nearly_all_of_it_can_be_solved_with_whatever_the_units() -> None:
    random = np.random.default_rng(6)
    columns = random.standard_normal((60, 3)) * np.array([3e9, 1.0, 1e-5])
    left = information_less(gram(columns, columns), gram(columns[:60], columns[:60]))
    unit = np.sqrt(np.diag(gram(columns, columns)))
    scaled = left / np.outer(unit, unit)
    assert np.linalg.eigvalsh(scaled).min() > 0.0
    assert scaled == pytest.approx(np.zeros((3, 3)), abs=1e-14)


def test_information_less_a_part_is_what_the_rest_says() -> None:
    columns = np.random.default_rng(7).standard_normal((60, 3)) * np.array([1e6, 1.0, 1e-3])
    left = information_less(gram(columns, columns), gram(columns[:40], columns[:40]))
    assert left == pytest.approx(gram(columns[40:], columns[40:]), rel=1e-9)
