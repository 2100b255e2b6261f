"""Refraction as a function of the apparent direction, against the solar position algorithm's own."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import pytest

from sunarc.sky.directions import angles_from_direction, direction_from_angles
from sunarc.sky.refraction import raised, refraction_rad
from sunarc.sky.site import Site
from sunarc.sky.sun import sun_angles, sun_directions

SITE = Site(latitude=36.604043, longitude=-97.484856, altitude=318.0)
TIMES = 1_368_403_200.0 + np.arange(0.0, 86_400.0, 600.0)


@pytest.mark.parametrize("temperature", [-5.0, 12.0, 35.0])
def test_it_is_that_of_the_algorithm(temperature: float) -> None:
    site = replace(SITE, temperature=temperature)
    angles = sun_angles(TIMES, site)
    up = angles.apparent_zenith < 90.0
    found = np.degrees(refraction_rad(sun_directions(TIMES, site)[up], site))
    np.testing.assert_allclose(found, (angles.zenith - angles.apparent_zenith)[up], rtol=0.05, atol=2e-4)


def test_raised_directions_stand_higher_by_the_angle() -> None:
    directions = direction_from_angles(zenith_deg=[10.0, 60.0, 89.0], azimuth_deg=[0.0, 100.0, 300.0])
    zenith, azimuth = angles_from_direction(raised(directions, np.radians([0.1, 0.2, 0.3])))
    np.testing.assert_allclose(zenith, [9.9, 59.8, 88.7], atol=1e-9)
    np.testing.assert_allclose((azimuth + 1.0) % 360.0, [1.0, 101.0, 301.0], atol=1e-9)


def test_measured_air_is_used_where_it_is_given() -> None:
    warm = sun_angles(TIMES, replace(SITE, temperature=35.0, pressure=99_000.0)).apparent_zenith
    every_other = np.where(np.arange(TIMES.size) % 2 == 0, 35.0, np.nan)
    pressure = np.where(np.isfinite(every_other), 99_000.0, np.nan)
    found = sun_angles(TIMES, SITE, temperature=every_other, pressure=pressure).apparent_zenith
    assumed = sun_angles(TIMES, SITE).apparent_zenith
    np.testing.assert_array_equal(found[::2], warm[::2])
    np.testing.assert_array_equal(found[1::2], assumed[1::2])
