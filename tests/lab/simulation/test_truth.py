"""The true cameras are what the paper's table and the population of lenses say."""

from __future__ import annotations

import json
import math
from dataclasses import replace
from datetime import UTC, datetime

import numpy as np
import pytest

from sunarc.calibration.answers.covariance import project_with_covariance
from sunarc.formats.calibration_document import from_document
from sunarc.lab.simulation.imager import truth_document
from sunarc.lab.simulation.truth import SGP, true_camera
from sunarc.optics.camera import Camera
from sunarc.optics.forward import decentering_shift, distorted_radius, project, rising_limit
from sunarc.optics.pose import pose_angles
from sunarc.sky.directions import direction_from_angles

THETA = np.linspace(0.0, math.pi / 2, 2001)


def residual_px(camera: Camera) -> np.ndarray[tuple[int], np.dtype[np.float64]]:
    return np.asarray((distorted_radius(camera, THETA) - 2.0 * np.sin(THETA / 2.0)) * camera.focal_length_px[0])


def test_the_first_camera_is_case_3_of_table_2() -> None:
    camera = true_camera()
    assert camera.focal_length_px == (601.32, 601.32)
    assert camera.principal_point_px == (871.96, 883.00)
    assert camera.skew_px == 2.57e-3
    assert pose_angles(camera.rotation_cam_enu) == pytest.approx((47.91, 2.46, 140.16))
    assert (camera.width, camera.height, camera.projection) == (1748, 1748, "equisolid")


def test_its_residuals_are_1_7_and_0_9_px() -> None:
    camera = true_camera()
    assert np.max(np.abs(residual_px(camera))) == pytest.approx(1.7, abs=0.01)
    angle = np.linspace(0.0, 2.0 * math.pi, 721)
    u, v = np.cos(angle), np.sin(angle)
    shift_x, shift_y = decentering_shift(camera.decentering, np.full_like(angle, math.sqrt(2.0)), u, v)
    assert float(np.max((shift_x * u + shift_y * v) * 601.32)) == pytest.approx(0.9, abs=0.001)


@pytest.mark.parametrize("lens_seed", range(6))
def test_the_radial_residual_is_orthogonal_to_the_projection(lens_seed: int) -> None:
    residual, ideal = residual_px(true_camera(lens_seed)), 2.0 * np.sin(THETA / 2.0)
    along, ideal_size, size = (np.trapezoid(f, THETA) for f in (residual * ideal, ideal**2, residual**2))
    assert abs(float(along)) < 1e-3 * math.sqrt(float(ideal_size * size))


@pytest.mark.parametrize("lens_seed", range(1, 12))
def test_drawn_cameras_are_of_the_population(lens_seed: int) -> None:
    camera = true_camera(lens_seed)
    pose = pose_angles(camera.rotation_cam_enu)
    assert camera == true_camera(lens_seed)
    assert camera != true_camera(lens_seed + 1)
    assert pose.theta_zz_deg <= 5.0
    assert 0.05 < np.std(residual_px(camera)) < 5.0
    assert abs(camera.principal_point_px[0] - 873.5) < 20.0
    assert rising_limit(camera, up_to=math.radians(93.0)) == pytest.approx(math.radians(93.0))


def test_the_document_is_a_calibration_of_that_very_camera_and_sure_of_it() -> None:
    camera = true_camera(2)
    document = truth_document(camera, SGP, name="demo", created_at=datetime(2013, 5, 13, 12, tzinfo=UTC))
    truth = from_document(json.loads(json.dumps(document)))
    direction = direction_from_angles(zenith_deg=[0.0, 50.0], azimuth_deg=[0.0, 200.0])
    pixels, covariance = project_with_covariance(truth, direction)
    assert replace(truth.camera, max_angle=camera.max_angle) == camera
    assert truth.camera.max_angle == pytest.approx(camera.max_angle)
    assert document["created_at"] == "2013-05-13T12:00:00Z"
    np.testing.assert_allclose(pixels, project(camera, direction), atol=1e-9)
    np.testing.assert_array_equal(covariance, 0.0)
