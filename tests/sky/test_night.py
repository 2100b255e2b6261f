"""Moon, planets and stars against skyfield (JPL's DE421), the stars also against ERFA, IAU's own algorithms."""

from __future__ import annotations

import math
import warnings
from collections.abc import Iterator
from datetime import UTC, datetime
from typing import Any

import numpy as np
import pytest

from sunarc.common.array_types import FloatArray, picked
from sunarc.sky.directions import angles_from_direction, angular_distance, direction_from_angles
from sunarc.sky.night import (
    SOLAR_SYSTEM_BODIES,
    STAR,
    SolarSystemBody,
    body_directions,
    body_position,
    night_sky,
    star_directions,
    star_table,
)
from sunarc.sky.refraction import apparent_elevation
from sunarc.sky.site import Site
from sunarc.sky.sun import sun_angles

api = pytest.importorskip("skyfield.api")
erfa = pytest.importorskip("erfa")
kernels = pytest.importorskip("skyfield_data")

SITES = [
    Site(latitude=36.604043, longitude=-97.484856, altitude=318.0),
    Site(latitude=-12.0, longitude=-77.0, altitude=150.0),
    Site(latitude=-41.0, longitude=175.0),
    Site(latitude=79.0, longitude=12.0, temperature=-5.0),
    Site(latitude=28.3, longitude=-16.5, altitude=2390.0),
    Site(latitude=-89.9, longitude=0.0, altitude=2835.0, temperature=-50.0),
]
MOMENTS = [
    datetime(year, month, 11, hour, 17, tzinfo=UTC).timestamp()
    for year, month, hour in ((1990, 1, 3), (1999, 8, 11), (2007, 3, 22), (2016, 11, 7), (2026, 6, 1), (2038, 9, 14))
] + [datetime(2049, 12, 30, 19, 5, tzinfo=UTC).timestamp()]
ARCSEC = math.degrees(1.0) * 3600.0
TIMESCALE = api.load.timescale(builtin=True)
_JD_1970 = 2_440_587.5


@pytest.fixture(scope="module")
def planets() -> Iterator[Any]:
    with warnings.catch_warnings():
        warnings.simplefilter("ignore", RuntimeWarning)  # of files that have expired; DE421 has not
        kernel = api.load_file(f"{kernels.get_skyfield_data_path()}/de421.bsp")
    yield kernel
    kernel.close()


def true_directions(sites: Site, unix_s: Any, targets: Any, planets: Any) -> FloatArray:  # noqa: ANN401
    """Return skyfield's directions without refraction, (..., 3); UT1 is the UTC that is given."""
    moment = TIMESCALE.ut1_jd(_JD_1970 + unix_s / 86_400.0)
    place = planets["earth"] + api.wgs84.latlon(sites.latitude, sites.longitude, elevation_m=sites.altitude)
    altitude, azimuth, _ = place.at(moment).observe(targets).apparent().altaz()
    return direction_from_angles(zenith_deg=90.0 - altitude.degrees, azimuth_deg=azimuth.degrees)


def refracted(directions: FloatArray, site: Site) -> FloatArray:
    zenith, azimuth = angles_from_direction(directions)
    return direction_from_angles(zenith_deg=90.0 - apparent_elevation(90.0 - zenith, site), azimuth_deg=azimuth)


@pytest.mark.parametrize(
    ("name", "limit_arcsec"), [(name, 10.0 if name == "moon" else 5.0) for name in SOLAR_SYSTEM_BODIES]
)
def test_moon_and_planets_are_where_the_ephemeris_of_jpl_has_them(
    name: SolarSystemBody,
    limit_arcsec: float,
    planets: Any,  # noqa: ANN401
) -> None:
    target = planets[name if name in {"moon", "venus", "mars"} else f"{name} barycenter"]
    apart = []
    for site in SITES:
        theirs = refracted(true_directions(site, np.array(MOMENTS), target, planets), site)
        ours = np.array([body_position(name, unix_s, site).direction for unix_s in MOMENTS])
        apart += list(angular_distance(ours, theirs))
    assert max(apart) * ARCSEC <= limit_arcsec
    assert max(apart) * ARCSEC > 0.05  # two theories of the planets are not the same to the digit


@pytest.mark.filterwarnings("ignore:ERFA function")  # distances and leap seconds that it does not know
@pytest.mark.parametrize("site", SITES, ids=lambda site: f"{site.latitude:g} N")
def test_stars_are_where_skyfield_and_erfa_have_them(site: Site, planets: Any) -> None:  # noqa: ANN401
    table = star_table()
    some = picked(table, np.arange(0, table.hip.size, 60))
    years = (2024.0 - 2000.0) * 365.25
    mas = some.motion * ARCSEC * 1e3
    stars = api.Star(
        ra_hours=np.degrees(some.right_ascension) / 15.0,
        dec_degrees=np.degrees(some.declination),
        ra_mas_per_year=mas[:, 0],
        dec_mas_per_year=mas[:, 1],
        epoch=2_451_545.0 + years,
    )
    for unix_s in MOMENTS[:: len(MOMENTS) - 1]:
        ours = star_directions(some, unix_s, site)
        theirs = refracted(true_directions(site, unix_s, stars, planets), site)
        assert np.max(angular_distance(ours, theirs)) * ARCSEC <= 2.0
        np.testing.assert_array_less(angular_distance(ours, refracted(by_erfa(some, unix_s, site), site)), 2.0 / ARCSEC)


def by_erfa(stars: Any, unix_s: float, site: Site) -> FloatArray:  # noqa: ANN401
    day = _JD_1970 + unix_s / 86_400.0
    since_2000 = (2024.0 - 2000.0) * 365.25
    speed = stars.motion[:, 0] / np.cos(stars.declination)
    still = np.zeros(stars.hip.size)
    at_2000 = erfa.pmsafe(
        stars.right_ascension,
        stars.declination,
        speed,
        stars.motion[:, 1],
        still,
        still,
        2_451_545.0,
        since_2000,
        2_451_545.0,
        0.0,
    )
    place = math.radians(site.longitude), math.radians(site.latitude), site.altitude
    azimuth, zenith, *_ = erfa.atco13(*at_2000, day, 0.0, 0.0, *place, 0.0, 0.0, 0.0, 0.0, 0.0, 0.55)
    return direction_from_angles(zenith_deg=np.degrees(zenith), azimuth_deg=np.degrees(azimuth))


def test_the_refraction_is_the_suns_and_close_to_erfas() -> None:
    site, times = SITES[0], MOMENTS[1] + np.arange(0.0, 43_200.0, 600.0)
    sun = sun_angles(times, site)
    raised = 90.0 - apparent_elevation(90.0 - sun.zenith, site)
    np.testing.assert_allclose(raised, sun.apparent_zenith, atol=1e-9)
    a, b = erfa.refco(site.pressure_pa / 100.0, site.temperature, 0.5, 0.55)
    elevation = np.arange(15.0, 90.0, 5.0)
    tangent = np.tan(np.radians(90.0 - apparent_elevation(elevation, site)))
    theirs = np.degrees(a * tangent + b * tangent**3)
    ratio = (apparent_elevation(elevation, site) - elevation) / theirs
    assert (
        1.02 < ratio.min() <= ratio.max() < 1.06
    )  # Saemundsson's formula is that much above: 8 arcseconds at 15 degrees


def test_the_sky_of_a_moment_holds_what_is_above_the_horizon_the_brightest_first() -> None:
    site, unix_s = SITES[0], MOMENTS[4]
    sky = night_sky(unix_s, site, faintest=4.5)
    assert 300 < len(sky) < 600
    assert np.all(np.diff(sky.magnitude) >= 0.0)
    assert sky.magnitude[-1] <= 4.5
    assert np.all(sky.directions[:, 2] > 0.0)
    np.testing.assert_allclose(np.linalg.norm(sky.directions, axis=-1), 1.0, atol=1e-12)
    vega = np.flatnonzero(sky.names == f"{STAR}91262")
    zenith, azimuth = angles_from_direction(sky.directions[vega[0]])
    assert (sky.magnitude[vega[0]], round(float(zenith)), round(float(azimuth))) == (0.03, 73, 54)
    up = {name for name in SOLAR_SYSTEM_BODIES if body_position(name, unix_s, site).direction[2] > 0.0} - {"moon"}
    assert up == {str(name) for name in sky.names if not name.startswith(STAR)}


def test_the_moons_disc_and_phase() -> None:
    full = body_position("moon", datetime(2026, 3, 3, 11, 34, tzinfo=UTC).timestamp(), SITES[0])  # a lunar eclipse
    half = body_position("moon", datetime(2026, 3, 11, 9, 38, tzinfo=UTC).timestamp(), SITES[0])  # last quarter
    assert full.illuminated_fraction > 0.995
    assert abs(half.illuminated_fraction - 0.5) < 0.01
    for moon in (full, half):
        assert 0.244 < math.degrees(moon.radius) < 0.284  # perigee and apogee, topocentric
        assert -13.0 < moon.magnitude < -9.0


def test_the_table_is_whole() -> None:
    table = star_table()
    assert table.hip.size == np.unique(table.hip).size == 2848
    assert np.all(np.isfinite(table.motion))
    size = np.hypot(*table.motion.T) * ARCSEC
    assert np.median(size) == pytest.approx(0.046, abs=0.01)
    arcturus, cygni_61 = (np.flatnonzero(table.hip == hip)[0] for hip in (69673, 104214))
    assert size[arcturus] == pytest.approx(2.28, abs=0.01)
    assert size[cygni_61] == pytest.approx(5.28, abs=0.02)
    assert np.count_nonzero(table.magnitude <= 4.5) == 919
    sirius = np.flatnonzero(table.hip == 32349)[0]
    assert np.degrees(table.right_ascension[sirius]) == pytest.approx(101.2835, abs=5e-4)  # at 2024.0
    assert table.motion[sirius] * ARCSEC == pytest.approx([-0.546, -1.223], abs=0.001)


def test_bodies_by_name_are_those_of_the_night_sky_and_of_their_own_moments() -> None:
    site, moments = SITES[0], (MOMENTS[3], MOMENTS[3] + 3600.0)
    skies = [night_sky(moment, site, faintest=3.0) for moment in moments]
    names = np.concatenate([skies[0].names, skies[1].names, ["sun", "star:HIP999999", "mast", "moon"]])
    times = np.concatenate([np.full(len(skies[0]), moments[0]), np.full(len(skies[1]) + 4, moments[1])])
    found = body_directions(names, times, site)
    expected = np.concatenate([sky.directions for sky in skies])
    np.testing.assert_allclose(found[:-4], expected, rtol=0.0, atol=1e-14)
    assert np.all(np.isnan(found[-4:-1]))
    np.testing.assert_allclose(found[-1], body_position("moon", moments[1], site).direction, rtol=0.0, atol=1e-14)


def test_a_measured_air_bends_the_light_of_a_star_as_the_sun_s() -> None:
    site, moment = SITES[0], MOMENTS[3]
    sky = night_sky(moment, site, faintest=3.0)
    times, cold = np.full(len(sky), moment), np.full(len(sky), -20.0)
    found = body_directions(sky.names, times, site, temperature=cold, pressure=np.full(len(sky), np.nan))
    expected = night_sky(moment, site.replace_air(temperature=-20.0, pressure=None), faintest=3.0)
    low = expected.directions[:, 2] > 0.0
    np.testing.assert_allclose(found[: low.sum()], expected.directions[low][: len(found)], rtol=0.0, atol=1e-14)
    assert np.max(angular_distance(found, sky.directions)) > 1e-6
