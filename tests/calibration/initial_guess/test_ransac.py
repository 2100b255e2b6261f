"""Starts from few sightings: the linear trials by hand, and what most sightings agree on."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import pytest
from numpy.typing import NDArray
from tests.fixtures.calibration import loose_precision, observed, small_camera, small_problem, sun_arc

from sunarc.calibration.model.sightings import Sightings
from sunarc.calibration.robust_loss import WELL_BEHAVED, robust_sigma
from sunarc.calibration.solve.problem import FitProblem
from sunarc.calibration.start import multistart as module
from sunarc.calibration.start.multistart import ransac_start

FloatArray = NDArray[np.float64]


@pytest.fixture(scope="module")
def problem() -> FitProblem:
    return small_problem(small_camera())


@pytest.fixture(scope="module")
def precision(problem: FitProblem) -> FloatArray:
    return loose_precision(problem)


@pytest.fixture(scope="module")
def truth(problem: FitProblem) -> FloatArray:
    return problem.unknowns([small_camera()])


def _seen(problem: FitProblem, truth: FloatArray, *, false: float) -> Sightings:
    seen = observed(problem.camera(truth), sun_arc(200), sigma_px=0.05)
    rng = np.random.default_rng(2)
    wrong = rng.random(200) < false
    return replace(seen, pixels=seen.pixels + np.where(wrong[:, None], [6.0, -4.0], 0.0))


def _pose_off(truth: FloatArray) -> FloatArray:
    start = truth.copy()
    start[17:20] += [0.01, -0.01, 0.02]
    return start


@pytest.mark.parametrize("false", [0.0, 0.3, 0.45])
def test_the_majority_s_camera_is_found(
    problem: FitProblem, precision: FloatArray, truth: FloatArray, false: float
) -> None:
    seen = _seen(problem, truth, false=false)
    start = _pose_off(truth)
    found = ransac_start(problem, seen, start, precision=precision)
    clean = _seen(problem, truth, false=0.0)
    before, after = (np.median(np.linalg.norm(problem.residuals(at, clean), axis=-1)) for at in (start, found))
    assert before > 2.0
    assert after < 0.2


def test_a_start_that_is_right_is_kept_about_as_it_is(
    problem: FitProblem, precision: FloatArray, truth: FloatArray
) -> None:
    seen = _seen(problem, truth, false=0.2)
    found = ransac_start(problem, seen, truth, precision=precision)
    change = problem.residuals(found, seen) - problem.residuals(truth, seen)
    assert np.max(np.abs(change)) < 0.2


def test_the_start_is_the_answer_where_nothing_is_better(problem: FitProblem) -> None:
    camera = small_camera()
    exact = observed(camera, sun_arc(50))
    start = problem.unknowns([camera])
    found = ransac_start(problem, exact, start, precision=np.full(problem.size, 1e12))
    residual = problem.residuals(found, exact)
    assert np.max(np.abs(residual)) < 1e-3


def test_the_answer_does_not_change_from_call_to_call(
    problem: FitProblem, precision: FloatArray, truth: FloatArray
) -> None:
    seen = _seen(problem, truth, false=0.3)
    first, second = (ransac_start(problem, seen, _pose_off(truth), precision=precision) for _ in range(2))
    np.testing.assert_array_equal(first, second)


def test_a_trial_solves_the_normal_equations_of_its_sample() -> None:
    """Seven sightings, one in each stretch: every trial is the same, and known."""
    rng = np.random.default_rng(4)
    residual, rows = rng.standard_normal((7, 2)), rng.standard_normal((7, 2, 3))
    start, precision = np.array([0.1, -0.2, 0.3]), np.array([1.0, 2.0, 0.5])
    found = module.sampled_steps(residual, rows, start, precision)
    flat = rows.reshape(14, 3) / 0.7
    normal = flat.T @ flat + np.diag(precision)
    expected = np.linalg.solve(normal, flat.T @ residual.ravel() / 0.7 - precision * start)
    assert found.shape == (240, 3)
    np.testing.assert_allclose(found, np.tile(expected, (240, 1)), rtol=1e-9)


def test_trials_draw_from_every_stretch() -> None:
    residual = np.repeat(np.arange(70.0), 2).reshape(70, 2)
    rows = np.ones((70, 2, 1))
    found = module.sampled_steps(residual, rows, np.zeros(1), np.full(1, 1e-12))[:, 0]
    # the mean of one number out of each of 7 stretches of 10
    assert np.mean(found) == pytest.approx(34.5, abs=1.0)
    assert np.std(found) == pytest.approx(np.sqrt(99.0 / 12.0 / 7.0), rel=0.25)


def test_tightening_ends_at_the_weighted_fixed_point() -> None:
    rng = np.random.default_rng(6)
    rows = rng.standard_normal((80, 2, 2))
    residual = rows @ [0.5, -1.0] + 0.05 * rng.standard_normal((80, 2))
    residual[:16] += 4.0
    found = module.tightened_step(np.zeros(2), residual, rows, np.zeros(2), np.full(2, 1e-9), WELL_BEHAVED)
    np.testing.assert_allclose(found, [0.5, -1.0], atol=0.03)
    plain = np.linalg.lstsq(rows.reshape(-1, 2), residual.ravel())[0]
    assert np.linalg.norm(found - [0.5, -1.0]) < 0.5 * np.linalg.norm(plain - [0.5, -1.0]) + 0.02


def test_disagreement_is_the_sum_of_logarithms(problem: FitProblem, truth: FloatArray) -> None:
    seen = _seen(problem, truth, false=0.0)
    distance = np.linalg.norm(problem.residuals(truth, seen), axis=-1)
    expected = float(np.sum(np.log(1.0 + (distance / 0.1) ** 2)))
    assert module.disagreement(problem, seen, truth, 0.1) == pytest.approx(expected)


def test_the_disagreement_is_cauchys_loss_of_distances_in_their_own_sigmas(
    problem: FitProblem, truth: FloatArray
) -> None:
    seen = observed(problem.camera(truth), sun_arc(3))
    off = np.array([[3.0, 4.0], [0.0, 0.0], [0.6, 0.8]])
    seen = replace(seen, pixels=seen.pixels + off, information=np.array([1.0 / 25.0, 1.0, 4.0]))
    # 5 px of a sigma of 5 px, and 1 px of a sigma of 0.5 px
    expected = np.log1p((1.0 / 0.5) ** 2) + np.log1p((2.0 / 0.5) ** 2)
    assert module.disagreement(problem, seen, truth, 0.5) == pytest.approx(expected, rel=1e-6)


def _lines(problem: FitProblem, truth: FloatArray) -> tuple[FloatArray, FloatArray]:
    return problem.linearised(_pose_off(truth), _seen(problem, truth, false=0.3))


def test_a_step_is_refined_by_weighted_least_squares(
    problem: FitProblem, precision: FloatArray, truth: FloatArray
) -> None:
    (residual, rows), start = _lines(problem, truth), _pose_off(truth)
    flat, right, step = rows.reshape(-1, rows.shape[-1]), residual.ravel(), np.zeros(problem.size)
    found = module.tightened_step(step, residual, rows, start, precision, WELL_BEHAVED)
    for cut in module.CUTS:
        after = (right - flat @ step).reshape(-1, 2)
        distance = np.hypot(after[:, 0], after[:, 1])
        sigma = robust_sigma(distance, floor=module.FLOOR_PX)
        weight = np.repeat(1.0 / (1.0 + (distance / (sigma * cut)) ** 2) ** 2 / sigma**2, 2)
        normal = (flat * weight[:, None]).T @ flat + np.diag(precision)
        step = np.linalg.solve(normal, (right * weight) @ flat - precision * start)
    np.testing.assert_allclose(rows @ found, rows @ step, atol=1e-4)
