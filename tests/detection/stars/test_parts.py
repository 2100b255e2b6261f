"""The parts of the detection of stars, each against its definition written out or scipy's."""

from __future__ import annotations

import math

import numpy as np
import pytest
from scipy.ndimage import median_filter
from tests.detection.stars.rendering import FULL_SCALE, GAIN_E, counted, expected

from sunarc.common.array_types import FloatArray, Image
from sunarc.detection.stars.detect import (
    Background,
    Stamps,
    detect_stars,
    estimate_background,
    find_maxima,
    fit_point_spreads,
    inverse_shape,
    light_plane,
    mean_width,
    outstanding_pixels,
    repaired,
    shape_at,
    stamps_at,
    start_at,
    warm_pixels,
)
from sunarc.detection.values import Bayer


def between(grid: FloatArray, shape: tuple[int, int]) -> FloatArray:
    """Return a grid of tiles of 32 px interpolated linearly between their centres, constant beyond the outer ones."""
    centres = [15.5 + 32.0 * np.arange(n) for n in grid.shape]
    across = np.array([np.interp(np.arange(shape[1]), centres[1], row) for row in grid])
    return np.array([np.interp(np.arange(shape[0]), centres[0], column) for column in across.T]).T


def test_the_background_is_the_medians_of_tiles_of_32_pixels() -> None:
    rng = np.random.default_rng(1)
    plane = rng.normal(200.0, 5.0, (100, 150)) + np.linspace(0.0, 60.0, 150) + np.linspace(0.0, 9.0, 100)[:, None]
    plane[40:44, 60:64] += 5000.0
    plane = plane.astype(np.float32).astype(np.float64)

    def medians(of: FloatArray) -> FloatArray:
        tiles = [[np.median(of[r : r + 32, c : c + 32]) for c in range(0, 160, 32)] for r in range(0, 128, 32)]
        return median_filter(np.array(tiles), 3, mode="nearest")

    level = between(medians(np.pad(plane, ((0, 28), (0, 10)), mode="reflect")), plane.shape)
    noise = 1.4826 * between(medians(np.pad(np.abs(plane - level), ((0, 28), (0, 10)), mode="reflect")), plane.shape)
    found = estimate_background(plane.astype(np.float32), least_noise=5.9)
    np.testing.assert_allclose(found.level, level, rtol=1e-5)
    np.testing.assert_allclose(found.noise, np.maximum(noise, 5.9), rtol=1e-4)
    assert 0.1 < np.mean(noise < 5.9) < 0.9


@pytest.mark.parametrize("colours", [1, 3])
def test_light_is_the_mean_of_the_colours_and_clipped_is_a_pixel_or_its_neighbour_at_97_percent(colours: int) -> None:
    image = np.full((12, 14, colours), 100, dtype=np.uint16)
    image[3, 4, 0], image[8, 9, colours - 1], image[6, 1, 0] = 969, 970, 700
    light, clipped = light_plane(image if colours == 3 else image[..., 0], 1000, None)
    expected_clipped = np.zeros((12, 14), dtype=bool)
    expected_clipped[7:10, 8:11] = True
    np.testing.assert_array_equal(clipped, expected_clipped)
    np.testing.assert_allclose(light, image.mean(axis=-1), rtol=1e-6)


@pytest.mark.parametrize(
    ("apart", "clipped", "found"),
    [((4, 3), False, 1), ((5, 1), False, 2), ((5, 1), True, 1), ((6, 8), True, 1), ((7, 8), True, 2)],
)
def test_of_two_maxima_the_brighter_one_counts_where_they_are_close(
    apart: tuple[int, int],
    clipped: bool,  # noqa: FBT001 - a parameter
    found: int,
) -> None:
    plane = np.zeros((60, 60), dtype=np.float32)
    y, x = np.mgrid[:60, :60]
    for height, at in ((80.0, (30, 30)), (60.0, (30 + apart[0], 30 + apart[1]))):
        plane += (height * np.exp(-0.5 * ((x - at[0]) ** 2 + (y - at[1]) ** 2) / 0.8**2)).astype(np.float32)
    cut_off = np.zeros(plane.shape, dtype=bool)
    cut_off[50, 50] = clipped
    ground = Background(np.zeros_like(plane), np.ones_like(plane))
    places = find_maxima(plane, ground, cut_off, np.ones_like(cut_off), 1.1)
    assert places.tolist() == [[30.0, 30.0], [30.0 + apart[0], 30.0 + apart[1]]][:found]


@pytest.mark.parametrize(("place", "found"), [(2, 0), (3, 1), (36, 1), (37, 0)])
@pytest.mark.parametrize("down", [False, True])
def test_no_star_is_looked_for_within_its_width_and_a_pixel_of_an_edge(place: int, found: int, *, down: bool) -> None:
    plane = np.zeros((40, 40), dtype=np.float32)
    plane[(place, 20) if down else (20, place)] = 100.0
    ground = Background(np.zeros_like(plane), np.ones_like(plane))
    none = np.zeros(plane.shape, dtype=bool)
    assert len(find_maxima(plane, ground, none, ~none, 1.1)) == found


@pytest.mark.parametrize("shape", [False, True])
@pytest.mark.parametrize("gain_e", [None, 3.0])
def test_a_fit_is_weighted_least_squares_with_the_shot_noise_of_the_star(gain_e: float | None, *, shape: bool) -> None:
    rng = np.random.default_rng(2)
    y, x = (axis.ravel().astype(float) for axis in np.mgrid[:11, :11])

    def model(at: FloatArray) -> FloatArray:
        dx, dy = x - at[0], y - at[1]
        return np.asarray(at[3] + at[2] * np.exp(-0.5 * (at[4] * dx**2 + 2.0 * at[5] * dx * dy + at[6] * dy**2)))

    truth = np.array([5.3, 4.8, 400.0, 10.0, 0.7, 0.1, 0.5])
    variance = rng.uniform(3.0, 6.0, x.size)
    value = model(truth) + 1.5 * rng.normal(0.0, np.sqrt(variance + (0.0 if gain_e is None else model(truth) / gain_e)))
    start = truth + np.array([0.4, -0.3, -60.0, -10.0, 0.1 * shape, 0.0, 0.05 * shape])
    found = fit_point_spreads(
        Stamps(x[None], y[None], value[None], variance[None]), start[None], gain_e=gain_e, shape=shape
    )
    at, free = found.parameters[0], 7 if shape else 4
    np.testing.assert_allclose(at[free:], truth[free:])
    step = 1e-5
    slopes = np.array(
        [(model(at + step * axis) - model(at - step * axis)) / (2.0 * step) for axis in np.eye(7)[:free]]
    ).T
    weight = 1.0 / (variance + (0.0 if gain_e is None else (model(at) - at[3]) / gain_e))
    normal = slopes.T @ (slopes * weight[:, None])
    off = np.linalg.solve(normal, slopes.T @ (weight * (value - model(at)))) / np.sqrt(np.diag(np.linalg.inv(normal)))
    assert np.max(np.abs(off)) < 2e-3
    chi2 = float(np.sum(weight * (value - model(at)) ** 2)) / (x.size - free)
    covariance = np.linalg.inv(normal)
    assert found.chi2[0] == pytest.approx(chi2, rel=1e-6)
    assert chi2 > 1.5
    assert found.sigma_px[0] == pytest.approx(
        math.hypot(math.sqrt(np.trace(covariance[:2, :2]) / 2.0 * chi2), 0.01), rel=1e-4
    )
    assert found.snr[0] == pytest.approx(at[2] / math.sqrt(covariance[2, 2]), rel=1e-4)


@pytest.mark.parametrize(("width", "reach"), [(0.5, 3), (1.1, 4), (2.0, 7), (6.0, 15)])
def test_a_stamp_is_what_is_nearest_to_its_star_within_three_and_a_half_widths(width: float, reach: int) -> None:
    rng = np.random.default_rng(3)
    plane, level = rng.normal(100.0, 9.0, (2, 60, 70)).astype(np.float32)
    noise = rng.uniform(1.0, 2.0, (60, 70)).astype(np.float32)
    clipped = rng.random((60, 70)) < 0.01
    places = np.array([[20.0, 30.0], [25.0, 32.0], [1.0, 57.0], [60.0, 10.0], [67.0, 58.0]])
    stamps, cut_off = stamps_at(plane, Background(level, noise), clipped, places, width)
    for k, (x0, y0) in enumerate(places.astype(int).tolist()):
        pixels = [(x0 + dx, y0 + dy) for dy in range(-reach, reach + 1) for dx in range(-reach, reach + 1)]
        assert list(zip(stamps.x[k].tolist(), stamps.y[k].tolist(), strict=True)) == pixels
        near_clipped = False
        for (x, y), value, variance in zip(pixels, stamps.value[k], stamps.variance[k], strict=True):
            inside = 0 <= x < 70 and 0 <= y < 60
            apart = np.hypot(*(places - [x, y]).T)
            own = apart[k] < np.min(np.delete(apart, k)) or (apart[k] == apart.min() and np.isfinite(variance))
            if inside and own and not clipped[y, x]:
                assert variance == pytest.approx(noise[y, x] ** 2, rel=1e-6)
                assert value == pytest.approx(plane[y, x] - level[y, x], rel=1e-5)
            else:
                assert np.isinf(variance)
            column, row = min(max(x, 0), 69), min(max(y, 0), 59)
            near_clipped |= bool(clipped[row, column]) and own and math.dist((x, y), (x0, y0)) <= 2.0 * width + 1.0
        assert cut_off[k] == near_clipped


def test_a_fit_begins_at_the_middle_pixel_with_the_shape_that_is_expected() -> None:
    value = np.arange(50.0).reshape(2, 25) - 20.0
    shape = np.array([[1.5, 0.2, 1.1], [2.0, -0.3, 0.9]])
    places = np.array([[4.0, 5.0], [6.0, 7.0]])
    found = start_at(Stamps(value, value, value, value), places, shape)
    for k in range(2):
        inverse = np.linalg.inv([[shape[k, 0], shape[k, 1]], [shape[k, 1], shape[k, 2]]])
        expected_row = [*places[k], max(value[k, 12], 1e-3), 0.0, inverse[0, 0], inverse[0, 1], inverse[1, 1]]
        np.testing.assert_allclose(found[k], expected_row)
        np.testing.assert_allclose(inverse_shape(shape)[k], found[k, 4:])


@pytest.mark.parametrize("count", [24, 25])
def test_the_shape_is_a_quadratic_of_the_place_from_25_stars_on(count: int) -> None:
    rng = np.random.default_rng(4)

    def planted(at: FloatArray) -> FloatArray:
        x, y = (at / [400.0, 300.0]).T
        return np.stack([1.5 + 0.3 * x - 0.2 * y * y, 0.1 * x * y, 1.2 + 0.2 * y + 0.1 * x * x], axis=-1)

    known, places = rng.uniform(0.0, [400.0, 300.0], (count, 2)), rng.uniform(0.0, [400.0, 300.0], (9, 2))
    shape = planted(known)
    shape[[3, 11]] += 2.0
    found = shape_at(known, shape, places, (300, 400))
    usual = np.tile(np.median(shape, axis=0), (9, 1))
    np.testing.assert_allclose(found, usual if count < 25 else planted(places), rtol=1e-6 if count < 25 else 1e-3)


def test_where_a_quadratic_is_no_shape_like_the_others_the_usual_one_stands() -> None:
    known = np.stack([np.linspace(180.0, 220.0, 40), np.random.default_rng(8).uniform(20.0, 280.0, 40)], axis=-1)

    def axis(at: FloatArray) -> FloatArray:
        return np.asarray(1.0 + (at[:, 0] - 200.0) / 150.0)

    shape = np.stack([axis(known) ** 2, np.zeros(40), axis(known) ** 2], axis=-1)
    places = np.stack([np.arange(60.0, 460.0, 10.0), np.full(40, 150.0)], axis=-1)
    expected_axis, middle = axis(places), float(np.median(mean_width(shape)))
    like = (expected_axis > 0.4 * middle) & (expected_axis < 2.5 * middle)
    expected_axis[~like] = math.sqrt(float(np.median(shape[:, 0])))
    found = shape_at(known, shape, places, (300, 400))
    np.testing.assert_allclose(np.sqrt(found[:, 0]), expected_axis, rtol=1e-3)
    assert 5 < np.count_nonzero(~like) < 20


def calm(image: Image, mosaic: bool) -> FloatArray:  # noqa: FBT001
    if not mosaic:
        return np.asarray(median_filter(image, 3, mode="nearest"), dtype=np.float64)
    found = np.empty(image.shape)
    for r, c in ((0, 0), (0, 1), (1, 0), (1, 1)):
        found[r::2, c::2] = median_filter(image[r::2, c::2], 3, mode="nearest")
    return found


@pytest.mark.parametrize("mosaic", [False, True])
@pytest.mark.parametrize("noise", [0.0, 8.0])
def test_a_pixel_stands_out_by_six_noises_over_its_neighbours(noise: float, *, mosaic: bool) -> None:
    rng = np.random.default_rng(5)
    image = (300.0 + rng.normal(0.0, 1.0, (64, 80)) * noise).round().astype(np.uint16)
    if mosaic:
        image[::2, ::2] += 90
    places = rng.choice(64 * 80, 60, replace=False)
    image.ravel()[places] += rng.integers(1, 8 + int(12 * noise), 60).astype(np.uint16)
    excess = image - calm(image, mosaic)
    sampled = excess[::4, ::4]
    least = max(1.4826 * float(np.median(np.abs(sampled - np.median(sampled)))), 0.5)
    bayer: Bayer | None = "RGGB" if mosaic else None
    found = outstanding_pixels(image, bayer=bayer)
    np.testing.assert_array_equal(found, np.flatnonzero(excess.ravel() > 6.0 * least))
    assert np.count_nonzero((excess > 6.0 * least) & (excess < 9.0 * least)) > 0
    whole = repaired(image, found, bayer=bayer)
    np.testing.assert_array_equal(whole.ravel()[found], calm(image, mosaic).ravel()[found])
    assert np.count_nonzero(whole != image) == found.size


def test_of_many_outstanding_pixels_the_brightest_count() -> None:
    image = np.full((450, 450), 50, dtype=np.uint16)
    image[1::3, 1::3] = 1000 + np.random.default_rng(6).permutation(150 * 150).reshape(150, 150)
    found = outstanding_pixels(image)
    assert found.size == 20_000
    assert image.ravel()[found].min() == 1000 + 2500


def test_warm_is_what_stands_out_in_seven_images_of_ten() -> None:
    outstanding = [np.array([one for one in range(11) if one > k]) for k in range(10)]
    assert warm_pixels(outstanding).tolist() == [7, 8, 9, 10]
    assert warm_pixels([]).size == 0


def test_a_star_that_is_clipped_widely_stands_for_what_is_found_about_it() -> None:
    rng, places = np.random.default_rng(7), np.array([[60.0, 60.0], [20.0, 90.0], [100.0, 25.0], [95.0, 100.0]])
    light = expected(places, np.array([2e4, 2e4, 3e4, 3e4]), size=128, width=1.1)
    y, x = np.mgrid[:128, :128]
    light += 1e5 * (np.hypot(x - 60.0, y - 60.0) < 5.0)
    for away, seen in ((8.0, False), (17.0, True)):
        beside = light + expected(np.array([[60.0 + away, 60.0]]), np.array([2e4]), size=128, width=1.1)
        stars = detect_stars(counted(rng, beside), full_scale=FULL_SCALE, gain_e_per_count=GAIN_E)
        (core,) = np.flatnonzero(np.isinf(stars.snr))
        width = float(np.median(stars.width_px[np.isfinite(stars.snr)]))
        np.testing.assert_allclose(stars.pixels[core], [60.0, 60.0], atol=0.3)
        radius = 2.0 * stars.sigma_px[core]
        assert 5.0 < radius < 6.6
        assert stars.width_px[core] == pytest.approx(width, rel=0.1)
        assert (stars.ellipticity[core], stars.peak_fraction[core], stars.saturated[core]) == (0.0, 1.0, True)
        found = np.hypot(*(stars.pixels - [60.0 + away, 60.0]).T) < 0.5
        assert (np.count_nonzero(found) == 1) == seen
        assert len(stars) == 4 + seen
