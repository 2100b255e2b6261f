"""The forward model and its derivatives."""

from __future__ import annotations

import math
from dataclasses import replace

import numpy as np
from numpy.typing import NDArray

from sunarc.optics.camera import Camera
from sunarc.optics.forward import local_stretch, project, project_with_jacobian

FloatArray = NDArray[np.float64]


def test_parameters_survive_the_vector(camera: Camera) -> None:
    assert camera.replace_parameters(camera.to_vector()) == camera


def test_derivatives_by_parameters_equal_central_differences(camera: Camera, directions: FloatArray) -> None:
    _, by_parameters, _ = project_with_jacobian(camera, directions[2:])
    wide, vector = replace(camera, max_angle=camera.max_angle + 0.01), camera.to_vector()
    for i in range(vector.size):
        step = np.zeros_like(vector)
        step[i] = 1e-6 * max(1.0, abs(vector[i]))
        ahead = project(wide.replace_parameters(vector + step), directions[2:])
        behind = project(wide.replace_parameters(vector - step), directions[2:])
        numeric = (ahead - behind) / (2.0 * step[i])
        np.testing.assert_allclose(by_parameters[..., i], numeric, rtol=2e-5, atol=2e-5 * np.abs(numeric).max() + 1e-7)


def test_derivatives_by_direction_equal_central_differences(camera: Camera, directions: FloatArray) -> None:
    _, _, by_direction = project_with_jacobian(camera, directions[2:])
    wide = replace(camera, max_angle=camera.max_angle + 0.01)
    for axis in np.eye(3):
        numeric = (project(wide, directions[2:] + 1e-6 * axis) - project(wide, directions[2:] - 1e-6 * axis)) / 2e-6
        np.testing.assert_allclose(by_direction @ axis, numeric, rtol=1e-5, atol=1e-4)


def test_broadcasting_equals_a_loop(camera: Camera, directions: FloatArray) -> None:
    grid = directions[:12].reshape(3, 4, 3)
    looped = np.array([[project(camera, d) for d in row] for row in grid])
    np.testing.assert_allclose(project(camera, grid), looped, atol=1e-10)


def test_turning_the_world_and_the_camera_changes_nothing(camera: Camera, directions: FloatArray) -> None:
    from sunarc.optics.pose import rotation_matrix, rotation_vector  # noqa: PLC0415 - used here alone

    turn = rotation_matrix((0.3, -0.2, 0.7))
    turned = replace(camera, rotation_cam_enu=rotation_vector(rotation_matrix(camera.rotation_cam_enu) @ turn.T))
    np.testing.assert_allclose(project(turned, directions @ turn.T), project(camera, directions), atol=1e-6)


def test_mirrored_image_is_the_image_turned_over(camera: Camera, directions: FloatArray) -> None:
    seen, other = project(camera, directions), project(replace(camera, mirrored=not camera.mirrored), directions)
    np.testing.assert_allclose(seen[:, 0] + other[:, 0], camera.width - 1.0, atol=1e-9)
    np.testing.assert_allclose(seen[:, 1], other[:, 1], atol=1e-9)


def test_beyond_the_field_there_is_no_pixel(level: Camera) -> None:
    angle = level.max_angle + 1e-6
    assert np.all(np.isnan(project(level, [math.sin(angle), 0.0, math.cos(angle)])))


def test_stretch_maps_small_angles_to_pixels(camera: Camera, directions: FloatArray) -> None:
    stretch = local_stretch(camera, directions[5])
    area = 0.5 * np.abs(np.linalg.det(stretch)) * 1e-8
    first = np.cross(directions[5], [0.1, 0.2, 0.3])
    first /= np.linalg.norm(first)
    second = np.cross(directions[5], first)
    corners = project(camera, np.stack([directions[5], directions[5] + 1e-4 * first, directions[5] + 1e-4 * second]))
    (ax, ay), (bx, by) = corners[1] - corners[0], corners[2] - corners[0]
    np.testing.assert_allclose(0.5 * abs(ax * by - ay * bx), area, rtol=2e-3)
