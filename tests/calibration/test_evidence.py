"""The evidence of explanations: densities against scipy's, correlations against Bessel functions, choices by hand."""

from __future__ import annotations

import itertools
import math

import numpy as np
import pytest
from scipy.special import gamma, kv
from scipy.stats import multivariate_normal

from sunarc.calibration.evidence import (
    Weighed,
    bounded_cost,
    explained,
    likeliest_path,
    log_marginal,
    matern_3_2,
    matern_5_2,
    most_probable,
    step_evidences,
    whitened,
)
from sunarc.common.array_types import FloatArray


def spread(n: int, *, seed: int) -> FloatArray:
    root = np.random.default_rng(seed).standard_normal((n, n))
    return root @ root.T + np.eye(n)


@pytest.mark.parametrize(("axes", "free"), [(1, 0), (2, 0), (1, 3), (2, 4), (3, 1)])
def test_the_marginal_is_the_dense_gaussian_with_the_free_numbers_covariance_added(axes: int, free: int) -> None:
    rng = np.random.default_rng(axes + 10 * free)
    covariance, values = spread(5, seed=1), rng.standard_normal((5, axes))
    columns = rng.standard_normal((5, axes, free))
    flat = columns.reshape(5 * axes, free)
    dense = np.kron(covariance, np.eye(axes)) + flat @ flat.T
    expected = multivariate_normal(np.zeros(5 * axes), dense).logpdf(values.ravel())
    assert log_marginal(values, covariance, columns) == pytest.approx(float(expected), rel=1e-12)
    if free == 0:
        assert log_marginal(values, covariance) == pytest.approx(float(expected), rel=1e-12)


@pytest.mark.parametrize("independent", [False, True])
def test_the_free_numbers_are_those_of_the_normal_distribution_given_the_values(*, independent: bool) -> None:
    rng = np.random.default_rng(7)
    values, columns = rng.standard_normal((5, 2)), rng.standard_normal((5, 2, 3))
    covariance = np.diag(rng.uniform(0.5, 2.0, 5)) if independent else spread(5, seed=3)
    found = explained(values, np.diag(covariance) if independent else covariance, columns)
    flat = columns.reshape(10, 3)
    gain = flat.T @ np.linalg.inv(np.kron(covariance, np.eye(2)) + flat @ flat.T)
    np.testing.assert_allclose(found.mean, gain @ values.ravel(), atol=1e-12)
    np.testing.assert_allclose(found.covariance, np.eye(3) - gain @ flat, atol=1e-12)
    assert found.log_evidence == pytest.approx(log_marginal(values, covariance, columns), rel=1e-12)


def test_the_evidence_of_a_change_before_each_observation_is_that_of_its_columns() -> None:
    rng = np.random.default_rng(8)
    values, common, step = (rng.standard_normal((6, 2, *size)) for size in ((), (2,), (3,)))
    found = step_evidences(values, common, step)
    late = (np.arange(6) >= np.arange(6)[:, None])[..., None, None]
    expected = [
        explained(values, np.ones(6), np.concatenate([common, step * one], axis=-1)).log_evidence for one in late
    ]
    np.testing.assert_allclose(found - found[0], np.array(expected) - expected[0], atol=1e-12)


def test_whitened_values_have_the_unit_covariance() -> None:
    covariance = spread(4, seed=2)
    white, half_log = whitened(covariance, np.eye(4))
    np.testing.assert_allclose(white.T @ white, np.linalg.inv(covariance), rtol=1e-10, atol=1e-12)
    assert half_log == pytest.approx(0.5 * np.linalg.slogdet(covariance).logabsdet)


@pytest.mark.parametrize("wrong", [np.nan, -5.0])
def test_a_covariance_that_is_none_has_no_density(wrong: float) -> None:
    covariance = np.eye(3)
    covariance[1, 1] = wrong
    with pytest.raises(np.linalg.LinAlgError):
        log_marginal(np.zeros((3, 1)), covariance)


@pytest.mark.parametrize(("correlation", "nu"), [(matern_3_2, 1.5), (matern_5_2, 2.5)])
def test_correlations_are_matern_s(correlation: object, nu: float) -> None:
    assert callable(correlation)
    lag = np.array([0.3, 1.0, 4.0, 11.0])
    scaled = math.sqrt(2.0 * nu) * lag / 2.5
    # Rasmussen and Williams (2006), eq. 4.14
    expected = 2.0 ** (1.0 - nu) / gamma(nu) * scaled**nu * kv(nu, scaled)
    np.testing.assert_allclose(correlation(-lag, 2.5), expected, rtol=1e-12)
    assert correlation(np.zeros(1), 2.5).tolist() == [1.0]


def test_the_most_probable_is_the_likeliest_less_its_rarity_and_the_first_of_equals() -> None:
    assert most_probable([Weighed("turn", 10.0), Weighed("lens", 15.9, 6.0)]).explanation == "turn"
    assert most_probable([Weighed("turn", 10.0), Weighed("lens", 16.1, 6.0)]).explanation == "lens"
    assert most_probable([Weighed("turn", 10.0), Weighed("clock", 4.0, -6.0)]).explanation == "turn"


def test_a_false_sighting_costs_as_much_however_far_off_it_is() -> None:
    assert bounded_cost(np.array([0.0, 1.0, 2.0, 5.0, 1e6]), 0.5).tolist() == [0.0, 2.0, 8.0, 8.0, 8.0]


@pytest.mark.parametrize("seed", range(6))
def test_the_likeliest_path_costs_least_of_all_paths(seed: int) -> None:
    costs = np.random.default_rng(seed).exponential(1.0, (6, 3))

    def cost(path: tuple[int, ...]) -> float:
        return float(costs[np.arange(6), path].sum()) + 0.8 * np.count_nonzero(np.diff(path))

    least = min(itertools.product(range(3), repeat=6), key=cost)
    assert tuple(likeliest_path(costs, change_cost=0.8).tolist()) == least
    assert likeliest_path(costs[:0], change_cost=0.8).size == 0
