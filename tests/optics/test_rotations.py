"""Rotation vectors, matrices, the right Jacobian and the angles of Table 2, against their definitions."""

from __future__ import annotations

import math

import numpy as np
import pytest
from numpy.typing import NDArray
from scipy.spatial.transform import Rotation
from tests.optics.reference import rodrigues

from sunarc.optics.pose import (
    PoseAngles,
    pose_angles,
    right_jacobian,
    rotation_between,
    rotation_from_pose_angles,
    rotation_matrix,
    rotation_vector,
    rotation_vectors,
)

FloatArray = NDArray[np.float64]
RNG = np.random.default_rng(3)
VECTORS = [np.array(v) for v in ((0.0, 0.0, 0.0), (1e-9, -2e-9, 3e-9), (3e-6, 4e-6, 0.0), (1.2e-5, 0.0, 0.0))]
VECTORS += [RNG.normal(0.0, 0.8, 3) for _ in range(20)]
VECTORS += [np.array([3.0, 0.5, -0.4]), np.array([0.0, 0.0, math.pi - 1e-6])]


def test_the_matrix_is_rodrigues_formula_and_a_rotation() -> None:
    for vector in VECTORS:
        matrix = rotation_matrix(vector)
        np.testing.assert_allclose(matrix, rodrigues(vector), atol=1e-14)
        np.testing.assert_allclose(matrix @ matrix.T, np.eye(3), atol=1e-14)
        assert np.linalg.det(matrix) == pytest.approx(1.0, abs=1e-14)
        np.testing.assert_allclose(matrix @ vector, vector, atol=1e-14)  # the axis stays


def test_a_quarter_turn_about_the_vertical_takes_east_to_north() -> None:
    matrix = rotation_matrix((0.0, 0.0, math.pi / 2.0))
    np.testing.assert_allclose(matrix @ [1.0, 0.0, 0.0], [0.0, 1.0, 0.0], atol=1e-15)


def test_vector_and_matrix_undo_one_another_up_to_half_a_turn() -> None:
    for vector in VECTORS:
        np.testing.assert_allclose(rotation_vector(rotation_matrix(vector)), vector, atol=1e-9)
    beyond = np.array([0.0, 0.0, 1.5 * math.pi])
    np.testing.assert_allclose(rotation_vector(rotation_matrix(beyond)), [0.0, 0.0, -0.5 * math.pi], atol=1e-14)


def test_many_rotations_are_those_of_scipy_at_every_angle() -> None:
    small = 10.0 ** RNG.uniform(-12.0, 0.0, 300)
    angles = np.concatenate([np.zeros(3), small, math.pi - small, RNG.uniform(0.0, 2.0 * math.pi, 300)])
    axes = RNG.normal(size=(angles.size, 3))
    vectors = axes / np.linalg.norm(axes, axis=-1, keepdims=True) * angles[:, None]
    expected = Rotation.from_rotvec(vectors)
    np.testing.assert_allclose(rotation_matrix(vectors), expected.as_matrix(), atol=1e-14)
    np.testing.assert_allclose(rotation_vectors(expected.as_matrix()), expected.as_rotvec(), atol=1e-13)


def test_the_angle_between_two_poses() -> None:
    one = (0.3, -0.2, 1.0)
    other = (Rotation.from_rotvec([0.0, 0.0, math.radians(5.0)]) * Rotation.from_rotvec(one)).as_rotvec()
    assert rotation_between(one, other) == pytest.approx(math.radians(5.0))
    assert rotation_between(one, one) == pytest.approx(0.0, abs=1e-12)


def skew_matrix(v: FloatArray) -> FloatArray:
    """Return the matrix whose product with u is v × u."""
    return np.cross(v, np.eye(3)).T


def test_the_right_jacobian_is_the_difference_quotient_of_the_rotation() -> None:
    # exp(w + h e) ≈ exp(w) exp(J h e): the vector of exp(w)ᵀ exp(w ± h e) over h is the column of J
    for vector in VECTORS[:-1]:
        turned = rodrigues(vector).T
        quotient = [
            np.subtract(
                rotation_vector(turned @ rodrigues(vector + step)), rotation_vector(turned @ rodrigues(vector - step))
            )
            / 2e-5
            for step in 1e-5 * np.eye(3)
        ]
        np.testing.assert_allclose(right_jacobian(vector), np.stack(quotient, axis=-1), atol=2e-9)


def test_the_right_jacobian_of_small_rotations_is_its_series_on_both_sides_of_the_switch() -> None:
    axis = np.array([0.6, -0.64, 0.48])
    axis /= np.linalg.norm(axis)
    for angle in (1e-8, 0.99e-5, 1.01e-5, 1e-4, 1e-3):
        skew = skew_matrix(axis * angle)
        series = np.eye(3) - skew / 2.0 + skew @ skew / 6.0 - skew @ skew @ skew / 24.0
        np.testing.assert_allclose(right_jacobian(axis * angle), series, atol=2e-11)


def test_the_right_jacobian_times_its_vector_is_the_vector_and_its_determinant_is_known() -> None:
    for vector in VECTORS:
        angle = float(np.linalg.norm(vector))
        jacobian = right_jacobian(vector)
        np.testing.assert_allclose(jacobian @ vector, vector, atol=1e-14)
        expected = 2.0 * (1.0 - math.cos(angle)) / angle**2 if angle > 1e-3 else 1.0
        assert np.linalg.det(jacobian) == pytest.approx(expected, abs=1e-9)


@pytest.mark.parametrize(
    ("angles", "x_axis", "z_axis"),
    [
        # level, x to the east: y (down in the image) is to the north, the image is seen from below
        (PoseAngles(0.0, 0.0, 0.0), (1.0, 0.0, 0.0), (0.0, 0.0, 1.0)),
        (PoseAngles(90.0, 0.0, 0.0), (0.0, 1.0, 0.0), (0.0, 0.0, 1.0)),
        # leaning 30 degrees to the east: x to the east points down as much
        (PoseAngles(0.0, 30.0, 90.0), (math.sqrt(0.75), 0.0, -0.5), (0.5, 0.0, math.sqrt(0.75))),
        # leaning to the north, x stays level
        (PoseAngles(0.0, 30.0, 0.0), (1.0, 0.0, 0.0), (0.0, 0.5, math.sqrt(0.75))),
        (PoseAngles(180.0, 30.0, 180.0), (-1.0, 0.0, 0.0), (0.0, -0.5, math.sqrt(0.75))),
    ],
)
def test_the_axes_of_a_pose_stand_where_its_angles_say(
    angles: PoseAngles, x_axis: tuple[float, ...], z_axis: tuple[float, ...]
) -> None:
    matrix = rotation_matrix(rotation_from_pose_angles(angles))
    np.testing.assert_allclose(matrix[0], x_axis, atol=1e-12)
    np.testing.assert_allclose(matrix[2], z_axis, atol=1e-12)
    np.testing.assert_allclose(matrix[1], np.cross(z_axis, x_axis), atol=1e-12)


def test_angles_come_back_from_every_pose() -> None:
    for phi in (-170.0, -45.0, 0.0, 47.91, 135.0):
        for tilt in (0.001, 2.46, 45.0, 89.0):
            for lean in (0.0, 12.0, 140.16, 200.0, 359.5):
                found = pose_angles(rotation_from_pose_angles(PoseAngles(phi, tilt, lean)))
                assert found.phi_xz_deg == pytest.approx(phi, abs=1e-9)
                assert found.theta_zz_deg == pytest.approx(tilt, abs=1e-9)
                assert (found.psi_z_deg - lean + 180.0) % 360.0 - 180.0 == pytest.approx(0.0, abs=1e-6)
                assert 0.0 <= found.psi_z_deg < 360.0


def test_a_level_camera_leans_nowhere_and_one_that_looks_down_is_tilted_by_180_degrees() -> None:
    level = pose_angles((0.0, 0.0, 0.3))
    assert level.psi_z_deg == 0.0
    almost_north = rotation_vector(rotation_matrix((0.2, 0.0, 0.0)) @ rotation_matrix((0.0, 1e-17, 0.0)))
    assert 0.0 <= pose_angles(almost_north).psi_z_deg < 360.0
    assert level.theta_zz_deg == 0.0
    assert level.phi_xz_deg == pytest.approx(-math.degrees(0.3))  # the rows are the camera's axes
    assert pose_angles((math.pi, 0.0, 0.0)).theta_zz_deg == pytest.approx(180.0)


def test_the_matrix_and_jacobian_near_the_end_of_the_series_are_those_of_scipy() -> None:
    for scale in (9e-4, 1.1e-3):
        vector = np.array([scale, 0.3 * scale, -0.2 * scale])
        np.testing.assert_allclose(rotation_matrix(vector), Rotation.from_rotvec(vector).as_matrix(), atol=2e-14)
        for k, change in enumerate(1e-6 * np.eye(3)):
            turned = Rotation.from_rotvec(vector).inv() * Rotation.from_rotvec(vector + change)
            np.testing.assert_allclose(turned.as_rotvec() / 1e-6, right_jacobian(vector)[:, k], atol=1e-6)
