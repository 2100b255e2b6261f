"""From sightings to first cameras: the truth is found with and without a start, and plausibility is by hand."""

from __future__ import annotations

import math
from dataclasses import replace

import numpy as np
import pytest
from numpy.typing import NDArray
from tests.fixtures.calibration import ideal_camera, observed, small_camera, small_problem, spread_directions, sun_arc

from sunarc.calibration.model.options import CalibrationOptions, ImageCircle
from sunarc.calibration.model.sightings import Sightings
from sunarc.calibration.start.initial_guess import (
    candidate_misfit,
    field_angle,
    first_cameras,
    level_camera,
    single_problem,
)
from sunarc.common.robust_statistics import robust_sigma
from sunarc.optics.camera import Camera
from sunarc.optics.forward import project
from sunarc.optics.pose import rotation_matrix

FloatArray = NDArray[np.float64]

OPTIONS = CalibrationOptions()
CIRCLE = ImageCircle(x=315.0, y=243.0, radius=220.5 * math.sqrt(2.0))


def _misses(camera: Camera, seen: Sightings) -> float:
    return float(np.median(np.linalg.norm(project(camera, seen.directions) - seen.pixels, axis=-1)))


def _found(
    seen: Sightings, *, options: CalibrationOptions = OPTIONS, circle: ImageCircle | None = CIRCLE
) -> tuple[list[Camera], float]:
    guess = level_camera(circle, image_size=(640, 480), options=options)
    return first_cameras(seen, guess, known=circle is not None, options=options, circle=circle)


@pytest.fixture(scope="module")
def seen() -> Sightings:
    return observed(small_camera(), sun_arc(90), sigma_px=0.1)


@pytest.mark.parametrize("circle", [CIRCLE, None], ids=["circle", "search"])
def test_the_camera_is_found_from_an_arc(seen: Sightings, circle: ImageCircle | None) -> None:
    cameras, cost = _found(seen, circle=circle)
    assert len(cameras) == 1
    assert math.isfinite(cost)
    assert _misses(cameras[0], seen) < 0.6


def test_a_start_is_taken_in_place_of_a_search(seen: Sightings) -> None:
    start = replace(small_camera(), rotation_cam_enu=(0.0, 0.0, 0.0))
    cameras, _ = first_cameras(seen, start, known=True, options=OPTIONS, circle=None)
    assert _misses(cameras[0], seen) < 0.3


def test_every_epoch_has_its_pose_with_the_lens_of_the_longest() -> None:
    camera = small_camera()
    x, y, z = camera.rotation_cam_enu
    other = replace(camera, rotation_cam_enu=(x + 0.1, y, z - 0.2))
    first, second = observed(camera, sun_arc(40), epoch=0), observed(other, sun_arc(60, declination_deg=-5.0), epoch=1)
    both = Sightings(
        directions=np.concatenate([first.directions, second.directions]),
        pixels=np.concatenate([first.pixels, second.pixels]),
        information=np.ones(100),
        epoch=np.concatenate([first.epoch, second.epoch]),
    )
    cameras, _ = _found(both)
    assert len(cameras) == 2
    assert cameras[0].focal_length_px == cameras[1].focal_length_px
    assert _misses(cameras[0], first) < 2.0
    assert _misses(cameras[1], second) < 1.0


def test_nothing_that_fits_is_infinitely_implausible() -> None:
    directions = spread_directions(30)
    nowhere = replace(observed(small_camera(), directions), pixels=np.full((30, 2), 1e6))
    options = replace(OPTIONS, projection="orthographic")
    cameras, cost = _found(nowhere, options=options)
    assert cost == math.inf
    assert cameras[0].focal_length_px[0] > 0.0


def test_the_field_s_angle_is_that_of_the_horizon_or_of_the_furthest_sighting() -> None:
    camera = replace(ideal_camera(), max_angle=2.0)
    near = observed(camera, spread_directions(5, widest_deg=30.0))
    assert field_angle(camera, near, OPTIONS) == pytest.approx(math.pi / 2)
    beyond = replace(near, pixels=np.array([[319.5 + 200.0 * 1.7, 239.5]] * 5))
    assert field_angle(camera, beyond, OPTIONS) == pytest.approx(1.7)
    far = replace(near, pixels=np.array([[319.5 + 200.0 * 2.5, 239.5]] * 5))
    assert field_angle(camera, far, OPTIONS) == pytest.approx(math.radians(100.0))


def test_an_orthographic_lens_ends_just_within_its_right_angle() -> None:
    camera = replace(ideal_camera(), projection="orthographic")
    seen = observed(camera, spread_directions(5, widest_deg=40.0))
    assert field_angle(camera, seen, OPTIONS) == pytest.approx(0.999 * math.pi / 2, rel=1e-9)
    narrow = replace(OPTIONS, max_angle_deg=20.0)
    assert field_angle(ideal_camera(), seen, narrow) == pytest.approx(math.radians(30.0))


def test_a_perspective_lens_is_looked_at_a_little_beyond_its_sightings() -> None:
    camera = replace(ideal_camera(), projection="perspective")
    at_45 = replace(observed(camera, spread_directions(5)), pixels=np.array([[519.5, 239.5]] * 5))
    assert field_angle(camera, at_45, OPTIONS) == pytest.approx(1.05 * math.pi / 4)
    on_axis = replace(at_45, pixels=np.array([[319.5, 239.5]] * 5))
    assert field_angle(camera, on_axis, OPTIONS) == pytest.approx(math.radians(20.0))
    wide = replace(at_45, pixels=np.array([[319.5 + 200.0 * 100.0, 239.5]] * 5))
    assert field_angle(camera, wide, OPTIONS) == pytest.approx(math.radians(80.0))


def test_the_problem_s_prior_is_about_the_camera(seen: Sightings) -> None:
    problem = single_problem(seen, small_camera(), OPTIONS, CIRCLE, n_epochs=2)
    assert problem.n_epochs == 2
    np.testing.assert_allclose(problem.prior.mean[[0, 1, 3, 4]], [220.5, 220.5, 315.0, 243.0])


@pytest.mark.parametrize("off_px", [0.4, 3.0])
def test_sightings_that_are_all_as_far_off_have_the_scatter_of_their_distance(off_px: float) -> None:
    """Without prior and tilt it is 0.3 n ln(s² + d² / (2 ln 2)): a median d of Rayleigh's has sigma² d² / (2 ln 2)."""
    camera = ideal_camera()
    clean = observed(camera, spread_directions(40))
    moved = replace(clean, pixels=clean.pixels + np.array([off_px, 0.0]))
    problem = small_problem(camera)
    zero = np.zeros(problem.size)
    scale = robust_sigma(np.full(40, off_px), share=0.5, floor=0.05)
    expected = 0.3 * 40 * math.log(scale**2 + off_px**2 / (2.0 * math.log(2.0)))
    assert candidate_misfit(problem, zero, np.zeros(problem.size), moved, camera) == pytest.approx(expected, abs=0.02)


def test_a_camera_that_looks_down_or_has_no_focal_length_is_impossible() -> None:
    camera = ideal_camera()
    problem, clean = small_problem(camera), observed(camera, spread_directions(40))
    zero = np.zeros(problem.size)
    for impossible in (
        replace(camera, rotation_cam_enu=(math.pi, 0.0, 0.0)),
        replace(camera, focal_length_px=(-200.0, 200.0)),
    ):
        assert candidate_misfit(problem, zero, zero, clean, impossible) == math.inf


def test_a_candidate_s_misfit_is_scatter_prior_and_tilt_in_half_squares() -> None:
    rng = np.random.default_rng(3)
    tilted = replace(ideal_camera(), rotation_cam_enu=(0.2, -0.1, 0.4))
    problem = small_problem(tilted)
    clean = observed(tilted, spread_directions(41, widest_deg=60.0))
    unknowns, precision = 0.3 * problem.unknowns([tilted]), rng.uniform(0.1, 2.0, problem.size)
    seen = replace(clean, pixels=clean.pixels + rng.normal(0.0, 1.0, (41, 2)), information=rng.uniform(0.5, 2.0, 41))
    distance = np.linalg.norm(problem.residuals(unknowns, seen), axis=-1) * np.sqrt(seen.information)
    scale = robust_sigma(distance, share=0.5, floor=0.05)
    scatter = 0.3 * 41 * math.log(scale**2 + float(np.median(distance)) ** 2 / 1.386)
    lean = math.acos(float(rotation_matrix(tilted.rotation_cam_enu)[2, 2]))
    expected = scatter + 0.5 * float(np.sum(precision * unknowns**2)) + 0.5 * (lean / math.radians(25.0)) ** 2
    assert candidate_misfit(problem, unknowns, precision, seen, tilted) == pytest.approx(expected, rel=1e-9)
