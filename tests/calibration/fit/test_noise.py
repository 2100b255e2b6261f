"""How much a sighting counts."""

from __future__ import annotations

import numpy as np
import pytest
from numpy.typing import NDArray

from sunarc.calibration.fit.noise import inflation, lag_one, neighbours
from sunarc.calibration.robust_loss import INFORMATION_PER_WEIGHT, robust_sigma, tukey_loss, tukey_weights


def _correlated(n: int, rho: float) -> NDArray[np.float64]:
    drawn = np.random.default_rng(5).standard_normal((n, 2))
    for i in range(1, n):
        drawn[i] = rho * drawn[i - 1] + np.sqrt(1.0 - rho**2) * drawn[i]
    return drawn


@pytest.mark.parametrize("share", [0.0, 0.2, 0.45])
def test_core_scale_is_found_among_outliers(share: float) -> None:
    rng = np.random.default_rng(2)
    points = rng.normal(0.0, 0.4, (4000, 2))
    points[rng.random(4000) < share] += [9.0, 3.0]
    assert robust_sigma(np.linalg.norm(points, axis=-1)) == pytest.approx(0.4, rel=0.05)


def test_weights_are_the_loss_s_slope_over_distance() -> None:
    distance = np.linspace(0.1, 7.0, 50)
    slope = (tukey_loss(distance + 1e-6, sigma=1.2) - tukey_loss(distance - 1e-6, sigma=1.2)) / 2e-6
    np.testing.assert_allclose(slope / distance, tukey_weights(distance, sigma=1.2) / 1.2**2, atol=1e-6)


def test_information_per_weight_equals_the_scatter_of_the_estimate() -> None:
    rng = np.random.default_rng(8)
    points = rng.standard_normal((4000, 60, 2))
    means = np.zeros((4000, 2))
    for _ in range(12):
        weight = tukey_weights(np.linalg.norm(points - means[:, None], axis=-1), sigma=1.0)
        means = np.sum(weight[..., None] * points, axis=1) / weight.sum(axis=1)[:, None]
    stated = 1.0 / (INFORMATION_PER_WEIGHT * weight.sum(axis=1).mean())
    assert np.mean(means**2) == pytest.approx(stated, rel=0.05)


@pytest.mark.parametrize("rho", [0.0, 0.5, 0.9])
def test_lag_one_correlation_is_read_back(rho: float) -> None:
    times = 30.0 * np.arange(4000.0)
    follows = neighbours(times, np.zeros(4000, dtype=np.int64))
    found, _ = lag_one(_correlated(4000, rho), np.ones(4000), follows)
    assert found == pytest.approx(rho, abs=0.03)


def test_white_noise_is_not_inflated_and_a_bad_day_alone_is() -> None:
    run = np.repeat([0, 1], 1000).astype(np.int64)
    times = 30.0 * np.arange(2000.0)
    noise = np.random.default_rng(6).standard_normal((2000, 2))
    follows = neighbours(times, run)
    np.testing.assert_allclose(inflation(noise, np.ones(2000), follows, run), 1.0, atol=0.15)
    noise[1000:] = _correlated(1000, 0.9)
    mixed = inflation(noise, np.ones(2000), follows, run)
    assert mixed[0] < mixed[-1]
    assert mixed[-1] > 8.0


def test_gaps_are_no_neighbours() -> None:
    follows = neighbours(np.array([0.0, 30.0, 60.0, 300.0, 330.0]), np.array([0, 0, 0, 0, 1]))
    assert follows.tolist() == [True, True, False, False]
