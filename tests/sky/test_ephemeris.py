"""The sun's place by cubics between hours, beside the series at every time."""

from __future__ import annotations

import numpy as np
import pytest
from numpy.typing import NDArray

from sunarc.sky.ephemeris import by_series, geocentric

FloatArray = NDArray[np.float64]

DELTA_T_S = 69.0
ROUNDING_DEG = 3e-9
"""Degrees; the algorithm's Julian day alone rounds the sidereal time to 1e-7."""


def _apart_deg(a: FloatArray, b: FloatArray) -> float:
    return float(np.max(np.abs((a - b + 180.0) % 360.0 - 180.0)))


@pytest.mark.parametrize(
    "unix_s",
    [
        1.37e9 + np.arange(0.0, 50_000.0, 30.0),
        np.random.default_rng(1).uniform(0.0, 20.0 * 86_400.0, 3_000),  # 1970, no order
        -1e9 + np.arange(0.0, 4e6, 900.0),
        1.0425e9 + np.arange(0.0, 4e7, 2_000.0),  # a year of them, perihelion and aphelion
    ],
    ids=["a day", "no order", "before 1970", "a year"],
)
def test_the_cubics_are_the_series(unix_s: FloatArray) -> None:
    found, expected = geocentric(unix_s, DELTA_T_S), by_series(unix_s, DELTA_T_S)
    assert not np.array_equal(found.declination, expected.declination)  # else nothing is compared
    for name in ("sidereal", "right_ascension", "declination"):
        assert _apart_deg(getattr(found, name), getattr(expected, name)) < ROUNDING_DEG
    np.testing.assert_allclose(found.distance, expected.distance, rtol=1e-10)


def test_a_few_times_are_by_the_series() -> None:
    few = np.array([1.4e9, 1.4e9 + 5.0, 1.5e9])
    for found, expected in zip(geocentric(few, DELTA_T_S), by_series(few, DELTA_T_S), strict=True):
        assert np.array_equal(found, expected)


def test_the_right_ascension_passes_from_360_to_0_within_a_piece() -> None:
    # the March equinox of 2021: 20 March, 09:37 UTC
    unix_s = 1.6162342e9 + np.arange(-7_200.0, 7_200.0, 10.0)
    found = geocentric(unix_s, DELTA_T_S).right_ascension
    assert found.max() > 359.9
    assert found.min() < 0.1
    assert _apart_deg(found, by_series(unix_s, DELTA_T_S).right_ascension) < ROUNDING_DEG
