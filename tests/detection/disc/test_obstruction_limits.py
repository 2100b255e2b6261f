"""The dark surroundings of a missing sun: each limit from both sides, on images of known levels."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import pytest
from tests.detection.rendering import Image

from sunarc.detection.disc.detect import obstruction
from sunarc.detection.values import Expectation, Sensor

SENSOR = Sensor(full_scale=4095, gain_e_per_count=5.0, read_noise_e=10.0, black_level=100.0)
PREDICTED = Expectation(x_px=128.0, y_px=128.0, clear_peak_fraction=1.0)


def sky(*, level: float, here: float, noise: float = 2.0) -> Image:
    """Return a sky of some counts above black, the 41×41 px around the sun at another level."""
    rng = np.random.default_rng(0)
    image = np.full((256, 256), 100.0 + level)
    image[108:149, 108:149] = 100.0 + here
    return np.rint(image + rng.normal(0.0, noise, image.shape)).astype(np.uint16)


def obstructed(image: Image, expectation: Expectation = PREDICTED, *, reach_px: float = 12.0) -> bool:
    found = obstruction(image, sensor=SENSOR, expectation=expectation, reach_px=reach_px)
    return found is not None


@pytest.mark.parametrize(("here", "expected"), [(96.0, True), (104.0, False)])
def test_surroundings_darker_than_half_of_the_sky_are_an_obstruction(here: float, *, expected: bool) -> None:
    assert obstructed(sky(level=200.0, here=here)) == expected


@pytest.mark.parametrize(("level", "expected"), [(0.4, False), (1.5, True)])
def test_the_difference_must_be_significant(level: float, *, expected: bool) -> None:
    assert obstructed(sky(level=level, here=0.0)) == expected  # 6 sigma of 625 px are 0.7 counts


@pytest.mark.parametrize(("clear", "expected"), [(0.0299, False), (0.0301, True), (None, False)])
def test_the_clear_sun_must_be_three_times_the_detection_limit(clear: float | None, *, expected: bool) -> None:
    assert obstructed(sky(level=200.0, here=20.0), replace(PREDICTED, clear_peak_fraction=clear)) == expected


def test_a_part_of_the_sky_may_be_dark_too() -> None:
    image = sky(level=200.0, here=20.0)
    image[:, 64:] = np.minimum(image[:, 64:], 120)  # a quarter of the tiles still shows the sky
    assert obstructed(image)
    image[:, :] = np.minimum(image, 120)
    assert not obstructed(image)


def test_hot_pixels_do_not_brighten_an_obstruction() -> None:
    image = sky(level=200.0, here=20.0)
    image[120:136:4, 120:136:4] = 4095
    assert obstructed(image)


def test_an_obstruction_smaller_than_the_surroundings_is_not_certain() -> None:
    assert obstructed(sky(level=200.0, here=20.0), reach_px=20.0)
    assert not obstructed(sky(level=200.0, here=20.0), reach_px=60.0)


@pytest.mark.parametrize("shape", [(63, 300), (300, 63), (20, 20)])
def test_an_image_without_a_whole_tile_tells_nothing(shape: tuple[int, int]) -> None:
    assert not obstructed(np.full(shape, 120, np.uint16), replace(PREDICTED, x_px=10.0, y_px=10.0))


def test_surroundings_beyond_the_image_tell_nothing() -> None:
    assert not obstructed(sky(level=200.0, here=20.0), replace(PREDICTED, x_px=400.0))


@pytest.mark.parametrize(("bright_rows", "expected"), [(26, False), (40, True)])
def test_without_read_noise_the_rounding_of_counts_is_the_noise(bright_rows: int, *, expected: bool) -> None:
    """Of 9 dark px 6 sigmas are 6 · 0.3 / 3 = 0.6 counts; the sky has 26 / 64 = 0.41 or 40 / 64 = 0.63 counts."""
    image = np.zeros((256, 256), dtype=np.uint16)
    for first in range(0, 256, 64):
        image[:, first : first + bright_rows] = 1
    image[125:132, 125:132] = 0
    sensor = replace(SENSOR, read_noise_e=0.0, black_level=0.0)
    found = obstruction(image, sensor=sensor, expectation=PREDICTED, reach_px=1.0)
    assert (found is not None) == expected


@pytest.mark.parametrize(("sky_counts", "expected"), [((2, 3), False), ((3, 3), True)])
def test_light_before_the_sun_counts_against_an_obstruction(sky_counts: tuple[int, int], *, expected: bool) -> None:
    """Of one dark px of 1 count 6 sigmas are 1.8 counts: a sky of 2.5 is 1.5 brighter, one of 3 is 2."""
    image = np.full((256, 256), sky_counts[0], dtype=np.uint16)
    image[:, ::2] = sky_counts[1]
    image[126:131, 126:131] = 1
    sensor = replace(SENSOR, read_noise_e=0.0, black_level=0.0)
    found = obstruction(image, sensor=sensor, expectation=PREDICTED, reach_px=0.0)
    assert (found is not None) == expected


@pytest.mark.parametrize("place", [(128, 0), (0, 128), (255, 128), (128, 255)])
def test_an_obstruction_in_the_outermost_row_or_column_is_one(place: tuple[int, int]) -> None:
    image = np.full((256, 256), 3, dtype=np.uint16)
    sensor = replace(SENSOR, read_noise_e=0.0, black_level=0.0)
    expectation = replace(PREDICTED, x_px=float(place[0]), y_px=float(place[1]))
    assert obstruction(image, sensor=sensor, expectation=expectation, reach_px=0.0) is None
    image[place[1], place[0]] = 1
    assert obstruction(image, sensor=sensor, expectation=expectation, reach_px=0.0) is not None
