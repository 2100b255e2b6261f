"""How bright the clear sun is, learned from days of sightings."""

from __future__ import annotations

import numpy as np
import pytest

from sunarc.detection import clear_sun
from sunarc.detection.disc.brightness import ClearSun
from sunarc.sky import relative_air_mass

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
