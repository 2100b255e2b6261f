"""The compiled loops over choices of scales against numpy."""

from __future__ import annotations

import numpy as np
import pytest
from tests.fixtures.calibration import random_covariance

from sunarc.calibration.fit.kernels import add_moments, exponential, write_inverses
from sunarc.calibration.fit.marginal_likelihood import RIDGE, general_inverses


@pytest.mark.parametrize("size", [1, 2, 9, 23])
def test_inverses_are_those_of_numpy(size: int) -> None:
    matrix = random_covariance(size, seed=3) * np.outer(np.geomspace(1.0, 1e6, size), np.geomspace(1.0, 1e6, size))
    diagonal = np.random.default_rng(4).uniform(0.0, 5.0, (4, size))
    found = np.empty((4, size, size))
    assert write_inverses(matrix, diagonal, RIDGE, found)
    for k in range(4):
        np.testing.assert_allclose(found[k] @ (matrix + np.diag(diagonal[k])), np.eye(size), atol=1e-6)
    expected = general_inverses(matrix, diagonal)
    scale = np.sqrt(np.diagonal(expected, axis1=-2, axis2=-1))
    np.testing.assert_allclose(
        found / scale[:, None] / scale[..., None], expected / scale[:, None] / scale[..., None], atol=1e-9
    )
    np.testing.assert_array_equal(found, np.swapaxes(found, -1, -2))


def test_a_matrix_that_is_not_positive_is_left_to_the_general_inverse() -> None:
    negative = np.array([[1.0, 3.0], [3.0, 1.0]])
    assert not write_inverses(negative, np.zeros((1, 2)), RIDGE, np.empty((1, 2, 2)))
    np.testing.assert_allclose(general_inverses(negative, np.zeros((1, 2)))[0] @ negative, np.eye(2), atol=1e-9)


def test_moments_are_products_from_both_sides_at_each_place_and_choice() -> None:
    rng = np.random.default_rng(8)
    left, right = rng.standard_normal((2, 5, 2, 4))
    covariance = np.stack([random_covariance(4, seed=s) for s in range(3)])
    found = np.ones((3, 3, 5))
    by_columns = (np.ascontiguousarray(side.transpose(2, 1, 0)).reshape(4, 10) for side in (left, right))
    add_moments(*by_columns, covariance, found)
    for k in range(3):
        for n in range(5):
            product = left[n] @ covariance[k] @ right[n].T
            expected = 0.5 * (product + product.T)[[0, 0, 1], [0, 1, 1]]
            np.testing.assert_allclose(found[k, :, n], 1.0 + expected, rtol=1e-12, atol=1e-12)


def test_the_exponential_is_that_of_the_library() -> None:
    x = np.linspace(0.0, 40.0, 997)
    np.testing.assert_allclose([exponential(float(one)) for one in x], np.exp(-x), rtol=1e-10, atol=1e-17)
