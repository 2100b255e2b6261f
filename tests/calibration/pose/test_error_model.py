"""The error model of a calibration in the camera's own axes, against finite differences and the stated covariance."""

from __future__ import annotations

import math
from dataclasses import replace

import numpy as np
import pytest
from numpy.typing import NDArray
from scipy.spatial.transform import Rotation
from tests.fixtures.calibration import (
    numerical_derivative,
    random_covariance,
    small_camera,
    small_errors,
    spread_directions,
    stated_calibration,
)

from sunarc.calibration.answers.covariance import project_with_covariance
from sunarc.calibration.answers.error_model import (
    build_error_model,
    coefficient_covariance,
    joint_covariance,
    moved,
    parameter_covariance,
    predicted,
    rotated,
)
from sunarc.calibration.model.result import Calibration
from sunarc.common.errors import InputError
from sunarc.optics.camera import Camera
from sunarc.optics.forward import project
from sunarc.optics.pose import rotation_matrix
from sunarc.optics.projections import angle_limit

FloatArray = NDArray[np.float64]
TURN = np.array([0.02, -0.05, 0.03])


@pytest.fixture(scope="module")
def calibration() -> Calibration:
    scale = np.sqrt(np.diag(small_errors()))
    plain = stated_calibration(
        small_camera(), covariance=random_covariance(20, seed=2) * np.outer(scale, scale), amplitude_px=0.3
    )
    cross = np.random.default_rng(1).standard_normal((2, 20, len(plain.field.basis.orders)))
    return replace(plain, field=replace(plain.field, cross=1e-3 * cross * scale[:, None]))


def test_a_rotation_by_nothing_leaves_the_camera() -> None:
    camera = small_camera()
    found = rotated(camera, np.zeros(3))
    np.testing.assert_allclose(
        rotation_matrix(found.rotation_cam_enu), rotation_matrix(camera.rotation_cam_enu), atol=1e-12
    )


def test_a_rotation_is_about_the_camera_s_own_axes() -> None:
    camera = small_camera()
    expected = Rotation.from_rotvec(TURN).as_matrix() @ rotation_matrix(camera.rotation_cam_enu)
    np.testing.assert_allclose(rotation_matrix(rotated(camera, TURN).rotation_cam_enu), expected, atol=1e-12)


def test_every_angle_is_nearly_the_projection_s_limit() -> None:
    camera = replace(small_camera("orthographic"), max_angle=0.2)
    limit = angle_limit("orthographic")
    assert limit * (1.0 - 1e-5) < camera.at_every_angle().max_angle < limit


def test_a_changed_camera_has_the_parameters_and_the_rotation(calibration: Calibration) -> None:
    model, camera = build_error_model(calibration), calibration.camera
    change = np.zeros(20)
    change[0], change[model.rotation] = 0.7, TURN
    found = moved(camera, model, change)
    assert found.focal_length_px[0] == pytest.approx(camera.focal_length_px[0] + 0.7)
    assert found.focal_length_px[1] == camera.focal_length_px[1]
    np.testing.assert_allclose(found.rotation_cam_enu, rotated(camera, TURN).rotation_cam_enu, atol=1e-12)


def test_derivatives_are_finite_differences_of_the_changed_camera(calibration: Calibration) -> None:
    model, camera = build_error_model(calibration), calibration.camera
    directions = spread_directions(6)
    found = predicted(model, camera, directions)
    rows = numerical_derivative(lambda change: project(moved(camera, model, change), directions), np.zeros(20))
    np.testing.assert_allclose(found.rows, rows, rtol=1e-5, atol=1e-4)
    np.testing.assert_allclose(found.pixels, project(camera, directions), atol=1e-9)
    np.testing.assert_allclose(found.basis_values, model.field.basis.values(found.pixels))


def test_the_joint_covariance_has_the_stated_one_in_its_blocks(calibration: Calibration) -> None:
    directions = spread_directions(5)
    model = build_error_model(calibration)
    at = predicted(model, calibration.camera, directions)
    joint = joint_covariance(model, at).reshape(5, 2, 5, 2)
    _, expected = project_with_covariance(calibration, directions)
    for n in range(5):
        np.testing.assert_allclose(joint[n, :, n], expected[n], rtol=1e-6, atol=1e-9)


def test_the_joint_covariance_is_that_of_draws() -> None:
    camera = small_camera()
    calibration = stated_calibration(camera, amplitude_px=0.3)
    model, directions = build_error_model(calibration), spread_directions(4)
    at = predicted(model, camera, directions)
    rng, n = np.random.default_rng(2), 4000
    change = rng.standard_normal((n, 20)) * np.sqrt(np.diag(model.covariance))
    coefficients = rng.standard_normal((n, 2, model.variances.size)) * np.sqrt(model.variances)
    errors = np.einsum("nap,kp->kna", at.rows, change) + np.einsum("nm,kam->kna", at.basis_values, coefficients)
    found, expected = joint_covariance(model, at), np.cov(errors.reshape(n, -1).T)
    scale = np.sqrt(np.diag(found))
    np.testing.assert_allclose(expected / np.outer(scale, scale), found / np.outer(scale, scale), atol=0.09)


def test_the_field_is_alike_at_near_places_and_its_axes_are_apart() -> None:
    camera = small_camera()
    calibration = stated_calibration(camera, covariance=np.zeros((20, 20)), amplitude_px=0.5, length_px=100.0)
    model = build_error_model(calibration)
    at = predicted(model, camera, spread_directions(3))
    joint = joint_covariance(model, at).reshape(3, 2, 3, 2)
    apart = np.linalg.norm(at.pixels[0] - at.pixels[1])
    expected = 0.25 * math.exp(-0.5 * (apart / 100.0) ** 2)
    np.testing.assert_allclose(joint[0, :, 1], expected * np.eye(2), atol=1e-12)


def test_the_covariance_of_the_parameters_with_the_prediction(calibration: Calibration) -> None:
    model = build_error_model(calibration)
    at = predicted(model, calibration.camera, spread_directions(3))
    flat = at.rows.reshape(6, 20)
    expected = model.covariance @ flat.T
    for n in range(3):
        for axis in (0, 1):
            expected[:, 2 * n + axis] += model.field.cross[axis] @ at.basis_values[n]
    np.testing.assert_allclose(parameter_covariance(model, at), expected, rtol=1e-10)


def test_the_covariance_of_the_prediction_with_the_field_s_coefficients(calibration: Calibration) -> None:
    model = build_error_model(calibration)
    at = predicted(model, calibration.camera, spread_directions(3))
    for axis in (0, 1):
        expected = at.rows.reshape(6, 20) @ model.field.cross[axis]
        expected[axis::2] += at.basis_values * model.variances
        np.testing.assert_allclose(coefficient_covariance(model, at, axis), expected, rtol=1e-10)


def test_without_a_field_there_are_no_waves() -> None:
    model = build_error_model(stated_calibration(small_camera()))
    at = predicted(model, small_camera(), spread_directions(3))
    assert at.basis_values.shape == (3, 0)
    flat = at.rows.reshape(6, 20)
    np.testing.assert_allclose(joint_covariance(model, at), flat @ model.covariance @ flat.T, rtol=1e-10)
    np.testing.assert_allclose(parameter_covariance(model, at), model.covariance @ flat.T, rtol=1e-10)


def test_a_field_shorter_than_16_px_is_taken_as_16() -> None:
    calibration = stated_calibration(small_camera(), amplitude_px=0.1)
    short = replace(calibration, field=replace(calibration.field, length_px=3.0))
    assert build_error_model(short).field.length_px == 16.0
    assert build_error_model(calibration).field.length_px == 160.0


def test_waves_that_a_document_left_out_come_back_without_cross_terms(calibration: Calibration) -> None:
    orders = calibration.field.basis.orders
    kept = np.arange(len(orders)) % 2 == 0
    basis = replace(calibration.field.basis, orders=orders[kept])
    thin = replace(calibration, field=replace(calibration.field, basis=basis, cross=calibration.field.cross[..., kept]))
    whole, found = build_error_model(calibration), build_error_model(thin)
    assert len(found.field.basis.orders) == len(whole.field.basis.orders)
    np.testing.assert_allclose(found.field.cross[..., kept], whole.field.cross[..., kept])
    np.testing.assert_array_equal(found.field.cross[..., ~kept], 0.0)


def test_a_calibration_without_its_pose_is_refused() -> None:
    names = ("focal_length_x_px", "rotation_x", "rotation_y")
    with pytest.raises(InputError, check=lambda error: error.field == "uncertainty.parameters"):
        build_error_model(stated_calibration(small_camera(), names=names))


def test_a_free_rotation_widens_the_pose_and_nothing_else(calibration: Calibration) -> None:
    model = build_error_model(calibration)
    wider = model.add_free_rotation(TURN, sigma_rad=0.2)
    difference = wider.covariance - model.covariance
    np.testing.assert_allclose(difference[np.ix_(model.rotation, model.rotation)], 0.04 * np.eye(3), atol=1e-12)
    difference[np.ix_(model.rotation, model.rotation)] = 0.0
    np.testing.assert_array_equal(difference, 0.0)
    np.testing.assert_allclose(wider.mean[model.rotation], TURN)
    assert np.count_nonzero(wider.mean) == 3


def test_a_camera_turned_as_a_whole_keeps_its_errors() -> None:
    """In the camera's axes the covariance of pixels does not depend on where the camera is turned to."""
    calibration = stated_calibration(small_camera())
    model, directions = build_error_model(calibration), spread_directions(4)
    other: Camera = rotated(calibration.camera, np.array([0.4, 1.0, -2.0]))
    same_rays = directions @ rotation_matrix(calibration.camera.rotation_cam_enu).T
    elsewhere = same_rays @ rotation_matrix(other.rotation_cam_enu)
    first = joint_covariance(model, predicted(model, calibration.camera, directions))
    second = joint_covariance(model, predicted(model, other.at_every_angle(), elsewhere))
    np.testing.assert_allclose(first, second, rtol=1e-6, atol=1e-9)
