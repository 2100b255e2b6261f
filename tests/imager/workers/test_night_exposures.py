"""Exposures of the night follow the sky."""

from __future__ import annotations

import numpy as np
import pytest

from sunarc.detection.values import Stars
from sunarc.imager.workers.night.exposures import NightExposures
from sunarc.imaging.exposure import ExposureBounds

BOUNDS = ExposureBounds(minimum_us=10.0, maximum_us=30e6, step_us=1.0)


def stars(peak: float, count: int = 40) -> Stars:
    one = np.ones(count)
    return Stars(
        pixels=np.zeros((count, 2)), sigma_px=0.1 * one, flux=one, snr=10.0 * one, peak_fraction=peak * one,
        width_px=one, ellipticity=0.1 * one, saturated=one < 0.0,
    )  # fmt: skip


def after(*reports: tuple[float, float], count: int = 40, bounds: ExposureBounds = BOUNDS) -> float:
    exposures = NightExposures()
    for peak, sky in reports:
        exposures.report(stars(peak, count), sky_fraction=sky)
    return exposures.next_us(bounds).exposure_us


def test_the_first_exposure_is_of_five_seconds() -> None:
    assert NightExposures().next_us(BOUNDS) == (5e6, 0.0)


@pytest.mark.parametrize(
    ("peak", "sky", "expected_us"),
    [
        (0.5, 0.2, 5e6),
        (0.5, 0.05, 10e6),
        (0.5, 0.119, 10e6),
        (0.5, 0.121, 5e6),
        (0.5, 0.349, 5e6),
        (0.5, 0.351, 2.5e6),
        (0.91, 0.05, 2.5e6),
        (0.89, 0.05, 10e6),
    ],
)
def test_a_bright_sky_and_clipped_stars_shorten_it_and_a_dark_one_lengthens_it(
    peak: float, sky: float, expected_us: float
) -> None:
    assert after((peak, sky)) == expected_us


def test_a_few_bright_planets_do_not_shorten_it() -> None:
    assert after((0.95, 0.05), count=29) == 10e6
    assert after((0.95, 0.05), count=30) == 2.5e6


def test_it_stays_on_the_ladder_and_within_the_camera_s_bounds() -> None:
    assert after(*[(0.5, 0.9)] * 20) == 0.3e6
    assert after(*[(0.5, 0.01)] * 20) == 10e6
    short = ExposureBounds(minimum_us=10.0, maximum_us=1e6, step_us=1.0)
    assert after(bounds=short) == 1e6
    long = ExposureBounds(minimum_us=0.5e6, maximum_us=3e7, step_us=1.0)
    assert after(*[(0.5, 0.9)] * 20, bounds=long) == 0.5e6


def gain_after(*reports: tuple[float, float]) -> tuple[float, float]:
    exposures = NightExposures()
    for peak, sky in reports:
        exposures.report(stars(peak), sky_fraction=sky)
    return exposures.next_us(BOUNDS)


def test_the_gain_is_raised_only_where_the_longest_exposure_is_too_dark() -> None:
    dark = (0.1, 0.01)
    assert gain_after(dark) == (10e6, 0.0)
    assert gain_after(dark, dark) == (10e6, 6.0)
    assert gain_after(*[dark] * 9) == (10e6, 18.0)
    assert gain_after(dark, (0.1, 0.03)) == (10e6, 0.0)
    assert gain_after(dark, (0.3, 0.01)) == (10e6, 0.0)


def test_a_bright_sky_lowers_the_gain_before_the_exposure() -> None:
    dark, bright = (0.1, 0.01), (0.1, 0.5)
    assert gain_after(dark, dark, dark, bright) == (10e6, 6.0)
    assert gain_after(dark, dark, dark, bright, bright, bright) == (5e6, 0.0)
