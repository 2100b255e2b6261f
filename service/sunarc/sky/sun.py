"""The sun's position: NREL's solar position algorithm as pvlib computes it.

Reference: I. Reda and A. Andreas, "Solar position algorithm for solar radiation applications", Solar Energy 76 (2004).
"""

from __future__ import annotations

import math
from typing import NamedTuple

import numpy as np
from numpy.typing import ArrayLike

from sunarc.array_types import FloatArray
from sunarc.sky.algorithm import load_spa
from sunarc.sky.directions import direction_from_angles
from sunarc.sky.ephemeris import Geocentric, geocentric
from sunarc.sky.refraction import REFRACTION_AT_HORIZON_DEG
from sunarc.sky.site import Site

SOLAR_RADIUS = math.radians(0.2666)
"""The sun's mean angular radius, radians (959.63 arcseconds at one astronomical unit)."""

_SPA = load_spa()
_SECONDS_PER_JULIAN_YEAR = 31_557_600.0


class SunAngles(NamedTuple):
    """Angles in degrees, each (...): true and apparent (refracted) zenith, azimuth clockwise from north."""

    zenith: FloatArray
    apparent_zenith: FloatArray
    azimuth: FloatArray


def sun_angles(
    unix_s: ArrayLike, site: Site, *, temperature: ArrayLike | None = None, pressure: ArrayLike | None = None
) -> SunAngles:
    """Return the position of the sun.

    Parameters
    ----------
    unix_s : (...) seconds since 1970-01-01 UTC.
    site : the place and its air.
    temperature, pressure : (...) of the air at each time, °C and Pa; None, or NaN where not measured: the site's.

    Returns
    -------
    Angles in degrees; below the horizon the refraction fades to 0, as in the algorithm.
    """
    times = np.asarray(unix_s, dtype=np.float64)
    flat = np.atleast_1d(times).ravel()
    if flat.size == 0:
        empty = np.zeros(times.shape)
        return SunAngles(empty, empty.copy(), empty.copy())
    zenith, apparent_zenith, azimuth = _topocentric(
        geocentric(flat, _delta_t_s(flat)),
        site,
        pressure_hpa=_measured_or(pressure, site.pressure_pa, flat) / 100.0,
        temperature=_measured_or(temperature, site.temperature, flat),
    )
    return SunAngles(*(np.reshape(angle, times.shape) for angle in (zenith, apparent_zenith, azimuth)))


def _topocentric(
    sun: Geocentric, site: Site, *, pressure_hpa: FloatArray | float, temperature: FloatArray | float
) -> SunAngles:
    """Return the angles of the sun at a site, step by step as `pvlib.spa.solar_position` does."""
    latitude = site.latitude
    hour = _SPA.local_hour_angle(sun.sidereal, site.longitude, sun.right_ascension)
    parallax, u = _SPA.equatorial_horizontal_parallax(sun.distance), _SPA.uterm(latitude)
    x, y = _SPA.xterm(u, latitude, site.altitude), _SPA.yterm(u, latitude, site.altitude)
    shift = _SPA.parallax_sun_right_ascension(x, parallax, hour, sun.declination)
    declination = _SPA.topocentric_sun_declination(sun.declination, x, y, parallax, shift, hour)
    hour = _SPA.topocentric_local_hour_angle(hour, shift)
    true = _SPA.topocentric_elevation_angle_without_atmosphere(latitude, declination, hour)
    lifted = _SPA.atmospheric_refraction_correction(pressure_hpa, temperature, true, REFRACTION_AT_HORIZON_DEG)
    azimuth = _SPA.topocentric_azimuth_angle(_SPA.topocentric_astronomers_azimuth(hour, declination, latitude))
    return SunAngles(90.0 - true, 90.0 - (true + lifted), azimuth)


def sun_directions(
    unix_s: ArrayLike, site: Site, *, temperature: ArrayLike | None = None, pressure: ArrayLike | None = None
) -> FloatArray:
    """Return the apparent directions of the sun's centre.

    Parameters
    ----------
    unix_s : (...) seconds since 1970-01-01 UTC.
    site : the place and its air.
    temperature, pressure : (...) of the air at each time, °C and Pa; None, or NaN where not measured: the site's.

    Returns
    -------
    (..., 3) unit vectors, east-north-up: the directions that the light arrives from.
    """
    angles = sun_angles(unix_s, site, temperature=temperature, pressure=pressure)
    return direction_from_angles(zenith_deg=angles.apparent_zenith, azimuth_deg=angles.azimuth)


def hour_angle(unix_s: ArrayLike, site: Site) -> FloatArray:
    """Return the sun's local hour angle in radians, -pi to pi, 0 at upper transit, east negative.

    Computed from the true horizontal angles, so that it is exact for the same algorithm.
    """
    angles = sun_angles(unix_s, site)
    direction = direction_from_angles(zenith_deg=angles.zenith, azimuth_deg=angles.azimuth)
    east, north, up = np.moveaxis(direction, -1, 0)
    latitude = math.radians(site.latitude)
    return np.asarray(np.arctan2(-east, up * math.cos(latitude) - north * math.sin(latitude)))


def _measured_or(measured: ArrayLike | None, assumed: float, times: FloatArray) -> FloatArray | float:
    """Return what was measured at times (n,), and what is assumed where nothing was."""
    if measured is None:
        return assumed
    values = np.broadcast_to(np.asarray(measured, dtype=np.float64), times.shape)
    return np.where(np.isfinite(values), values, assumed)


def _delta_t_s(unix_s: FloatArray) -> float:
    """Terrestrial time minus UT in seconds; a decade's drift of it moves the sun by less than 0.0003 degrees."""
    year = 1970.0 + float(np.mean(unix_s)) / _SECONDS_PER_JULIAN_YEAR
    whole_year = math.floor(year)
    return float(_SPA.calculate_deltat(whole_year, 1 + 11 * (year - whole_year)))
