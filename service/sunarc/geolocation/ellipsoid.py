"""Places on the WGS 84 ellipsoid, from east-north-up about a site.

Altitudes are taken as heights above the ellipsoid: what the geoid adds (up to 100 m) is the same at the camera, under
the cloud and at the shadow, and cancels.
"""

from __future__ import annotations

import math
from typing import NamedTuple

import numpy as np

from sunarc.array_types import FloatArray
from sunarc.sky.site import Site

SEMI_MAJOR_M = 6_378_137.0
FLATTENING = 1.0 / 298.257223563
ECCENTRICITY2 = FLATTENING * (2.0 - FLATTENING)
_ROUNDS = 4


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
    axes, origin = _frame(site)
    x, y, z = np.moveaxis(position_m @ axes + origin, -1, 0)
    across = np.hypot(x, y)
    latitude = np.arctan2(z, across * (1.0 - ECCENTRICITY2))
    for _ in range(_ROUNDS):  # each one is a few hundred times closer
        radius = SEMI_MAJOR_M / np.sqrt(1.0 - ECCENTRICITY2 * np.sin(latitude) ** 2)
        latitude = np.arctan2(z + ECCENTRICITY2 * radius * np.sin(latitude), across)
    radius = SEMI_MAJOR_M / np.sqrt(1.0 - ECCENTRICITY2 * np.sin(latitude) ** 2)
    sine, cosine, longitude = np.sin(latitude), np.cos(latitude), np.arctan2(y, x)
    altitude = across * cosine + (z + ECCENTRICITY2 * radius * sine) * sine - radius
    up = np.stack([cosine * np.cos(longitude), cosine * np.sin(longitude), sine], axis=-1) @ axes.T
    return GeodeticPosition(np.degrees(latitude), np.degrees(longitude), altitude, up)


def in_frame_of(site: Site, other: Site) -> tuple[FloatArray, FloatArray]:
    """Return where another site is, (3,) metres east, north and up of a site, and (3, 3): its axes to the site's."""
    axes, origin = _frame(site)
    other_axes, other_origin = _frame(other)
    return axes @ (other_origin - origin), axes @ other_axes.T


def _frame(site: Site) -> tuple[FloatArray, FloatArray]:
    """Return the (3, 3) rows east, north, up and the site itself, in the Earth's own frame."""
    latitude, longitude = math.radians(site.latitude), math.radians(site.longitude)
    sine, cosine = math.sin(latitude), math.cos(latitude)
    up = np.array([cosine * math.cos(longitude), cosine * math.sin(longitude), sine])
    east = np.array([-math.sin(longitude), math.cos(longitude), 0.0])
    radius = SEMI_MAJOR_M / math.sqrt(1.0 - ECCENTRICITY2 * sine**2)
    origin = (radius + site.altitude) * up - np.array([0.0, 0.0, ECCENTRICITY2 * radius * sine])
    return np.stack([east, np.cross(up, east), up]), origin
