"""The direct linear transform (Eqs. 23 to 25): exact from exact points, and its null spaces."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import pytest
from tests.fixtures.calibration import ideal_camera, observed, small_camera, spread_directions

from sunarc.calibration.model.sightings import Sightings
from sunarc.calibration.paper import direct_linear_pose
from sunarc.optics.camera import Camera
from sunarc.optics.forward import project
from sunarc.optics.pose import rotation_matrix


def _of(camera: Camera, *, count: int = 40) -> Sightings:
    return observed(camera, spread_directions(count, widest_deg=70.0))


@pytest.mark.parametrize("mirrored", [False, True])
def test_the_pose_of_exact_sightings_is_exact(*, mirrored: bool) -> None:
    camera = small_camera(mirrored=mirrored)
    start = replace(camera, rotation_cam_enu=(0.0, 0.0, 0.0))
    found = direct_linear_pose(start, _of(camera))
    np.testing.assert_allclose(
        rotation_matrix(found.rotation_cam_enu), rotation_matrix(camera.rotation_cam_enu), atol=1e-5
    )
    np.testing.assert_allclose(found.translation, 0.0, atol=1e-5)


def test_a_translation_is_found() -> None:
    camera = replace(ideal_camera(), rotation_cam_enu=(0.1, -0.2, 0.5), translation=(0.05, -0.02, 0.03))
    found = direct_linear_pose(
        replace(camera, rotation_cam_enu=(0.0, 0.0, 0.0), translation=(0.0, 0.0, 0.0)), _of(camera)
    )
    np.testing.assert_allclose(found.translation, camera.translation, atol=1e-5)
    np.testing.assert_allclose(
        rotation_matrix(found.rotation_cam_enu), rotation_matrix(camera.rotation_cam_enu), atol=1e-5
    )
    np.testing.assert_allclose(project(found, _of(camera).directions), _of(camera).pixels, atol=1e-2)


def test_a_rotation_is_right_handed_from_noisy_sightings() -> None:
    camera = small_camera()
    seen = observed(camera, spread_directions(40, widest_deg=70.0), sigma_px=1.0)
    found = direct_linear_pose(camera, seen)
    assert np.linalg.det(rotation_matrix(found.rotation_cam_enu)) == pytest.approx(1.0)
    assert np.degrees(np.linalg.norm(np.subtract(found.rotation_cam_enu, camera.rotation_cam_enu))) < 3.0


def test_pixels_without_a_ray_are_left_aside() -> None:
    camera = small_camera("orthographic")
    seen = _of(camera)
    pixels = seen.pixels.copy()
    pixels[:5] = 1e5
    found = direct_linear_pose(camera, replace(seen, pixels=pixels))
    np.testing.assert_allclose(
        rotation_matrix(found.rotation_cam_enu), rotation_matrix(camera.rotation_cam_enu), atol=1e-5
    )
