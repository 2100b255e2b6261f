"""Plateaus: the highest level that a compact region fills, whatever is brighter and thinner."""

from __future__ import annotations

from pathlib import Path

import cv2
import numpy as np
import pytest
from tests.detection.photo.suns import glare_image, with_text
from tests.fixtures.stored_answers import require_stored

from sunarc.common.array_types import Image
from sunarc.detection.photo.plateau import (
    Near,
    Plateau,
    cell_minimum,
    circle_box,
    faintest_colour,
    plateaus,
    static_mask,
)


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
    assert np.array_equal(cell_minimum(image), cells)


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


def test_the_plateaus_of_many_images_are_the_stored_ones() -> None:
    """Suns of all sizes, dimmer ones beside brighter ones, holes, boxes, far from a prediction, in coarser steps."""
    rows, columns = np.mgrid[:200, :200]
    found: list[Plateau] = []
    for radius in (1.5, 2.2, 3.0, 6.0, 14.0, 30.0):
        found += plateaus(glare_image(radius=radius), least_level=1400.0)
    for share in (0.4, 0.49, 0.52, 0.7, 0.9, 0.96, 0.98):
        for far in (20, 40, 80):
            image = np.full((200, 200), 300, np.uint16)
            image[np.hypot(columns - 60, rows - 100) < 8.0] = 4000
            image[np.hypot(columns - 60 - far, rows - 100) < 9.0] = round(4000 * share)
            found += plateaus(image, least_level=1400.0)
    for hole in (2.0, 5.0, 7.0, 8.5, 10.0):
        image = glare_image(radius=16.0)
        image[np.hypot(columns - 101.0, rows - 91.0) < hole] = 200
        found += plateaus(image, least_level=1400.0)
    for light in (400, 1100, 1300, 2500):
        image = np.full((200, 200), light, np.uint16)
        image[60:72, 50:90] = 4000
        image[120:128, 20:60] = 3990
        found += [one for least in (0.0, 0.3, 0.6) for one in plateaus(image, least_level=1400.0, least_near=least)]
    for reach in (4.0, 12.0, 21.0, 40.0):
        image = np.maximum(glare_image(60.0, 100.0, radius=7.0), glare_image(150.0, 60.0, radius=5.0))
        for near in (Near(66.0, 104.0, reach), Near(130.0, 70.0, reach), Near(150.0, 61.0, reach)):
            found += plateaus(image, least_level=1400.0, near=near)
            found += plateaus(image, least_level=1400.0, near=near, size=1950)
    for size in (1400, 1460, 2800):
        found += plateaus(with_text(glare_image(radius=12.0)), least_level=1400.0, size=size)
    many = np.full((200, 200), 300, np.uint16)
    for k in range(9):
        many[20 * k + 10 : 20 * k + 16 + k % 3, 20 * k + 8 : 20 * k + 16] = 4000
    found += plateaus(many, least_level=1400.0)
    answer: dict[str, list[object]] = {"codes": [len(found)], "places": [x for one in found for x in one]}
    require_stored(Path(__file__).parents[1] / "stored_answers.json", "plateaus", answer, relative=0.0, apart_px=0.02)


def test_a_mask_is_where_light_of_half_of_full_scale_changes_by_six_percent_at_most() -> None:
    images = [np.full((400, 500), 20, np.uint8) for _ in range(3)]
    for k, image in enumerate(images):
        image[100:110, 100:110] = 250 - 7 * k
        image[200:210, 100:110] = 250 - 8 * k
        image[100:110, 300:310] = 128
        image[200:210, 300:310] = 127
    still = static_mask(images, full_scale=255)
    assert still is not None
    expected = np.zeros((400, 500), dtype=bool)
    expected[98:112, 98:112] = expected[98:112, 298:312] = True  # grown by 0.006 of 400 px
    np.testing.assert_array_equal(still, expected)
    assert static_mask(images[:2], full_scale=255) is None


def _circle(share: float, *, size: int = 400, softness: float = 1.0, x: float = 0.0) -> Image:
    """Return an image with a light disc of so much of its area, whose edge is so many px wide."""
    rows, columns = np.mgrid[:size, :size] - size / 2.0
    away = np.hypot(columns - x, rows) - size * np.sqrt(share / np.pi)
    light = 8.0 + 120.0 / (1.0 + np.exp(np.clip(away / softness, -50.0, 50.0)))
    return np.asarray(np.round(light), dtype=np.uint8)


@pytest.mark.parametrize("share", [0.12, 0.2, 0.4, 0.55])
@pytest.mark.parametrize("x", [0.0, 20.0])
def test_the_box_about_a_small_image_circle_holds_it_and_little_else(share: float, x: float) -> None:
    rows, columns = circle_box(_circle(share, x=x)) or pytest.fail("none is seen")
    radius = 400.0 * np.sqrt(share / np.pi)
    for part, middle in ((rows, 200.0), (columns, 200.0 + x)):
        assert 0.0 <= middle - radius - part.start < 0.15 * radius + 8.0
        assert 0.0 <= part.stop - middle - radius < 0.15 * radius + 8.0
        assert part.start % 2 == 0


def test_what_fills_the_image_and_what_fades_is_no_small_image_circle() -> None:
    assert circle_box(_circle(0.75)) is None
    assert circle_box(_circle(2.0)) is None
    assert circle_box(_circle(0.2, softness=40.0)) is None  # the glare of a lamp
    assert circle_box(_circle(0.02)) is None
    assert circle_box(np.zeros((40, 30, 3), np.uint8)) is None
