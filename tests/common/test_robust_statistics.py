"""Tukey's biweight and the scale of the inliers, against their definitions and normal samples."""

from __future__ import annotations

import math

import numpy as np
import pytest
from numpy.typing import NDArray
from scipy.integrate import quad
from scipy.stats import rayleigh

from sunarc.common.robust_statistics import CUT, INFORMATION_PER_WEIGHT, robust_sigma, tukey_loss, tukey_weights

FloatArray = NDArray[np.float64]


def _distances(seed: int, *, n: int = 400, sigma: float = 0.3) -> FloatArray:
    return np.asarray(np.linalg.norm(np.random.default_rng(seed).normal(0.0, sigma, (n, 2)), axis=-1))


@pytest.mark.parametrize("sigma", [1.0, 0.3, 2.0])
def test_the_weight_is_psi_over_distance_times_variance(sigma: float) -> None:
    distance = np.linspace(0.05, 1.2 * CUT * sigma, 80)
    step = 1e-6 * sigma
    psi = tukey_loss(distance + step, sigma=sigma) - tukey_loss(distance - step, sigma=sigma)
    expected = psi / (2.0 * step) / distance * sigma**2
    np.testing.assert_allclose(tukey_weights(distance, sigma=sigma), expected, atol=1e-8)


def test_weights_by_hand() -> None:
    # at 0, half the cut, the cut and beyond: (1 - u^2)^2
    weights = tukey_weights(np.array([0.0, 2.5, 5.0, 50.0]), sigma=1.0)
    np.testing.assert_allclose(weights, [1.0, 0.5625, 0.0, 0.0], atol=1e-15)


def test_the_loss_is_half_a_square_near_zero_and_a_constant_beyond_the_cut() -> None:
    near = np.array([0.01, 0.02])
    np.testing.assert_allclose(tukey_loss(near, sigma=2.0), 0.5 * (near / 2.0) ** 2, rtol=1e-5)
    # Beaton and Tukey (1974): c^2 / 6
    np.testing.assert_allclose(tukey_loss(np.array([10.0, 1e9]), sigma=2.0), CUT**2 / 6.0, rtol=1e-14)


def test_the_loss_grows_with_the_distance_up_to_the_cut() -> None:
    loss = tukey_loss(np.linspace(0.0, 5.0, 200), sigma=1.0)
    assert np.all(np.diff(loss) > 0.0)


def test_information_per_weight_is_the_ratio_of_expectations() -> None:
    def weight(r: float) -> float:
        return (1.0 - (r / CUT) ** 2) ** 2

    def expected(function: object) -> float:
        return float(quad(lambda r: function(r) * rayleigh.pdf(r), 0.0, CUT)[0])  # type: ignore[operator]

    # divergence of the vector psi(x) = w(|x|) x in the plane, per axis: w + r w'(r) / 2
    slope = expected(lambda r: weight(r) + 0.5 * r * 2.0 * (1.0 - (r / CUT) ** 2) * (-2.0 * r / CUT**2))
    square = expected(lambda r: 0.5 * (weight(r) * r) ** 2)
    assert pytest.approx(slope**2 / square / expected(weight), rel=1e-4) == INFORMATION_PER_WEIGHT
    assert 1.0 < INFORMATION_PER_WEIGHT < 1.2


def test_the_scale_of_normal_samples_is_unbiased() -> None:
    found = np.array([robust_sigma(_distances(seed)) for seed in range(60)])
    assert 0.985 < found.mean() / 0.3 < 1.015
    # efficiency: least squares has 1 / sqrt(2 n) / sqrt(2) = 2.5 %, and a trimmed scale a little more
    assert 0.02 < found.std() / 0.3 < 0.06


@pytest.mark.parametrize("share", [0.1, 0.3, 0.5])
def test_the_share_that_begins_does_not_change_the_scale(share: float) -> None:
    assert robust_sigma(_distances(1, n=4000), share=share) == pytest.approx(0.3, rel=0.03)


def test_one_round_by_hand() -> None:
    # all distances equal r: within 2.5 sigma the mean square is r^2, corrected for the tail of a round Gaussian
    tail = math.exp(-0.5 * 2.5**2)
    correction = 1.0 - 0.5 * 2.5**2 * tail / (1.0 - tail)
    assert robust_sigma(np.full(50, 2.0)) == pytest.approx(math.sqrt(0.5 * 4.0 / correction), rel=1e-12)


@pytest.mark.parametrize("far", [3.0, 30.0, 3e5])
def test_a_third_of_outliers_changes_the_scale_little(far: float) -> None:
    distance = np.concatenate([_distances(4, n=4000), np.full(2000, far)])
    assert robust_sigma(distance) == pytest.approx(0.3, rel=0.03)


def test_the_floor_is_the_smallest_answer() -> None:
    assert robust_sigma(np.zeros(0)) == 1e-9
    assert robust_sigma(np.zeros(0), floor=0.25) == 0.25
    assert robust_sigma(np.zeros(9), floor=0.25) == 0.25
    assert robust_sigma(_distances(1), floor=7.0) == 7.0


def test_the_scale_is_of_the_unit_of_the_distances() -> None:
    distance = _distances(8)
    assert robust_sigma(1000.0 * distance) == pytest.approx(1000.0 * robust_sigma(distance), rel=1e-9)


@pytest.mark.parametrize("share", [0.0, 0.2, 0.45])
def test_core_scale_is_found_among_outliers(share: float) -> None:
    rng = np.random.default_rng(2)
    points = rng.normal(0.0, 0.4, (4000, 2))
    points[rng.random(4000) < share] += [9.0, 3.0]
    assert robust_sigma(np.linalg.norm(points, axis=-1)) == pytest.approx(0.4, rel=0.05)


def test_information_per_weight_equals_the_scatter_of_the_estimate() -> None:
    rng = np.random.default_rng(8)
    points = rng.standard_normal((4000, 60, 2))
    means = np.zeros((4000, 2))
    for _ in range(12):
        weight = tukey_weights(np.linalg.norm(points - means[:, None], axis=-1), sigma=1.0)
        means = np.sum(weight[..., None] * points, axis=1) / weight.sum(axis=1)[:, None]
    stated = 1.0 / (INFORMATION_PER_WEIGHT * weight.sum(axis=1).mean())
    assert np.mean(means**2) == pytest.approx(stated, rel=0.05)


@pytest.mark.parametrize("size", [1, 2, 3, 7, 1000])
@pytest.mark.parametrize("share", [0.1, 0.3, 0.999])
def test_the_scale_begins_at_numpys_quantile(size: int, share: float) -> None:
    values = np.random.default_rng(size).exponential(size=size)
    values[: size // 3] = math.inf
    # far beyond all distances the floor is the answer, but for the quantile over the cut
    assert robust_sigma(values, share=0.1, floor=1e-9) >= np.quantile(values, 0.1) / 2.5 * (1.0 - 1e-12)
    finite = np.sort(values[size // 3 :])
    nearest = float(np.quantile(finite, share))
    expected = max(nearest / math.sqrt(-2.0 * math.log1p(-share)), nearest / 2.5)
    for _ in range(60):
        kept, before = finite[finite < 2.5 * expected], expected
        if kept.size == 0:
            break
        tail = math.exp(-0.5 * 2.5**2)
        correction = 1.0 - 0.5 * 2.5**2 * tail / (1.0 - tail)
        expected = max(math.sqrt(0.5 * float(np.mean(kept**2)) / correction), nearest / 2.5)
        if abs(expected - before) < 1e-4 * before:
            break
    assert robust_sigma(finite, share=share) == pytest.approx(expected, rel=1e-12)
