"""Cholesky's factorisation of the compiled loops, by numpy's."""

from __future__ import annotations

import math

import numpy as np
import pytest

from sunarc.compiled_math import cholesky_factor, cholesky_solve, forward_substitution


def _positive(size: int) -> np.ndarray[tuple[int, int], np.dtype[np.float64]]:
    drawn = np.random.default_rng(size).standard_normal((size, size + 3))
    return np.asarray(drawn @ drawn.T)


@pytest.mark.parametrize("size", [1, 2, 5, 20])
def test_the_factor_and_the_determinant_are_numpys(size: int) -> None:
    matrix = _positive(size)
    work = matrix.copy()
    determinant = cholesky_factor(work, size, size)
    assert np.tril(work) == pytest.approx(np.linalg.cholesky(matrix), rel=1e-9, abs=1e-9)
    assert determinant == pytest.approx(np.linalg.slogdet(matrix)[1], rel=1e-12, abs=1e-10)


def test_further_rows_are_multiplied_by_the_inverse_of_the_factor() -> None:
    matrix = _positive(4)
    work = np.vstack([matrix, np.arange(8.0).reshape(2, 4)])
    cholesky_factor(work, 4, 6)
    assert work[4:] @ np.linalg.cholesky(matrix).T == pytest.approx(np.arange(8.0).reshape(2, 4), abs=1e-12)


def test_the_square_of_half_a_solution_is_the_quadratic_form() -> None:
    matrix, vector = _positive(6), np.arange(1.0, 7.0)
    work, half = matrix.copy(), vector.copy()
    cholesky_factor(work, 6, 6)
    assert forward_substitution(work, half, 6) == pytest.approx(vector @ np.linalg.solve(matrix, vector), rel=1e-10)


@pytest.mark.parametrize("size", [1, 3, 20])
def test_a_solution_is_numpys(size: int) -> None:
    matrix, vector = _positive(size), np.arange(1.0, size + 1.0)
    work, found = matrix.copy(), vector.copy()
    assert cholesky_solve(work, found)
    assert found == pytest.approx(np.linalg.solve(matrix, vector), rel=1e-8)


@pytest.mark.parametrize("matrix", [[[1.0, 2.0], [2.0, 1.0]], [[0.0, 0.0], [0.0, 0.0]], [[math.nan, 0.0], [0.0, 1.0]]])
def test_a_matrix_that_is_not_positive_is_refused(matrix: list[list[float]]) -> None:
    assert math.isnan(cholesky_factor(np.array(matrix), 2, 2))
    assert not cholesky_solve(np.array(matrix), np.ones(2))
