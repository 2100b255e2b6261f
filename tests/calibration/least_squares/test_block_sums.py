"""The sums over blocks of sightings against those of arrays of rows."""

from __future__ import annotations

from collections.abc import Iterator

import numpy as np
import pytest
from numpy.typing import NDArray

from sunarc.calibration.robust_loss import UNSEEN_PX, tukey_loss, tukey_weights
from sunarc.calibration.solve.row_kernels import add_products, block_size, reach_of, weigh
from sunarc.optics.kernels import BLOCK, N_COLUMNS, PIXEL_X, PIXEL_Y, RESIDUAL, WORK

FloatArray = NDArray[np.float64]

SIZE, BEGIN = BLOCK - 5, 3


@pytest.fixture
def work() -> FloatArray:
    rng = np.random.default_rng(6)
    filled = rng.standard_normal(WORK)
    filled[PIXEL_X + 2] = filled[PIXEL_Y + 2] = np.nan  # as where the lens shows nothing
    return filled


def _columns(work: FloatArray) -> FloatArray:
    return work[: N_COLUMNS * 2 * BLOCK].reshape(N_COLUMNS, 2, BLOCK)


def _sightings() -> tuple[FloatArray, FloatArray]:
    rng = np.random.default_rng(7)
    pixels, information = rng.normal(0.0, 2.0, (BEGIN + SIZE, 2)), rng.uniform(0.5, 2.0, BEGIN + SIZE)
    pixels[BEGIN + 1] += 50.0  # beyond the cut
    return pixels, information


def _residuals(work: FloatArray, pixels: FloatArray) -> FloatArray:
    modelled = np.stack([work[PIXEL_X : PIXEL_X + SIZE], work[PIXEL_Y : PIXEL_Y + SIZE]], axis=-1)
    residual = pixels[BEGIN:] - modelled
    return np.where(np.isfinite(residual), residual, UNSEEN_PX)


@pytest.mark.parametrize("sigma", [0.0, 0.8])
def test_columns_and_residuals_are_weighed_as_by_the_loss(work: FloatArray, sigma: float) -> None:
    pixels, information = _sightings()
    residual, before = _residuals(work, pixels), _columns(work).copy()
    distance = np.hypot(*residual.T) * np.sqrt(information[BEGIN:])
    loss = weigh(work, pixels, information, BEGIN, SIZE, sigma)
    if sigma > 0.0:
        expected, weight = tukey_loss(distance, sigma=sigma), tukey_weights(distance, sigma=sigma) / sigma**2
        assert weight[1] == 0.0
    else:
        expected, weight = 0.5 * distance**2, np.ones(SIZE)
    assert loss == pytest.approx(np.sum(expected), rel=1e-12)
    weight = weight * information[BEGIN:]
    weight[2] = 0.0
    before[RESIDUAL, :, :SIZE] = residual.T
    np.testing.assert_allclose(_columns(work)[..., :SIZE], np.sqrt(weight) * before[..., :SIZE], atol=1e-12)
    np.testing.assert_array_equal(_columns(work)[..., SIZE:], 0.0)


def test_products_are_added_to_the_lower_half(work: FloatArray) -> None:
    products, count = np.ones((RESIDUAL + 2, RESIDUAL + 2)), RESIDUAL + 2
    flat = _columns(work)[:count].reshape(count, -1)
    add_products(work, products)
    lower = np.tril_indices(count)
    np.testing.assert_allclose(products[lower], 1.0 + (flat @ flat.T)[lower], rtol=1e-11, atol=1e-11)


def _blocks(epoch: NDArray[np.int64]) -> Iterator[tuple[int, int]]:
    begin = 0
    while begin < epoch.size:
        size = block_size(epoch, begin)
        yield begin, size
        begin += size


def test_blocks_are_of_one_pose_and_hold_every_sighting_once() -> None:
    epoch = np.concatenate(
        [np.zeros(BLOCK + 9, dtype=np.int64), np.ones(4, dtype=np.int64), np.zeros(1, dtype=np.int64)]
    )
    assert list(_blocks(epoch)) == [(0, BLOCK), (BLOCK, 9), (BLOCK + 9, 4), (BLOCK + 13, 1)]


def test_the_reach_of_a_row_is_what_of_it_is_not_0() -> None:
    basis = np.array([[0.0, 2.0, 0.0, 3.0], [0.0] * 4, [1.0, 0.0, 0.0, 0.0]])
    reach = reach_of(basis)
    assert [basis[i, a:b].tolist() for i, (a, b) in enumerate(reach)] == [[2.0, 0.0, 3.0], [], [1.0]]
