"""The compiled inverse against general solvers."""

from __future__ import annotations

import math
from dataclasses import replace
from typing import Any

import numpy as np
import pytest
from scipy.optimize import brentq, fsolve
from tests.fixtures.calibration import small_camera

from sunarc.optics.forward import decentering_shift, distorted_radius
from sunarc.optics.inverse import unproject
from sunarc.optics.projections import PROJECTIONS, Projection

_BARE: dict[str, Any] = {
    "decentering": (0.0,) * 4,
    "rotation_cam_enu": (0.0,) * 3,
    "focal_length_px": (500.0, 500.0),
    "skew_px": 0.0,
}


@pytest.mark.parametrize("strength", [1e-4, 5e-3])
def test_the_decentering_is_taken_out_as_a_general_solver_does(strength: float) -> None:
    coefficients = np.array([strength, -0.7 * strength, 0.3, -0.2])
    points = np.random.default_rng(1).uniform(-0.9, 0.9, (2, 40))

    def shifted(q: np.ndarray) -> np.ndarray:
        radius = np.hypot(*q)
        return np.asarray(q + np.stack(decentering_shift(coefficients, radius, *(q / radius))))

    def missed(q: np.ndarray, at: np.ndarray) -> np.ndarray:
        return np.asarray(shifted(q) - at)

    # of an equidistant lens without a radial part the pixel, in focal lengths, is the angle along the azimuth
    camera = replace(small_camera("equidistant"), radial=(0.0,) * 8, max_angle=math.pi, mirrored=False, **_BARE)
    camera = replace(camera, decentering=tuple(coefficients.tolist()))
    ray = unproject(camera, 500.0 * points.T + camera.principal_point_px)
    found = ray[:, :2].T * (np.arccos(ray[:, 2]) / np.hypot(ray[:, 0], ray[:, 1]))
    for i in range(40):
        expected = fsolve(missed, points[:, i], args=(points[:, i],), xtol=1e-13)
        np.testing.assert_allclose(found[:, i], expected, atol=1e-11)
    np.testing.assert_allclose(shifted(found), points, atol=1e-12)
    np.testing.assert_allclose(unproject(camera, camera.principal_point_px), [0.0, 0.0, 1.0], atol=1e-15)


@pytest.mark.parametrize("projection", PROJECTIONS)
def test_angles_are_those_of_bracketing(projection: Projection) -> None:
    camera = replace(small_camera(projection), max_angle=math.radians(75.0), **_BARE)
    edge = float(distorted_radius(camera, camera.max_angle))
    radii = np.array([0.0, 1e-9, 0.2 * edge, 0.7 * edge, 0.999 * edge, edge, 1.01 * edge, math.nan])
    x0, y0 = camera.principal_point_px
    found = unproject(camera, np.stack([x0 + 500.0 * radii, np.full(radii.size, y0)], axis=-1))
    np.testing.assert_allclose(found[0], [0.0, 0.0, 1.0], atol=1e-15)
    assert np.isnan(found[-2:]).all()
    for radius, direction in zip(radii[1:6], found[1:6], strict=True):
        angle = brentq(
            lambda theta, r=radius: distorted_radius(camera, theta) - r, 0.0, camera.max_angle + 1e-9, xtol=1e-15
        )
        np.testing.assert_allclose(direction, [math.sin(angle), 0.0, math.cos(angle)], atol=1e-12)


def test_one_pixel_and_a_sheet_of_pixels_give_the_same_directions() -> None:
    pixels = np.random.default_rng(2).uniform(100.0, 400.0, (3, 4, 2))
    sheet = unproject(small_camera(mirrored=True), pixels)
    assert sheet.shape == (3, 4, 3)
    np.testing.assert_allclose(sheet[1, 2], unproject(small_camera(mirrored=True), pixels[1, 2]), atol=1e-15)


def test_a_pixel_without_a_direction_leaves_the_others_of_its_block_alone() -> None:
    camera = small_camera()
    pixels = np.random.default_rng(3).uniform(150.0, 350.0, (600, 2))
    expected = unproject(camera, pixels)
    pixels[::7] = [math.nan, 1.0]
    pixels[1::7] = [1e9, -1e9]
    pixels[2::7] = [math.inf, 0.0]
    found = unproject(camera, pixels)
    spoiled = np.isin(np.arange(600) % 7, (0, 1, 2))
    assert np.isnan(found[spoiled]).all()
    np.testing.assert_allclose(found[~spoiled], expected[~spoiled], atol=1e-15)
