"""Places, clouds, shadows and their covariances against PROJ, a flat Earth, difference quotients and drawn samples."""

from __future__ import annotations

import math

import numpy as np
import pytest
from numpy.typing import NDArray
from pyproj import Transformer

from sunarc.geolocation.locate import (
    ECCENTRICITY2,
    SEMI_MAJOR_M,
    Located,
    clouds,
    geodetic_position,
    local_frame,
    shadows,
)
from sunarc.sky.directions import direction_from_angles
from sunarc.sky.site import Site

FloatArray = NDArray[np.float64]
SITE = Site(latitude=36.604043, longitude=-97.484856, altitude=318.0)
PLACES = [
    SITE,
    Site(latitude=90.0, longitude=0.0, altitude=2800.0),
    Site(latitude=-89.5, longitude=-180.0),
    Site(latitude=0.0, longitude=180.0, altitude=-400.0),
    Site(latitude=-33.9, longitude=18.4, altitude=8000.0),
]
NONE = np.zeros((1, 3, 3))


def geocentric(latitude: FloatArray, longitude: FloatArray, altitude: FloatArray) -> FloatArray:
    transformer = Transformer.from_crs("EPSG:4979", "EPSG:4978", always_xy=True)
    return np.stack(transformer.transform(longitude, latitude, altitude), axis=-1)


def test_the_ellipsoid_is_wgs_84() -> None:
    # NIMA TR8350.2: a, b = 6 356 752.3142 m, first eccentricity squared
    assert SEMI_MAJOR_M == 6_378_137.0
    assert pytest.approx(6.69437999014e-3, rel=1e-12) == ECCENTRICITY2
    assert SEMI_MAJOR_M * math.sqrt(1.0 - ECCENTRICITY2) == pytest.approx(6_356_752.3142, abs=1e-4)


def test_the_frame_of_a_site_is_proj_s_and_orthonormal() -> None:
    for site in PLACES:
        axes, origin = local_frame(site)
        np.testing.assert_allclose(axes @ axes.T, np.eye(3), atol=1e-15)
        assert np.linalg.det(axes) == pytest.approx(1.0)
        here = geocentric(*(np.array([v]) for v in (site.latitude, site.longitude, site.altitude)))[0]
        np.testing.assert_allclose(origin, here, atol=1e-6)
        higher = geocentric(*(np.array([v]) for v in (site.latitude, site.longitude, site.altitude + 1000.0)))[0]
        np.testing.assert_allclose(axes[2], (higher - here) / 1000.0, atol=1e-9)
        assert axes[0, 2] == 0.0  # east is level with the equator


def test_places_go_to_proj_and_back() -> None:
    rng = np.random.default_rng(1)
    for site in PLACES:
        enu = rng.normal(0.0, [60e3, 60e3, 5e3], (30, 3))
        geodetic = geodetic_position(enu, site)
        axes, origin = local_frame(site)
        theirs = (geocentric(geodetic.latitude, geodetic.longitude, geodetic.altitude) - origin) @ axes.T
        np.testing.assert_allclose(theirs, enu, atol=1e-5)
        above = geocentric(geodetic.latitude, geodetic.longitude, geodetic.altitude + 100.0)
        below = geocentric(geodetic.latitude, geodetic.longitude, geodetic.altitude)
        np.testing.assert_allclose(geodetic.up, (above - below) / 100.0 @ axes.T, atol=1e-9)
        assert np.all(np.abs(geodetic.longitude) <= 180.0)


def test_a_point_100_km_off_on_the_tangent_plane_stands_784_m_up() -> None:
    # d² / 2R with the radii of curvature of the latitude: M along the meridian, N across it
    sine2 = math.sin(math.radians(SITE.latitude)) ** 2
    across = SEMI_MAJOR_M / math.sqrt(1.0 - ECCENTRICITY2 * sine2)
    along = across * (1.0 - ECCENTRICITY2) / (1.0 - ECCENTRICITY2 * sine2)
    found = geodetic_position(np.array([[1e5, 0.0, 0.0], [0.0, 1e5, 0.0]]), SITE).altitude - SITE.altitude
    np.testing.assert_allclose(found, [1e10 / 2.0 / across, 1e10 / 2.0 / along], rtol=1e-3)


def test_on_a_flat_earth_the_cloud_stands_at_height_times_tangent() -> None:
    zenith, azimuth = math.radians(40.0), math.radians(65.0)
    direction = direction_from_angles(zenith_deg=[40.0], azimuth_deg=[65.0])
    found = clouds(direction, height_m=100.0, covariance=NONE, site=SITE)
    flat = 100.0 * math.tan(zenith) * np.array([math.sin(azimuth), math.cos(azimuth)])
    np.testing.assert_allclose(found.position_m[0, :2], flat, atol=0.01)
    assert found.position_m[0, 2] == pytest.approx(100.0, abs=0.01)
    metres_per_degree = math.radians(1.0) * SEMI_MAJOR_M
    assert (found.geodetic.latitude[0] - SITE.latitude) * metres_per_degree == pytest.approx(flat[1], rel=0.01)
    eastward = (found.geodetic.longitude[0] - SITE.longitude) * metres_per_degree
    assert eastward * math.cos(math.radians(SITE.latitude)) == pytest.approx(flat[0], rel=0.01)


def test_on_a_flat_earth_the_shadow_lies_the_sun_s_tangent_further() -> None:
    direction = direction_from_angles(zenith_deg=[30.0], azimuth_deg=[200.0])
    sun = direction_from_angles(zenith_deg=50.0, azimuth_deg=110.0)
    cloud = clouds(direction, height_m=100.0, covariance=NONE, site=SITE)
    flat = cloud.position_m[0, :2] - 100.0 * sun[:2] / sun[2]
    found = shadows(cloud, sun, SITE)
    np.testing.assert_allclose(found.position_m[0], [*flat, 0.0], atol=0.01)
    assert found.geodetic.altitude[0] == pytest.approx(SITE.altitude, abs=1e-6)


def test_heights_may_differ_from_cloud_to_cloud() -> None:
    directions = direction_from_angles(zenith_deg=[0.0, 70.0, 85.0], azimuth_deg=[0.0, 10.0, 200.0])
    heights = np.array([500.0, 3000.0, 11_000.0])
    many = clouds(directions, height_m=heights, covariance=np.zeros((3, 3, 3)), site=SITE)
    np.testing.assert_allclose(many.geodetic.altitude, SITE.altitude + heights, atol=1e-6)
    for i, height in enumerate(heights):
        one = clouds(directions[i : i + 1], height_m=height, covariance=NONE, site=SITE)
        np.testing.assert_allclose(one.position_m[0], many.position_m[i], atol=1e-6)


@pytest.mark.parametrize(("rise", "seen"), [(0.9e-4, False), (1.1e-4, True)])
def test_a_ray_must_rise_by_a_ten_thousandth(*, rise: float, seen: bool) -> None:
    level = np.array([[math.sqrt(1.0 - rise**2), 0.0, rise]])
    found = clouds(level, height_m=1000.0, covariance=NONE, site=SITE)
    assert bool(np.isfinite(found.position_m).all()) is seen
    if seen:  # the horizon of a sphere: √(2 R h)
        assert np.linalg.norm(found.position_m) == pytest.approx(math.sqrt(2.0 * SEMI_MAJOR_M * 1000.0), rel=0.01)
    from_above = shadows(clouds(np.array([[0.0, 0.0, 1.0]]), height_m=0.01, covariance=NONE, site=SITE), level[0], SITE)
    assert bool(np.isfinite(from_above.position_m).all()) is seen


def moved(direction: FloatArray, sun: FloatArray, height_m: float) -> tuple[FloatArray, FloatArray]:
    """Return the positions of a cloud and of its shadow."""
    cloud = clouds(direction[None], height_m=height_m, covariance=NONE, site=SITE)
    return cloud.position_m[0], shadows(cloud, sun, SITE).position_m[0]


@pytest.mark.parametrize("zenith_deg", [3.0, 45.0, 80.0])
def test_the_covariances_are_those_of_the_difference_quotients(zenith_deg: float) -> None:
    direction = direction_from_angles(zenith_deg=zenith_deg, azimuth_deg=250.0)
    sun = direction_from_angles(zenith_deg=60.0, azimuth_deg=130.0)
    root = np.random.default_rng(4).normal(0.0, 1e-4, (3, 3))
    covariance = root @ root.T
    columns = [
        np.subtract(moved(direction + step, sun, 2000.0), moved(direction - step, sun, 2000.0)) / 2e-5
        for step in 1e-5 * np.eye(3)
    ]
    jacobians = np.stack(columns, axis=-1)
    cloud = clouds(direction[None], height_m=2000.0, covariance=covariance[None], site=SITE)
    for found, jacobian in zip((cloud, shadows(cloud, sun, SITE)), jacobians, strict=True):
        expected = jacobian @ covariance @ jacobian.T
        np.testing.assert_allclose(found.covariance_m2[0], expected, atol=2e-4 * np.abs(expected).max())
        up = found.geodetic.up[0]  # a cloud and a shadow slide along their surfaces
        assert abs(float(up @ found.covariance_m2[0] @ up)) < 1e-9 * float(np.trace(expected))


def test_the_stated_covariance_covers_what_is_drawn_neither_less_nor_more() -> None:
    rng = np.random.default_rng(9)
    direction = direction_from_angles(zenith_deg=65.0, azimuth_deg=30.0)
    sun = direction_from_angles(zenith_deg=40.0, azimuth_deg=200.0)
    sigma, count = 3e-4, 4000
    flat = np.eye(3) - np.outer(direction, direction)
    stated = clouds(direction[None], height_m=1200.0, covariance=sigma**2 * flat[None], site=SITE)
    drawn_rays = direction + rng.normal(0.0, sigma, (count, 3)) @ flat
    drawn_rays /= np.linalg.norm(drawn_rays, axis=-1, keepdims=True)
    drawn = clouds(drawn_rays, height_m=1200.0, covariance=np.zeros((count, 3, 3)), site=SITE)
    for one, many in ((stated, drawn), (shadows(stated, sun, SITE), shadows(drawn, sun, SITE))):
        share = within_95_percent(one, many)
        assert 0.94 < share < 0.96
        scatter = np.trace(np.cov(many.position_m.T)) / np.trace(one.covariance_m2[0])
        assert 0.93 < scatter < 1.07


def within_95_percent(one: Located, many: Located) -> float:
    """Return the share of the drawn points within the stated ellipse of 95 % on the ground (χ² of 2: 5.991)."""
    off = (many.position_m - one.position_m)[:, :2]
    inverse = np.linalg.inv(one.covariance_m2[0, :2, :2])
    return float(np.mean(np.einsum("ni,ij,nj->n", off, inverse, off) < 5.991))
