"""Cutting of windows: borders, colours, saturation, blooming, black level, smear."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import pytest
from tests.detection.rendering import Image

from sunarc.detection.disc.window import Window, column_excess, column_smear, cut, saturated_level
from sunarc.detection.values import BAYERS, Bayer, Sensor

SENSOR = Sensor(full_scale=4095, gain_e_per_count=4.884, black_level=32.0)


def ramp(shape: tuple[int, int] = (40, 50)) -> Image:
    """Return 100 y + x, no count twice."""
    rows, columns = np.mgrid[: shape[0], : shape[1]]
    return np.asarray(100 * rows + columns, dtype=np.uint16)


def window_at(image: Image, x: float, y: float, *, sensor: Sensor = SENSOR, half: int = 4) -> Window:
    return cut(image, center=(x, y), half=half, sensor=sensor, saturation_fraction=0.98)


@pytest.mark.parametrize(
    ("center", "first", "shape"),
    [
        ((20.4, 15.6), (16, 12), (9, 9)),
        ((0.0, 0.0), (0, 0), (5, 5)),
        ((49.0, 39.0), (45, 35), (5, 5)),
        ((-3.0, 39.9), (0, 36), (4, 2)),
    ],
)
def test_a_window_is_the_part_of_the_image_around_its_centre(
    center: tuple[float, float], first: tuple[int, int], shape: tuple[int, int]
) -> None:
    window = window_at(ramp(), *center)
    assert (window.first, window.counts.shape) == (first, shape)
    assert window.counts[0, 0] == 100.0 * first[1] + first[0] - 32.0


@pytest.mark.parametrize("center", [(-20.0, 10.0), (70.0, 10.0), (10.0, -20.0), (10.0, 70.0)])
def test_a_window_beyond_the_image_is_empty(center: tuple[float, float]) -> None:
    window = window_at(ramp(), *center)
    assert (window.counts.size, window.saturated_px) == (0, 0)


@pytest.mark.parametrize("bayer", BAYERS)
@pytest.mark.parametrize("center", [(20.0, 20.0), (21.0, 20.0), (20.0, 21.0), (3.0, 2.0)])
def test_every_pixel_has_its_colour_of_the_mosaic(bayer: Bayer, center: tuple[float, float]) -> None:
    window = window_at(ramp(), *center, sensor=replace(SENSOR, bayer=bayer))
    rows, columns = np.indices(window.counts.shape)
    letters = np.array(list(bayer)).reshape(2, 2)
    expected = letters[(rows + window.first[1]) % 2, (columns + window.first[0]) % 2]
    assert window.colours == 3
    assert (np.array(list("RGB"))[window.colour] == expected).all()


def test_a_mono_sensor_has_one_colour() -> None:
    window = window_at(ramp(), 20.0, 20.0)
    assert (window.colours, window.colour.any()) == (1, np.False_)


@pytest.mark.parametrize(("counts", "saturated"), [(4013, 0), (4014, 1), (4095, 1)])
def test_a_pixel_is_saturated_from_the_fraction_of_full_scale_on(counts: int, saturated: int) -> None:
    image = np.full((40, 50), 100, np.uint16)
    image[20, 21] = counts
    window = window_at(image, 20.0, 20.0)
    assert window.saturated_px == saturated
    assert np.count_nonzero(~window.usable) == np.count_nonzero(~window.linear) == saturated


def test_blooming_masks_the_neighbours_too() -> None:
    image = np.full((40, 50), 100, np.uint16)
    image[20, 21] = image[16, 16] = 4095
    window = window_at(image, 20.0, 20.0, sensor=replace(SENSOR, blooming=True))
    assert window.saturated_px == 2
    assert np.count_nonzero(~window.usable) == 9 + 4


def test_means_of_clipped_pixels_are_usable_but_not_linear() -> None:
    image = np.full((40, 50), 100, np.uint16)
    image[20, 20:23] = (4090, 3000, 1500)
    window = window_at(image, 20.0, 20.0, sensor=replace(SENSOR, binning=2))
    assert window.usable[4, 4:7].tolist() == [False, True, True]
    assert window.linear[4, 4:8].tolist() == [False, False, False, True]
    assert window.saturated_px == 3


@pytest.mark.parametrize(("binning", "level"), [(1, 4013.1), (2, 32 + 0.5 * 4063), (4, 32 + 0.125 * 4063)])
def test_the_level_from_which_a_mean_may_be_clipped(binning: int, level: float) -> None:
    assert saturated_level(replace(SENSOR, binning=binning), 0.98) == pytest.approx(level)


def test_the_smear_of_the_columns_is_subtracted() -> None:
    image = np.full((400, 50), 132, np.uint16)
    image[:, 22] += 40
    window = window_at(image, 20.0, 200.0)
    assert window.counts == pytest.approx(np.full((9, 9), 100.0))


@pytest.mark.parametrize("rows", [7, 8, 9, 20])
@pytest.mark.parametrize("smear", [2.0, 3.0])
def test_a_column_stands_out_by_five_noises_of_its_median_over_the_darkest(rows: int, smear: float) -> None:
    rng = np.random.default_rng(rows)
    image = (100.0 + rng.normal(0.0, 1.0, (rows, 12))).round().astype(np.uint16)
    image[:, 5] += int(smear)
    level = np.median(image, axis=0)
    noise = 1.2533 * max(1.4826 * np.median(np.abs(image - level)), 0.3) / np.sqrt(rows)
    excess = level - level.min()
    stands_out = rows >= 8 and excess.max() >= 5.0 * noise
    np.testing.assert_allclose(column_excess(image), excess if stands_out else np.zeros(12))


@pytest.mark.parametrize("mosaic", [False, True])
def test_smear_is_that_of_the_rows_beyond_the_window_each_of_its_colour(*, mosaic: bool) -> None:
    image = np.full((300, 30), 50, dtype=np.uint16)
    image[::2, 9] += 7
    image[1::2, 9] += 20
    image[100:120, 9] += 500
    found = column_smear(image, x0=4, x1=14, y0=100, y1=120, mosaic=mosaic)
    assert found.shape == (20, 10)
    assert np.count_nonzero(found[:, np.arange(10) != 5]) == 0
    np.testing.assert_array_equal(found[:, 5], np.where(np.arange(20) % 2, 20.0, 7.0) if mosaic else 7.0)
    beyond = image.copy()
    beyond[:100], beyond[120:] = 50, 50
    beyond[96:100:4, 9] += 900  # one row of the many that are looked at is no smear
    assert not column_smear(beyond, x0=4, x1=14, y0=100, y1=120, mosaic=mosaic).any()
