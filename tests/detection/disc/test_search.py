"""Bright spots in a frame: hot pixels, several spots, moments of discs."""

from __future__ import annotations

import math

import numpy as np
import pytest
from scipy.linalg import sqrtm
from tests.detection.rendering import FloatArray, Image

from sunarc.common.robust_statistics import fast_median
from sunarc.detection.disc.detect import brightest_spots, measure_spot, moments, semi_axes, symmetric_root


def frame(*discs: tuple[float, float, float, float], size: tuple[int, int] = (150, 200)) -> Image:
    """Return a dark frame of 10 counts with even discs (x, y, radius, counts), their edges a pixel wide."""
    rows, columns = np.mgrid[: size[0], : size[1]]
    light = np.full(size, 10.0)
    for x, y, radius, counts in discs:
        light += counts * np.clip(radius + 0.5 - np.hypot(columns - x, rows - y), 0.0, 1.0)
    return np.asarray(light + 0.5, dtype=np.uint16)


@pytest.mark.parametrize("place", [(31.3, 40.8), (63.6, 64.2), (128.0, 64.0), (4.2, 5.1), (195.7, 145.2)])
def test_a_disc_anywhere_is_found_with_centre_level_and_size(place: tuple[float, float]) -> None:
    found = brightest_spots(frame((*place, 3.4, 2000.0)), count=3, reach=15, floor=100.0)
    assert len(found) == 1
    assert (found[0].x, found[0].y) == pytest.approx(place, abs=0.15)
    assert (found[0].level, found[0].background) == (2010.0, 10.0)
    assert found[0].contrast == 2000.0
    assert found[0].semi_axes == pytest.approx((3.3, 3.3), abs=0.3)


def test_single_bright_pixels_are_no_spot() -> None:
    image = frame()
    image[40, 50] = image[80, 90] = 4000
    image[80, 91] = 4000  # a pair is not four
    assert brightest_spots(image, count=3, reach=15, floor=100.0) == []


@pytest.mark.parametrize("corner", [(40, 50), (41, 50), (40, 51), (41, 51), (63, 63), (62, 127)])
def test_two_by_two_pixels_or_three_are_a_spot(corner: tuple[int, int]) -> None:
    y, x = corner
    image = frame()
    image[y : y + 3, x : x + 3] = 900
    found = brightest_spots(image, count=3, reach=15, floor=100.0)
    assert [(round(spot.x), round(spot.y)) for spot in found] == [(x + 1, y + 1)]


def test_spots_are_ordered_by_level_and_as_many_as_asked_for() -> None:
    image = frame((30.0, 30.0, 3.0, 800.0), (100.0, 30.0, 3.0, 2400.0), (160.0, 110.0, 3.0, 1600.0))
    found = brightest_spots(image, count=3, reach=15, floor=100.0)
    assert [round(spot.level) for spot in found] == [2410, 1610, 810]
    assert len(brightest_spots(image, count=2, reach=15, floor=100.0)) == 2
    assert brightest_spots(image, count=0, reach=15, floor=100.0) == []


@pytest.mark.parametrize(("floor", "spots"), [(809.0, 1), (810.0, 0)])
def test_a_core_must_exceed_the_floor(floor: float, spots: int) -> None:
    assert len(brightest_spots(frame((30.0, 30.0, 3.0, 800.0)), count=3, reach=15, floor=floor)) == spots


def test_a_disc_on_the_border_of_tiles_is_one_spot() -> None:
    assert len(brightest_spots(frame((63.5, 63.5, 4.0, 1000.0)), count=4, reach=15, floor=100.0)) == 1


@pytest.mark.parametrize(("size", "spots"), [((7, 40), 0), ((40, 7), 0), ((8, 8), 1)])
def test_an_image_of_less_than_eight_pixels_has_no_spots(size: tuple[int, int], spots: int) -> None:
    assert len(brightest_spots(np.full(size, 500, np.uint16), count=1, reach=15, floor=100.0)) == spots


def test_an_even_image_has_a_spot_without_contrast() -> None:
    spot = brightest_spots(np.full((64, 64), 500, np.uint16), count=1, reach=15, floor=100.0)[0]
    assert spot.contrast == 0.0


def test_the_window_is_moved_onto_a_spot_that_it_cut() -> None:
    spot = measure_spot(frame((60.0, 60.0, 8.0, 1000.0)), x=50, y=52, reach=12)
    assert (spot.x, spot.y) == pytest.approx((60.0, 60.0), abs=0.1)
    assert spot.semi_axes == pytest.approx((8.0, 8.0), abs=0.4)


@pytest.mark.parametrize("angle_deg", [0.0, 30.0, 90.0, 140.0])
def test_the_axes_are_those_of_the_ellipse(angle_deg: float) -> None:
    rows, columns = np.mgrid[:60, :60]
    angle = math.radians(angle_deg)
    u = (columns - 30.2) * math.cos(angle) + (rows - 29.7) * math.sin(angle)
    v = (rows - 29.7) * math.cos(angle) - (columns - 30.2) * math.sin(angle)
    image = np.where((u / 8.0) ** 2 + (v / 5.0) ** 2 < 1.0, 1000, 0).astype(np.uint16)
    spot = measure_spot(image, x=30, y=30, reach=20)
    assert spot.semi_axes == pytest.approx((4.8, 7.8), abs=0.3)
    values, vectors = np.linalg.eigh(spot.axes)
    assert abs(float(vectors[:, int(np.argmax(values))] @ [math.cos(angle), math.sin(angle)])) > 0.995


def test_eight_and_sixteen_bits_are_measured_alike() -> None:
    image = frame((30.4, 40.1, 3.0, 200.0))
    deep, shallow = (brightest_spots(i, count=1, reach=15, floor=50.0)[0] for i in (image, image.astype(np.uint8)))
    assert (deep.x, deep.y, deep.level) == (shallow.x, shallow.y, shallow.level)


@pytest.mark.parametrize("size", [1, 2, 3, 8, 101])
def test_the_median_is_numpys(size: int) -> None:
    values = np.random.default_rng(size).normal(size=size)
    assert fast_median(values) == pytest.approx(float(np.median(values)))


@pytest.mark.parametrize(
    "matrix", [np.diag([4.0, 9.0]), np.array([[5.0, 1.2], [1.2, 3.0]]), np.array([[5.0, -2.0], [-2.0, 1.0]])]
)
def test_the_symmetric_root_is_scipys(matrix: FloatArray) -> None:
    assert symmetric_root(matrix) == pytest.approx(np.real(sqrtm(matrix)))


@pytest.mark.parametrize("matrix", [np.diag([2.0, -3.0]), np.array([[2.9, 0.4], [0.4, 2.5]]), np.zeros((2, 2))])
def test_semi_axes_are_the_singular_values(matrix: FloatArray) -> None:
    assert semi_axes(matrix) == pytest.approx(tuple(np.linalg.svd(matrix, compute_uv=False)[::-1]))


def test_moments_are_those_of_what_exceeds_half_the_level() -> None:
    mean = np.zeros((9, 11))
    mean[3:6, 4:8] = [[60.0, 80.0, 100.0, 70.0], [90.0, 100.0, 95.0, 55.0], [20.0, 65.0, 85.0, 45.0]]
    rows, columns = np.nonzero(mean > 50.0)
    weight = mean[rows, columns] - 50.0
    x, y = (float(np.average(axis, weights=weight)) for axis in (columns, rows))
    found = moments(mean, x0=100.5, y0=200.5)
    assert (found.x, found.y, found.level, found.background) == pytest.approx((x + 100.5, y + 200.5, 100.0, 0.0))
    covariance = [
        [np.mean((a - p) * (b - q)) for b, q in ((columns, x), (rows, y))] for a, p in ((columns, x), (rows, y))
    ]
    expected = np.real(sqrtm(4.0 * np.array(covariance) + 1e-3 * np.eye(2)))
    assert np.asarray(found.axes) == pytest.approx(expected, rel=1e-6)


def test_a_spot_of_one_pixel_has_the_least_axes() -> None:
    mean = np.zeros((9, 11))
    mean[4, 5] = 100.0
    assert moments(mean, x0=0.0, y0=0.0).semi_axes == pytest.approx((math.sqrt(1e-3), math.sqrt(1e-3)))
