"""The exact inverse against a search, the table against the exact inverse, and the stretch against its definition."""

from __future__ import annotations

import math
from dataclasses import replace

import numpy as np
import pytest
from numpy.typing import NDArray
from scipy.optimize import brentq
from tests.optics.reference import STRANGE, field_of, pixel_by_hand, pixels_by_hand

from sunarc.optics.camera import Camera
from sunarc.optics.forward import distorted_radius, local_stretch, project, radius_slope, rising_limit, tangent_basis
from sunarc.optics.inverse import unproject
from sunarc.optics.inverse_table import decentering_rounds, inverse_table
from sunarc.optics.projections import PROJECTIONS, angle_limit

FloatArray = NDArray[np.float64]
GENTLE = (1.2e-3, -7e-4, 0.03, -0.002)  # a decentering whose fixed point converges all over the field
CAMERAS = [replace(camera, translation=(0.0, 0.0, 0.0), decentering=GENTLE) for camera in STRANGE]


def searched(camera: Camera, pixel: FloatArray) -> FloatArray:
    """Return the direction whose pixel by hand is nearest, by ever finer grids about the best one."""
    best, width = field_of(camera, 400, seed=2), 0.15
    centre = best[np.argmin(np.linalg.norm(pixels_by_hand(camera, best) - pixel, axis=-1))]
    offsets = np.linspace(-1.0, 1.0, 7)
    for _ in range(22):
        basis = np.linalg.svd(centre[None])[2][1:]
        grid = centre + width * np.array([a * basis[0] + b * basis[1] for a in offsets for b in offsets])
        grid /= np.linalg.norm(grid, axis=-1, keepdims=True)
        centre = grid[np.argmin(np.linalg.norm(pixels_by_hand(camera, grid) - pixel, axis=-1))]
        width *= 0.45
    return np.asarray(centre)


def test_the_exact_inverse_is_what_a_search_of_the_sky_finds() -> None:
    for camera in CAMERAS[::2]:
        wanted = field_of(camera, 3)[2]
        pixel = np.array(pixel_by_hand(camera, wanted))
        found = unproject(camera, pixel)
        np.testing.assert_allclose(found, searched(camera, pixel), atol=2e-8)
        np.testing.assert_allclose(found, wanted, atol=1e-12)


def test_the_exact_inverse_gives_unit_vectors_whose_pixel_by_hand_is_the_pixel() -> None:
    for camera in CAMERAS:
        pixels = project(camera, field_of(camera, 40))
        found = unproject(camera, pixels.reshape(8, 5, 2))
        assert found.shape == (8, 5, 3)
        np.testing.assert_allclose(np.linalg.norm(found, axis=-1), 1.0, atol=1e-14)
        np.testing.assert_allclose(pixels_by_hand(camera, found.reshape(-1, 3)), pixels, atol=1e-9)


def test_without_decentering_the_radius_alone_decides() -> None:
    for camera in CAMERAS[::2]:
        plain = replace(
            camera, decentering=(0.0,) * 4, skew_px=0.0, rotation_cam_enu=(0.0,) * 3, focal_length_px=(600.0, 600.0)
        )
        x0, y0 = plain.principal_point_px
        theta = brentq(lambda t, lens=plain: float(distorted_radius(lens, t)) - 0.4, 0.0, 1.2, xtol=1e-15)
        expected = [0.0, math.sin(theta), math.cos(theta)]
        np.testing.assert_allclose(unproject(plain, [x0, y0 + 600.0 * 0.4]), expected, atol=1e-12)
        np.testing.assert_allclose(inverse_table(plain).directions([x0, y0 + 600.0 * 0.4]).ravel(), expected, atol=1e-9)
        np.testing.assert_allclose(unproject(plain, [x0, y0]), [0.0, 0.0, 1.0], atol=1e-15)


def test_the_edge_of_the_field_has_a_direction_and_what_lies_beyond_has_none() -> None:
    for camera in CAMERAS[::2]:
        plain = replace(camera, decentering=(0.0,) * 4, skew_px=0.0)
        x0, y0 = plain.principal_point_px
        edge = float(distorted_radius(plain, plain.max_angle)) * plain.focal_length_px[0]
        for unprojected in (lambda p, lens=plain: unproject(lens, p), inverse_table(plain).directions):
            within, beyond = unprojected(np.array([[x0 + edge - 1e-6, y0], [x0 + edge + 1e-6, y0]]))
            assert np.all(np.isfinite(within))
            assert np.all(np.isnan(beyond))
        axis = rodrigues_axis(plain)
        angle = math.acos(float(unproject(plain, [x0 + edge - 1e-6, y0]) @ axis))
        assert angle == pytest.approx(plain.max_angle, abs=1e-7)


def rodrigues_axis(camera: Camera) -> FloatArray:
    """Return the optical axis in east, north, up."""
    return np.asarray(unproject(replace(camera, decentering=(0.0,) * 4), camera.principal_point_px))


def test_the_table_is_the_exact_inverse_to_a_hundred_millionth_of_a_pixel() -> None:
    for camera in CAMERAS:
        pixels = project(camera, field_of(camera, 200))
        table = inverse_table(camera)
        off = np.linalg.norm(table.directions(pixels) - unproject(camera, pixels), axis=-1)
        assert float(off.max()) * camera.focal_length_px[0] < 1e-6
        np.testing.assert_allclose(table.directions(pixels[0]), table.directions(pixels)[0], atol=1e-15)


def test_far_beyond_the_image_the_table_has_no_direction() -> None:
    for camera in CAMERAS[:4]:
        assert np.all(np.isnan(inverse_table(camera).directions([[-9e4, 0.0], [math.nan, 1.0], [math.inf, 0.0]])))


def test_more_pixels_than_a_block_are_all_answered() -> None:
    camera = CAMERAS[2]
    pixels = project(camera, field_of(camera, 1100))
    found = inverse_table(camera).directions(pixels)
    np.testing.assert_allclose(found, unproject(camera, pixels), atol=1e-8)


def test_the_rounds_bring_the_fixed_point_to_a_ten_billionth_and_no_further_than_needed() -> None:
    for camera in CAMERAS[::2]:
        largest = float(distorted_radius(camera, camera.max_angle))
        weak = replace(camera, decentering=(2e-4, -1e-4, 0.1, -0.05))
        assert decentering_rounds(replace(camera, decentering=(0.0, 0.0, 0.1, 0.1)), largest) == 0
        few, more = (decentering_rounds(one, 1.0) for one in (weak, replace(weak, decentering=(0.02, 0.0, 0.0, 0.0))))
        assert few is not None
        assert more is not None
        assert 1 <= few <= 5
        assert few < more <= 20
        assert decentering_rounds(replace(weak, decentering=(0.6, 0.0, 0.0, 0.0)), 1.0) is None  # it never converges


def test_a_decentering_whose_rounds_diverge_is_answered_exactly() -> None:
    camera = replace(CAMERAS[2], decentering=(0.5, -0.3, 0.0, 0.0))
    table, pixels = inverse_table(camera), np.add(camera.principal_point_px, [[0.0, 0.0], [3.0, -5.0]])
    assert table.rounds is None
    np.testing.assert_array_equal(table.directions(pixels), unproject(camera, pixels))


def test_an_orthographic_lens_asked_beyond_its_limit_is_answered_exactly_at_its_edge() -> None:
    lens = replace(CAMERAS[8], radial=(0.0,) * 8, decentering=(0.0,) * 4, max_angle=math.radians(120.0))
    pixels = project(lens, field_of(replace(lens, max_angle=math.radians(89.9)), 400))
    np.testing.assert_allclose(inverse_table(lens).directions(pixels), unproject(lens, pixels), atol=1e-8)


def test_a_lens_that_hardly_rises_at_its_edge_is_answered_exactly_there() -> None:
    lens = replace(CAMERAS[8], radial=(0.0,) * 8, decentering=(0.0,) * 4, max_angle=math.radians(89.0))
    assert lens.projection == "orthographic"
    table = inverse_table(lens)
    assert 60.0 < math.degrees(math.asin(table.constants.exact_from)) < 89.0
    pixels = project(lens, field_of(replace(lens, max_angle=math.radians(90.7)), 300))
    pixels = pixels[np.isfinite(pixels).all(axis=-1)]
    np.testing.assert_allclose(table.directions(pixels), unproject(lens, pixels), atol=3e-9)
    assert inverse_table(CAMERAS[2]).constants.exact_from == math.inf


def test_the_stretch_is_the_difference_quotient_along_its_basis() -> None:
    for camera in STRANGE:
        for direction in field_of(camera, 3):
            basis = tangent_basis(direction)
            quotient = [
                np.subtract(
                    pixel_by_hand(camera, direction + 1e-6 * axis), pixel_by_hand(camera, direction - 1e-6 * axis)
                )
                / 2e-6
                for axis in basis.T
            ]
            np.testing.assert_allclose(
                local_stretch(camera, direction), np.stack(quotient, axis=-1), rtol=1e-6, atol=1e-4
            )


def test_the_tangent_basis_is_orthonormal_right_handed_and_has_no_gap() -> None:
    rng = np.random.default_rng(8)
    directions = rng.normal(size=(200, 3))
    directions /= np.linalg.norm(directions, axis=-1, keepdims=True)
    directions = np.concatenate([directions, np.eye(3), -np.eye(3)])
    basis = tangent_basis(directions)
    np.testing.assert_allclose(np.swapaxes(basis, -1, -2) @ basis, np.broadcast_to(np.eye(2), (206, 2, 2)), atol=1e-14)
    np.testing.assert_allclose(np.cross(basis[..., 0], basis[..., 1]), directions, atol=1e-14)


def test_an_equidistant_lens_stretches_by_its_focal_length_and_theta_over_sine() -> None:
    plain = Camera(
        width=1000,
        height=1000,
        projection="equidistant",
        focal_length_px=(300.0, 300.0),
        principal_point_px=(500.0, 500.0),
        rotation_cam_enu=(0.0, 0.0, 0.0),
    )
    for theta in (0.3, 1.0, 1.5):
        stretch = local_stretch(plain, [math.sin(theta), 0.0, math.cos(theta)])
        axes = np.linalg.svd(stretch, compute_uv=False)
        np.testing.assert_allclose(axes, [300.0 * theta / math.sin(theta), 300.0], rtol=1e-12)


def test_a_lens_rises_up_to_the_angle_where_its_slope_vanishes() -> None:
    # θ + k2 (θ/(π/2))² has the slope 1 + 2 k2 θ/(π/2)² = 0 at θ = -(π/2)²/(2 k2)
    for k2 in (-1.0, -2.0):
        falling = replace(CAMERAS[2], radial=(k2, *([0.0] * 7)))
        top = -((math.pi / 2.0) ** 2) / (2.0 * k2)
        found = rising_limit(falling, up_to=1.7)
        assert top - 1.7 / 1000.0 < found <= top
        assert float(radius_slope(falling, found)) > 0.0
        assert rising_limit(falling, up_to=0.5) == 0.5
    for name in PROJECTIONS:
        plain = replace(CAMERAS[2], projection=name, radial=(0.0,) * 8)
        assert rising_limit(plain, up_to=4.0) == pytest.approx(angle_limit(name), rel=2e-6)
        assert rising_limit(plain, up_to=4.0) < angle_limit(name)
