"""Extinction, completeness, limiting magnitude, halo and growth of stars: what was put in is recovered."""

from __future__ import annotations

import math

import numpy as np
import pytest

from sunarc.common.array_types import FloatArray, Image, picked
from sunarc.detection.stars.detect import detect_stars
from sunarc.detection.stars.photometry import (
    ZENITH_BANDS_DEG,
    NightLimits,
    NightTrend,
    StarLight,
    dew_suspected,
    fit_extinction,
    focus_ratio,
    limiting_magnitude,
    night_trend,
    star_halo,
    zenith_bands,
)
from sunarc.sky.site import relative_air_mass

LIMITS = NightLimits()


def stars_of_a_night(
    seed: int, *, extinction: float, zero_points: tuple[float, ...], wrong: float = 0.0, n: int = 60
) -> list[StarLight]:
    """Return images of stars over the sky with 0.15 magnitudes of twinkle, and a share of wrongly named ones."""
    rng = np.random.default_rng(seed)
    images = []
    for zero in zero_points:
        zenith = np.degrees(np.arccos(rng.uniform(math.cos(math.radians(80.0)), 1.0, n)))
        air_mass, magnitude = relative_air_mass(zenith), rng.uniform(0.0, 4.0, n)
        lost = extinction * air_mass + rng.normal(0.0, 0.15, n) + (rng.random(n) < wrong) * rng.normal(0.0, 2.0, n)
        rate = 10.0 ** (-0.4 * (magnitude + lost - zero))
        images.append(StarLight(zenith_deg=zenith, air_mass=air_mass, magnitude=magnitude, rate=rate))
    return images


@pytest.mark.parametrize("extinction", [0.1, 0.25, 0.6])
def test_extinction_and_zero_points_are_recovered_within_what_is_stated(extinction: float) -> None:
    zeros = (12.0, 11.4, 11.9)
    off, zero_off = [], []
    for seed in range(80):
        images = stars_of_a_night(seed, extinction=extinction, zero_points=zeros, wrong=0.05)
        found = fit_extinction(images, ZENITH_BANDS_DEG)
        off.append((found.per_air_mass - extinction) / found.sigma)
        zero_off.append(found.zero_point - zeros)
        assert 0.005 < found.sigma < 0.03
    assert abs(np.mean(off)) < 0.4
    assert 0.7 < np.std(off) < 1.4
    assert 0.01 < np.std(zero_off) < 0.05
    assert abs(np.mean(zero_off)) < 0.02


def test_transparency_by_zenith_angle_is_that_of_the_air_in_between() -> None:
    images = stars_of_a_night(1, extinction=0.3, zero_points=(12.0,) * 20)
    found = fit_extinction(images, ZENITH_BANDS_DEG)
    zenith, air = np.concatenate([one.zenith_deg for one in images]), np.concatenate([one.air_mass for one in images])
    for k, share in enumerate(found.transparency.tolist()):
        within = (zenith >= ZENITH_BANDS_DEG[k]) & (zenith < ZENITH_BANDS_DEG[k + 1])
        assert share == pytest.approx(10.0 ** (-0.12 * float(np.median(air[within]))), rel=0.04)
    assert np.all(np.diff(found.transparency) < 0.0)


def test_few_stars_or_a_narrow_sky_say_nothing_of_the_air() -> None:
    few = fit_extinction(stars_of_a_night(1, extinction=0.2, zero_points=(12.0,)), ZENITH_BANDS_DEG)
    assert math.isnan(few.per_air_mass)
    assert np.all(np.isnan(few.zero_point))
    (image,) = stars_of_a_night(1, extinction=0.2, zero_points=(12.0,), n=400)
    high = image.zenith_deg < 40.0
    narrow = picked(image, high)
    assert math.isnan(fit_extinction([narrow], ZENITH_BANDS_DEG).per_air_mass)
    assert math.isnan(fit_extinction([], ZENITH_BANDS_DEG).per_air_mass)


@pytest.mark.parametrize("cloud", [0.0, 0.4])
@pytest.mark.parametrize("limit", [3.0, 4.5])
def test_the_limiting_magnitude_is_recovered_beside_clouds(limit: float, cloud: float) -> None:
    rng = np.random.default_rng(3)
    off = []
    for _ in range(60):
        magnitude = 5.5 + np.log10(rng.random(800)) / 0.5  # 3.2 times as many a magnitude
        magnitude = magnitude[magnitude > -1.0]
        sharp = 1.0 / (1.0 + np.exp((magnitude - limit) / 0.2))
        found = rng.random(magnitude.size) < (1.0 - cloud) * sharp
        off.append(limiting_magnitude(magnitude, found) - limit)
    assert abs(np.median(off)) < 0.12
    assert np.quantile(np.abs(off), 0.9) < 0.35


def test_a_limit_is_never_beyond_the_catalogue_and_none_without_stars() -> None:
    magnitude = np.linspace(1.0, 5.5, 200)
    everything = np.ones(200, dtype=bool)
    assert 5.2 < limiting_magnitude(magnitude, everything) <= 5.5
    assert math.isnan(limiting_magnitude(magnitude, ~everything))
    assert math.isnan(limiting_magnitude(magnitude[:10], everything[:10]))


def test_bands_count_every_star_above_their_lowest_once() -> None:
    rng = np.random.default_rng(1)
    zenith, found = rng.uniform(0.0, 90.0, 500), rng.random(500) < 0.6
    bands = zenith_bands(zenith, found)
    assert sum(band.predicted for band in bands) == np.count_nonzero(zenith < 78.0)
    for band in bands:
        rows = [k for k, one in enumerate(zenith.tolist()) if band.from_deg <= one < band.to_deg]
        assert (band.predicted, band.found) == (len(rows), int(sum(found[rows])))


def drawn(halo: float, *, width: float = 1.3, seed: int = 2) -> Image:
    """Return an image of 60 stars whose light lies to a share `halo` in a Gaussian five times as wide."""
    rng = np.random.default_rng(seed)
    y, x = np.mgrid[0:600, 0:600]
    sky = 200.0 + rng.normal(0.0, 3.0, (600, 600))
    for k in range(60):
        at = 45.0 + 70.0 * (k % 8), 45.0 + 70.0 * (k // 8)
        for share, size in ((1.0 - halo, width), (halo, 5.0 * width)):
            sky += (
                share
                * 15000.0
                / (2.0 * math.pi * size**2)
                * np.exp(-(np.hypot(x - at[0], y - at[1]) ** 2) / 2.0 / size**2)
            )
    return np.clip(np.rint(sky), 0, 4095).astype(np.uint16)


def darker_mean(values: FloatArray) -> float:
    return float(np.mean(np.sort(values)[: int(0.8 * values.size)]))


def halo_in_ring(halo: float, core: float) -> float:
    """Return by brute force what the ring has over the core's light, the ground around it taken off."""
    y, x = np.mgrid[-130:131, -130:131] / 10.0 * 1.3  # a tenth of a width
    radius = np.hypot(x, y) / 1.3
    wide = np.exp(-(radius**2) / 50.0) / (2.0 * math.pi * 25.0 * 1.3**2)
    ring_value, ground = (
        darker_mean(wide[(radius >= one) & (radius < other)]) for one, other in ((4.0, 7.0), (9.0, 12.0))
    )
    area = math.pi * (7.0**2 - 4.0**2) * 1.3**2
    return halo * (ring_value - ground) * area / core


@pytest.mark.parametrize("halo", [0.0, 0.1, 0.3])
def test_the_halo_of_stars_is_measured(halo: float) -> None:
    image = drawn(halo)
    stars = detect_stars(image, full_scale=4095)
    found = star_halo(image, stars, full_scale=4095)
    core = float(np.median(stars.flux)) / 15000.0
    assert found == pytest.approx(halo_in_ring(halo, core), rel=0.2, abs=0.01)


def test_few_stars_have_no_halo() -> None:
    image = np.full((200, 200), 200, dtype=np.uint16)
    assert math.isnan(star_halo(image, detect_stars(image, full_scale=4095), full_scale=4095))


def test_a_night_that_dews_over_is_suspected_and_an_ordinary_one_is_not() -> None:
    rng = np.random.default_rng(4)

    def night(growth: float, halo: float, fading: float) -> NightTrend:
        late = np.linspace(0.0, 1.0, 30) ** 2
        noise: list[FloatArray] = [rng.normal(0.0, size, 30) for size in (0.03, 0.01, 0.05)]
        return night_trend(
            1.3 * (1.0 + growth * late) + noise[0], 0.02 + halo * late + noise[1], 12.0 - fading * late + noise[2]
        )

    ordinary = [dew_suspected(night(0.05, 0.01, 0.1), LIMITS) for _ in range(300)]
    assert sum(ordinary) == 0
    assert all(dew_suspected(night(0.5, 0.0, 0.8), LIMITS) for _ in range(50))
    assert all(dew_suspected(night(0.0, 0.2, 0.8), LIMITS) for _ in range(50))
    assert not dew_suspected(night(0.5, 0.0, 0.0), LIMITS)  # a lens that goes out of focus does not fade
    assert not dew_suspected(night(0.0, 0.0, 1.0), LIMITS)  # thin cloud
    few = night_trend(np.ones(5), np.ones(5), np.ones(5))
    assert math.isnan(few.width_growth)
    assert not dew_suspected(few, LIMITS)


def test_a_focus_that_got_worse_is_found_after_two_nights_and_one_wide_night_is_not() -> None:
    before = [2.4, 2.5, 2.3, 2.45]
    assert focus_ratio([3.2, 3.1, *before], LIMITS) == pytest.approx(3.1 / 2.425)
    assert focus_ratio([3.2, *before], LIMITS) is None
    assert focus_ratio([2.6, 2.7, *before], LIMITS) is None
    assert focus_ratio([3.2, 3.1, *before[:2]], LIMITS) is None  # nothing to compare with
    assert focus_ratio([3.2, math.nan, 3.1, *before], LIMITS) == pytest.approx(3.1 / 2.425)


def test_stars_whose_ground_leaves_the_image_do_not_count() -> None:
    image = drawn(0.3)[40:541, 40:541]  # the outer stars are 5 px from the edge they are at
    stars = detect_stars(image, full_scale=4095)
    inner = picked(stars, np.all((stars.pixels > 20.0) & (stars.pixels < 480.0), axis=-1))
    assert len(inner) < len(stars) - 15
    found = star_halo(image, stars, full_scale=4095)
    assert found == pytest.approx(star_halo(image, inner, full_scale=4095), rel=0.03)
    outer = picked(stars, np.any((stars.pixels < 16.0) | (stars.pixels > 484.0), axis=-1))
    assert math.isnan(star_halo(image, outer, full_scale=4095))
