"""The evidence's determinants and squares, against dense linear algebra."""

from __future__ import annotations

import math

import numpy as np
import pytest
from numpy.typing import NDArray
from tests.fixtures.calibration import random_covariance

from sunarc.calibration.fit.kernels import evidence_terms
from sunarc.compiled_math import cholesky_factor

FloatArray = NDArray[np.float64]


@pytest.mark.parametrize("first", [0, 3, 7])
def test_terms_are_those_of_dense_matrices(first: int) -> None:
    rng = np.random.default_rng(first)
    units = 10.0 ** rng.uniform(-3.0, 3.0, 11)
    matrices = np.stack([random_covariance(11, seed=s) * np.outer(units, units) for s in (1, 2)])
    vectors, at = rng.standard_normal((2, 11)) * units, rng.standard_normal(11) / units
    fixed = rng.uniform(0.1, 2.0, 11) * units**2
    varied = rng.uniform(0.1, 5.0, (3, 4)) * units[first : first + 4] ** 2
    found = np.empty((2, 3))
    evidence_terms(matrices, vectors, at, fixed, varied, first, 0.0, found)
    for n in range(2):
        for k in range(3):
            precision = fixed.copy()
            precision[first : first + 4] = varied[k]
            whole = matrices[n] + np.diag(precision)
            pull = vectors[n] - precision * at
            expected = pull @ np.linalg.solve(whole, pull) - np.linalg.slogdet(whole)[1]
            assert found[n, k] == pytest.approx(expected, rel=1e-9)


def test_choices_that_share_their_first_precisions_and_one_that_is_not_positive() -> None:
    rng = np.random.default_rng(8)
    matrix, vector, at = random_covariance(7, seed=6), rng.standard_normal(7), rng.standard_normal(7)
    fixed = np.full(7, 0.5)
    varied = np.array([[1.0, 2.0, 3.0], [1.0, 2.0, 5.0], [1.0, 2.0, -99.0], [1.0, 2.0, 7.0], [4.0, 2.0, 7.0]])
    found = np.empty((1, 5))
    evidence_terms(matrix[None], vector[None], at, fixed, varied, 2, 0.0, found)
    assert math.isnan(found[0, 2])
    for k in (0, 1, 3, 4):
        precision = np.r_[fixed[:2], varied[k], fixed[5:]]
        whole, pull = matrix + np.diag(precision), vector - precision * at
        expected = pull @ np.linalg.solve(whole, pull) - np.linalg.slogdet(whole)[1]
        assert found[0, k] == pytest.approx(expected, rel=1e-9)


def test_a_ridge_is_a_share_of_the_diagonal() -> None:
    matrix, vector = random_covariance(5, seed=3), np.ones(5)
    found, expected = np.empty((1, 1)), np.empty((1, 1))
    nothing = np.zeros(5)
    evidence_terms(matrix[None], vector[None], nothing, nothing, np.zeros((1, 2)), 1, 0.1, found)
    raised = matrix + 0.1 * np.diag(np.diag(matrix))
    evidence_terms(raised[None], vector[None], nothing, nothing, np.zeros((1, 2)), 1, 0.0, expected)
    assert found[0, 0] == pytest.approx(expected[0, 0])


def test_a_factor_gives_back_the_matrix_and_solves_further_rows() -> None:
    matrix = random_covariance(6, seed=5)
    work = matrix.copy()
    determinant = cholesky_factor(work, 4, 6)
    lower = np.tril(work[:4, :4])
    np.testing.assert_allclose(lower @ lower.T, matrix[:4, :4])
    np.testing.assert_allclose(work[4:, :4] @ lower.T, matrix[4:, :4])
    assert determinant == pytest.approx(np.linalg.slogdet(matrix[:4, :4])[1])


def test_a_matrix_that_is_not_positive_has_no_determinant() -> None:
    assert math.isnan(cholesky_factor(np.array([[1.0, 0.0], [2.0, 1.0]]), 2, 2))
