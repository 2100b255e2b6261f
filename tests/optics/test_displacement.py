"""The displacement beside the lens: against the sum by its definition, finite differences, and there and back."""

from __future__ import annotations

import math
from dataclasses import replace

import numpy as np
import pytest
from scipy.optimize import fsolve

from sunarc.common.array_types import FloatArray
from sunarc.common.errors import InputError
from sunarc.optics.camera import Camera
from sunarc.optics.displacement import Displacement
from sunarc.optics.forward import project, project_with_jacobian, project_with_rows_fast
from sunarc.optics.inverse import unproject
from sunarc.optics.inverse_table import inverse_table

SIZE = 1748
CENTER = (SIZE - 1) / 2.0
LENS = Camera(
    width=SIZE,
    height=SIZE,
    projection="equisolid",
    focal_length_px=(600.0, 600.2),
    principal_point_px=(880.0, 868.0),
    rotation_cam_enu=(0.02, -0.03, 1.9),
    radial=(0.01, -0.02, 0.01, 0.0, 0.0, 0.0, 0.0, 0.0),
    decentering=(1e-3, -5e-4, 0.1, 0.0),
)


def smooth(seed: int = 3, *, amplitude_px: float = 0.3) -> Displacement:
    """Draw a displacement of some amplitude whose waves are as long as those of a field of 400 px."""
    rng = np.random.default_rng(seed)
    half = CENTER + 500.0
    orders = tuple((i, j) for i in range(1, 13) for j in range(1, 13) if math.hypot(i, j) < 12.0)
    frequency = 0.5 * math.pi * np.hypot(*np.array(orders).T) / half
    spread = amplitude_px * math.sqrt(2.0 * math.pi) * 400.0 * np.exp(-0.25 * (400.0 * frequency) ** 2)
    x, y = rng.normal(size=(2, len(orders))) * spread
    return Displacement(center_px=(CENTER, CENTER), half_px=(half, half), orders=orders, x_px=tuple(x), y_px=tuple(y))


DISPLACED = replace(LENS, displacement=smooth())


def sky(count: int = 200, seed: int = 1) -> FloatArray:
    """Draw directions over the upper hemisphere."""
    rng = np.random.default_rng(seed)
    zenith, azimuth = np.arccos(rng.uniform(0.02, 1.0, count)), rng.uniform(0.0, 2.0 * math.pi, count)
    return np.stack([np.sin(zenith) * np.sin(azimuth), np.sin(zenith) * np.cos(azimuth), np.cos(zenith)], axis=-1)


def by_definition(field: Displacement, pixel: FloatArray) -> FloatArray:
    """Return (2,): the sum over the waves, one by one."""
    total = np.zeros(2)
    for (i, j), x, y in zip(field.orders, field.x_px, field.y_px, strict=True):
        wave = 1.0
        for order, place, center, half in zip((i, j), pixel, field.center_px, field.half_px, strict=True):
            wave *= math.sin(math.pi * order * (place - center + half) / (2.0 * half)) / math.sqrt(half)
        total += wave * np.array([x, y])
    return total


def test_it_is_the_sum_of_its_waves() -> None:
    field, pixels = smooth(), np.random.default_rng(0).uniform(0.0, SIZE, (40, 2))
    expected = np.array([by_definition(field, pixel) for pixel in pixels])
    assert 0.05 < np.max(np.abs(expected)) < 3.0
    np.testing.assert_allclose(field.at(pixels), expected, atol=1e-12)


def test_the_waves_have_unit_norm_over_the_box() -> None:
    one = Displacement(center_px=(10.0, 5.0), half_px=(8.0, 6.0), orders=((3, 2),), x_px=(1.0,), y_px=(0.0,))
    # midpoints: exact for sines up to rounding
    x, y = np.meshgrid(2.0 + (np.arange(160) + 0.5) / 10.0, -1.0 + (np.arange(120) + 0.5) / 10.0)
    values = one.at(np.stack([x.ravel(), y.ravel()], axis=-1))
    assert np.sum(values[:, 0] ** 2) * 0.01 == pytest.approx(1.0, abs=1e-9)


def test_beyond_the_box_it_is_nothing_and_nan_stays_nan() -> None:
    field = smooth()
    beyond = np.array([[CENTER + field.half_px[0] + 1.0, CENTER], [CENTER, -1e9], [np.nan, 5.0]])
    np.testing.assert_array_equal(field.at(beyond), [[0.0, 0.0], [0.0, 0.0], [np.nan, np.nan]])


def test_slopes_are_the_finite_differences() -> None:
    field, pixels, step = smooth(), np.random.default_rng(2).uniform(0.0, SIZE, (30, 2)), 1e-3
    values, slopes = field.value_and_slopes(pixels)
    np.testing.assert_array_equal(values, field.at(pixels))
    for axis in range(2):
        shift = step * np.eye(2)[axis]
        difference = (field.at(pixels + shift) - field.at(pixels - shift)) / (2.0 * step)
        np.testing.assert_allclose(slopes[..., axis], difference, atol=1e-10)


def test_the_inverse_undoes_the_displacement() -> None:
    field, pixels = smooth(amplitude_px=2.0), np.random.default_rng(4).uniform(0.0, SIZE, (200, 2))
    before = field.inverse(pixels)
    assert np.max(np.abs(before - pixels)) > 1.0
    np.testing.assert_allclose(before + field.at(before), pixels, atol=1e-10)


def test_the_inverse_beyond_the_box_is_the_pixel_itself_and_nan_stays_nan() -> None:
    """In a block with pixels that have an inverse, and in one that is not full."""
    field, inside = smooth(), np.random.default_rng(6).uniform(0.0, SIZE, (300, 2))
    expected = field.inverse(inside)
    pixels = inside.copy()
    pixels[5], pixels[140], pixels[299] = [np.nan, 5.0], [CENTER, -1e9], [CENTER + field.half_px[0] + 1.0, CENTER]
    found = field.inverse(pixels)
    assert np.isnan(found[5]).all()
    np.testing.assert_array_equal(found[[140, 299]], pixels[[140, 299]])
    others = np.setdiff1d(np.arange(300), [5, 140, 299])
    np.testing.assert_allclose(found[others], expected[others], atol=1e-12)


def test_the_inverse_is_what_a_general_solver_finds() -> None:
    field, pixels = smooth(), np.random.default_rng(7).uniform(0.0, SIZE, (10, 2))
    for pixel, found in zip(pixels, field.inverse(pixels), strict=True):

        def off(place: FloatArray, given: FloatArray = pixel) -> FloatArray:
            return np.asarray(place + field.at(place[None])[0] - given)

        np.testing.assert_allclose(found, fsolve(off, pixel, xtol=1e-14), atol=1e-9)


def test_a_field_that_folds_the_image_has_no_inverse() -> None:
    folding = smooth(amplitude_px=2000.0)
    pixels = np.random.default_rng(5).uniform(0.0, SIZE, (100, 2))
    before = folding.inverse(pixels)
    found = np.all(np.isfinite(before), axis=-1)
    assert not np.all(found)
    np.testing.assert_allclose((before + folding.at(before))[found], pixels[found], atol=1e-9)


def test_the_camera_adds_it_to_the_pixel_of_the_lens() -> None:
    directions = sky()
    alone = project(LENS, directions)
    np.testing.assert_allclose(project(DISPLACED, directions), alone + smooth().at(alone), atol=1e-12)
    assert DISPLACED.lens_alone() == LENS
    assert LENS.lens_alone() is LENS


def test_a_mirrored_image_is_displaced_where_it_is_seen() -> None:
    mirrored, directions = replace(LENS, mirrored=True), sky()
    alone = project(mirrored, directions)
    displaced = project(replace(mirrored, displacement=smooth()), directions)
    np.testing.assert_allclose(displaced, alone + smooth().at(alone), atol=1e-12)


@pytest.mark.parametrize("mirrored", [False, True])
def test_back_projection_is_the_inverse(mirrored: bool) -> None:  # noqa: FBT001
    camera, directions = replace(DISPLACED, mirrored=mirrored), sky()
    pixels = project(camera, directions)
    np.testing.assert_allclose(unproject(camera, pixels), directions, atol=1e-12)
    # 1e-7 px of 600 px a radian
    np.testing.assert_allclose(inverse_table(camera).directions(pixels), directions, atol=3e-9)


def test_the_table_answers_far_outside_of_the_image_as_well() -> None:
    pixels = np.array([[-300.0, 900.0], [CENTER, CENTER], [2100.0, 800.0], [np.nan, 1.0], [1e7, 1e7]])
    np.testing.assert_allclose(inverse_table(DISPLACED).directions(pixels), unproject(DISPLACED, pixels), atol=3e-9)


def test_derivatives_by_parameters_and_direction_hold_with_it() -> None:
    directions = sky(20)
    _, rows = project_with_rows_fast(DISPLACED, directions)
    _, _, by_direction = project_with_jacobian(DISPLACED, directions)
    vector = DISPLACED.to_vector()
    for k in (0, 3, 5, 6, 11, 19):
        step = np.zeros(vector.size)
        step[k] = 1e-6 * max(1.0, abs(vector[k]))
        up, down = (project(DISPLACED.replace_parameters(vector + s * step), directions) for s in (1.0, -1.0))
        np.testing.assert_allclose(rows[..., k], (up - down) / (2.0 * step[k]), rtol=1e-6, atol=2e-6)
    for axis in range(3):
        shift = 1e-6 * np.eye(3)[axis]
        difference = (project(DISPLACED, directions + shift) - project(DISPLACED, directions - shift)) / 2e-6
        np.testing.assert_allclose(by_direction[..., axis], difference, atol=1e-5)


@pytest.mark.parametrize(
    "change",
    [
        {"orders": ((0, 1),)},
        {"orders": ((1, 100_000),)},
        {"x_px": ()},
        {"y_px": (math.nan,)},
        {"half_px": (0.0, 5.0)},
    ],
)
def test_what_is_no_displacement_is_refused(change: dict[str, object]) -> None:
    sound = {"center_px": (1.0, 1.0), "half_px": (5.0, 5.0), "orders": ((1, 1),), "x_px": (0.1,), "y_px": (0.2,)}
    Displacement(**sound)  # type: ignore[arg-type]
    with pytest.raises(InputError) as refused:
        Displacement(**(sound | change))  # type: ignore[arg-type]
    assert refused.value.field.startswith("displacement")
