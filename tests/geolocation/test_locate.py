from __future__ import annotations

import numpy as np
import pytest
from numpy.typing import NDArray
from pyproj import Geod, Transformer

from sunarc.geolocation.locate import Located, clouds, geodetic_position, shadows
from sunarc.sky.directions import direction_from_angles
from sunarc.sky.site import Site

FloatArray = NDArray[np.float64]
SITE = Site(latitude=36.604043, longitude=-97.484856, altitude=318.0)
SITES = [SITE, Site(latitude=-89.0, longitude=179.9, altitude=2800.0), Site(latitude=0.0, longitude=-180.0)]
SKY = direction_from_angles(
    zenith_deg=np.repeat([0.0, 20.0, 60.0, 80.0, 88.0], 8), azimuth_deg=np.tile(np.arange(0.0, 360.0, 45.0), 5)
)
SURE = np.zeros((len(SKY), 3, 3))


def geocentric(latitude: FloatArray, longitude: FloatArray, altitude: FloatArray) -> FloatArray:
    transformer = Transformer.from_crs("EPSG:4979", "EPSG:4978", always_xy=True)
    return np.stack(transformer.transform(longitude, latitude, altitude), axis=-1)


@pytest.mark.parametrize("site", SITES)
def test_places_are_projs_own(site: Site) -> None:
    enu = SKY * 70_000.0
    geodetic = geodetic_position(enu, site)
    here = f"+proj=topocentric +ellps=WGS84 +lat_0={site.latitude} +lon_0={site.longitude} +h_0={site.altitude}"
    pipeline = f"+proj=pipeline +step +proj=cart +ellps=WGS84 +step {here}"
    theirs = Transformer.from_pipeline(pipeline).transform(geodetic.longitude, geodetic.latitude, geodetic.altitude)
    np.testing.assert_allclose(np.stack(theirs, axis=-1), enu, atol=1e-5)


@pytest.mark.parametrize("site", SITES)
@pytest.mark.parametrize("height_m", [300.0, 12_000.0])
def test_a_cloud_lies_on_its_ray_and_at_its_height(site: Site, height_m: float) -> None:
    found = clouds(SKY, height_m=height_m, covariance=SURE, site=site)
    np.testing.assert_allclose(found.geodetic.altitude, site.altitude + height_m, atol=1e-4)
    np.testing.assert_allclose(np.cross(found.position_m, SKY), 0.0, atol=1e-6)
    first = geocentric(*(np.array([v]) for v in (site.latitude, site.longitude, site.altitude)))
    there = geocentric(found.geodetic.latitude, found.geodetic.longitude, found.geodetic.altitude)
    np.testing.assert_allclose(
        np.linalg.norm(there - first, axis=-1), np.linalg.norm(found.position_m, axis=-1), atol=1e-3
    )


def test_overhead_is_overhead_and_near_the_zenith_the_earth_is_flat() -> None:
    found = clouds(SKY[:16], height_m=1000.0, covariance=SURE[:16], site=SITE)
    np.testing.assert_allclose(found.position_m[:8], [[0.0, 0.0, 1000.0]] * 8, atol=1e-6)
    flat = 1000.0 * np.tan(np.radians(20.0)) * SKY[8:16, :2] / np.sin(np.radians(20.0))
    np.testing.assert_allclose(found.position_m[8:16, :2], flat, atol=0.02)


def test_the_distance_on_the_ground_is_the_geodesic() -> None:
    found = clouds(SKY[16:24], height_m=1000.0, covariance=SURE[16:24], site=SITE)
    azimuth, _, distance = Geod(ellps="WGS84").inv(
        np.full(8, SITE.longitude), np.full(8, SITE.latitude), found.geodetic.longitude, found.geodetic.latitude
    )
    np.testing.assert_allclose(distance, 1000.0 * np.tan(np.radians(60.0)), rtol=1e-3)
    np.testing.assert_allclose(azimuth % 360.0, np.arange(0.0, 360.0, 45.0), atol=0.01)


def test_a_shadow_falls_away_from_the_sun() -> None:
    cloud = clouds(SKY[:1], height_m=2000.0, covariance=SURE[:1], site=SITE)
    found = shadows(cloud, direction_from_angles(zenith_deg=45.0, azimuth_deg=180.0), SITE)
    np.testing.assert_allclose(found.position_m, [[0.0, 2000.0, 0.0]], atol=1.0)
    np.testing.assert_allclose(found.geodetic.altitude, SITE.altitude, atol=1e-4)
    above = clouds(
        direction_from_angles(zenith_deg=[45.0], azimuth_deg=[180.0]), height_m=1.0, covariance=SURE[:1], site=SITE
    )
    sun = direction_from_angles(zenith_deg=45.0, azimuth_deg=180.0)
    np.testing.assert_allclose(shadows(above, sun, SITE).position_m, 0.0, atol=1e-6)  # a cloud before the sun: here


@pytest.mark.parametrize("zenith_deg", [90.0, 100.0])
def test_with_the_sun_down_there_is_no_shadow(zenith_deg: float) -> None:
    cloud = clouds(SKY, height_m=2000.0, covariance=SURE, site=SITE)
    found = shadows(cloud, direction_from_angles(zenith_deg=zenith_deg, azimuth_deg=180.0), SITE)
    assert np.all(np.isnan(found.position_m))
    assert np.all(np.isnan(found.geodetic.latitude))


def test_sunlight_past_a_cloud_may_miss_the_earth() -> None:
    cloud = clouds(SKY[:1], height_m=12_000.0, covariance=SURE[:1], site=SITE)
    low = shadows(cloud, direction_from_angles(zenith_deg=89.0, azimuth_deg=270.0), SITE)
    assert np.all(np.isnan(low.position_m))
    seen = shadows(cloud, direction_from_angles(zenith_deg=80.0, azimuth_deg=270.0), SITE)
    assert seen.position_m[0, 0] == pytest.approx(
        12_000.0 * np.tan(np.radians(80.0)), rel=0.05
    )  # and more, on a curved Earth


def test_below_the_horizon_and_without_height_there_is_nothing() -> None:
    below = direction_from_angles(zenith_deg=[95.0, 90.0, 20.0, 20.0], azimuth_deg=[0.0] * 4)
    found = clouds(below, height_m=[1000.0, 1000.0, 0.0, -5.0], covariance=SURE[:4], site=SITE)
    assert np.all(np.isnan(found.position_m))


def across(direction: FloatArray, *, radius: float) -> FloatArray:
    """Return the covariance of a direction that is as unsure every way across."""
    return radius**2 * (np.eye(3) - direction[:, :, None] * direction[:, None, :])


def test_the_doubt_on_the_ground_is_that_of_moved_directions() -> None:
    rng = np.random.default_rng(0)
    direction = SKY[18:19]
    sun = direction_from_angles(zenith_deg=55.0, azimuth_deg=140.0)
    sigma = 1e-4
    stated = clouds(direction, height_m=1500.0, covariance=across(direction, radius=sigma), site=SITE)
    moved = direction + rng.normal(0.0, sigma, (20_000, 3)) @ (np.eye(3) - np.outer(direction, direction))
    moved /= np.linalg.norm(moved, axis=-1, keepdims=True)
    drawn = clouds(moved, height_m=1500.0, covariance=np.zeros((20_000, 3, 3)), site=SITE)
    for one, many in ((stated, drawn), (shadows(stated, sun, SITE), shadows(drawn, sun, SITE))):
        agree(one, many)
    root = np.sqrt(np.linalg.eigvalsh(stated.covariance_m2[0, :2, :2]))
    along = 1500.0 * sigma / np.cos(np.radians(60.0))
    np.testing.assert_allclose(root, [along, along / np.cos(np.radians(60.0))], rtol=0.01)


def agree(one: Located, many: Located) -> None:
    measured = np.cov(many.position_m[:, :2].T)
    np.testing.assert_allclose(measured, one.covariance_m2[0, :2, :2], rtol=0.05, atol=0.005)


def test_the_error_of_the_height_is_the_difference_that_it_makes() -> None:
    low, high = (clouds(SKY[:30], height_m=1500.0 + step, covariance=SURE[:30], site=SITE) for step in (-0.5, 0.5))
    found = clouds(SKY[:30], height_m=1500.0, covariance=SURE[:30], site=SITE, height_sigma_m=40.0)
    sun = direction_from_angles(zenith_deg=[35.0], azimuth_deg=[140.0])[0]
    for at, spread in (
        ((low, high), found.covariance_m2),
        ((shadows(low, sun, SITE), shadows(high, sun, SITE)), shadows(found, sun, SITE).covariance_m2),
    ):
        shift = 40.0 * (at[1].position_m - at[0].position_m)
        expected = shift[:, :, None] * shift[:, None, :]
        scale = np.nanmax(np.abs(expected), axis=(1, 2), keepdims=True)
        np.testing.assert_allclose(spread / scale, expected / scale, atol=2e-3)


def test_the_errors_of_height_and_direction_add_as_independent_ones() -> None:
    directions, spread = SKY[:5], across(SKY[:5], radius=1e-3)
    both = clouds(
        directions, height_m=1500.0, covariance=spread, site=SITE, height_sigma_m=[0.0, 10.0, 20.0, 30.0, 40.0]
    )
    alone = clouds(directions, height_m=1500.0, covariance=spread, site=SITE)
    height = clouds(
        directions, height_m=1500.0, covariance=SURE[:5], site=SITE, height_sigma_m=[0.0, 10.0, 20.0, 30.0, 40.0]
    )
    np.testing.assert_allclose(both.covariance_m2, alone.covariance_m2 + height.covariance_m2, atol=1e-9)
    assert np.all(height.covariance_m2[0] == 0.0)
