"""Gaussian conditioning and the mixture of true and false sightings, against dense algebra and by hand."""

from __future__ import annotations

import math

import numpy as np
import pytest
from numpy.typing import NDArray
from scipy.integrate import dblquad
from scipy.stats import multivariate_normal
from tests.fixtures.calibration import random_covariance, small_camera, spread_directions, stated_calibration

from sunarc.calibration.answers.error_model import CameraErrorModel, build_error_model, joint_covariance, predicted
from sunarc.calibration.evidence import PixelResiduals, false_density, fit_inlier_mixture, log_evidence, log_normal
from sunarc.calibration.model.result import Calibration
from sunarc.calibration.pose import conditioned
from sunarc.common.array_types import picked

FloatArray = NDArray[np.float64]


def _seen(residual: FloatArray, *, variance: float = 0.04, log_false: float = -12.0) -> PixelResiduals:
    n = residual.shape[0]
    return PixelResiduals(residual=residual, variance=np.full(n, variance), false_density=np.full(n, log_false))


def _drawn(n: int, covariance: FloatArray, *, seed: int, variance: float = 0.04) -> FloatArray:
    rng = np.random.default_rng(seed)
    total = covariance + variance * np.eye(2 * n)
    return np.asarray(rng.multivariate_normal(np.zeros(2 * n), total).reshape(n, 2))


ALL = np.ones(6, dtype=bool)


def test_the_density_of_false_sightings_is_one_over_the_plane() -> None:
    def density(y: float, x: float) -> float:
        return float(np.exp(false_density(np.array([[x, y]]), area_px2=1e30))[0])

    total, _ = dblquad(density, -120.0, 120.0, -120.0, 120.0, epsabs=1e-4)
    assert total == pytest.approx(0.5, abs=1e-3)  # the other half lies anywhere in the image


def test_the_density_of_false_sightings_by_hand() -> None:
    found = false_density(np.array([[0.0, 0.0], [15.0, 0.0], [1e3, 0.0], [np.nan, 0.0]]), area_px2=1e6)
    near = 1.0 / (2.0 * math.pi * 15.0**2)
    expected = [0.5 * near + 0.5e-6, 0.5 * near * math.exp(-0.5) + 0.5e-6, 0.5e-6, 0.5e-6]
    np.testing.assert_allclose(np.exp(found), expected, rtol=1e-9)


def test_the_log_density_is_scipy_s() -> None:
    covariance = random_covariance(12, seed=1)
    residual = _drawn(6, covariance, seed=2)
    found = log_normal(covariance, _seen(residual), ALL)
    expected = multivariate_normal(np.zeros(12), covariance + 0.04 * np.eye(12)).logpdf(residual.ravel())
    assert found == pytest.approx(float(expected))


def test_the_log_density_is_of_the_inliers_alone() -> None:
    covariance = random_covariance(12, seed=1)
    residual = _drawn(6, covariance, seed=2)
    some = np.array([True, False, True, True, False, False])
    both = np.repeat(some, 2)
    total = covariance[np.ix_(both, both)] + 0.04 * np.eye(6)
    expected = multivariate_normal(np.zeros(6), total).logpdf(residual[some].ravel())
    assert log_normal(covariance, _seen(residual), some) == pytest.approx(float(expected))
    assert log_normal(covariance, _seen(residual), np.zeros(6, dtype=bool)) == 0.0


def test_the_evidence_counts_true_and_false_with_their_shares() -> None:
    covariance = random_covariance(12, seed=1)
    seen = _seen(_drawn(6, covariance, seed=2))
    some = np.array([True, True, True, True, False, False])
    expected = log_normal(covariance, seen, some) + 4 * math.log(0.8) + 2 * (math.log(0.2) - 12.0)
    assert log_evidence(covariance, seen, some) == pytest.approx(expected)


def test_the_classes_of_largest_evidence_are_found_among_all_of_them() -> None:
    """Brute force over the 64 ways to call six sightings true or false."""
    covariance = 0.2 * random_covariance(12, seed=3)
    residual = _drawn(6, covariance, seed=4)
    residual[1] += [9.0, 0.0]
    residual[4] += [-3.0, 7.0]
    seen = _seen(residual)
    ways = [np.array([bool(k >> i & 1) for i in range(6)]) for k in range(64)]
    best = max(ways, key=lambda way: log_evidence(covariance, seen, way))
    found = fit_inlier_mixture(covariance, seen, ALL & (np.abs(residual).max(axis=1) < 3.0))
    assert found.inlier.tolist() == best.tolist() == [True, False, True, True, False, True]
    assert found.log_evidence == pytest.approx(log_evidence(covariance, seen, best))


def test_leave_one_out_residuals_are_those_of_conditioning_on_the_others() -> None:
    covariance = random_covariance(12, seed=5)
    residual = _drawn(6, covariance, seed=6)
    found = fit_inlier_mixture(covariance, _seen(residual), ALL)
    assert np.all(found.inlier)
    total = covariance + 0.04 * np.eye(12)
    for n in range(6):
        own = np.zeros(12, dtype=bool)
        own[2 * n : 2 * n + 2] = True
        gain = np.linalg.solve(total[np.ix_(~own, ~own)], total[np.ix_(~own, own)]).T
        expected = residual[n] - gain @ residual.ravel()[~own]
        spread = total[np.ix_(own, own)] - gain @ total[np.ix_(~own, own)]
        np.testing.assert_allclose(found.loo_residual[n], expected, rtol=1e-8)
        np.testing.assert_allclose(found.loo_covariance[n], spread, rtol=1e-8)


def test_the_surprise_of_true_sightings_is_two_on_average() -> None:
    covariance = random_covariance(12, seed=7)
    found = [
        fit_inlier_mixture(covariance, _seen(_drawn(6, covariance, seed=s), log_false=-100.0), ALL).surprise
        for s in range(60)
    ]
    # chi-square of two: its mean over 360 dependent numbers, and its median
    assert 1.7 < np.mean(found) < 2.3
    assert 0.4 < np.mean(np.array(found) < 2.0 * math.log(2.0)) < 0.6


def test_an_outlier_s_residual_is_by_the_inliers() -> None:
    covariance = np.asarray(np.kron(np.ones((4, 4)), np.eye(2)), dtype=np.float64)  # one error, shared by all
    residual = np.array([[1.0, 0.0], [1.0, 0.0], [1.0, 0.0], [21.0, 0.0]])
    found = fit_inlier_mixture(covariance, _seen(residual, variance=1e-4), np.array([True, True, True, False]))
    assert found.inlier.tolist() == [True, True, True, False]
    np.testing.assert_allclose(found.loo_residual[3], [20.0, 0.0], atol=0.01)


def test_where_nothing_is_plausible_the_first_classes_stay() -> None:
    residual = np.full((3, 2), 1e4)
    found = fit_inlier_mixture(np.eye(6), _seen(residual), np.array([True, False, False]))
    assert found.inlier.tolist() == [True, False, False]


def test_a_selection_keeps_the_columns_together() -> None:
    seen = PixelResiduals(
        residual=np.arange(6.0).reshape(3, 2),
        variance=np.array([1.0, 2.0, 3.0]),
        false_density=np.array([4.0, 5.0, 6.0]),
    )
    some = picked(seen, np.array([True, False, True]))
    assert some.residual.tolist() == [[0.0, 1.0], [4.0, 5.0]]
    assert some.variance.tolist() == [1.0, 3.0]
    assert some.false_density.tolist() == [4.0, 6.0]


@pytest.fixture(scope="module")
def calibration() -> Calibration:
    return stated_calibration(small_camera(), amplitude_px=0.3)


@pytest.fixture(scope="module")
def model(calibration: Calibration) -> CameraErrorModel:
    return build_error_model(calibration)


def test_conditioning_is_that_of_the_joint_gaussian(model: CameraErrorModel) -> None:
    """Parameters, field coefficients and sightings as one Gaussian, conditioned by the textbook's formula."""
    camera, directions = small_camera(), spread_directions(6)
    at = predicted(model, camera, directions)
    residual = np.random.default_rng(3).normal(0.0, 0.3, (6, 2))
    seen = _seen(residual, variance=0.01)
    flat, p, m = at.rows.reshape(12, 20), 20, model.variances.size
    # unknowns: parameters, then the coefficients of x, then of y
    prior = np.zeros((p + 2 * m, p + 2 * m))
    prior[:p, :p] = model.covariance
    prior[p:, p:] = np.diag(np.tile(model.variances, 2))
    design = np.zeros((12, p + 2 * m))
    design[:, :p] = flat
    design[0::2, p : p + m] = at.basis_values
    design[1::2, p + m :] = at.basis_values
    # the joint covariance takes the field's exact kernel in place of its waves
    total = joint_covariance(model, at) + 0.01 * np.eye(12)
    gain = prior @ design.T @ np.linalg.inv(total)
    after = prior - gain @ design @ prior
    found = conditioned(model, at, seen)
    np.testing.assert_allclose(found.mean, (gain @ residual.ravel())[:p], rtol=1e-8, atol=1e-12)
    np.testing.assert_allclose(found.covariance, after[:p, :p], rtol=1e-7, atol=1e-14)
    np.testing.assert_allclose(found.field.cross[0], after[:p, p : p + m], rtol=1e-6, atol=1e-10)
    np.testing.assert_allclose(found.field.cross[1], after[:p, p + m :], rtol=1e-6, atol=1e-10)


def test_conditioning_twice_is_conditioning_on_both(model: CameraErrorModel) -> None:
    """Without a field, whose joint covariance is not carried over, the order does not matter."""
    plain = build_error_model(stated_calibration(small_camera()))
    at = predicted(plain, small_camera(), spread_directions(6))
    seen = _seen(np.random.default_rng(3).normal(0.0, 0.3, (6, 2)), variance=0.01)
    first = np.arange(6) < 4
    at_once = conditioned(plain, at, seen)
    in_turn = conditioned(
        conditioned(plain, picked(at, first), picked(seen, first)), picked(at, ~first), picked(seen, ~first)
    )
    np.testing.assert_allclose(in_turn.mean, at_once.mean, rtol=1e-6, atol=1e-12)
    np.testing.assert_allclose(in_turn.covariance, at_once.covariance, rtol=1e-6, atol=1e-14)
    assert np.trace(at_once.covariance) < np.trace(model.covariance)


def test_a_sighting_where_the_camera_has_no_pixel_is_an_error_of_the_equations(model: CameraErrorModel) -> None:
    at, seen = predicted(model, small_camera(), spread_directions(6)), _seen(np.zeros((6, 2)))
    at.rows[2] = np.nan
    with pytest.raises(np.linalg.LinAlgError):
        conditioned(model, at, seen)
    covariance = np.eye(12)
    covariance[3, 3] = np.nan
    with pytest.raises(np.linalg.LinAlgError):
        log_normal(covariance, seen, ALL)


def test_no_sighting_changes_nothing(model: CameraErrorModel) -> None:
    at = predicted(model, small_camera(), np.zeros((0, 3)))
    assert conditioned(model, at, _seen(np.zeros((0, 2)))) is model


def test_coverage_of_the_conditioned_errors() -> None:
    """Cameras drawn from the prior, 40 seeds: the posterior's 95 % hold the truth, neither more nor less."""
    model = build_error_model(stated_calibration(small_camera()))
    at = predicted(model, small_camera(), spread_directions(8))
    inside = []
    for seed in range(40):
        rng = np.random.default_rng(seed)
        truth = rng.standard_normal(20) * np.sqrt(np.diag(model.covariance))
        residual = at.rows @ truth + 0.1 * rng.standard_normal((8, 2))
        after = conditioned(model, at, _seen(residual, variance=0.01))
        inside.append(np.abs(after.mean - truth) < 1.96 * np.sqrt(np.diag(after.covariance)))
    assert 0.93 < np.mean(inside) < 0.97


@pytest.mark.parametrize("offset", [-0.05, 0.05])
def test_a_sighting_is_an_inlier_where_that_is_likelier_by_the_shares(offset: float) -> None:
    covariance = np.diag([0.5, 0.5])
    # alone, its leave-one-out prediction is the prior; four of five sightings are true
    density = float(multivariate_normal(np.zeros(2), 0.54 * np.eye(2)).logpdf([1.0, 0.0]))
    equal = density + math.log(0.8) - math.log(0.2)
    beside = np.array([[0.0, 0.0], [1.0, 0.0]])
    both = PixelResiduals(residual=beside, variance=np.full(2, 0.04), false_density=np.array([-50.0, equal + offset]))
    apart = np.asarray(np.kron(np.eye(2), covariance), dtype=np.float64)
    found = fit_inlier_mixture(apart, both, np.ones(2, dtype=bool))
    assert found.inlier.tolist() == [True, offset < 0.0]
