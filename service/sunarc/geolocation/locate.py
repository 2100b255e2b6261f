"""Positions on the ellipsoid (WGS 84) of a cloud and its shadow from directions and a height.

Rays are straight and directions are apparent ones: what refraction bends below the cloud is left out, which moves a
cloud seen 10 degrees above the horizon by less than 1 % of its distance.
"""

from __future__ import annotations

import math
from dataclasses import dataclass, replace
from typing import NamedTuple

import numpy as np
from numpy.typing import ArrayLike

from sunarc.common.array_types import FloatArray
from sunarc.sky.site import Site

SEMI_MAJOR_M = 6_378_137.0
FLATTENING = 1.0 / 298.257223563
ECCENTRICITY2 = FLATTENING * (2.0 - FLATTENING)
_LATITUDE_ROUNDS = 4


class GeodeticPosition(NamedTuple):
    """Latitude and longitude in degrees, altitude in metres, each (n,); `up` (n, 3) is the vertical there.

    `up` is in the site's east-north-up.
    """

    latitude: FloatArray
    longitude: FloatArray
    altitude: FloatArray
    up: FloatArray


def geodetic_position(position_m: FloatArray, site: Site) -> GeodeticPosition:
    """Return the places of points (n, 3), metres east, north and up of a site."""
    axes, origin = local_frame(site)
    x, y, z = np.moveaxis(position_m @ axes + origin, -1, 0)
    across = np.hypot(x, y)
    latitude = np.arctan2(z, across * (1.0 - ECCENTRICITY2))
    for _ in range(_LATITUDE_ROUNDS):  # each one is a few hundred times closer
        radius = SEMI_MAJOR_M / np.sqrt(1.0 - ECCENTRICITY2 * np.sin(latitude) ** 2)
        latitude = np.arctan2(z + ECCENTRICITY2 * radius * np.sin(latitude), across)
    radius = SEMI_MAJOR_M / np.sqrt(1.0 - ECCENTRICITY2 * np.sin(latitude) ** 2)
    sine, cosine, longitude = np.sin(latitude), np.cos(latitude), np.arctan2(y, x)
    altitude = across * cosine + (z + ECCENTRICITY2 * radius * sine) * sine - radius
    up = np.stack([cosine * np.cos(longitude), cosine * np.sin(longitude), sine], axis=-1) @ axes.T
    return GeodeticPosition(np.degrees(latitude), np.degrees(longitude), altitude, up)


def relative_frame(site: Site, other: Site) -> tuple[FloatArray, FloatArray]:
    """Return where another site is, (3,) metres east, north and up of a site, and (3, 3): its axes to the site's."""
    axes, origin = local_frame(site)
    other_axes, other_origin = local_frame(other)
    return axes @ (other_origin - origin), axes @ other_axes.T


def local_frame(site: Site) -> tuple[FloatArray, FloatArray]:
    """Return the (3, 3) rows east, north, up and the site itself, in the Earth's own frame."""
    latitude, longitude = math.radians(site.latitude), math.radians(site.longitude)
    sine, cosine = math.sin(latitude), math.cos(latitude)
    up = np.array([cosine * math.cos(longitude), cosine * math.sin(longitude), sine])
    east = np.array([-math.sin(longitude), math.cos(longitude), 0.0])
    radius = SEMI_MAJOR_M / math.sqrt(1.0 - ECCENTRICITY2 * sine**2)
    origin = (radius + site.altitude) * up - np.array([0.0, 0.0, ECCENTRICITY2 * radius * sine])
    return np.stack([east, np.cross(up, east), up]), origin


_ROUNDS = 5
_LEVEL = 1e-4
"""A ray that rises by less than this never leaves the haze, and its length means nothing."""


@dataclass(frozen=True, slots=True, kw_only=True, eq=False)
class Located:
    """Points above or on the ground; NaN elsewhere.

    Attributes
    ----------
    position_m : (n, 3) metres east, north and up of the site; up falls with distance as the Earth curves away.
    geodetic : latitude, longitude, altitude.
    covariance_m2 : (n, 3, 3) of the position, from the uncertainties of the view direction and of the height.
    """

    position_m: FloatArray
    geodetic: GeodeticPosition
    covariance_m2: FloatArray

    @property
    def sigma_m(self) -> FloatArray:
        """(n,) 1-sigma per axis on the ground, m."""
        return np.asarray(np.sqrt(0.5 * (self.covariance_m2[:, 0, 0] + self.covariance_m2[:, 1, 1])))


def clouds(
    directions: FloatArray, *, height_m: ArrayLike, covariance: FloatArray, site: Site, height_sigma_m: ArrayLike = 0.0
) -> Located:
    """Return where view directions pass through a cloud base.

    Parameters
    ----------
    directions : (n, 3) unit vectors, east-north-up.
    height_m : (n) or one: of the cloud base above the site's altitude, the same along the curved Earth.
    covariance : (n, 3, 3) of the unit vectors.
    site : where the camera stands.
    height_sigma_m : (n) or one: 1-sigma of the height, m, independent of the direction's error.

    Returns
    -------
    NaN for a direction at or below the horizon, and for a height that is not positive.
    """
    height = np.broadcast_to(np.asarray(height_m, dtype=np.float64), directions.shape[:1])
    with np.errstate(invalid="ignore"):
        valid = (directions[:, 2] > _LEVEL) & (height > 0.0)
    direction = np.where(valid[:, None], directions, np.nan)
    sigma = np.broadcast_to(np.asarray(height_sigma_m, dtype=np.float64), height.shape)
    found = _intersect_surface(np.zeros_like(direction), direction, site.altitude + height, covariance, site)
    # a higher base is met further along the ray, which rises by the cosine of its angle to the vertical there
    shift = direction * (sigma / np.sum(direction * found.geodetic.up, axis=-1))[:, None]
    return replace(found, covariance_m2=found.covariance_m2 + shift[:, :, None] * shift[:, None, :])


def shadows(cloud: Located, sun: FloatArray, site: Site) -> Located:
    """Return where the shadows of clouds fall, on the surface at the site's altitude.

    Parameters
    ----------
    cloud : the clouds.
    sun : (3,) or (n, 3) the sun's apparent direction, east-north-up; one for all or one for each.
    site : where the camera stands.

    Returns
    -------
    NaN where the sun is at or below the horizon, or the sunlight past the cloud misses the ground.
    """
    towards = np.broadcast_to(sun, cloud.position_m.shape)
    ray = np.where(towards[:, 2:] > _LEVEL, -towards, np.nan)
    target = np.full(len(cloud.position_m), site.altitude)
    length, geodetic = _solve_ray_length(cloud.position_m, ray, target, site)
    moved = _slide_along_surface(ray, geodetic.up)
    return Located(
        position_m=cloud.position_m + length[:, None] * ray,
        geodetic=geodetic,
        covariance_m2=moved @ cloud.covariance_m2 @ np.swapaxes(moved, -1, -2),
    )


def _intersect_surface(
    start: FloatArray, ray: FloatArray, altitude: FloatArray, covariance: FloatArray, site: Site
) -> Located:
    length, geodetic = _solve_ray_length(start, ray, altitude, site)
    moved = length[:, None, None] * _slide_along_surface(ray, geodetic.up)
    return Located(
        position_m=start + length[:, None] * ray,
        geodetic=geodetic,
        covariance_m2=moved @ covariance @ np.swapaxes(moved, -1, -2),
    )


def _solve_ray_length(
    start: FloatArray, ray: FloatArray, altitude: FloatArray, site: Site
) -> tuple[FloatArray, GeodeticPosition]:
    """Return the lengths of rays to the surface of an altitude, and the end points: sphere first, then Newton."""
    begin = geodetic_position(start, site)
    rise = np.sum(ray * begin.up, axis=-1)
    inner, outer = SEMI_MAJOR_M + begin.altitude, SEMI_MAJOR_M + altitude
    with np.errstate(invalid="ignore"):
        root = np.sqrt((inner * rise) ** 2 + (outer - inner) * (outer + inner))
    length = np.where(rise > 0.0, 1.0, -1.0) * root - inner * rise
    geodetic = begin
    for _ in range(_ROUNDS):
        geodetic = geodetic_position(start + length[:, None] * ray, site)
        length = length - (geodetic.altitude - altitude) / np.sum(ray * geodetic.up, axis=-1)
    return length, geodetic_position(start + length[:, None] * ray, site)


def _slide_along_surface(ray: FloatArray, up: FloatArray) -> FloatArray:
    """Return (n, 3, 3): displacement along the surface of a ray's end for a shift of the ray."""
    slope = np.sum(ray * up, axis=-1)[:, None, None]
    return np.asarray(np.eye(3) - ray[:, :, None] * up[:, None, :] / slope)
