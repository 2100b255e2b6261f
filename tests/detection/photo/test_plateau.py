"""Plateaus: the highest level that a compact region fills, whatever is brighter and thinner."""

from __future__ import annotations

import cv2
import numpy as np
import pytest
from tests.detection.photo.suns import glare_image, with_text

from sunarc.array_types import Image
from sunarc.detection.photo.plateau import Plateau, faintest_colour, faintest_of_mosaic, plateaus


def first_of(plane: Image, least_level: float = 1400.0) -> Plateau:
    return plateaus(plane, least_level=least_level)[0]


def test_the_faintest_colour_is_the_smallest_of_three() -> None:
    image = np.random.default_rng(1).integers(0, 256, (20, 30, 3)).astype(np.uint8)
    assert np.array_equal(faintest_colour(image), image.min(axis=2))
    assert faintest_colour(image[..., 0]) is not None
    assert np.array_equal(faintest_colour(image[..., 0]), image[..., 0])


@pytest.mark.parametrize("shape", [(20, 30), (21, 31)])
def test_the_faintest_of_a_mosaic_is_the_smallest_of_each_cell(shape: tuple[int, int]) -> None:
    image = np.random.default_rng(1).integers(0, 4096, shape).astype(np.uint16)
    cells = image[:20, :30].reshape(10, 2, 15, 2).min(axis=(1, 3))
    assert np.array_equal(faintest_of_mosaic(image), cells)


@pytest.mark.parametrize("radius", [4.0, 9.0, 22.0])
@pytest.mark.parametrize("place", [(100.0, 90.0), (60.3, 120.7)])
def test_the_plateau_of_a_sun_is_found_to_a_pixel(radius: float, place: tuple[float, float]) -> None:
    found = first_of(glare_image(*place, radius=radius))
    assert (found.x, found.y) == pytest.approx(place, abs=1.0)
    assert found.radius == pytest.approx(radius, abs=1.0)
    assert found.level == pytest.approx(4095.0)


def test_in_a_large_image_the_search_is_reduced_and_the_place_is_not() -> None:
    large = cv2.resize(glare_image(), (2000, 2000), interpolation=cv2.INTER_LINEAR)
    found = first_of(large.astype(np.uint16))
    assert (found.x, found.y) == pytest.approx((1004.5, 904.5), abs=2.0)
    assert found.radius == pytest.approx(85.0, abs=5.0)


def test_a_sun_clipped_below_full_scale_is_found_beneath_brighter_text() -> None:
    clipped = np.minimum(glare_image(), 2600).astype(np.uint16)
    clipped[4:24:6, 6:60] = 4095  # strokes of one pixel are no region
    found = first_of(clipped)
    assert (found.x, found.y) == pytest.approx((100.0, 90.0), abs=1.0)
    assert found.level == pytest.approx(2600.0)


def test_a_painted_box_is_another_plateau_and_does_not_hide_the_suns() -> None:
    clipped = with_text(np.minimum(glare_image(), 2600).astype(np.uint16))
    found = plateaus(clipped, least_level=1400.0)
    assert {round(each.level) for each in found} == {4095, 2600}
    sun = next(each for each in found if each.level < 3000)
    assert (sun.x, sun.y) == pytest.approx((100.0, 90.0), abs=1.0)


def test_what_stands_still_does_not_take_part() -> None:
    clipped = with_text(np.minimum(glare_image(), 2600).astype(np.uint16))
    static = clipped > 3000
    assert {round(each.level) for each in plateaus(clipped, least_level=1400.0, static=static)} == {2600}


def test_a_dark_mark_within_the_sun_is_closed() -> None:
    image = glare_image(radius=14.0)
    image[86:93, 97:104] = 100
    found = first_of(image)
    assert (found.x, found.y) == pytest.approx((100.0, 90.0), abs=1.5)
    assert found.radius == pytest.approx(14.0, abs=1.5)


def test_the_glare_of_a_plateau_is_no_second_one() -> None:
    found = plateaus(glare_image(radius=20.0), least_level=1400.0)
    assert [each for each in found if each.level < 3900.0 and np.hypot(each.x - 100.0, each.y - 90.0) < 20.0] == []


@pytest.mark.parametrize("level", [0, 1399])
def test_below_the_least_level_nothing_is_found(level: int) -> None:
    assert plateaus(np.full((64, 64), level, np.uint16), least_level=1400.0) == []


@pytest.mark.parametrize("shape", [(1, 1), (2, 5), (3, 3), (5, 2), (40, 3)])
def test_an_image_of_any_size_is_looked_through(shape: tuple[int, int]) -> None:
    assert isinstance(plateaus(np.full(shape, 4095, np.uint16), least_level=1.0), list)
