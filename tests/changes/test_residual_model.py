"""The covariance of residuals when nothing has changed: its parts, each against its definition."""

from __future__ import annotations

import math
from dataclasses import replace

import numpy as np
import pytest
from numpy.typing import NDArray
from scipy.spatial.transform import Rotation
from scipy.special import gamma, kv
from tests.fixtures.calibration import SGP, small_camera, stated_calibration, sun_arc

from sunarc.calibration.answers.error_model import joint_covariance
from sunarc.calibration.model.result import Calibration
from sunarc.changes.online import errors_at, make_residual_model, wandering
from sunarc.changes.values import SightingWindow, WatchOptions
from sunarc.optics.forward import project
from sunarc.optics.pose import rotation_matrix, rotation_vector
from sunarc.sky.refraction import raised, refraction_rad

FloatArray = NDArray[np.float64]

STILL = WatchOptions(wander_deg=0.0)


def window_at(calibration: Calibration, directions: FloatArray, *, step_s: float = 300.0) -> SightingWindow:
    n = directions.shape[0]
    return SightingWindow(
        unix_s=1.4e9 + step_s * np.arange(n, dtype=np.float64),
        pixels=project(calibration.camera, directions),
        directions=directions,
        sigma_px=np.full(n, 0.2),
        trusted=np.ones(n, dtype=bool),
        surprise=np.zeros((n, 2)),
    )


@pytest.fixture(scope="module")
def calibration() -> Calibration:
    return stated_calibration(small_camera(), amplitude_px=0.2)


def test_a_mount_wanders_as_a_matern_process() -> None:
    times = np.array([0.0, 1800.0, 7200.0, 50_000.0])
    found = wandering(times, WatchOptions(wander_deg=0.5))
    np.testing.assert_allclose(np.diag(found), math.radians(0.5) ** 2)
    # Rasmussen and Williams (2006), eq. 4.14 with nu = 3/2
    scaled = math.sqrt(3.0) * times[1:] / 7200.0
    expected = 2.0 ** (1.0 - 1.5) / gamma(1.5) * scaled**1.5 * kv(1.5, scaled)
    np.testing.assert_allclose(found[0, 1:] / found[0, 0], expected, rtol=1e-9)
    np.testing.assert_allclose(found, found.T)


def test_residuals_are_observed_minus_predicted_and_their_noise_is_that_of_the_sightings(
    calibration: Calibration,
) -> None:
    window = window_at(calibration, sun_arc(6))
    shifted = replace(window, pixels=window.pixels + np.array([0.3, -0.1]))
    found = make_residual_model(shifted, calibration, STILL)
    np.testing.assert_allclose(found.sightings.residual, np.tile([0.3, -0.1], (6, 1)), atol=1e-8)
    np.testing.assert_allclose(found.sightings.variance, 0.04)
    assert found.camera.max_angle > calibration.camera.max_angle


def test_a_sighting_that_the_camera_cannot_see_is_far_off() -> None:
    calibration = stated_calibration(small_camera("orthographic"))
    down = np.array([[0.1, 0.0, -math.sqrt(0.99)]])
    window = replace(window_at(calibration, down), pixels=np.zeros((1, 2)))
    np.testing.assert_allclose(make_residual_model(window, calibration, STILL).sightings.residual, 1e4)


def test_the_covariance_is_the_sum_of_its_parts(calibration: Calibration) -> None:
    directions = sun_arc(6)
    found = make_residual_model(window_at(calibration, directions), calibration, WatchOptions())
    stated_part = joint_covariance(found.error_model, found.at)
    rest = found.covariance - stated_part - found.air
    flat = found.at.rows[..., found.error_model.rotation].reshape(12, 3)
    expected = (flat @ flat.T) * np.repeat(np.repeat(found.wander, 2, axis=0), 2, axis=1)
    np.testing.assert_allclose(rest, expected, atol=1e-12)
    np.testing.assert_allclose(errors_at(found, found.at), found.covariance, atol=1e-12)


def test_the_wandering_s_part_is_that_of_small_rotations(calibration: Calibration) -> None:
    """Drawn: one rotation for all sightings (they are seconds apart), isotropic in the camera's axes."""
    directions = sun_arc(3)
    window = window_at(calibration, directions, step_s=1e-3)
    wide = make_residual_model(window, calibration, WatchOptions(wander_deg=0.1))
    still = make_residual_model(window, calibration, STILL)
    camera, rng = calibration.camera, np.random.default_rng(1)
    draws = []
    for _ in range(1500):
        turn = rng.normal(0.0, math.radians(0.1), 3)
        matrix = Rotation.from_rotvec(turn).as_matrix() @ rotation_matrix(camera.rotation_cam_enu)
        draws.append(project(replace(camera, rotation_cam_enu=rotation_vector(matrix)), directions).ravel())
    difference = wide.covariance - still.covariance
    scale = np.sqrt(np.diag(difference))
    np.testing.assert_allclose(
        np.cov(np.array(draws).T) / np.outer(scale, scale), difference / np.outer(scale, scale), atol=0.12
    )


def test_the_air_s_part_is_the_outer_product_of_what_other_refraction_does(calibration: Calibration) -> None:
    directions = sun_arc(5, widest_deg=85.0)
    found = make_residual_model(window_at(calibration, directions), calibration, STILL)
    sd = math.hypot(0.04, 0.015)  # common to the record and of the day (decision 0009)
    rise = 1e-4 * refraction_rad(directions, SGP)
    shift = (project(found.camera, raised(directions, rise)) - project(found.camera, directions)) / 1e-4 * sd
    np.testing.assert_allclose(found.air, np.outer(shift.ravel(), shift.ravel()), rtol=2e-3, atol=1e-9)


def test_density_of_false_sightings_is_about_the_prediction(calibration: Calibration) -> None:
    window = window_at(calibration, sun_arc(2))
    off = replace(window, pixels=window.pixels + np.array([[0.0, 0.0], [60.0, 0.0]]))
    density = make_residual_model(off, calibration, STILL).sightings.false_density
    near = 1.0 / (2.0 * math.pi * 15.0**2)
    expected = [0.5 * near + 0.5 / 307_200.0, 0.5 * near * math.exp(-8.0) + 0.5 / 307_200.0]
    np.testing.assert_allclose(np.exp(density), expected, rtol=1e-6)
