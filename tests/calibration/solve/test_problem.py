"""Residuals and derivatives of a fit's unknowns, against projection and finite differences."""

from __future__ import annotations

import math
from dataclasses import replace

import numpy as np
import pytest
from numpy.typing import NDArray
from tests.fixtures.calibration import (
    SGP,
    ideal_camera,
    numerical_derivative,
    observed,
    small_camera,
    small_problem,
    spread_directions,
)

from sunarc.calibration.model.sightings import Sightings, filter_sightings
from sunarc.calibration.solve.priors import N_LENS
from sunarc.calibration.solve.problem import Block, by_elevation, problem_for
from sunarc.optics.camera import Camera
from sunarc.optics.forward import by_direction, project, project_with_rows_fast
from sunarc.optics.projections import Projection, angle_limit
from sunarc.sky.refraction import raised

FloatArray = NDArray[np.float64]


def _turned(camera: Camera, by: float) -> Camera:
    x, y, z = camera.rotation_cam_enu
    return replace(camera, rotation_cam_enu=(x + by, y - by, z))


def test_the_unknowns_of_cameras_give_the_cameras_back() -> None:
    camera = small_camera()
    problem = small_problem(camera, n_epochs=2)
    assert problem.size == N_LENS + 6
    unknowns = problem.unknowns([camera, _turned(camera, 0.01)])
    for epoch, expected in enumerate([camera, _turned(camera, 0.01)]):
        found = problem.camera(unknowns, epoch)
        np.testing.assert_allclose(found.to_vector(), expected.to_vector(), rtol=1e-8, atol=1e-10)
    assert problem.pose_slice(1) == slice(20, 23)


BLOCKS = (Block("first", slice(0, 2)), Block("second", slice(2, 3)))


def test_blocks_add_unknowns_after_the_poses() -> None:
    problem = replace(small_problem(small_camera(), n_epochs=2), blocks=BLOCKS)
    assert problem.size == N_LENS + 6 + 3
    assert problem.block_slice("first") == slice(N_LENS + 6, N_LENS + 8)
    assert problem.block_slice("second") == slice(N_LENS + 8, N_LENS + 9)
    assert problem.block_slice("none").start == problem.block_slice("none").stop
    unknowns = problem.unknowns([small_camera(), small_camera()])
    np.testing.assert_allclose(unknowns[-3:], 0.0)


def test_a_problem_of_one_block_alone_takes_its_columns() -> None:
    camera = small_camera()
    shared = np.random.default_rng(4).normal(0.0, 0.1, (8, 2, 3))
    seen = replace(observed(camera, spread_directions(8)), systematic_px=shared)
    only, places = replace(small_problem(camera), blocks=BLOCKS).only({"second"})
    assert places.tolist() == [*range(N_LENS + 3), N_LENS + 5]
    assert only.names == {"second"}
    at = only.unknowns([camera])
    at[-1] = 2.0
    np.testing.assert_allclose(only.residuals(at, seen), -2.0 * shared[:, :, 2], atol=1e-8)
    np.testing.assert_allclose(only.linearised(at, seen)[1][..., -1], shared[:, :, 2])


def test_residuals_are_observed_minus_predicted() -> None:
    camera = small_camera()
    seen = observed(camera, spread_directions(20))
    shifted = replace(seen, pixels=seen.pixels + np.array([0.5, -0.25]))
    problem = small_problem(camera)
    np.testing.assert_allclose(problem.residuals(problem.unknowns([camera]), seen), 0.0, atol=1e-8)
    residual = problem.residuals(problem.unknowns([camera]), shifted)
    np.testing.assert_allclose(residual, np.tile([0.5, -0.25], (20, 1)), atol=1e-8)


def test_a_direction_that_the_camera_cannot_see_is_ten_thousand_pixels_off() -> None:
    camera = small_camera("orthographic")
    down = np.array([[0.1, 0.2, -math.sqrt(0.95)]])
    seen = Sightings(
        directions=down, pixels=np.zeros((1, 2)), information=np.ones(1), epoch=np.zeros(1, dtype=np.int64)
    )
    problem = small_problem(camera)
    at = problem.unknowns([camera])
    np.testing.assert_allclose(problem.residuals(at, seen), 1e4)
    np.testing.assert_allclose(problem.linearised(at, seen)[0], 1e4)


@pytest.mark.parametrize("projection", ["equisolid", "perspective", "stereographic"])
@pytest.mark.parametrize("mirrored", [False, True])
def test_derivatives_are_finite_differences_of_the_prediction(projection: Projection, *, mirrored: bool) -> None:
    camera = small_camera(projection, mirrored=mirrored)
    directions = spread_directions(7, widest_deg=50.0)
    seen = observed(camera, directions)
    problem = small_problem(camera)
    at = problem.unknowns([camera]) + 0.01
    residual, rows = problem.linearised(at, seen)
    np.testing.assert_allclose(residual, problem.residuals(at, seen), atol=1e-9)
    expected = numerical_derivative(lambda x: seen.pixels - problem.residuals(x, seen), at, step=1e-5)
    np.testing.assert_allclose(rows, expected, rtol=1e-5, atol=2e-5)


def test_derivatives_of_two_poses_belong_to_their_own_sightings() -> None:
    camera = small_camera()
    directions = spread_directions(10)
    seen = observed(camera, directions)
    seen = replace(seen, epoch=np.arange(10) % 2)
    problem = small_problem(camera, n_epochs=2)
    at = problem.unknowns([camera, _turned(camera, 0.02)])
    _, rows = problem.linearised(at, seen)
    expected = numerical_derivative(lambda x: seen.pixels - problem.residuals(x, seen), at, step=1e-5)
    np.testing.assert_allclose(rows, expected, rtol=1e-5, atol=2e-5)
    np.testing.assert_allclose(rows[seen.epoch == 0][..., 20:23], 0.0)
    np.testing.assert_allclose(rows[seen.epoch == 1][..., 17:20], 0.0)


@pytest.mark.parametrize("mirrored", [False, True])
def test_by_elevation_is_the_finite_difference_of_a_rising_direction(*, mirrored: bool) -> None:
    camera = small_camera(mirrored=mirrored)
    directions = spread_directions(9)
    rows = by_direction(camera, project_with_rows_fast(camera, directions)[1])
    step = 1e-6
    up, down = (project(camera, raised(directions, np.full(9, sign * step))) for sign in (1.0, -1.0))
    np.testing.assert_allclose(by_elevation(directions, rows), (up - down) / (2.0 * step), rtol=1e-5, atol=1e-3)


def test_the_fit_answers_as_far_as_the_projection_has_angles() -> None:
    camera = replace(small_camera("orthographic"), max_angle=0.3)
    problem = small_problem(camera)
    assert problem.template.max_angle == pytest.approx(angle_limit("orthographic"), rel=1e-5)
    assert problem.template.max_angle < angle_limit("orthographic")
    assert problem_for(camera, problem.prior, n_epochs=3).n_epochs == 3


@pytest.mark.parametrize("limit_deg", [95.0, 120.0])
def test_directions_beyond_the_angle_that_the_camera_answers_are_told_apart_in_each_epoch(limit_deg: float) -> None:
    camera = small_camera()
    level = replace(camera, rotation_cam_enu=(0.0, 0.0, 0.0))
    tilted = replace(camera, rotation_cam_enu=(math.radians(30.0), 0.0, 0.0))  # the axis leans to the north
    prior = small_problem(camera).prior
    problem = problem_for(camera, prior, n_epochs=2, max_angle=math.radians(limit_deg))
    elevation = np.radians([80.0, 2.0, -4.0, -6.0, 25.0, -31.0])
    south = np.stack([np.zeros(6), -np.cos(elevation), np.sin(elevation)], axis=-1)
    for epoch, lean in enumerate((0.0, 30.0)):
        seen = Sightings(
            directions=south, pixels=np.zeros((6, 2)), information=np.ones(6), epoch=np.full(6, epoch, dtype=np.int64)
        )
        off_axis = 90.0 - np.degrees(elevation) + lean
        beyond = problem.beyond(problem.unknowns([level, tilted]), seen)
        assert beyond.tolist() == (off_axis > limit_deg).tolist()


def test_a_right_angle_off_the_axis_always_counts() -> None:
    problem = problem_for(small_camera(), small_problem(small_camera()).prior, n_epochs=1, max_angle=0.5)
    assert problem.max_angle == pytest.approx(math.pi / 2)


def test_usable_sightings_hold_the_inverse_square_of_the_relative_sigma() -> None:
    times = 1_368_468_000.0 + 600.0 * np.arange(30.0)
    pixels = np.stack([100.0 + 5.0 * np.arange(30.0), 200.0 + 3.0 * np.arange(30.0)], axis=-1)
    sigma = np.where(np.arange(30) % 2, 0.2, 0.1)
    usable = filter_sightings(Sightings.of(unix_s=times, pixels=pixels, sigma_px=sigma), site=SGP)
    ratio = usable.information[usable.index % 2 == 0][0] / usable.information[usable.index % 2 == 1][0]
    assert ratio == pytest.approx(4.0)


def test_a_selection_and_new_information_keep_the_rest() -> None:
    seen = observed(ideal_camera(), spread_directions(6))
    assert seen.refraction_sd.shape == (6, 1)
    some = seen.select(np.array([4, 1]))
    np.testing.assert_allclose(some.pixels, seen.pixels[[4, 1]])
    np.testing.assert_allclose(some.directions, seen.directions[[4, 1]])
    heavier = replace(seen, information=np.full(6, 9.0))
    np.testing.assert_allclose(heavier.information, 9.0)
    np.testing.assert_allclose(heavier.pixels, seen.pixels)
    assert len(seen.select(slice(0, 0))) == 0


def test_shared_errors_displace_the_prediction() -> None:
    camera = small_camera()
    seen = replace(
        observed(camera, spread_directions(8)), systematic_px=np.random.default_rng(4).normal(0.0, 0.1, (8, 2, 3))
    )
    problem = replace(small_problem(camera), blocks=BLOCKS)
    at = np.concatenate([problem.unknowns([camera])[:-3], [0.4, -0.7, 1.3]])
    residual, rows = problem.linearised(at, seen)
    np.testing.assert_allclose(residual, problem.residuals(at, seen), atol=1e-9)
    expected = numerical_derivative(lambda x: seen.pixels - problem.residuals(x, seen), at, step=1e-4)
    np.testing.assert_allclose(rows[..., -3:], expected[..., -3:], rtol=1e-4, atol=1e-5)
    np.testing.assert_allclose(rows[..., -3:], seen.systematic_px)
