"""Levenberg-Marquardt on the robust cost, against scipy's least squares and minimisers."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import pytest
from numpy.typing import NDArray
from scipy.optimize import least_squares, minimize
from tests.calibration.solve.solve_reference import damped_step
from tests.fixtures.calibration import (
    loose_precision,
    observed,
    random_covariance,
    small_camera,
    small_problem,
    spread_directions,
)

from sunarc.calibration.model.sightings import Sightings
from sunarc.calibration.solve.levenberg_marquardt import information, most_probable
from sunarc.calibration.solve.problem import FitProblem
from sunarc.common.robust_statistics import tukey_loss, tukey_weights

FloatArray = NDArray[np.float64]


def test_a_step_without_damping_solves_the_normal_equations() -> None:
    normal, gradient = random_covariance(6, seed=1), np.random.default_rng(1).standard_normal(6)
    np.testing.assert_allclose(damped_step(normal, gradient, 0.0), np.linalg.solve(normal, gradient), rtol=1e-9)


@pytest.mark.parametrize("damping", [0.01, 1.0, 1e6])
def test_damping_adds_its_share_of_the_diagonal(damping: float) -> None:
    normal, gradient = random_covariance(5, seed=2), np.random.default_rng(2).standard_normal(5)
    expected = np.linalg.solve(normal + damping * np.diag(np.diag(normal)), gradient)
    np.testing.assert_allclose(damped_step(normal, gradient, damping), expected, rtol=1e-9)


def test_a_step_does_not_depend_on_the_units_of_the_unknowns() -> None:
    normal, gradient = random_covariance(4, seed=3), np.random.default_rng(3).standard_normal(4)
    units = np.array([1.0, 1e6, 1e-6, 1e3])
    scaled = damped_step(normal * np.outer(units, units), units * gradient, 0.5)
    np.testing.assert_allclose(units * scaled, damped_step(normal, gradient, 0.5), rtol=1e-8)


def test_equations_that_cannot_be_solved_give_no_step() -> None:
    normal = np.diag([1.0, np.nan])
    np.testing.assert_array_equal(damped_step(normal, np.ones(2), 1e-3), 0.0)
    indefinite = np.array([[1.0, 3.0], [3.0, 1.0]])
    np.testing.assert_array_equal(damped_step(indefinite, np.ones(2), 1e-3), 0.0)


def test_information_is_that_of_the_observations_without_a_loss() -> None:
    seen = replace(observed(small_camera(), spread_directions(4)), information=np.array([1.0, 2.0, 3.0, 4.0]))
    np.testing.assert_allclose(information(np.ones((4, 2)), seen, None), [1.0, 2.0, 3.0, 4.0])


def test_information_with_a_loss_is_the_weight_over_the_variance() -> None:
    seen = replace(observed(small_camera(), spread_directions(3)), information=np.array([1.0, 4.0, 1.0]))
    residual = np.array([[0.3, 0.4], [0.3, 0.4], [30.0, 40.0]])
    found = information(residual, seen, 0.5)
    # distances 0.5, 1.0 and 50 in relative sigmas
    expected = np.array([1.0, 4.0, 1.0]) * tukey_weights(np.array([0.5, 1.0, 50.0]), sigma=0.5) / 0.25
    np.testing.assert_allclose(found, expected)
    assert found[2] == 0.0


def _case() -> tuple[FitProblem, Sightings, FloatArray, FloatArray]:
    camera = small_camera()
    problem = small_problem(camera)
    seen = observed(camera, spread_directions(60), sigma_px=0.2)
    return problem, seen, problem.unknowns([camera]), loose_precision(problem)


def test_plain_squares_with_priors_are_those_of_scipy() -> None:
    problem, seen, start, precision = _case()

    def misfit(unknowns: FloatArray) -> FloatArray:
        return np.concatenate([problem.residuals(unknowns, seen).ravel(), np.sqrt(precision) * unknowns])

    expected = least_squares(misfit, start, method="lm", x_scale="jac", xtol=1e-12, ftol=1e-12)
    found = most_probable(problem, seen, start, precision=precision, tolerance=1e-12, iterations=60)
    assert found.cost == pytest.approx(expected.cost, rel=1e-8)
    found_pixels = seen.pixels - problem.residuals(found.unknowns, seen)
    expected_pixels = seen.pixels - problem.residuals(expected.x, seen)
    np.testing.assert_allclose(found_pixels, expected_pixels, atol=1e-3)


def _robust_cost(
    problem: FitProblem, seen: Sightings, precision: FloatArray, sigma: float, unknowns: FloatArray
) -> float:
    residual = problem.residuals(unknowns, seen)
    loss = tukey_loss(np.linalg.norm(residual, axis=-1), sigma=sigma)
    return float(np.sum(loss) + 0.5 * np.sum(precision * unknowns**2))


def test_the_robust_cost_is_at_a_minimum_and_outliers_have_no_part_in_it() -> None:
    problem, seen, start, precision = _case()
    pixels = seen.pixels.copy()
    pixels[::6] += [9.0, -4.0]
    seen = replace(seen, pixels=pixels)
    found = most_probable(problem, seen, start, precision=precision, sigma=0.3, tolerance=1e-12, iterations=100)
    assert found.cost == pytest.approx(_robust_cost(problem, seen, precision, 0.3, found.unknowns), rel=1e-12)
    assert found.cost < _robust_cost(problem, seen, precision, 0.3, start)
    pose = slice(17, 20)

    def of_pose(change: FloatArray) -> float:
        at = found.unknowns.copy()
        at[pose] += 1e-4 * change
        return _robust_cost(problem, seen, precision, 0.3, at)

    lowest = minimize(of_pose, np.zeros(3), method="Nelder-Mead", options={"xatol": 1e-4, "fatol": 1e-9})
    assert lowest.fun == pytest.approx(found.cost, abs=1e-4)
    np.testing.assert_allclose(information(problem.residuals(found.unknowns, seen), seen, 0.3)[::6], 0.0)


def test_what_is_not_free_does_not_move() -> None:
    problem, seen, start, precision = _case()
    free = np.zeros(problem.size, dtype=bool)
    free[[0, 18]] = True
    begin = start.copy()
    begin[0] += 0.05
    found = most_probable(problem, seen, begin, precision=precision, free=free)
    np.testing.assert_array_equal(found.unknowns[~free], begin[~free])
    assert abs(found.unknowns[0] - start[0]) < 0.01


def test_no_iteration_leaves_the_start_with_its_cost() -> None:
    problem, seen, start, precision = _case()
    found = most_probable(problem, seen, start + 0.01, precision=precision, iterations=0)
    np.testing.assert_array_equal(found.unknowns, start + 0.01)
    square = float(np.sum(problem.residuals(start + 0.01, seen) ** 2))
    assert found.cost == pytest.approx(0.5 * square + 0.5 * float(np.sum(precision * (start + 0.01) ** 2)))


def test_the_relative_information_weighs_the_squares() -> None:
    problem, seen, start, precision = _case()
    heavier = replace(seen, information=np.full(60, 4.0))
    one = most_probable(problem, seen, start, precision=precision, iterations=0)
    other = most_probable(problem, heavier, start, precision=precision, iterations=0)
    prior = 0.5 * float(np.sum(precision * start**2))
    assert other.cost - prior == pytest.approx(4.0 * (one.cost - prior))


def test_a_looser_tolerance_rests_earlier() -> None:
    problem, seen, start, precision = _case()
    begin = start.copy()
    begin[17:20] += 0.05
    exact = most_probable(problem, seen, begin, precision=precision, tolerance=1e-12)
    rough = most_probable(problem, seen, begin, precision=precision, tolerance=0.5)
    assert exact.cost < rough.cost


@pytest.mark.parametrize(("off", "within_px"), [(0.02, 0.02), (0.2, 0.2)])
def test_the_truth_is_found_from_a_pose_that_is_off(off: float, within_px: float) -> None:
    camera = small_camera()
    problem = small_problem(camera)
    seen = observed(camera, spread_directions(80))
    begin = problem.unknowns([camera])
    begin[17:20] += [off, -off, off]
    found = most_probable(problem, seen, begin, precision=1e-6 * loose_precision(problem), iterations=80)
    assert np.max(np.abs(problem.residuals(found.unknowns, seen))) < within_px


def test_sightings_without_a_finite_pixel_do_not_break_the_fit() -> None:
    problem, seen, start, precision = _case()
    pixels = seen.pixels.copy()
    pixels[3] = np.nan
    found = most_probable(problem, replace(seen, pixels=pixels), start, precision=precision, sigma=0.3)
    assert np.all(np.isfinite(found.unknowns))
    without = replace(seen, information=np.where(np.arange(len(seen)) == 3, 0.0, seen.information))
    expected = most_probable(problem, without, start, precision=precision, sigma=0.3)
    np.testing.assert_allclose(found.unknowns, expected.unknowns, rtol=1e-9)


def test_coverage_of_the_inverse_normal_matrix() -> None:
    """The 1-sigma ellipsoid of an unweighted fit holds the truth as often as chi-square says, over 40 seeds."""
    camera = small_camera()
    problem = small_problem(camera)
    directions = spread_directions(60)
    precision = loose_precision(problem)
    truth = problem.unknowns([camera])
    free = np.zeros(problem.size, dtype=bool)
    free[[0, 3, 4, 17, 18, 19]] = True
    inside = []
    for seed in range(40):
        seen = observed(camera, directions, sigma_px=0.2, seed=seed)
        seen = replace(seen, information=np.full(60, 0.2**-2))
        found = most_probable(problem, seen, truth, precision=0.0 * precision, free=free, iterations=4)
        rows = problem.linearised(found.unknowns, seen)[1][..., free].reshape(-1, 6)
        off = (found.unknowns - truth)[free]
        inside.append(off @ (rows.T @ rows / 0.2**2) @ off)
    # chi-square of 6 degrees of freedom: mean 6, standard deviation of the mean of 40 0.55
    assert 4.6 < np.mean(inside) < 7.6
    assert 0.8 < np.mean(np.array(inside) < 12.59) <= 1.0  # its 95 % point
    assert 0.25 < np.mean(np.array(inside) < 5.35) < 0.75  # its median
