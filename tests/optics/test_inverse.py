"""The exact inverse, and the table that stands for it."""

from __future__ import annotations

import math
from dataclasses import replace

import numpy as np
from hypothesis import given, settings
from hypothesis import strategies as st
from numpy.typing import NDArray

from sunarc.optics.camera import Camera
from sunarc.optics.forward import project, project_fast, project_with_jacobian, project_with_rows_fast
from sunarc.optics.inverse import unproject
from sunarc.optics.inverse_table import inverse_table
from sunarc.optics.pose import PoseAngles, pose_angles, rotation_from_pose_angles

FloatArray = NDArray[np.float64]

EQUISOLID = Camera(
    width=1748,
    height=1748,
    projection="equisolid",
    focal_length_px=(601.32, 601.32),
    principal_point_px=(871.96, 883.0),
    rotation_cam_enu=(0.0, 0.0, 0.0),
    decentering=(2e-4, -1e-4, 0.1, -0.05),
)


def test_unproject_undoes_project(camera: Camera, directions: FloatArray) -> None:
    np.testing.assert_allclose(unproject(camera, project(camera, directions)), directions, atol=1e-11)


@settings(derandomize=True, deadline=None, max_examples=60)
@given(
    zenith=st.floats(0.0, 89.0),
    azimuth=st.floats(0.0, 360.0),
    tilt=st.floats(0.0, 60.0),
    lean=st.floats(0.0, 360.0),
    k=st.floats(-0.02, 0.02),
    mirrored=st.booleans(),
)
def test_a_direction_comes_back_from_any_pose(
    *, zenith: float, azimuth: float, tilt: float, lean: float, k: float, mirrored: bool
) -> None:
    from sunarc.sky.directions import direction_from_angles  # noqa: PLC0415 - used here alone

    turn = rotation_from_pose_angles(PoseAngles(30.0, tilt, lean))
    camera = replace(EQUISOLID, rotation_cam_enu=turn, radial=(k, *([0.0] * 7)), mirrored=mirrored, max_angle=2.7)
    direction = direction_from_angles(zenith_deg=zenith, azimuth_deg=azimuth)
    np.testing.assert_allclose(unproject(camera, project(camera, direction)), direction, atol=1e-9)


def test_pixels_outside_the_field_have_no_direction(camera: Camera) -> None:
    assert np.all(np.isnan(unproject(camera, [-5e4, -5e4])))
    assert np.all(np.isnan(inverse_table(camera).directions([[-5e4, -5e4], [np.nan, 3.0]])))


def test_table_equals_the_exact_inverse_to_a_millionth_of_a_pixel(camera: Camera, directions: FloatArray) -> None:
    pixels = project(camera, directions)
    found = inverse_table(camera).directions(pixels)
    focal = camera.focal_length_px[0]
    assert np.max(np.linalg.norm(found - directions, axis=-1)) * focal < 1e-6
    assert inverse_table(camera).directions(pixels.reshape(2, -1, 2)).shape == (2, pixels.shape[0] // 2, 3)


def test_compiled_projection_equals_numpy(camera: Camera, directions: FloatArray) -> None:
    shifted = replace(camera, translation=(1e-3, -2e-3, 5e-4))
    beyond = np.concatenate([directions, -directions[:3]])
    np.testing.assert_allclose(project_fast(shifted, beyond), project(shifted, beyond), atol=1e-9)


def test_compiled_derivatives_equal_numpy(camera: Camera, directions: FloatArray) -> None:
    wide = replace(camera, max_angle=camera.max_angle + 0.01, translation=(1e-3, -2e-3, 5e-4))
    pixels, by_parameters, _ = project_with_jacobian(wide, directions)
    fast_pixels, rows = project_with_rows_fast(wide, directions)
    np.testing.assert_allclose(fast_pixels, pixels, atol=1e-9)
    np.testing.assert_allclose(rows, by_parameters, rtol=1e-9, atol=1e-7)


def test_compiled_derivatives_are_nothing_beyond_the_field(level: Camera) -> None:
    angle = level.max_angle + 0.01
    pixels, rows = project_with_rows_fast(level, np.array([[math.sin(angle), 0.0, math.cos(angle)]]))
    assert np.all(np.isnan(pixels))
    assert not np.any(rows)


def test_table_2_angles_survive_the_rotation_vector() -> None:
    angles = PoseAngles(phi_xz_deg=47.91, theta_zz_deg=2.46, psi_z_deg=140.16)
    np.testing.assert_allclose(pose_angles(rotation_from_pose_angles(angles)), angles, atol=1e-9)
