"""Connected bright regions: areas, centroids, inscribed circles."""

from __future__ import annotations

import math

import numpy as np
import pytest
from tests.detection.rendering import FloatArray

from sunarc.detection.photo.plateau import Mask, largest_blobs, opened, thickest


def mask_of(*discs: tuple[float, float, float], size: int = 120) -> Mask:
    rows, columns = np.mgrid[:size, :size]
    inside: FloatArray = np.zeros((size, size))
    for x, y, radius in discs:
        inside += np.hypot(columns - x, rows - y) <= radius
    return (inside > 0).astype(np.uint8)


@pytest.mark.parametrize("radius", [5.0, 12.4, 30.0])
def test_a_disc_has_its_centroid_diameter_and_box(radius: float) -> None:
    mask = mask_of((57.0, 61.0, radius))
    (blob,) = largest_blobs(mask, most=3)
    assert (blob.x, blob.y) == pytest.approx((57.0, 61.0))
    assert blob.diameter == pytest.approx(2.0 * math.sqrt(float(mask.sum()) / math.pi))
    assert blob.diameter == pytest.approx(2.0 * radius, abs=0.6)
    assert blob.box == (
        round(57 - math.floor(radius)),
        round(61 - math.floor(radius)),
        *([2 * math.floor(radius) + 1] * 2),
    )


def test_a_bar_has_its_middle_and_its_box() -> None:
    mask = np.zeros((60, 80), np.uint8)
    mask[20:24, 10:70] = 1
    (blob,) = largest_blobs(mask, most=1)
    assert (blob.x, blob.y, blob.box) == (39.5, 21.5, (10, 20, 60, 4))


def test_blobs_are_ordered_by_area_and_as_many_as_asked_for() -> None:
    mask = mask_of((20.0, 20.0, 5.0), (60.0, 60.0, 12.0), (100.0, 20.0, 8.0))
    assert [round(blob.x) for blob in largest_blobs(mask, most=5)] == [60, 100, 20]
    assert [round(blob.x) for blob in largest_blobs(mask, most=2)] == [60, 100]
    assert largest_blobs(mask, most=0) == []


def test_pixels_that_touch_at_a_corner_are_one_blob() -> None:
    mask = np.zeros((10, 10), np.uint8)
    mask[3, 3] = mask[4, 4] = 1
    (blob,) = largest_blobs(mask, most=5)
    assert (blob.x, blob.y) == (3.5, 3.5)


def test_a_hole_does_not_count_for_the_diameter() -> None:
    mask = mask_of((60.0, 60.0, 20.0)) - mask_of((60.0, 60.0, 8.0))
    (blob,) = largest_blobs(mask, most=1)
    assert blob.diameter == pytest.approx(2.0 * math.sqrt(400.0 - 64.0), rel=0.02)


def test_one_pixel_is_a_blob_and_none_is_none() -> None:
    mask = np.zeros((5, 5), np.uint8)
    assert largest_blobs(mask, most=1) == []
    mask[0, 4] = 1
    (blob,) = largest_blobs(mask, most=1)
    assert (blob.x, blob.y, blob.box) == (4.0, 0.0, (4, 0, 1, 1))
    assert blob.diameter == pytest.approx(2.0 / math.sqrt(math.pi))


def test_inscribed_circles_are_ordered_and_apart() -> None:
    found = thickest(mask_of((30.0, 30.0, 8.0), (85.0, 80.0, 15.0)), most=5, least_radius=4.0)
    assert [(round(x), round(y)) for x, y, _ in found[:2]] == [(85, 80), (30, 30)]
    assert found[0][2] == pytest.approx(15.5, abs=0.8)
    assert found[1][2] == pytest.approx(8.5, abs=0.8)
    assert thickest(mask_of((30.0, 30.0, 8.0)), most=0, least_radius=1.0) == []


@pytest.mark.parametrize(("least", "found"), [(7.0, 1), (10.0, 0)])
def test_thin_regions_have_no_inscribed_circle(least: float, found: int) -> None:
    assert len(thickest(mask_of((60.0, 60.0, 8.0)), most=1, least_radius=least)) == found


def test_a_region_at_the_border_is_not_thicker_than_it_is() -> None:
    mask = np.zeros((40, 40), np.uint8)
    mask[:, :6] = 1
    (first, *_) = thickest(mask, most=1, least_radius=1.0)
    assert first[2] == pytest.approx(3.0, abs=0.6)


@pytest.mark.parametrize(("width", "left"), [(2, 0), (3, 3)])
def test_opening_takes_away_what_is_thinner_than_the_disc(width: int, left: int) -> None:
    mask = np.zeros((30, 30), np.uint8)
    mask[5:25, 10 : 10 + width] = 1
    assert int(opened(mask, 3).any(axis=0).sum()) == left


def test_opening_by_a_pixel_or_nothing_changes_nothing() -> None:
    mask = mask_of((30.0, 30.0, 8.0))
    assert (opened(mask, 1) == mask).all()
    assert (opened(mask, 0) == mask).all()
