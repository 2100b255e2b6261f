"""Merge, brightness, darkness, levels and previews against cases worked by hand, without noise."""

from __future__ import annotations

import math

import numpy as np
import pytest
from numpy.typing import NDArray

from sunarc.common.array_types import Image
from sunarc.common.errors import InputError
from sunarc.detection.values import Bayer, Sensor
from sunarc.imaging.brightness import (
    Exposed,
    Level,
    factor_all_over,
    is_dark,
    light_ratio_contradiction,
    measure_level,
    trimmed_mean,
)
from sunarc.imaging.hdr import merge_hdr
from sunarc.imaging.preview import preview as preview_of

FloatArray = NDArray[np.float64]
FULL_SCALE, BLACK = 4095, 100.0
SENSOR = Sensor(full_scale=FULL_SCALE, gain_e_per_count=2.5, read_noise_e=5.0, black_level=BLACK)


# the merge

SHORT = np.array([[100, 350, 1100], [4013, 4014, 4095], [90, 100, 600]], dtype=np.uint16)
LONG = np.array([[100, 1100, 4095], [4095, 4095, 4095], [80, 140, 2100]], dtype=np.uint16)


def merged_by_hand(short: float, long: float) -> float:
    """Return the rate in counts per µs of a pixel exposed for 1000 and 4000 µs, by the inverse variance of each."""
    limit = 0.98 * FULL_SCALE
    frames = [(n - BLACK, t) for n, t in ((short, 1000.0), (long, 4000.0)) if n < limit]
    if short >= limit:
        return (FULL_SCALE - BLACK) / 1000.0
    pooled = max(sum(n for n, _ in frames) / sum(t for _, t in frames), 0.0)
    # each estimate n/t has the variance (read noise² + digitisation 1/12 + photons) / t²
    variances = [((5.0 / 2.5) ** 2 + 1.0 / 12.0 + pooled * t / 2.5) / t**2 for _, t in frames]
    return sum(n / t / v for (n, t), v in zip(frames, variances, strict=True)) / sum(1.0 / v for v in variances)


def image_by_hand() -> FloatArray:
    """Return the merge of `SHORT` and `LONG`, pixel by pixel by hand."""
    rates = [[merged_by_hand(s, n) for s, n in zip(*rows, strict=True)] for rows in zip(SHORT, LONG, strict=True)]
    return np.rint(np.clip(np.array(rates) / ((FULL_SCALE - BLACK) / 1000.0), 0.0, 1.0) * 65535.0)


def test_a_merge_of_three_by_three_pixels_is_the_one_by_hand() -> None:
    merged = merge_hdr([LONG, SHORT], [4000.0, 1000.0], sensor=SENSOR)
    expected = image_by_hand()
    np.testing.assert_array_equal(merged.image, expected)
    assert merged.counts_per_us == pytest.approx((FULL_SCALE - BLACK) / 1000.0 / 65535.0, rel=1e-15)
    assert merged.exposures_us == (1000.0, 4000.0)
    assert merged.saturated_px == 2  # 4014 and 4095; 4013 is below 98 %
    # 250 counts in 1 ms and 1000 in 4 ms are one rate, whatever the weights
    assert merged.image[0, 1] * merged.counts_per_us == pytest.approx(0.25, abs=merged.counts_per_us)
    assert merged.image[0, 0] == 0
    assert merged.image[2, 0] == 0


def test_photons_shift_the_weight_from_the_exposure_squared_to_the_exposure() -> None:
    # two exposures of unlike rates: among readers' noise the longer counts 16-fold, among photons' noise fourfold
    faint = [np.array([[101]], np.uint16), np.array([[100]], np.uint16)]
    quiet = Sensor(full_scale=FULL_SCALE, gain_e_per_count=2.5, read_noise_e=1e4, black_level=BLACK)
    bright = [np.array([[1100]], np.uint16), np.array([[2100]], np.uint16)]
    noisy = Sensor(full_scale=FULL_SCALE, gain_e_per_count=1e-3, read_noise_e=0.0, black_level=BLACK)
    for images, sensor, expected in ((faint, quiet, 1e-3 / 17.0), (bright, noisy, (1.0 + 4.0 * 0.5) / 5.0)):
        merged = merge_hdr(images, [1000.0, 4000.0], sensor=sensor)
        rate = float(merged.image[0, 0]) * merged.counts_per_us
        assert rate == pytest.approx(expected, abs=0.51 * merged.counts_per_us)


def test_one_frame_is_its_own_merge_and_eight_bits_merge_too() -> None:
    merged = merge_hdr([SHORT], [1000.0], sensor=SENSOR)
    np.testing.assert_allclose(merged.image[0] * merged.counts_per_us * 1000.0, [0.0, 250.0, 1000.0], atol=0.05)
    eight = merge_hdr([np.array([[10, 60]], np.uint8)], [100.0], sensor=Sensor(full_scale=255, gain_e_per_count=40.0))
    np.testing.assert_array_equal(eight.image, np.rint(np.array([[10, 60]]) / 255.0 * 65535.0))


@pytest.mark.parametrize("exposure_us", [math.nan, math.inf, -1.0, 0.0])
def test_an_exposure_that_is_none_is_refused_by_its_field(exposure_us: float) -> None:
    with pytest.raises(InputError) as caught:
        merge_hdr([SHORT, LONG], [1000.0, exposure_us], sensor=SENSOR)
    assert caught.value.field == "exposures_us"
    unlike: list[list[Image]] = [[SHORT, LONG[:2]], [SHORT, LONG.astype(np.uint8)], [SHORT[None], LONG[None]]]
    for images in unlike:
        with pytest.raises(InputError) as caught:
            merge_hdr(images, [1000.0, 4000.0], sensor=SENSOR)
        assert caught.value.field == "images"


# two exposures beside one another

SIZE = 120


def gradient() -> FloatArray:
    """Return counts per microsecond that rise evenly from 0 to 1 down the image."""
    return np.tile(np.linspace(0.0, 1.0, SIZE)[:, None], (1, SIZE))


def frame(said_us: float, *, light: float = 1.0, scene: FloatArray | None = None) -> Exposed:
    """Return a frame without noise whose light is `light` times that of its exposure."""
    counts = BLACK + (gradient() if scene is None else scene) * said_us * light
    image = np.clip(np.rint(counts), 0, FULL_SCALE).astype(np.uint16)
    return Exposed(image=image, exposure_us=said_us, full_scale=FULL_SCALE)


@pytest.mark.parametrize(
    ("light", "agrees"),
    [(1.0, True), (1.5, True), (1.0 / 1.5, True), (1.7, False), (1.0 / 1.7, False), (4.0, False), (0.25, False)],
)
def test_frames_may_differ_by_a_factor_of_1_6_either_way(*, light: float, agrees: bool) -> None:
    long = frame(3000.0)
    short = frame(750.0, light=light)
    for pair in ((short, long), (long, short)):
        assert (light_ratio_contradiction(*pair) is None) is agrees


def test_the_factor_found_is_the_factor_drawn() -> None:
    for light in (0.3, 0.5, 2.0, 3.0):
        told = light_ratio_contradiction(frame(750.0, light=light), frame(3000.0))
        assert told is not None
        assert told.startswith("750 µs shows ")
        assert told.endswith("3000 µs")
        assert float(told.split()[3]) == pytest.approx(light, rel=0.02)


def test_very_short_exposures_may_last_10_microseconds_longer() -> None:
    scene = 40.0 * gradient()
    for truly_us, agrees in ((30.0, True), (20.0, True), (47.0, True), (60.0, False)):
        short = frame(20.0, light=truly_us / 20.0, scene=scene)
        assert (light_ratio_contradiction(short, frame(80.0, scene=scene)) is None) is agrees


def test_a_long_exposure_saturated_all_over_must_be_bright_enough_in_the_short_one() -> None:
    scene = 2.0 + 0.5 * gradient()  # 3000 µs: saturated all over, 750 µs: 1500 to 1900 counts where it should be so
    scene[:10] = 0.0
    long = frame(3000.0, scene=scene)
    assert float(np.mean(long.image >= FULL_SCALE)) > 0.9
    assert light_ratio_contradiction(frame(750.0, scene=scene), long) is None
    # at least 0.98 full scale in 3000 µs is 978 counts above black in 750 µs; below 1 / 1.25 of it is a contradiction
    for counts, agrees in ((1000.0, True), (820.0, True), (700.0, False), (200.0, False)):
        flat = np.full((SIZE, SIZE), counts / 750.0)
        flat[:10] = 0.0
        assert (light_ratio_contradiction(frame(750.0, scene=flat), long) is None) is agrees


def test_without_contrast_nothing_can_be_said() -> None:
    floor = max(0.5, 5e-4 * FULL_SCALE)
    for contrast, judged in ((3.0 * floor, False), (40.0 * floor, True)):
        scene = gradient() * contrast / 3000.0
        told = light_ratio_contradiction(frame(750.0, light=20.0, scene=scene), frame(3000.0, scene=scene))
        assert (told is not None) is judged
    dots = np.zeros((SIZE, SIZE))
    dots[::40, ::40] = 1.0  # hot pixels: nine of them, none beside another
    assert light_ratio_contradiction(frame(750.0, light=9.0, scene=dots), frame(3000.0, scene=dots)) is None


def test_a_trimmed_mean_leaves_out_a_tenth_at_either_end() -> None:
    values = np.array([0, *[50, 60] * 9, 4095], dtype=np.uint16)
    found = trimmed_mean(values)
    assert found.mean == pytest.approx(55.0)
    assert found.error == pytest.approx(5.0 / 4.0)  # of the 16 that stay


# a black frame


def test_a_frame_is_dark_below_every_one_of_its_thresholds_and_not_above() -> None:
    full_scale = 10_000

    def shown(*, ramp: float = 0.0, level: float = 0.01, spot: float = 0.0) -> bool:
        image = np.tile(level + ramp * np.repeat(np.linspace(0.0, 1.0, 20), 16), (320, 1))
        image[160:176, 160:176] += spot
        return is_dark(np.rint(image * full_scale).astype(np.uint16), full_scale=full_scale)

    assert shown()
    assert shown(ramp=0.0028)
    assert not shown(ramp=0.0040)
    assert shown(spot=0.018)
    assert not shown(spot=0.022)
    assert shown(level=0.19)
    assert not shown(level=0.21)


def test_less_than_four_blocks_say_nothing_and_four_do() -> None:
    assert not is_dark(np.zeros((31, 63), np.uint16), full_scale=255)
    assert is_dark(np.zeros((32, 32), np.uint16), full_scale=255)
    assert is_dark(np.zeros((16, 64), np.uint8), full_scale=255)
    ragged = np.zeros((47, 47), np.uint8)
    ragged[32:, :] = 255  # what is left of the last block is not looked at
    assert is_dark(ragged, full_scale=255)


# from cycle to cycle


def test_block_means_of_a_ramp_are_its_values_at_the_middle_of_the_blocks() -> None:
    image = np.tile(np.arange(240, dtype=np.uint16), (240, 1))
    found = measure_level([Exposed(image=image, exposure_us=5.0, full_scale=255)])
    assert found.blocks.shape == (1, 24 * 24)
    np.testing.assert_allclose(found.blocks.reshape(24, 24)[3], 4.5 + 10.0 * np.arange(24))
    assert (found.shape, found.full_scale, found.exposures_us) == ((240, 240), 255, (5.0,))
    large = np.tile(np.arange(24 * 40, dtype=np.uint16), (24 * 40, 1))
    sampled = measure_level([Exposed(image=large, exposure_us=5.0, full_scale=1023)]).blocks.reshape(24, 24)
    np.testing.assert_allclose(sampled[0], 19.0 + 40.0 * np.arange(24))  # every other one of 40
    small = measure_level([Exposed(image=image[:6, :7], exposure_us=5.0, full_scale=255)])
    assert small.blocks.shape == (1, 42)


def cycle(blocks: FloatArray, *, exposure_us: float = 100.0, full_scale: int = 4095) -> Level:
    return Level(exposures_us=(exposure_us,), blocks=np.atleast_2d(blocks), shape=(240, 240), full_scale=full_scale)


def test_the_factor_of_a_hundred_blocks_by_hand() -> None:
    # 5 dark blocks at 60 counts, 95 from 160 to 1100: what lies above the dark ones is what is compared
    light = np.r_[np.zeros(5), np.linspace(100.0, 1040.0, 95)]
    for factor in (0.25, 0.9, 1.3, 4.0):
        assert factor_all_over(cycle(60.0 + light), cycle(70.0 + factor * light)) == pytest.approx(factor, rel=1e-12)
    assert factor_all_over(cycle(60.0 + light), cycle(60.0 + light)) == 1.0


def test_a_tenth_of_the_image_may_go_another_way_and_no_more() -> None:
    light = np.r_[np.zeros(10), np.full(190, 500.0)]
    for other, expected in ((17, 3.0), (25, 1.0)):
        gained, lost = 3.0 * light, light / 3.0
        gained[-other:], lost[-other:] = light[-other:] / 2.0, light[-other:] * 2.0
        assert factor_all_over(cycle(60.0 + light), cycle(60.0 + gained)) == pytest.approx(expected)
        assert factor_all_over(cycle(60.0 + light), cycle(60.0 + lost)) == pytest.approx(1.0 / expected)


def test_blocks_without_contrast_or_near_saturation_are_not_compared() -> None:
    def judged(bright: FloatArray) -> bool:
        before = np.r_[np.full(5, 60.0), np.full(75 - bright.size, 60.0), bright]
        return factor_all_over(cycle(before), cycle(60.0 + 2.0 * (before - 60.0))) is not None

    assert judged(np.full(20, 500.0))
    assert not judged(np.full(19, 500.0))
    contrast = 4e-3 * 4095
    assert judged(np.full(30, 60.0 + 1.05 * contrast))
    assert not judged(np.full(30, 60.0 + 0.95 * contrast))
    assert judged(np.full(30, 0.84 * 4095))
    assert not judged(np.full(30, 0.86 * 4095))


def test_exposures_within_a_hundredth_are_the_same_and_others_are_not() -> None:
    light = np.r_[np.full(5, 60.0), np.full(95, 560.0)]
    for other_us, same in ((100.9, True), (99.1, True), (101.2, False), (98.8, False)):
        assert (factor_all_over(cycle(light), cycle(light, exposure_us=other_us)) is not None) is same
    assert factor_all_over(cycle(light), cycle(light, full_scale=1023)) is None
    covered = factor_all_over(cycle(light), cycle(np.r_[np.full(5, 60.0), np.full(95, 50.0)]))
    assert covered == 0.0


# the preview


def test_a_preview_is_the_logarithm_of_the_share_of_white() -> None:
    image = np.repeat(np.array([[0, 10, 100, 500, 1000, 1000]], np.uint16), 8, axis=0).repeat(4, axis=1)
    found = preview_of(image, white_percentile=100.0)[0, ::4]
    expected = [
        round(255.0 * math.log1p(300.0 * n / 1000.0) / math.log1p(300.0)) for n in (0, 10, 100, 500, 1000, 1000)
    ]
    assert found.tolist() == expected
    assert preview_of(image[:, :8], white_percentile=100.0).max() == 255
    assert not preview_of(np.zeros((8, 8), np.uint8)).any()


@pytest.mark.parametrize(("bayer", "row", "column"), [("RGGB", 0, 0), ("BGGR", 1, 1), ("GRBG", 0, 1), ("GBRG", 1, 0)])
def test_the_red_pixel_of_each_mosaic_is_shown_red(bayer: Bayer, row: int, column: int) -> None:
    mosaic: Image = np.zeros((16, 16), np.uint16)
    mosaic[row::2, column::2] = 4000
    shown = preview_of(mosaic, bayer=bayer, white_percentile=100.0)
    assert shown.shape == (16, 16, 3)
    blue, green, red = shown[8, 8].astype(int)
    assert red == 255
    assert max(blue, green) < red
