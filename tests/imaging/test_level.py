"""A cycle is held to the one before it: what changes all of the image alike is no sky (drawn here, not simulated)."""

from __future__ import annotations

import numpy as np
import pytest
from numpy.typing import NDArray

from sunarc.imaging.brightness import MOST_ALL_OVER, Exposed, Level, factor_all_over, measure_level

FULL_SCALE, BLACK = 4095, 60.0
SIZE = 300
HDR_US = (3e3, 12e3, 48e3)


def sky(*, sun: float = 1.0, clouds: float = 0.0) -> NDArray[np.float64]:
    """Return counts per microsecond: a smooth sky in a dark frame, an aureole, clouds of half or twice the light."""
    y, x = np.mgrid[:SIZE, :SIZE]
    inside = np.hypot(x - 150, y - 150) < 140
    distance = np.hypot(x - 190, y - 120)
    patches = 2.0 ** (np.sin(x / 17.0 + clouds) * np.sin(y / 23.0 - clouds)) if clouds else 1.0
    return np.asarray(inside * patches * (0.04 + 0.0001 * y + sun * 30.0 / (3.0 + distance) ** 2))


def level(rate: NDArray[np.float64], *, factor: float = 1.0, exposures_us: tuple[float, ...] = HDR_US) -> Level:
    rng = np.random.default_rng(7)

    def exposed(said_us: float) -> Exposed:
        counts = BLACK + rng.poisson(np.minimum(rate * said_us * factor, 1e6)) + rng.normal(0.0, 2.0, rate.shape)
        image = np.clip(np.round(counts), 0, FULL_SCALE).astype(np.uint16)
        return Exposed(image=image, exposure_us=said_us, full_scale=FULL_SCALE)

    return measure_level([exposed(said_us) for said_us in exposures_us])


@pytest.mark.parametrize("factor", [1 / 16, 0.25, 0.4, 2.5, 4.0, 16.0])
@pytest.mark.parametrize("clouds", [0.0, 1.0])
def test_a_factor_that_all_exposures_share_is_told(factor: float, clouds: float) -> None:
    told = factor_all_over(level(sky(clouds=clouds)), level(sky(clouds=clouds), factor=factor))
    assert told is not None
    assert not 1 / MOST_ALL_OVER <= told <= MOST_ALL_OVER
    if factor <= 4.0:
        assert told == pytest.approx(factor, rel=0.15)


@pytest.mark.parametrize(
    ("before", "now"),
    [
        (sky(sun=0.0), sky(sun=3.0)),  # the sun comes out: tenfold about it
        (sky(sun=3.0), sky(sun=0.0)),
        (sky(clouds=1.0), sky(clouds=2.5)),
        (sky(), sky(clouds=2.0) * 1.6),  # broken clouds, and all of it brighter
        (sky(), sky() / 1.6),  # two minutes of twilight
    ],
)
def test_a_sky_that_changes_is_possible(before: NDArray[np.float64], now: NDArray[np.float64]) -> None:
    told = factor_all_over(level(before), level(now))
    assert told is not None
    assert 1 / MOST_ALL_OVER <= told <= MOST_ALL_OVER


def test_a_lens_that_is_covered_is_darker_all_over() -> None:
    assert factor_all_over(level(sky()), level(np.zeros((SIZE, SIZE)))) == pytest.approx(0.0, abs=0.01)


@pytest.mark.parametrize("rate", [0.0, 0.05, 100.0])
def test_a_night_a_fog_and_a_saturated_frame_tell_nothing(rate: float) -> None:
    even = np.full((SIZE, SIZE), rate)
    assert factor_all_over(level(even), level(even, factor=4.0)) is None


def test_only_the_same_exposures_of_the_same_camera_are_compared() -> None:
    small = level(sky()[:200])
    assert factor_all_over(level(sky()), small) is None
    assert factor_all_over(level(sky()), level(sky(), exposures_us=(1e3, 2e3))) is None
    assert factor_all_over(level(sky()), level(sky(), exposures_us=(12e3,), factor=0.25)) == pytest.approx(
        0.25, rel=0.1
    )


def test_a_dusk_that_only_the_longest_exposure_shows_is_told_by_it() -> None:
    dusk = sky(sun=0.0) / 40.0
    assert factor_all_over(level(dusk), level(dusk, factor=0.25)) == pytest.approx(0.25, abs=0.1)
