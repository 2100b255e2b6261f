"""The backward model of Eqs. 14 to 19, against the forward model and the ideal projections."""

from __future__ import annotations

import math
from dataclasses import replace

import numpy as np
import pytest
from numpy.typing import NDArray
from scipy.optimize import least_squares
from tests.fixtures.calibration import ideal_camera, numerical_derivative, small_camera, spread_directions

from sunarc.optics import backward
from sunarc.optics.backward import NO_BACKWARD, BackwardModel, back_project, fit_backward
from sunarc.optics.camera import camera_sees
from sunarc.optics.forward import project
from sunarc.optics.inverse import calibrated, unproject
from sunarc.optics.projections import PROJECTIONS, Projection, ideal_radius

NOTHING = BackwardModel(radial=(0.0,) * 8, decentering=(0.0,) * 5, max_error_px=0.0)


@pytest.mark.parametrize("projection", PROJECTIONS)
def test_an_ideal_lens_needs_no_coefficients(projection: Projection) -> None:
    camera = replace(ideal_camera(), projection=projection, rotation_cam_enu=(0.3, -0.2, 1.0))
    directions = spread_directions(20, widest_deg=45.0)
    found = back_project(camera, NOTHING, project(camera, directions))
    np.testing.assert_allclose(found, directions, atol=1e-9)


@pytest.mark.parametrize("mirrored", [False, True])
def test_pixels_come_back_to_within_the_stated_error(*, mirrored: bool) -> None:
    camera = small_camera(mirrored=mirrored)
    model = fit_backward(camera)
    assert 0.0 < model.max_error_px < 0.3
    x, y = np.meshgrid(np.linspace(100.0, 540.0, 12), np.linspace(60.0, 420.0, 10))
    pixels = np.stack([x, y], axis=-1)
    again = project(camera, back_project(camera, model, pixels))
    assert np.nanmax(np.linalg.norm(again - pixels, axis=-1)) < 1.5 * model.max_error_px
    np.testing.assert_allclose(back_project(camera, model, pixels), unproject(camera, pixels), atol=2e-3)


def test_an_ideal_lens_is_fitted_with_an_error_of_nothing() -> None:
    model = fit_backward(ideal_camera())
    assert model.max_error_px < 1e-3
    assert np.max(np.abs(model.radial)) < 1e-2


def test_a_lens_that_shows_nothing_has_no_backward_model() -> None:
    assert fit_backward(replace(ideal_camera(), max_angle=1e-9)).max_error_px == pytest.approx(0.0, abs=1e-6)
    outside = replace(ideal_camera(), principal_point_px=(-5000.0, -5000.0))
    assert fit_backward(outside) is NO_BACKWARD
    assert math.isnan(NO_BACKWARD.max_error_px)


def test_a_radius_without_an_angle_has_no_direction() -> None:
    camera = replace(ideal_camera(), projection="orthographic")
    assert np.all(np.isnan(back_project(camera, NOTHING, [319.5 + 201.0, 239.5])))
    assert np.all(np.isfinite(back_project(camera, NOTHING, [319.5 + 199.0, 239.5])))


def test_the_axis_is_answered() -> None:
    np.testing.assert_allclose(back_project(ideal_camera(), NOTHING, [319.5, 239.5]), [0.0, 0.0, 1.0], atol=1e-12)


def test_a_camera_sees_what_lies_within_its_outer_pixels_edges() -> None:
    pixels = np.array(
        [[-0.5, -0.5], [639.5, 479.5], [-0.6, 0.0], [639.6, 0.0], [0.0, -0.6], [0.0, 479.6], [np.nan, 1.0]]
    )
    assert camera_sees(ideal_camera(), pixels).tolist() == [True, True, False, False, False, False, False]


def test_slopes_are_the_differences_of_the_point() -> None:
    camera = small_camera()
    x_hat, y_hat = np.meshgrid(np.linspace(-1.2, 1.3, 7), np.linspace(-1.1, 1.2, 6))
    at = np.r_[camera.decentering[:2], np.zeros(8), camera.decentering[2:], 0.0]
    at += np.r_[0.01, -0.02, np.full(8, 2e-3), 0.1, 0.05, -0.1]

    def point(coefficients: NDArray[np.float64]) -> NDArray[np.float64]:
        return backward.ideal_point(camera, coefficients, x_hat.ravel(), y_hat.ravel())

    found = backward.ideal_point_derivatives(camera, at, x_hat.ravel(), y_hat.ravel())
    np.testing.assert_allclose(found, numerical_derivative(point, at), atol=1e-7)
    assert found.shape == (42, 2, 13)


def test_the_start_meets_a_lens_without_decentering_already() -> None:
    camera = replace(small_camera(), decentering=(0.0,) * 4)
    rays, pixels = backward.synthetic_rays(camera)
    x_hat, y_hat = calibrated(camera, pixels)
    radius = ideal_radius(camera.projection, np.arctan2(np.hypot(rays[:, 0], rays[:, 1]), rays[:, 2]))
    azimuth = np.arctan2(rays[:, 1], rays[:, 0])
    target = radius[:, None] * np.stack([np.cos(azimuth), np.sin(azimuth)], axis=-1)
    start = backward.first_coefficients(camera, x_hat, y_hat, target)
    off = camera.focal_length_px[0] * np.linalg.norm(
        backward.ideal_point(camera, start, x_hat, y_hat) - target, axis=-1
    )
    assert np.max(off) < 0.01  # px; its decentering of 1e-6 makes 0.002


def test_a_decentering_that_nothing_determines_is_fitted_as_well() -> None:
    """p1 and p2 next to nothing beside p3 in the thousands, as a noisy day's fit by the paper's method ends."""
    camera = replace(small_camera(), decentering=(8e-8, 1e-8, -4600.0, 1100.0))
    assert fit_backward(camera).max_error_px < 0.05


def test_the_coefficients_are_those_of_scipys_least_squares() -> None:
    """Of a curve whose columns are nearly dependent, as powers of the radius are, from a start that is off."""
    x = np.linspace(0.0, 1.0, 60)
    data = np.exp(-1.3 * x) + 0.01 * np.sin(40.0 * x)

    def misfit(at: NDArray[np.float64]) -> NDArray[np.float64]:
        return np.asarray(np.exp(at[0] * x) + at[1] * x**2 + at[2] * x**3 + at[3] * x**4 - data)

    def slopes(at: NDArray[np.float64]) -> NDArray[np.float64]:
        return np.stack([x * np.exp(at[0] * x), x**2, x**3, x**4], axis=-1)

    start = np.array([3.0, 0.0, 0.0, 0.0])
    found = backward.least_squares(misfit, slopes, start)
    expected = least_squares(misfit, start, jac=slopes, method="lm", ftol=1e-12)
    assert np.sum(misfit(found) ** 2) == pytest.approx(2.0 * expected.cost, rel=1e-5)
    assert 2.0 * expected.cost < 1e-3 * np.sum(misfit(start) ** 2)
