"""Candidates of an image: tones of deep images, mosaics, and the distance to the middle of the glare."""

from __future__ import annotations

import math

import numpy as np
import pytest
from tests.detection.photo.suns import glare_image

from sunarc.detection.photo.candidates import candidates_in, plane_of


def test_the_light_of_deep_images_is_compared_by_the_tones_of_eight_bits() -> None:
    linear = glare_image(radius=12.0)
    toned = np.round(255.0 * (linear / 4095.0) ** (1.0 / 2.2)).astype(np.uint8)
    deep, eight = candidates_in(linear, full_scale=4095)[0].rim, candidates_in(toned, full_scale=255)[0].rim
    assert deep.near == pytest.approx(eight.near, abs=0.02)
    assert deep.far == pytest.approx(eight.far, abs=0.02)


def test_a_candidate_of_a_mosaic_is_twice_that_of_its_cells() -> None:
    cells = glare_image(90.0, 80.0, radius=12.0)
    mosaic = np.repeat(np.repeat(cells, 2, axis=0), 2, axis=1)
    small, large = candidates_in(cells, full_scale=4095)[0], candidates_in(mosaic, full_scale=4095, bayer="RGGB")[0]
    assert np.array_equal(plane_of(mosaic, "RGGB"), cells)
    assert (large.rim.x, large.rim.y) == pytest.approx((2.0 * small.rim.x + 0.5, 2.0 * small.rim.y + 0.5))
    lengths = ("radius", "scatter", "spread", "offset")
    assert [getattr(large.rim, name) for name in lengths] == pytest.approx(
        [2.0 * getattr(small.rim, name) for name in lengths]
    )
    assert tuple(large[1:5]) == pytest.approx([2.0 * value for value in small[1:5]])
    assert large[5:] == small[5:]


def test_the_middle_of_the_glare_is_the_largest_suns() -> None:
    twins = np.maximum(glare_image(60.0, 100.0, radius=14.0), glare_image(150.0, 60.0, radius=5.0))
    seen = {round(each.rim.x, -1): each for each in candidates_in(twins, full_scale=4095)}
    larger, smaller = seen[60.0], seen[150.0]
    assert larger.off_glare_px < 3.0
    assert smaller.off_glare_px == pytest.approx(math.hypot(90.0, 40.0), abs=4.0)
    assert smaller.off_local_glare_px < 4.0


@pytest.mark.parametrize(("of_level", "area"), [(1.0, 0.025), (0.81, 0.025), (0.77, 0.0)])
def test_what_is_as_light_elsewhere_is_counted_by_its_area(of_level: float, area: float) -> None:
    image = glare_image(60.0, 100.0, radius=6.0)
    assert candidates_in(image, full_scale=4095)[0].other_area == 0.0
    image[20:40, 120:170] = round(4095 * of_level)  # 0.9 of 8 bits' tones are 0.793 of the light
    seen = [each for each in candidates_in(image, full_scale=4095) if abs(each.rim.x - 60.0) < 2.0]
    assert seen[0].other_area == pytest.approx(area)


@pytest.mark.parametrize("shape", [(1, 1), (2, 7), (9, 9), (30, 4)])
def test_an_image_of_any_size_has_no_candidates_or_some(shape: tuple[int, int]) -> None:
    for level in (0, 255):
        assert candidates_in(np.full(shape, level, np.uint8), full_scale=255) == []
