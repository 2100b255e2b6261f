"""The merge of a cycle's exposures, and the preview."""

from __future__ import annotations

import numpy as np
import pytest
from numpy.typing import NDArray

from sunarc.common.array_types import Image
from sunarc.common.errors import InputError
from sunarc.detection.values import Sensor
from sunarc.imaging.hdr import merge_hdr
from sunarc.imaging.preview import preview

EXPOSURES_US = (3000.0, 12000.0, 48000.0)


def exposed(rate: NDArray[np.float64], exposure_us: float, sensor: Sensor, rng: np.random.Generator) -> Image:
    """Return counts of a scene of `rate` counts per microsecond."""
    electrons = rng.poisson(rate * exposure_us * sensor.gain_e_per_count) + rng.normal(
        0, sensor.read_noise_e, rate.shape
    )
    counts = np.rint(electrons / sensor.gain_e_per_count + sensor.black_level)
    clipped = np.asarray(np.clip(counts, 0, sensor.full_scale))
    return clipped.astype(np.uint8) if sensor.full_scale == 255 else clipped.astype(np.uint16)


def scene(level: float, size: int = 100) -> NDArray[np.float64]:
    return np.full((size, size), level)


@pytest.mark.parametrize("full_scale", [255, 4095])
@pytest.mark.parametrize("level", [0.002, 0.02, 0.06, 0.2, 1.0])
def test_the_merge_is_linear_in_radiance_and_unbiased(full_scale: int, level: float) -> None:
    rng = np.random.default_rng(0)
    sensor = Sensor(full_scale=full_scale, gain_e_per_count=20_000.0 / full_scale, black_level=round(full_scale * 0.02))
    rate = scene(level * full_scale / 4095)
    merged = merge_hdr([exposed(rate, e, sensor, rng) for e in EXPOSURES_US], EXPOSURES_US, sensor=sensor)
    assert merged.image.dtype == np.uint16
    assert merged.saturated_px == 0
    assert merged.image.mean() * merged.counts_per_us == pytest.approx(rate[0, 0], rel=0.02)


def test_the_merge_is_less_noisy_than_its_best_exposure() -> None:
    rng = np.random.default_rng(1)
    sensor = Sensor.from_full_well(full_scale=4095)
    images = [exposed(scene(0.05), e, sensor, rng) for e in EXPOSURES_US]
    merged = merge_hdr(images, EXPOSURES_US, sensor=sensor)
    assert np.std(merged.image * merged.counts_per_us) < np.std(images[2] / EXPOSURES_US[2])


def test_saturated_exposures_are_left_out() -> None:
    rng = np.random.default_rng(2)
    sensor = Sensor.from_full_well(full_scale=4095)
    images = [exposed(scene(0.5), e, sensor, rng) for e in EXPOSURES_US]
    assert np.all(images[2] == 4095)
    merged = merge_hdr(images, EXPOSURES_US, sensor=sensor)
    assert merged.image.mean() * merged.counts_per_us == pytest.approx(0.5, rel=0.01)


def test_what_saturates_even_in_the_shortest_is_counted_and_white() -> None:
    sensor = Sensor.from_full_well(full_scale=255)
    images: list[Image] = [np.full((4, 6), 255, np.uint8)] * 3
    merged = merge_hdr(images, EXPOSURES_US, sensor=sensor)
    assert merged.saturated_px == 24
    assert np.all(merged.image == 65535)


def test_the_order_of_the_exposures_does_not_matter() -> None:
    rng = np.random.default_rng(3)
    sensor = Sensor.from_full_well(full_scale=4095)
    images = [exposed(scene(0.1), e, sensor, rng) for e in EXPOSURES_US]
    forward = merge_hdr(images, EXPOSURES_US, sensor=sensor)
    backward = merge_hdr(images[::-1], EXPOSURES_US[::-1], sensor=sensor)
    assert np.array_equal(forward.image, backward.image)


@pytest.mark.parametrize(
    ("shapes", "exposures"), [([(4, 4), (4, 5)], (1.0, 2.0)), ([(4, 4)], (0.0,)), ([(4, 4)], (1.0, 2.0)), ([], ())]
)
def test_unlike_frames_are_refused(shapes: list[tuple[int, int]], exposures: tuple[float, ...]) -> None:
    with pytest.raises(InputError):
        merge_hdr(
            [np.zeros(shape, np.uint16) for shape in shapes], exposures, sensor=Sensor.from_full_well(full_scale=4095)
        )


def test_a_preview_keeps_the_order_of_levels() -> None:
    ramp = np.tile(np.arange(4096, dtype=np.uint16), (8, 1))
    shown = preview(ramp)
    assert shown.dtype == np.uint8
    assert np.all(np.diff(shown[0].astype(int)) >= 0)
    assert shown.max() == 255


def test_a_preview_of_darkness_is_black() -> None:
    assert not preview(np.zeros((8, 8), np.uint16)).any()


def test_a_red_mosaic_is_shown_red() -> None:
    mosaic = np.zeros((16, 16), np.uint16)
    mosaic[::2, ::2] = 4000
    blue, green, red = preview(mosaic, bayer="RGGB")[8, 8].astype(int)
    assert red > max(blue, green)
