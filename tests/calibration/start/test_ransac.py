"""Starts from few sightings: the linear trials by hand, and what most sightings agree on."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import pytest
from numpy.typing import NDArray
from tests.fixtures.calibration import loose_precision, observed, small_camera, small_problem, sun_arc

from sunarc.calibration.model.sightings import Sightings
from sunarc.calibration.solve.problem import FitProblem
from sunarc.calibration.start.multistart import best_start, sampled_steps

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
    found = best_start(problem, seen, start, precision=precision)
    clean = _seen(problem, truth, false=0.0)
    before, after = (np.median(np.linalg.norm(problem.residuals(at, clean), axis=-1)) for at in (start, found))
    assert before > 2.0
    assert after < 0.2


def test_a_start_that_is_right_is_kept_about_as_it_is(
    problem: FitProblem, precision: FloatArray, truth: FloatArray
) -> None:
    seen = _seen(problem, truth, false=0.2)
    found = best_start(problem, seen, truth, precision=precision)
    change = problem.residuals(found, seen) - problem.residuals(truth, seen)
    assert np.max(np.abs(change)) < 0.2


def test_the_answer_does_not_change_from_call_to_call(
    problem: FitProblem, precision: FloatArray, truth: FloatArray
) -> None:
    seen = _seen(problem, truth, false=0.3)
    first, second = (best_start(problem, seen, _pose_off(truth), precision=precision) for _ in range(2))
    np.testing.assert_array_equal(first, second)


def test_a_trial_solves_the_normal_equations_of_its_sample() -> None:
    """Seven sightings, one in each stretch: every trial is the same, and known."""
    rng = np.random.default_rng(4)
    residual, rows = rng.standard_normal((7, 2)), rng.standard_normal((7, 2, 3))
    start, precision = np.array([0.1, -0.2, 0.3]), np.array([1.0, 2.0, 0.5])
    found = sampled_steps(residual, rows, start, precision)
    flat = rows.reshape(14, 3) / 0.7
    normal = flat.T @ flat + np.diag(precision)
    expected = np.linalg.solve(normal, flat.T @ residual.ravel() / 0.7 - precision * start)
    assert found.shape == (240, 3)
    np.testing.assert_allclose(found, np.tile(expected, (240, 1)), rtol=1e-9)


def test_trials_draw_from_every_stretch() -> None:
    residual = np.repeat(np.arange(70.0), 2).reshape(70, 2)
    rows = np.ones((70, 2, 1))
    found = sampled_steps(residual, rows, np.zeros(1), np.full(1, 1e-12))[:, 0]
    # the mean of one number out of each of 7 stretches of 10
    assert np.mean(found) == pytest.approx(34.5, abs=1.0)
    assert np.std(found) == pytest.approx(np.sqrt(99.0 / 12.0 / 7.0), rel=0.25)
