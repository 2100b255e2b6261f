"""Covariances of pixels and directions, against draws of cameras and fields and against finite differences."""

from __future__ import annotations

import math
from dataclasses import replace

import numpy as np
import pytest
from numpy.typing import NDArray
from scipy.spatial.transform import Rotation
from tests.fixtures.calibration import (
    SGP,
    ideal_camera,
    numerical_derivative,
    random_covariance,
    small_camera,
    small_errors,
    spread_directions,
    stated_calibration,
)

from sunarc.calibration.answers.covariance import (
    direction_covariance,
    hemisphere,
    pose_error,
    project_with_covariance,
    rotation_covariance,
    sigma_deg,
    sigma_px,
    sky_sigma_deg,
    uncertainties,
    unproject_with_sigma,
)
from sunarc.calibration.model.residual_field import Field
from sunarc.calibration.model.result import Calibration
from sunarc.calibration.solve.priors import FREE
from sunarc.optics.camera import Camera
from sunarc.optics.forward import project
from sunarc.optics.inverse import unproject
from sunarc.optics.pose import rotation_matrix

FloatArray = NDArray[np.float64]


def _drawn_pixels(calibration: Calibration, directions: FloatArray, count: int) -> FloatArray:
    """Return (count, n, 2): pixels of cameras and fields drawn jointly from what a calibration states."""
    rng = np.random.default_rng(9)
    vector = calibration.camera.to_vector()
    root = np.linalg.cholesky(calibration.covariance)
    draws = []
    for _ in range(count):
        v = vector.copy()
        v[FREE] += root @ rng.standard_normal(FREE.size)
        draws.append(project(calibration.camera.replace_parameters(v), directions))
    return np.array(draws)


@pytest.mark.parametrize("mirrored", [False, True])
def test_the_covariance_of_pixels_is_that_of_drawn_cameras(*, mirrored: bool) -> None:
    camera = small_camera(mirrored=mirrored)
    scale = np.sqrt(np.diag(small_errors()))
    covariance = random_covariance(20, seed=2) * np.outer(scale, scale)
    calibration = stated_calibration(camera, covariance=covariance)
    directions = spread_directions(4)
    pixels, found = project_with_covariance(calibration, directions)
    np.testing.assert_allclose(pixels, project(camera, directions), atol=1e-9)
    draws = _drawn_pixels(calibration, directions, 1000) - pixels
    expected = np.einsum("kna,knb->nab", draws, draws) / 1000
    size = np.sqrt(np.einsum("naa->na", expected))
    scale = size[:, :, None] * size[:, None]
    np.testing.assert_allclose(found / scale, expected / scale, atol=0.15)


def test_the_covariance_is_j_c_j_of_finite_differences() -> None:
    camera = small_camera()
    covariance = random_covariance(20, seed=4, scale=1e-4)
    directions = spread_directions(5)
    _, found = project_with_covariance(stated_calibration(camera, covariance=covariance), directions)
    rows = numerical_derivative(lambda v: project(camera.replace_parameters(v), directions), camera.to_vector())[
        ..., FREE
    ]
    np.testing.assert_allclose(found, rows @ covariance @ np.swapaxes(rows, -1, -2), rtol=1e-4, atol=1e-9)


def test_an_independent_field_adds_its_variance() -> None:
    camera = small_camera()
    _, without = project_with_covariance(stated_calibration(camera), spread_directions(6))
    _, with_field = project_with_covariance(stated_calibration(camera, amplitude_px=0.4), spread_directions(6))
    np.testing.assert_allclose(with_field - without, np.broadcast_to(0.16 * np.eye(2), (6, 2, 2)), atol=1e-12)


def test_a_field_that_hangs_together_with_the_camera_adds_its_cross_terms() -> None:
    camera = small_camera()
    plain = stated_calibration(camera, amplitude_px=0.4)
    m = len(plain.field.basis.orders)
    cross = 1e-3 * np.random.default_rng(1).standard_normal((2, 20, m))
    calibration = replace(plain, field=replace(plain.field, cross=cross))
    directions = spread_directions(5)
    pixels, found = project_with_covariance(calibration, directions)
    _, without = project_with_covariance(plain, directions)
    rows = numerical_derivative(lambda v: project(camera.replace_parameters(v), directions), camera.to_vector())[
        ..., FREE
    ]
    waves = plain.field.basis.values(pixels)
    for n in range(5):
        # Cov(J b + f, J b + f) with f = (w . c_x, w . c_y): J X_a w in column a, and its transpose
        shared = np.stack([rows[n] @ cross[a] @ waves[n] for a in (0, 1)], axis=-1)
        np.testing.assert_allclose(found[n] - without[n], shared + shared.T, rtol=1e-4, atol=1e-8)


def test_many_directions_in_chunks_are_answered_as_few() -> None:
    calibration = stated_calibration(small_camera(), amplitude_px=0.1)
    directions = spread_directions(4500)
    pixels, covariance = project_with_covariance(calibration, directions.reshape(45, 100, 3))
    assert covariance.shape == (45, 100, 2, 2)
    some = [0, 4095, 4096, 4499]
    few_pixels, few = project_with_covariance(calibration, directions[some])
    np.testing.assert_allclose(pixels.reshape(-1, 2)[some], few_pixels, atol=1e-12)
    np.testing.assert_allclose(covariance.reshape(-1, 2, 2)[some], few, atol=1e-12)


def test_beyond_the_camera_s_field_there_is_no_covariance() -> None:
    calibration = stated_calibration(replace(small_camera(), max_angle=math.radians(60.0)), amplitude_px=0.2)
    pixels, covariance = project_with_covariance(calibration, np.array([[0.0, 0.0, 1.0], [0.0, 0.0, -1.0]]))
    assert np.all(np.isfinite(covariance[0]))
    assert np.all(np.isnan(pixels[1]))
    assert np.all(np.isnan(covariance[1]))


def test_sigma_on_the_sphere_is_that_of_drawn_directions() -> None:
    camera = small_camera()
    calibration = stated_calibration(camera, amplitude_px=0.5)
    directions = spread_directions(5, widest_deg=60.0)
    pixels, covariance = project_with_covariance(calibration, directions)
    rng = np.random.default_rng(3)
    found = sigma_deg(calibration, directions)
    for n in range(5):
        draws = unproject(camera, rng.multivariate_normal(pixels[n], covariance[n], 4000))
        off = np.degrees(np.linalg.norm(draws - directions[n], axis=-1))
        assert math.sqrt(0.5 * np.mean(off**2)) == pytest.approx(found[n], rel=0.05)


def test_the_covariance_of_unit_vectors_lies_across_them_and_is_that_of_draws() -> None:
    camera = small_camera()
    directions = spread_directions(3, widest_deg=60.0)
    covariance = np.stack([random_covariance(2, seed=s, scale=0.3) for s in range(3)])
    found = direction_covariance(camera, directions, covariance)
    np.testing.assert_allclose(np.einsum("nij,nj->ni", found, directions), 0.0, atol=1e-12)
    pixels, rng = project(camera, directions), np.random.default_rng(5)
    for n in range(3):
        draws = unproject(camera, rng.multivariate_normal(pixels[n], covariance[n], 6000))
        np.testing.assert_allclose(found[n], np.cov(draws.T), atol=0.06 * np.trace(found[n]))


def test_sigma_px_is_the_root_of_half_the_trace() -> None:
    covariance = np.array([[[3.0, 0.7], [0.7, 5.0]], [[0.0, 0.0], [0.0, 0.0]], [[-1.0, 0.0], [0.0, -1.0]]])
    np.testing.assert_allclose(sigma_px(covariance), [2.0, 0.0, 0.0])


def test_a_pixel_s_direction_has_the_sigma_of_its_direction() -> None:
    calibration = stated_calibration(small_camera(), amplitude_px=0.3)
    directions = spread_directions(6, widest_deg=60.0)
    pixels = project(calibration.camera, directions)
    back, sigma, inside = unproject_with_sigma(calibration, pixels)
    np.testing.assert_allclose(back, directions, atol=1e-8)
    np.testing.assert_allclose(sigma, sigma_deg(calibration, directions), rtol=1e-6)
    assert inside.tolist() == [bool(-0.5 <= x <= 639.5 and -0.5 <= y <= 479.5) for x, y in pixels]
    _, far_sigma, far_inside = unproject_with_sigma(calibration, [[1e5, 1e5]])
    assert np.isnan(far_sigma[0])
    assert not far_inside[0]


def test_an_ideal_camera_s_focal_error_by_hand() -> None:
    """Equidistant: the radius is f theta, so 1-sigma of f of 1 px is theta px outward and none across."""
    names = ("focal_length_x_px", "focal_length_y_px")
    calibration = stated_calibration(ideal_camera(), names=names, covariance=np.ones((2, 2)))
    theta = math.radians(40.0)
    direction = np.array([[math.sin(theta), 0.0, math.cos(theta)]])
    covariance, sigma = uncertainties(calibration, direction)
    np.testing.assert_allclose(covariance[0], [[theta**2, 0.0], [0.0, 0.0]], atol=1e-9)
    assert math.radians(sigma[0]) == pytest.approx(theta / 200.0 / math.sqrt(2.0))


def test_the_hemisphere_is_evenly_covered() -> None:
    directions = hemisphere(2000)
    np.testing.assert_allclose(np.linalg.norm(directions, axis=-1), 1.0)
    assert directions.shape == (2000, 3)
    assert directions[:, 2].min() > 0.0
    # of an even cover the mean is (0, 0, 1/2) and the second moments are 1/3
    np.testing.assert_allclose(directions.mean(axis=0), [0.0, 0.0, 0.5], atol=1e-3)
    np.testing.assert_allclose(directions.T @ directions / 2000, np.eye(3) / 3.0, atol=2e-3)
    nearest = np.sort(directions @ directions.T, axis=1)[:, -2]
    assert np.degrees(np.arccos(nearest)).max() < 4.0


def test_the_sky_s_sigma_is_the_root_mean_square_over_what_the_image_shows() -> None:
    calibration = stated_calibration(small_camera(), amplitude_px=0.3)
    rms, most = sky_sigma_deg(calibration)
    directions = hemisphere()
    pixels = project(calibration.camera, directions)
    shown = np.all((pixels >= -0.5) & (pixels <= [639.5, 479.5]), axis=-1)
    sigma = sigma_deg(calibration, directions[shown])
    assert rms == pytest.approx(float(np.sqrt(np.mean(sigma**2))))
    assert most == pytest.approx(float(np.max(sigma)))
    assert rms < most


def test_what_lands_in_the_image_a_second_time_is_no_sky_that_it_shows() -> None:
    level = replace(
        small_camera(),
        projection="perspective",
        focal_length_px=(136.0, 136.0),
        principal_point_px=(319.5, 239.5),
        skew_px=0.0,
        rotation_cam_enu=(0.0, 0.0, 0.0),
        radial=(0.0,) * 8,
        max_angle=math.radians(89.9),
    )
    bent = replace(level, decentering=(0.0, -0.02, 0.0, 0.0))
    directions = hemisphere()
    low, pixels = directions[:, 2] < math.cos(math.radians(80.0)), project(bent, directions)
    assert np.any(low & np.all((pixels >= -0.5) & (pixels <= [639.5, 479.5]), axis=-1))
    (rms, most), (plain, _) = (sky_sigma_deg(stated_calibration(one, amplitude_px=0.3)) for one in (bent, level))
    assert most < 10.0 * rms
    assert rms == pytest.approx(plain, rel=0.3)


def test_a_camera_that_shows_no_sky_has_no_sigma() -> None:
    below = replace(small_camera(), rotation_cam_enu=(math.pi, 0.0, 0.0), max_angle=math.radians(30.0))
    assert np.all(np.isnan(sky_sigma_deg(stated_calibration(below))))


def _turn_of(camera: Camera, turn: FloatArray) -> FloatArray:
    """Return the rotation vector of a camera after a small rotation of the world, east-north-up."""
    matrix = rotation_matrix(camera.rotation_cam_enu) @ Rotation.from_rotvec(turn).as_matrix()
    return np.asarray(Rotation.from_matrix(matrix).as_rotvec())


def test_turns_about_the_world_s_axes_become_those_of_the_rotation_vector() -> None:
    camera = small_camera()
    rows = numerical_derivative(lambda turn: _turn_of(camera, turn), np.zeros(3))
    turn = random_covariance(3, seed=6)
    np.testing.assert_allclose(rotation_covariance(camera, turn), rows @ turn @ rows.T, rtol=1e-5, atol=1e-8)


def test_a_clock_error_turns_the_camera_about_the_pole() -> None:
    camera = small_camera()
    found = pose_error(camera, SGP, clock_error_s=2.0, site_error_m=0.0)
    pole = np.array([0.0, math.cos(math.radians(SGP.latitude)), math.sin(math.radians(SGP.latitude))])
    rate = 2.0 * math.pi / 86_164.1  # of a sidereal day
    expected = rotation_covariance(camera, (2.0 * rate) ** 2 * np.outer(pole, pole))
    np.testing.assert_allclose(found, expected, rtol=1e-3, atol=1e-15)
    assert np.linalg.matrix_rank(found, tol=1e-12) == 1


def test_a_site_error_tilts_the_ground() -> None:
    camera = ideal_camera()
    found = pose_error(camera, SGP, clock_error_s=0.0, site_error_m=30.0)
    angle = 30.0 / 6_371_000.0
    tangent = math.tan(math.radians(SGP.latitude))
    # north by 30 m turns about east; east by 30 m turns about the pole by 30 m / (R cos latitude)
    expected = angle**2 * np.array([[1.0, 0.0, 0.0], [0.0, 1.0, tangent], [0.0, tangent, tangent**2]])
    np.testing.assert_allclose(found, expected, rtol=1e-9, atol=1e-20)


def test_at_the_pole_east_has_no_meaning() -> None:
    pole = replace(SGP, latitude=89.9)
    found = pose_error(ideal_camera(), pole, clock_error_s=0.0, site_error_m=30.0)
    np.testing.assert_allclose(np.diag(found)[:2], (30.0 / 6_371_000.0) ** 2)
    assert found[2, 2] == 0.0


def test_both_errors_add() -> None:
    both = pose_error(small_camera(), SGP, clock_error_s=1.0, site_error_m=100.0)
    one = pose_error(small_camera(), SGP, clock_error_s=1.0, site_error_m=0.0)
    other = pose_error(small_camera(), SGP, clock_error_s=0.0, site_error_m=100.0)
    np.testing.assert_allclose(both, one + other, rtol=1e-12)


def test_a_field_without_amplitude_is_not_looked_at() -> None:
    plain = stated_calibration(small_camera())
    broken = replace(plain, field=replace(plain.field, cross=np.full_like(plain.field.cross, np.nan)))
    assert isinstance(broken.field, Field)
    assert np.all(np.isfinite(project_with_covariance(broken, spread_directions(3))[1]))


def test_no_direction_is_off_by_more_than_half_a_turn() -> None:
    camera = small_camera()
    plain = stated_calibration(camera)
    rms, most = sky_sigma_deg(plain)
    wide = replace(plain, covariance=plain.covariance * 1e4)
    assert sky_sigma_deg(wide) == pytest.approx((100.0 * rms, 100.0 * most))
    assert sky_sigma_deg(replace(plain, covariance=plain.covariance * 1e16)) == (180.0, 180.0)
