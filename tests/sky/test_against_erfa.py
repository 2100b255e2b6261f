"""The sun against ERFA, the IAU's own algorithms: where they differ, and by what."""

from __future__ import annotations

import math

import numpy as np
import pytest

from sunarc.common.array_types import FloatArray
from sunarc.sky.directions import angular_distance, direction_from_angles
from sunarc.sky.ephemeris import terrestrial_minus_universal_s
from sunarc.sky.site import Site
from sunarc.sky.sun import sun_angles

erfa = pytest.importorskip("erfa")

SITES = [
    Site(latitude=36.604043, longitude=-97.484856, altitude=318.0),
    Site(latitude=-12.0, longitude=-77.0, altitude=150.0),
    Site(latitude=79.0, longitude=12.0),
    Site(latitude=28.3, longitude=-16.5, altitude=2390.0),
]
YEARS = 631_152_000.0 + 31_557_600.0 * np.arange(60.0)  # from 1990 to 2050
AU_M, AU_PER_DAY_OF_LIGHT, LIGHT_DAYS_PER_AU = 149_597_870_700.0, 173.1446326846693, 499.004784 / 86_400.0
TURN_PER_DAY = 1.00273781191135448 * 2.0 * math.pi
ARCSEC = math.degrees(1.0) * 3600.0


def by_erfa(unix_s: FloatArray, site: Site, *, rotating: bool) -> FloatArray:
    """Return the sun's true directions; `rotating`: with its aberration. UT1 is the UTC given, of one year."""
    midnight, of_day = np.floor(unix_s / 86_400.0) + 2_440_587.5, unix_s / 86_400.0 % 1.0
    terrestrial = of_day + terrestrial_minus_universal_s(unix_s) / 86_400.0
    earth, about_barycentre = erfa.epv00(midnight, terrestrial)
    distance = np.linalg.norm(earth["p"], axis=-1)
    earlier, earlier_about = erfa.epv00(midnight, terrestrial - distance * LIGHT_DAYS_PER_AU)
    to_date = erfa.pnm06a(midnight, terrestrial)
    sidereal = erfa.gst06(midnight, of_day, midnight, terrestrial, to_date)
    longitude, latitude = math.radians(site.longitude), math.radians(site.latitude)
    x, y, z = erfa.gd2gc(1, longitude, latitude, site.altitude) / AU_M
    cosine, sine = np.cos(sidereal), np.sin(sidereal)
    place = np.stack([cosine * x - sine * y, sine * x + cosine * y, np.full_like(cosine, z)], axis=-1)
    speed = TURN_PER_DAY * np.stack([-place[:, 1], place[:, 0], 0.0 * cosine], axis=-1) * rotating
    of_2000 = np.swapaxes(to_date, -1, -2)
    sun = earlier_about["p"] - earlier["p"] - about_barycentre["p"] - (of_2000 @ place[..., None])[..., 0]
    velocity = (about_barycentre["v"] + (of_2000 @ speed[..., None])[..., 0]) / AU_PER_DAY_OF_LIGHT
    lorentz = np.sqrt(1.0 - np.sum(velocity**2, axis=-1))
    seen = erfa.ab(sun / np.linalg.norm(sun, axis=-1, keepdims=True), velocity, distance, lorentz)
    seen = (to_date @ seen[..., None])[..., 0]
    hour = sidereal + longitude - np.arctan2(seen[:, 1], seen[:, 0])
    azimuth, elevation = erfa.hd2ae(hour, np.arcsin(seen[:, 2]), latitude)
    return direction_from_angles(zenith_deg=90.0 - np.degrees(elevation), azimuth_deg=np.degrees(azimuth))


@pytest.mark.parametrize("site", SITES, ids=lambda site: f"{site.latitude:g} N")
def test_the_series_are_within_0_6_arcseconds_and_the_earths_rotation_adds_a_third(site: Site) -> None:
    rng = np.random.default_rng(1)
    apart: dict[bool, list[float]] = {False: [], True: []}
    for year in YEARS:
        unix_s = year + rng.uniform(0.0, 31_557_600.0, 60)
        angles = sun_angles(unix_s, site)
        ours = direction_from_angles(zenith_deg=angles.zenith, azimuth_deg=angles.azimuth)
        for rotating, found in apart.items():
            theirs = by_erfa(unix_s, site, rotating=rotating)
            found.extend(angular_distance(ours, theirs)[angles.zenith < 90.0] * ARCSEC)
    still, turning = apart.values()
    assert 0.08 < np.median(still) < 0.16
    assert np.max(still) < 0.6
    # 0.32" at the equator, which the algorithm leaves out
    assert np.max(turning) < 0.6 + 0.32 * math.cos(math.radians(site.latitude))


def test_a_day_with_a_leap_second_is_longer_for_erfa_and_not_for_unix_time() -> None:
    # its UTC is a quasi-Julian day: from seconds since 1970 as they are, the sun of that day is up to 15" off
    midnight, noon = 1_483_142_400.0 / 86_400.0 + 2_440_587.5, 0.5  # 31 December 2016
    ahead = erfa.utcut1(midnight, noon, 0.0)[1] - noon
    assert ahead * 86_400.0 == pytest.approx(0.5, abs=1e-6)
