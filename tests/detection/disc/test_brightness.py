"""How bright the clear sun is, learned from days of sightings."""

from __future__ import annotations

import numpy as np
import pytest

from sunarc.detection.disc.series import ClearSun, clear_sun
from sunarc.sky.site import relative_air_mass

ZENITH = np.linspace(20.0, 88.0, 400)


def levels(*, above_air: float = 3.0, depth: float = 0.2) -> np.ndarray:
    return np.asarray(above_air * np.exp(-depth * relative_air_mass(ZENITH)))


def learned(*days: np.ndarray) -> ClearSun | None:
    day = np.repeat(np.arange(len(days)), ZENITH.size)
    return clear_sun(apparent_zenith=np.tile(ZENITH, len(days)), level_per_us=np.concatenate(days), day=day)


@pytest.mark.parametrize("depth", [0.1, 0.2, 0.35])
def test_one_clear_day_tells_the_level_at_every_height(depth: float) -> None:
    clear = learned(levels(depth=depth))
    assert clear is not None
    for zenith in (25.0, 60.0, 80.0, 86.0):
        true = 3.0 * np.exp(-depth * relative_air_mass(zenith))
        assert clear.level_per_us(zenith) == pytest.approx(true, rel=0.25)


def test_clouds_do_not_lower_it_and_single_overexposed_frames_do_not_raise_it() -> None:
    rng = np.random.default_rng(0)
    cloudy = levels() * np.where(rng.random(ZENITH.size) < 0.6, rng.uniform(0.05, 0.8, ZENITH.size), 1.0)
    cloudy[::25] *= 4.0
    clear = learned(cloudy)
    assert clear is not None
    assert clear.level_per_us(40.0) == pytest.approx(3.0 * np.exp(-0.2 * relative_air_mass(40.0)), rel=0.15)


def test_a_lasting_higher_level_counts_from_its_second_day() -> None:
    usual, bright = levels(), levels(above_air=12.0)
    once, twice = learned(usual, usual, bright), learned(usual, bright, bright)
    assert once is not None
    assert twice is not None
    assert twice.level_per_us(40.0) / once.level_per_us(40.0) == pytest.approx(4.0, rel=0.05)


def test_a_few_sightings_tell_nothing() -> None:
    few = clear_sun(apparent_zenith=ZENITH[:3], level_per_us=levels()[:3], day=np.zeros(3, np.int64))
    assert few is None
    assert clear_sun(apparent_zenith=np.zeros(0), level_per_us=np.zeros(0), day=np.zeros(0, np.int64)) is None


def days(zenith: float, *per_day: list[float]) -> ClearSun | None:
    """Return what sightings of some days at one zenith angle teach."""
    level = np.concatenate([np.array(one) for one in per_day])
    day = np.repeat(np.arange(len(per_day)), [len(one) for one in per_day])
    return clear_sun(apparent_zenith=np.full(level.size, zenith), level_per_us=level, day=day)


def test_one_height_tells_the_level_and_leaves_the_depth_at_its_prior() -> None:
    clear = days(60.0, [2.0] * 5)
    assert clear is not None
    assert clear.optical_depth == pytest.approx(0.2, abs=1e-9)
    assert clear.level_per_us(60.0) == pytest.approx(2.0)
    assert clear.log_level == pytest.approx(np.log(2.0) + 0.2 * float(relative_air_mass(60.0)))


@pytest.mark.parametrize(("count", "known"), [(4, False), (5, True)])
def test_a_day_counts_from_five_sightings_of_a_height_on(count: int, *, known: bool) -> None:
    assert (days(60.0, [2.0] * count) is not None) == known


def test_a_day_has_the_quantile_of_its_sightings() -> None:
    levels_of_day = [1.0, 1.2, 1.4, 1.6, 1.8, 9.0]  # 0.8 of the way through six is the fifth
    clear = days(60.0, levels_of_day)
    assert clear is not None
    assert clear.level_per_us(60.0) == pytest.approx(1.8)


@pytest.mark.parametrize(("others", "level"), [([], 5.0), ([1.0], 5.0), ([1.0, 2.0], 2.0), ([1.0, 2.0, 3.0], 3.0)])
def test_of_three_or_more_days_the_second_brightest_counts(others: list[float], level: float) -> None:
    clear = days(60.0, [5.0] * 5, *([one] * 5 for one in others))
    assert clear is not None
    assert clear.level_per_us(60.0) == pytest.approx(level)


def test_the_line_through_two_heights_is_least_squares_with_the_prior() -> None:
    zenith = np.repeat([30.0, 75.0], 5)
    air = relative_air_mass(zenith)
    clear = clear_sun(apparent_zenith=zenith, level_per_us=3.0 * np.exp(-0.35 * air), day=np.zeros(10, np.int64))
    assert clear is not None
    rows = np.array([[10.0, -10.0 * air[0]], [10.0, -10.0 * air[-1]], [0.0, 10.0]])  # 1-sigma of 0.1 each
    right = np.array([10.0 * (np.log(3.0) - 0.35 * air[0]), 10.0 * (np.log(3.0) - 0.35 * air[-1]), 2.0])
    log_level, depth = np.linalg.lstsq(rows, right, rcond=None)[0]
    assert (clear.log_level, clear.optical_depth) == pytest.approx((log_level, depth))
    assert 0.28 < clear.optical_depth < 0.35


def test_the_level_falls_by_bouguers_law() -> None:
    clear = ClearSun(log_level=float(np.log(4.0)), optical_depth=0.25)
    assert clear.level_per_us(0.0) == pytest.approx(4.0 * np.exp(-0.25), rel=1e-3)
    assert clear.level_per_us(60.0) == pytest.approx(4.0 * np.exp(-0.5), rel=5e-3)
