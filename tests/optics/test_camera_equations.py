"""The numpy model, the compiled kernels and the derivatives of both, against the equations written out by hand."""

from __future__ import annotations

import math
from dataclasses import replace

import numpy as np
import pytest
from numpy.typing import NDArray
from tests.optics.reference import IDEAL, STRANGE, field_of, parameters_by_differences, pixel_by_hand, pixels_by_hand

from sunarc.common.errors import InputError
from sunarc.optics.camera import PARAMETER_NAMES, Camera
from sunarc.optics.forward import (
    decentering_shift,
    decentering_slopes,
    distorted_radius,
    project,
    project_fast,
    project_with_jacobian,
    project_with_rows_fast,
    radius_slope,
)
from sunarc.optics.inverse import calibrated
from sunarc.optics.projections import PROJECTIONS, Projection, angle_limit, ideal_angle, ideal_radius, ideal_slope

FloatArray = NDArray[np.float64]
AXIS = np.array([[0.0, 0.0, 1.0]])
LENSES = [replace(camera, rotation_cam_enu=(0.0, 0.0, 0.0), translation=(0.0, 0.0, 0.0)) for camera in STRANGE]


def close(found: FloatArray, expected: FloatArray) -> None:
    """Require derivatives to agree to a millionth of the largest of their column."""
    scale = np.abs(expected).max(axis=(0, 1)) if expected.ndim == 3 else np.abs(expected).max()
    assert np.all(np.abs(found - expected) <= 2e-6 * scale + 1e-9)
    assert np.all(scale > 0.0)


def off_axis(*angles_deg: float) -> FloatArray:
    theta = np.radians(angles_deg)
    return np.stack([np.sin(theta), np.zeros_like(theta), np.cos(theta)], axis=-1)


def test_all_projections_put_directions_where_the_equations_do() -> None:
    for camera in STRANGE:
        directions = field_of(camera, 60)
        expected = pixels_by_hand(camera, directions)
        np.testing.assert_allclose(project(camera, directions), expected, rtol=0.0, atol=1e-8)
        np.testing.assert_allclose(project_fast(camera, directions), expected, rtol=0.0, atol=1e-8)
        pixels, rows = project_with_rows_fast(camera, directions)
        np.testing.assert_allclose(pixels, expected, rtol=0.0, atol=1e-8)
        assert rows.shape == (60, 2, len(PARAMETER_NAMES))


def test_all_23_derivatives_of_all_projections_are_the_difference_quotients() -> None:
    for camera in STRANGE:
        directions = field_of(camera, 12)
        expected = parameters_by_differences(camera, directions)
        close(project_with_jacobian(camera, directions)[1], expected)
        close(project_with_rows_fast(camera, directions)[1], expected)


def test_derivatives_by_the_direction_are_the_difference_quotients() -> None:
    for camera in STRANGE:
        directions = field_of(camera, 8)
        _, _, found = project_with_jacobian(camera, directions)
        for i, axis in enumerate(np.eye(3) * 1e-5):
            numeric = pixels_by_hand(camera, directions + axis) - pixels_by_hand(camera, directions - axis)
            np.testing.assert_allclose(found[..., i], numeric / 2e-5, rtol=1e-6, atol=1e-4)


def test_on_the_axis_both_paths_have_the_limit_of_the_derivatives_beside_it() -> None:
    for camera in LENSES:
        near = np.array([[1e-7, 0.0, 1.0]])
        _, exact, by_direction = project_with_jacobian(camera, AXIS)
        pixels, rows = project_with_rows_fast(camera, AXIS)
        _, beside, by_direction_beside = project_with_jacobian(camera, near)
        np.testing.assert_allclose(pixels, project(camera, AXIS), atol=1e-12)
        x0, y0 = camera.principal_point_px
        expected = (camera.width - 1.0 - x0 if camera.mirrored else x0, y0)
        np.testing.assert_allclose(pixels[0], expected, atol=1e-12)
        np.testing.assert_allclose(rows, exact, atol=1e-12)
        np.testing.assert_allclose(exact, beside, atol=1e-3)
        np.testing.assert_allclose(by_direction, by_direction_beside, atol=1e-3)
        assert np.all(np.isfinite(exact))
        sign = -1.0 if camera.mirrored else 1.0
        fx, fy = camera.focal_length_px
        np.testing.assert_allclose(by_direction[0, :, :2], [[sign * fx, sign * camera.skew_px], [0.0, fy]], atol=1e-9)


def test_a_point_on_the_axis_at_half_the_distance_moves_twice_as_far() -> None:
    for camera in LENSES:
        nearer = replace(camera, translation=(0.0, 0.0, -0.5))
        _, by_parameters, _ = project_with_jacobian(camera, AXIS)
        _, nearby, _ = project_with_jacobian(nearer, AXIS)
        np.testing.assert_allclose(nearby[..., 8:10], 2.0 * by_parameters[..., 8:10], rtol=1e-12)
        np.testing.assert_allclose(project_with_rows_fast(nearer, AXIS)[1], nearby, atol=1e-12)


def test_a_pixel_exists_up_to_the_largest_angle_and_not_beyond() -> None:
    for camera in LENSES:
        edge = math.degrees(camera.max_angle)
        inside, outside = off_axis(edge - 1e-7, 0.0), off_axis(edge + 1e-7, 100.0, 180.0)
        for found in (project(camera, inside), project_fast(camera, inside), project_with_rows_fast(camera, inside)[0]):
            assert np.all(np.isfinite(found))
        pixels, rows = project_with_rows_fast(camera, outside)
        for found in (project(camera, outside), project_fast(camera, outside), pixels):
            assert np.all(np.isnan(found))
        assert not np.any(rows)


def test_lenses_that_see_more_than_a_half_sphere_answer_beyond_90_degrees() -> None:
    for camera in LENSES:
        wide = replace(camera, max_angle=math.radians(120.0))
        directions = off_axis(89.0, 95.0, 119.0)
        found = project(wide, directions)
        if angle_limit(camera.projection) < 2.0:
            assert np.isfinite(found).all(axis=-1).tolist() == [True, False, False]
        else:
            np.testing.assert_allclose(found, pixels_by_hand(wide, directions), atol=1e-8)
            np.testing.assert_allclose(project_fast(wide, directions), found, atol=1e-8)


def test_what_is_not_a_number_has_no_pixel() -> None:
    unknown = np.full((2, 3), np.nan)
    camera = STRANGE[2]
    assert np.all(np.isnan(project(camera, unknown)))
    assert np.all(np.isnan(project_fast(camera, unknown)))
    pixels, rows = project_with_rows_fast(camera, unknown)
    assert np.all(np.isnan(pixels))
    assert not np.any(rows)


def test_derivatives_are_the_difference_quotients_of_the_pixels() -> None:
    for camera in STRANGE:
        directions = field_of(camera, 4)
        _, rows = project_with_rows_fast(camera, directions)
        vector = camera.to_vector()
        for k, step in enumerate(1e-5 * np.maximum(1.0, np.abs(vector) * 1e-2)):
            ahead, behind = (
                project(camera.replace_parameters(vector + sign * step * np.eye(23)[k]), directions)
                for sign in (1.0, -1.0)
            )
            np.testing.assert_allclose(rows[..., k], (ahead - behind) / (2.0 * step), rtol=1e-5, atol=1e-4)
        assert not np.any(project_with_rows_fast(camera, -directions)[1][np.isnan(project(camera, -directions)[:, 0])])


def test_ideal_projections_are_miyamoto_s_and_their_slopes_the_difference_quotients() -> None:
    for name in PROJECTIONS:
        theta = np.linspace(0.01, min(angle_limit(name), math.pi - 0.2) - 0.05, 50)
        np.testing.assert_allclose(ideal_radius(name, theta), [IDEAL[name](float(t)) for t in theta], rtol=1e-14)
        quotient = (ideal_radius(name, theta + 1e-6) - ideal_radius(name, theta - 1e-6)) / 2e-6
        np.testing.assert_allclose(ideal_slope(name, theta), quotient, rtol=1e-7, atol=1e-8)
        np.testing.assert_allclose(ideal_angle(name, ideal_radius(name, theta)), theta, rtol=1e-9)


def test_the_limit_of_each_projection_is_where_its_radius_ends() -> None:
    limits = {name: math.degrees(angle_limit(name)) for name in PROJECTIONS}
    assert limits == {
        "perspective": 90.0,
        "equidistant": 180.0,
        "equisolid": 180.0,
        "stereographic": 180.0,
        "orthographic": 90.0,
    }
    ends: dict[Projection, float] = {"orthographic": 1.0, "equisolid": 2.0, "equidistant": math.pi}
    for name, largest in ends.items():
        within, beyond = ideal_angle(name, [largest - 1e-9, largest + 1e-9])
        assert float(within) == pytest.approx(angle_limit(name), abs=1e-4)
        assert math.isnan(beyond)
    assert np.all(np.isfinite(ideal_angle("perspective", [1e6])))


def test_the_distorted_radius_and_its_slope_are_the_polynomial_of_the_paper() -> None:
    for camera in STRANGE:
        theta = np.linspace(0.0, camera.max_angle, 30)
        tau = theta / math.radians(90.0)
        by_hand = np.array([IDEAL[camera.projection](float(t)) for t in theta])
        by_hand += sum(k * tau**n for n, k in enumerate(camera.radial, start=2))
        np.testing.assert_allclose(distorted_radius(camera, theta), by_hand, atol=1e-14)
        quotient = (distorted_radius(camera, theta + 1e-6) - distorted_radius(camera, theta - 1e-6)) / 2e-6
        np.testing.assert_allclose(radius_slope(camera, theta), quotient, rtol=1e-8)


def test_at_90_degrees_the_radial_coefficients_add_up() -> None:
    for camera in LENSES:
        plain = replace(camera, radial=(0.0,) * 8)
        if angle_limit(camera.projection) > 2.0:
            excess = distorted_radius(camera, math.pi / 2.0) - distorted_radius(plain, math.pi / 2.0)
            assert float(excess) == pytest.approx(sum(camera.radial), abs=1e-15)


def test_the_decentering_along_the_axes_is_three_to_one() -> None:
    # p1 alone: 3 p1 r² along x, p1 r² across it; p3 and p4 scale both by 1 + p3 r² + p4 r⁴
    for u, v, expected in ((1.0, 0.0, (3.0, 0.0)), (0.0, 1.0, (1.0, 0.0))):
        found = decentering_shift((0.01, 0.0, 0.5, 0.25), np.array(0.8), np.array(u), np.array(v))
        scale = 0.01 * 0.64 * (1.0 + 0.5 * 0.64 + 0.25 * 0.64**2)
        np.testing.assert_allclose(found, np.array(expected) * scale, atol=1e-17)
    shift = decentering_shift((0.0, 0.01), np.array(2.0), np.array(math.sqrt(0.5)), np.array(math.sqrt(0.5)))
    np.testing.assert_allclose(shift, (0.04, 0.08), rtol=1e-12)


def test_the_slopes_of_the_decentering_are_its_difference_quotients() -> None:
    coefficients, turn = np.array([2e-3, -3e-3, 0.4, -0.3]), np.linspace(0.0, 6.0, 11)
    at = np.linspace(0.1, 1.3, 11), np.cos(turn), np.sin(turn)
    slopes = decentering_slopes(coefficients, *at)
    for k, change in enumerate(1e-6 * np.eye(4)):
        ahead, behind = (np.stack(decentering_shift(coefficients + by, *at), axis=-1) for by in (change, -change))
        np.testing.assert_allclose(slopes[..., k], (ahead - behind) / 2e-6, rtol=1e-6, atol=1e-9)


def test_the_calibrated_point_is_what_the_calibration_matrix_brings_to_the_pixel() -> None:
    for camera in STRANGE:
        pixels = np.array([[10.0, 20.0], [861.25, 803.5], [1700.0, 50.0]])
        x_hat, y_hat = calibrated(camera, pixels)
        x = camera.focal_length_px[0] * x_hat + camera.skew_px * y_hat + camera.principal_point_px[0]
        y = camera.focal_length_px[1] * y_hat + camera.principal_point_px[1]
        np.testing.assert_allclose(camera.width - 1.0 - x if camera.mirrored else x, pixels[:, 0], atol=1e-9)
        np.testing.assert_allclose(y, pixels[:, 1], atol=1e-9)


def test_five_coefficients_are_the_longer_series_of_the_paper() -> None:
    one, other = (
        decentering_shift(q, np.array(0.9), np.array(0.6), np.array(0.8))
        for q in ((0.01, -0.02, 0.3, 0.2), (0.01, -0.02, 0.3, 0.2, 0.5))
    )
    added = 0.5 * 0.9**8 * np.array([0.01 * 1.72 - 0.02 * 0.96, 0.01 * 0.96 - 0.02 * 2.28])
    np.testing.assert_allclose(np.subtract(other, one), added, atol=1e-16)


def test_many_shapes_of_directions_give_the_same_pixels() -> None:
    camera = STRANGE[4]
    directions = field_of(camera, 6)
    single = np.array([project(camera, direction) for direction in directions])
    np.testing.assert_allclose(project(camera, directions.reshape(2, 3, 3)).reshape(6, 2), single, atol=1e-12)
    _, by_parameters, by_direction = project_with_jacobian(camera, directions.reshape(2, 3, 3))
    assert by_parameters.shape == (2, 3, 2, 23)
    assert by_direction.shape == (2, 3, 2, 3)
    np.testing.assert_allclose(pixel_by_hand(camera, directions[3]), single[3], atol=1e-8)


def test_a_vector_holds_the_parameters_in_the_order_of_their_names() -> None:
    camera = STRANGE[0]
    named = dict(zip(PARAMETER_NAMES, camera.to_vector(), strict=True))
    assert len(named) == 23
    assert (named["focal_length_x_px"], named["focal_length_y_px"], named["skew_px"]) == (571.0, 613.0, 7.5)
    assert (named["principal_point_x_px"], named["principal_point_y_px"]) == (861.25, 803.5)
    assert tuple(named[f"rotation_{axis}"] for axis in "xyz") == camera.rotation_cam_enu
    assert tuple(named[f"translation_{axis}"] for axis in "xyz") == camera.translation
    assert tuple(named[f"k{n}"] for n in range(2, 10)) == camera.radial
    assert tuple(named[f"p{n}"] for n in range(1, 5)) == camera.decentering
    counted = camera.replace_parameters(np.arange(1.0, 24.0))
    np.testing.assert_array_equal(counted.to_vector(), np.arange(1.0, 24.0))
    assert (counted.width, counted.max_angle) == (camera.width, camera.max_angle)


@pytest.mark.parametrize(
    ("change", "field"),
    [
        ({"projection": "cubic"}, "projection"),
        ({"width": 0}, "image size"),
        ({"height": 0}, "image size"),
        ({"radial": (0.0,) * 7}, "radial, decentering"),
        ({"decentering": (0.0,) * 5}, "radial, decentering"),
        ({"skew_px": math.nan}, "camera"),
        ({"max_angle": math.inf}, "camera"),
    ],
)
def test_what_is_no_camera_is_refused_by_its_field(change: dict[str, object], field: str) -> None:
    with pytest.raises(InputError) as caught:
        replace(STRANGE[0], **change)  # type: ignore[arg-type]
    assert caught.value.field == field


def test_the_smallest_image_is_a_camera_and_22_numbers_are_none() -> None:
    assert replace(STRANGE[0], width=1, height=1).width == 1
    with pytest.raises(InputError, match="22 numbers"):
        STRANGE[0].replace_parameters(np.zeros(22))


def test_a_camera_without_further_words_is_undistorted_and_sees_100_degrees() -> None:
    plain = Camera(
        width=10,
        height=10,
        projection="equidistant",
        focal_length_px=(2.0, 2.0),
        principal_point_px=(4.5, 4.5),
        rotation_cam_enu=(0.0, 0.0, 0.0),
    )
    assert plain.to_vector().tolist() == [2.0, 2.0, 0.0, 4.5, 4.5, *([0.0] * 18)]
    assert math.degrees(plain.max_angle) == pytest.approx(100.0)
    assert not plain.mirrored
