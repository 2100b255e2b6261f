"""What stands still in a series: overlays are, the sun is not."""

from __future__ import annotations

import numpy as np
import pytest
from numpy.typing import NDArray
from tests.detection.photo.suns import glare_image, with_text

from sunarc.common.errors import InputError
from sunarc.detection.photo.plateau import static_mask


def series(count: int = 4) -> list[NDArray[np.uint16]]:
    """Return a sun that moves by 35 px from image to image beneath an overlay."""
    return [with_text(glare_image(50.0 + 35.0 * k, 90.0, seed=k)) for k in range(count)]


def test_text_and_boxes_stand_still_and_the_sun_does_not() -> None:
    mask = static_mask(series(), full_scale=4095)
    assert mask is not None
    assert mask[180:192, 10:34].all()
    assert mask[4:24:6, 6:60].all()
    assert not mask[60:120, 40:170].any()
    assert 0.01 < mask.mean() < 0.08


def test_colours_are_told_by_their_faintest() -> None:
    colours = [np.stack([image, image, np.full_like(image, 100)], axis=-1) for image in series()]
    mask = static_mask(colours, full_scale=4095)
    assert mask is not None
    assert not mask.any()


def test_the_margin_covers_the_digits_that_change() -> None:
    images = [np.full((1000, 1000), 50, np.uint8) for _ in range(3)]
    for k, image in enumerate(images):
        image[100:110, 100:110] = 255
        image[100:110, 110 + 2 * k : 112 + 2 * k] = 255
    mask = static_mask(images, full_scale=255)
    assert mask is not None
    assert mask[100:110, 110:116].all()
    assert not mask[100:110, 117:].any()


@pytest.mark.parametrize(("change", "still"), [(15, True), (16, False)])
def test_a_level_stands_still_within_the_noise_of_jpeg(change: int, *, still: bool) -> None:
    images = [np.full((20, 20), 200 + change * (k == 1), np.uint8) for k in range(3)]
    mask = static_mask(images, full_scale=255)
    assert mask is not None
    assert mask.all() == still


@pytest.mark.parametrize(("level", "bright"), [(128, True), (127, False)])
def test_only_bright_levels_count(level: int, *, bright: bool) -> None:
    mask = static_mask([np.full((20, 20), level, np.uint8)] * 3, full_scale=255)
    assert mask is not None
    assert mask.all() == bright


@pytest.mark.parametrize("count", [0, 1, 2])
def test_fewer_than_three_images_cannot_tell(count: int) -> None:
    assert static_mask(series()[:count], full_scale=4095) is None


def test_images_of_two_sizes_are_refused() -> None:
    with pytest.raises(InputError) as error:
        static_mask([np.zeros((4, 4), np.uint8), np.zeros((4, 5), np.uint8)], full_scale=255)
    assert error.value.field == "images"


def test_the_images_are_not_changed() -> None:
    images = series()
    copies = [image.copy() for image in images]
    static_mask(images, full_scale=4095)
    assert all(np.array_equal(one, other) for one, other in zip(images, copies, strict=True))
