"""The autocorrelation of residuals and its factor on the variance of a mean, against AR(1) series and by hand.

And the noise by the sun's height, against draws whose noise is known.
"""

from __future__ import annotations

import numpy as np
import pytest
from numpy.typing import NDArray
from scipy.signal import lfilter

from sunarc.calibration.noise import autocorrelation_inflation, growth_rate, lag_one, neighbours

FloatArray = NDArray[np.float64]


def _ar1(n: int, rho: float, *, seed: int) -> FloatArray:
    drawn = np.random.default_rng(seed).standard_normal((n, 2)) * np.sqrt(1.0 - rho**2)
    return np.asarray(lfilter([1.0], [1.0, -rho], drawn, axis=0))


def _run(n: int) -> NDArray[np.int64]:
    return np.zeros(n, dtype=np.int64)


def test_neighbours_by_hand() -> None:
    times = np.array([0.0, 10.0, 20.0, 35.0, 52.0, 62.0])
    # the usual step is 10 s: 15 s follows, 17 s does not
    assert neighbours(times, _run(6)).tolist() == [True, True, True, False, True]
    assert neighbours(times, np.array([0, 0, 1, 1, 1, 1])).tolist()[1] is False


@pytest.mark.parametrize("n", [0, 1])
def test_fewer_than_two_sightings_have_no_neighbours(n: int) -> None:
    assert neighbours(np.zeros(n), _run(n)).size == 0


def test_two_sightings_of_a_run_are_neighbours() -> None:
    assert neighbours(np.array([0.0, 10.0]), _run(2)).tolist() == [True]


def test_runs_of_one_sighting_have_no_neighbours() -> None:
    assert neighbours(np.array([0.0, 1.0, 2.0]), np.array([0, 1, 2])).tolist() == [False, False]


def test_lag_one_by_hand() -> None:
    residual = np.array([[1.0, 0.0], [2.0, 0.0], [4.0, 0.0]] * 6)[:17]
    follows = np.ones(16, dtype=bool)
    first, second = residual[:-1], residual[1:]
    expected = np.sum(first * second) / (0.5 * (np.sum(first**2) + np.sum(second**2)))
    rho, error = lag_one(residual, np.ones(17, dtype=bool), follows)
    assert rho == pytest.approx(expected)
    assert error == pytest.approx(np.sqrt((1.0 - expected**2) / 32.0))


def test_fewer_than_fifteen_pairs_tell_nothing() -> None:
    follows = np.ones(14, dtype=bool)
    assert lag_one(np.ones((15, 2)), np.ones(15, dtype=bool), follows) == (0.0, 1.0)
    assert lag_one(np.ones((16, 2)), np.ones(16, dtype=bool), np.ones(15, dtype=bool))[0] == pytest.approx(1.0)


def test_sightings_without_weight_make_no_pair() -> None:
    residual, weight = _ar1(400, 0.8, seed=1), np.ones(400)
    residual[::7], weight[::7] = 1e3, 0.0
    rho, _ = lag_one(residual, weight > 0.0, np.ones(399, dtype=bool))
    assert rho == pytest.approx(0.8, abs=0.1)


def test_residuals_of_nothing_have_no_correlation() -> None:
    assert lag_one(np.zeros((60, 2)), np.ones(60, dtype=bool), np.ones(59, dtype=bool))[0] == 0.0


@pytest.mark.parametrize("rho", [-0.5, 0.0, 0.3, 0.7, 0.95])
def test_the_correlation_is_unbiased_and_its_error_covers(rho: float) -> None:
    follows = np.ones(799, dtype=bool)
    found = np.array([lag_one(_ar1(800, rho, seed=s), np.ones(800, dtype=bool), follows) for s in range(40)])
    assert np.mean(found[:, 0]) == pytest.approx(rho, abs=0.02)
    inside = np.abs(found[:, 0] - rho) < 2.0 * found[:, 1]
    assert 0.85 < inside.mean() <= 1.0
    # two axes, each with the error of a correlation (Bartlett): sqrt((1 - rho^2) / 2n)
    assert 0.7 < np.std(found[:, 0]) / np.mean(found[:, 1]) < 1.4


@pytest.mark.parametrize("rho", [0.5, 0.8])
def test_the_inflation_is_that_of_the_variance_of_a_mean(rho: float) -> None:
    means = [_ar1(500, rho, seed=s).mean(axis=0) for s in range(200)]
    follows = np.ones(499, dtype=bool)
    found = np.mean(
        [
            autocorrelation_inflation(_ar1(500, rho, seed=s), np.ones(500, dtype=bool), follows, _run(500))[0]
            for s in range(20)
        ]
    )
    assert found == pytest.approx((1.0 + rho) / (1.0 - rho), rel=0.1)
    assert np.mean(np.square(means)) * 500.0 == pytest.approx(found, rel=0.2)


def test_white_noise_is_not_inflated() -> None:
    follows = np.ones(999, dtype=bool)
    found = [
        autocorrelation_inflation(_ar1(1000, 0.0, seed=s), np.ones(1000, dtype=bool), follows, _run(1000))[0]
        for s in range(20)
    ]
    assert np.min(found) == 1.0
    assert np.mean(found) < 1.05


def test_negative_correlation_does_not_deflate() -> None:
    follows = np.ones(999, dtype=bool)
    np.testing.assert_array_equal(
        autocorrelation_inflation(_ar1(1000, -0.6, seed=3), np.ones(1000, dtype=bool), follows, _run(1000)), 1.0
    )


def test_the_inflation_is_bounded() -> None:
    same = np.ones((100, 2))
    found = autocorrelation_inflation(same, np.ones(100, dtype=bool), np.ones(99, dtype=bool), _run(100))
    np.testing.assert_allclose(found, 1.995 / 0.005)


def test_a_short_run_has_the_correlation_of_all() -> None:
    run = np.r_[np.zeros(1000, dtype=np.int64), np.ones(10, dtype=np.int64)]
    residual = _ar1(1010, 0.8, seed=4)
    times = 30.0 * np.arange(1010.0)
    found = autocorrelation_inflation(residual, np.ones(1010, dtype=bool), neighbours(times, run), run)
    assert found[0] == pytest.approx(9.0, rel=0.25)
    assert found[-1] == pytest.approx(found[0], rel=0.1)


def test_runs_keep_their_own_correlation_where_it_is_well_known() -> None:
    run = np.repeat([0, 1], 3000).astype(np.int64)
    residual = np.concatenate([_ar1(3000, 0.2, seed=5), _ar1(3000, 0.8, seed=6)])
    found = autocorrelation_inflation(residual, np.ones(6000, dtype=bool), neighbours(np.arange(6000.0), run), run)
    assert found[0] == pytest.approx(1.2 / 0.8, rel=0.2)
    assert found[-1] == pytest.approx(9.0, rel=0.2)


def test_white_noise_is_not_inflated_and_a_bad_day_alone_is() -> None:
    run = np.repeat([0, 1], 1000).astype(np.int64)
    times = 30.0 * np.arange(2000.0)
    noise = np.random.default_rng(6).standard_normal((2000, 2))
    follows = neighbours(times, run)
    np.testing.assert_allclose(
        autocorrelation_inflation(noise, np.ones(2000, dtype=bool), follows, run), 1.0, atol=0.15
    )
    noise[1000:] = _ar1(1000, 0.9, seed=5)
    mixed = autocorrelation_inflation(noise, np.ones(2000, dtype=bool), follows, run)
    assert mixed[0] < mixed[-1]
    assert mixed[-1] > 8.0


ZENITH = np.abs(np.linspace(-1.5, 1.5, 1600)) + 0.05
"""Of a day, rad."""


def _distances(rate: float, *, seed: int, rho: float = 0.0) -> FloatArray:
    error = _ar1(ZENITH.size, rho, seed=seed) * np.exp(rate * ZENITH)[:, None]
    return np.asarray(np.hypot(error[:, 0], error[:, 1]))


@pytest.mark.parametrize("rate", [-0.6, 0.4, 1.1])
def test_the_growth_is_that_of_the_draws(rate: float) -> None:
    found = np.array([growth_rate(_distances(rate, seed=seed), ZENITH, 0.0) for seed in range(40)])
    scatter = 0.5 * np.pi / np.sqrt(6.0) / np.sqrt(np.sum((ZENITH - ZENITH.mean()) ** 2))
    assert found.mean() == pytest.approx(rate, abs=3.0 * scatter / np.sqrt(40.0))
    assert 0.7 * scatter < found.std() < 1.4 * scatter


def _found_to_grow(rho: float, *, rate: float = 0.0) -> float:
    """Return the share of draws in which a growth is found."""
    return float(np.mean([growth_rate(_distances(rate, seed=s, rho=rho), ZENITH, rho) != 0.0 for s in range(400)]))


@pytest.mark.parametrize("rho", [0.0, 0.9])
def test_even_noise_is_hardly_ever_found_to_grow(rho: float) -> None:
    assert _found_to_grow(rho) <= 0.01


def test_a_growth_of_three_standard_errors_is_found_in_every_second_draw() -> None:
    three = 1.5 * np.pi / np.sqrt(6.0) / np.sqrt(np.sum((ZENITH - ZENITH.mean()) ** 2))
    assert 0.4 < _found_to_grow(0.0, rate=three) < 0.6


def test_the_growth_is_bounded_and_needs_thirty_sightings() -> None:
    steepest = np.log(10.0) / (0.5 * np.pi)
    assert growth_rate(np.exp(4.0 * ZENITH), ZENITH, 0.0) == pytest.approx(steepest)
    assert growth_rate(np.exp(-4.0 * ZENITH), ZENITH, 0.0) == pytest.approx(-steepest)
    assert growth_rate(np.exp(ZENITH[:29]), ZENITH[:29], 0.0) == 0.0
    assert growth_rate(np.zeros(40), ZENITH[:40], 0.0) == 0.0
    assert growth_rate(np.ones(40), np.ones(40), 0.0) == 0.0
    assert growth_rate(np.zeros(0), np.zeros(0), 0.0) == 0.0


def test_the_inflation_and_the_growth_are_those_of_their_formulas() -> None:
    for seed, strength in ((1, 0.6), (2, 0.25), (3, 0.05), (4, 0.9)):
        run = np.repeat([0, 1, 2, 3], [60, 14, 200, 40])
        residual = _ar1(314, strength, seed=seed) * (1.0 + 0.3 * (run == 3))[:, None]
        follows, counted = np.diff(run) == 0, np.random.default_rng(seed).random(314) > 0.1

        def correlation(
            rows: NDArray[np.intp], residual: FloatArray = residual, counted: NDArray[np.bool_] = counted
        ) -> tuple[float, float]:
            pairs = [(residual[i], residual[i + 1]) for i in rows if counted[i] and counted[i + 1]]
            if 2 * len(pairs) < 30:
                return 0.0, 1.0
            power = sum(0.5 * (one @ one + other @ other) for one, other in pairs)
            rho = sum(one @ other for one, other in pairs) / power
            return float(rho), float(np.sqrt((1.0 - rho**2) / (2 * len(pairs))))

        overall, error = correlation(np.flatnonzero(follows))
        overall = overall if overall > 2.0 * error else 0.0
        expected = []
        for one in range(4):
            rho, run_error = correlation(np.flatnonzero(follows & (run[:-1] == one)))
            drawn = min(max(overall + 0.0025 / (0.0025 + run_error**2) * (rho - overall), 0.0), 0.995)
            drawn = drawn if drawn > 2.0 * run_error or overall > 0.0 else 0.0
            expected += [(1.0 + drawn) / (1.0 - drawn)] * int(np.sum(run == one))
        found = autocorrelation_inflation(residual, counted, follows, run)
        np.testing.assert_allclose(found, expected, rtol=1e-9)
        zenith = np.linspace(0.1, 1.4, 314)
        distance = np.linalg.norm(residual, axis=-1) * np.exp(0.4 * seed * zenith)
        distance[7] = 0.0
        logs = np.log(np.maximum(distance, 1e-3 * np.median(distance)))
        offset = zenith - zenith.mean()
        slope, power = 2.0 * float(offset @ logs) / float(offset @ offset), float(offset @ offset)
        for correlated in (0.0, 0.5, 0.97):
            sigma = np.pi / np.sqrt(6.0) * np.sqrt((1.0 + correlated**2) / (1.0 - correlated**2) / power)
            steepest = 2.0 * np.log(10.0) / np.pi
            rate = float(np.clip(0.5 * slope, -steepest, steepest)) if abs(slope) > 3.0 * sigma else 0.0
            assert growth_rate(distance, zenith, correlated) == pytest.approx(rate, rel=1e-9)
