"""Several starts of the robust fit: which one is taken, and what each begins with."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import pytest
from numpy.typing import NDArray
from tests.fixtures.calibration import loose_precision, observed, small_camera, small_problem, sun_arc

from sunarc.calibration.model.sightings import Sightings
from sunarc.calibration.solve.priors import DECENTERING, HIGHER, LENS, Whitened
from sunarc.calibration.solve.problem import FitProblem
from sunarc.calibration.start import multistart
from sunarc.calibration.start.multistart import (
    best_start,
    distance_sigmas,
    least_squares,
    loosened,
    lowest,
    solve_from_starts,
    undistorted,
)
from sunarc.common.robust_statistics import UNSEEN_PX, robust_sigma, tukey_loss
from sunarc.optics.camera import PARAMETER_NAMES
from sunarc.optics.pose import rotation_matrix

FloatArray = NDArray[np.float64]


@pytest.fixture(scope="module")
def problem() -> FitProblem:
    return small_problem(small_camera())


@pytest.fixture(scope="module")
def precision(problem: FitProblem) -> FloatArray:
    return loose_precision(problem)


@pytest.fixture(scope="module")
def truth(problem: FitProblem) -> FloatArray:
    return problem.unknowns([replace(small_camera(), focal_length_px=(220.5, 220.5), skew_px=0.0)])


@pytest.fixture(scope="module")
def seen(problem: FitProblem, truth: FloatArray) -> Sightings:
    return observed(problem.camera(truth), sun_arc(120), sigma_px=0.05)


def test_the_indices_of_the_decentering_are_those_of_the_lens() -> None:
    names = [PARAMETER_NAMES[i] for i in LENS]
    assert (names[Whitened.P1], names[Whitened.P3], names[Whitened.P4]) == ("p1", "p3", "p4")


def test_a_sighting_beyond_the_angle_that_the_camera_answers_is_missed(
    problem: FitProblem, truth: FloatArray, seen: Sightings
) -> None:
    axis = rotation_matrix(truth[problem.pose_slice(0)])[2]
    limit = float(np.median(np.arccos(seen.directions @ axis)))
    distance = distance_sigmas(replace(problem, max_angle=limit), seen, truth)
    assert np.sum(distance == UNSEEN_PX) == 60
    beyond = np.arccos(seen.directions @ axis) > limit
    np.testing.assert_array_equal(distance == UNSEEN_PX, beyond)
    np.testing.assert_allclose(distance[~beyond], distance_sigmas(problem, seen, truth)[~beyond])


def test_distances_are_in_relative_sigmas(problem: FitProblem, truth: FloatArray, seen: Sightings) -> None:
    heavier = replace(seen, information=np.full(120, 4.0))
    expected = 2.0 * np.linalg.norm(problem.residuals(truth, seen), axis=-1)
    np.testing.assert_allclose(distance_sigmas(problem, heavier, truth), expected)


def test_an_ideal_lens_has_neither_radial_distortion_nor_decentering(problem: FitProblem, truth: FloatArray) -> None:
    plain = problem.camera(undistorted(truth))
    np.testing.assert_allclose(plain.radial, 0.0, atol=1e-12)
    np.testing.assert_allclose(plain.decentering[:2], 0.0, atol=1e-12)
    np.testing.assert_allclose(plain.rotation_cam_enu, problem.camera(truth).rotation_cam_enu)
    assert np.any(truth[5:13])


def test_loosened_precisions_hold_skew_and_aspect_alone(problem: FitProblem) -> None:
    found = loosened(problem)
    np.testing.assert_allclose(found[[1, 2]], 1.0)
    np.testing.assert_allclose(np.delete(found[:17], [1, 2]), 1e-4)
    np.testing.assert_allclose(found[17:], 1e-9)


def test_least_squares_goes_below_the_noise(problem: FitProblem, truth: FloatArray, seen: Sightings) -> None:
    begin = truth.copy()
    begin[17:20] += 0.01
    found = least_squares(problem, seen, begin)
    rms = float(np.sqrt(np.mean(problem.residuals(found, seen) ** 2)))
    assert 0.03 < rms < 0.05 * 1.02


def test_the_lowest_is_by_one_scale_for_all(
    problem: FitProblem, precision: FloatArray, truth: FloatArray, seen: Sightings
) -> None:
    """A camera that misses everything alike has a scale of its own at which it would look good."""
    shifted = truth.copy()
    shifted[3] += 5.0 / problem.prior.basis[3, 3]
    assert lowest(problem, seen, [shifted, truth], precision=precision) is truth
    assert lowest(problem, seen, [truth, shifted], precision=precision) is truth


def test_the_lowest_counts_the_prior_too(problem: FitProblem, truth: FloatArray, seen: Sightings) -> None:
    other = truth + 0.0
    other[17] += 1e-7
    held = np.zeros(problem.size)
    held[17] = 1e12
    at_zero, far = truth.copy(), other
    costs = []
    for at in (at_zero, far):
        distance = distance_sigmas(problem, seen, at)
        sigma = robust_sigma(distance, share=0.5, floor=1e-4)
        costs.append(float(np.sum(tukey_loss(distance, sigma=sigma))) + 0.5 * 1e12 * at[17] ** 2)
    expected = [at_zero, far][int(np.argmin(costs))]
    assert lowest(problem, seen, [at_zero, far], precision=held) is expected


def test_a_start_comes_to_rest_at_the_minimum(
    problem: FitProblem, precision: FloatArray, truth: FloatArray, seen: Sightings
) -> None:
    begin = truth.copy()
    begin[17:20] += [0.01, 0.0, -0.01]
    found = begin
    for _ in range(3):
        found = multistart.settled(problem, seen, found, precision=precision)
    again = multistart.settled(problem, seen, found, precision=precision)
    change = problem.residuals(found, seen) - problem.residuals(again, seen)
    assert np.max(np.abs(change)) < 0.02
    assert np.median(np.linalg.norm(problem.residuals(found, seen), axis=-1)) < 0.07


def test_the_best_of_the_starts_is_the_truth_s_among_outliers(
    problem: FitProblem, precision: FloatArray, truth: FloatArray, seen: Sightings
) -> None:
    pixels = seen.pixels.copy()
    pixels[80:110] += [4.0, -3.0]  # an episode, alike for a quarter of the arc
    begin = truth.copy()
    begin[17:20] += [0.005, 0.0, -0.005]
    found = best_start(problem, replace(seen, pixels=pixels), begin, precision=precision)
    off = np.linalg.norm(problem.residuals(found, seen), axis=-1)
    assert np.median(off) < 0.1


def test_the_sign_of_the_decentering_is_found(problem: FitProblem, precision: FloatArray, seen: Sightings) -> None:
    """From the opposite decentering the fit does not stay in the valley that it begins in."""
    truth = problem.unknowns([replace(small_camera(), focal_length_px=(220.5, 220.5), skew_px=0.0)])
    begin = truth.copy()
    begin[DECENTERING] *= -1.0
    begin[HIGHER] = 0.0
    exact = replace(
        observed(problem.camera(truth), sun_arc(60, widest_deg=70.0), sigma_px=0.01), information=np.full(60, 1e4)
    )
    found = solve_from_starts(problem, exact, begin, precision=precision)
    residual = problem.residuals(found, exact)
    assert float(np.sqrt(np.mean(residual**2))) < 0.03
    assert seen.pixels.shape == (120, 2)


def test_starts_that_image_every_sighting_alike_are_one(
    problem: FitProblem, truth: FloatArray, seen: Sightings
) -> None:
    slightly, far = truth.copy(), truth.copy()
    slightly[Whitened.CENTER_X] += 1e-5
    far[Whitened.CENTER_X] += 0.5
    found = multistart.distinct_starts(problem, seen, [truth, slightly, far, far.copy()])
    assert len(found) == 2
    assert found[0] is truth
    assert found[1] is far
