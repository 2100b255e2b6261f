"""The sun's position as seen from a site: NREL's solar position algorithm, digit for digit as pvlib computes it.

Reference: I. Reda and A. Andreas, "Solar position algorithm for solar radiation applications", Solar Energy 76 (2004).
"""

from __future__ import annotations

import math
from typing import NamedTuple

import numpy as np
from numpy.typing import ArrayLike

from sunarc.common.array_types import BoolArray, FloatArray
from sunarc.common.utc import DAY_S
from sunarc.sky.directions import direction_from_angles
from sunarc.sky.ephemeris import geocentric, terrestrial_minus_universal_s
from sunarc.sky.refraction import true_elevation_refraction_deg
from sunarc.sky.site import Site

SOLAR_RADIUS = math.radians(0.2666)
"""The sun's mean angular radius, radians (959.63 arcseconds at one astronomical unit)."""

DARK_ZENITH_DEG = 102.0
"""The sun's apparent zenith angle from which on it is night, degrees: the end of nautical twilight."""

_STEP_S = 300.0
"""Seconds in which the sun does not both pass a zenith angle and come back, but where it only grazes it."""
_FIRST_LOOK_S = 3600.0
"""Time ahead that is searched first; each further stretch is twice as long. A multiple of the step."""
_LONGEST_NIGHT_DAYS = 200.0
"""More than the night of a pole."""
_POLAR_RADIUS = 0.99664719
"""Of the earth, in its equatorial ones."""
_EARTH_RADIUS_M = 6_378_140.0


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
    pressure_pa, celsius = (
        assumed
        if measured is None
        else np.where(np.isfinite(of := np.asarray(measured, dtype=np.float64)), of, assumed)
        for measured, assumed in ((pressure, site.pressure_pa), (temperature, site.temperature))
    )
    sun = geocentric(flat, terrestrial_minus_universal_s(flat))
    # seen from the site (equations 32 to 47)
    phi = math.radians(site.latitude)
    u = math.atan(_POLAR_RADIUS * math.tan(phi))
    across = math.cos(u) + site.altitude / _EARTH_RADIUS_M * math.cos(phi)
    up = _POLAR_RADIUS * math.sin(u) + site.altitude / _EARTH_RADIUS_M * math.sin(phi)
    parallax = np.sin(np.radians(8.794 / (3600.0 * sun.distance)))
    geocentric_hour = (sun.sidereal + site.longitude - sun.right_ascension) % 360.0
    hour, declination = np.radians(geocentric_hour), np.radians(sun.declination)
    towards = np.cos(declination) - across * parallax * np.cos(hour)
    shift = np.degrees(np.arctan2(-across * parallax * np.sin(hour), towards))
    declination = np.arctan2((np.sin(declination) - up * parallax) * np.cos(np.radians(shift)), towards)
    hour = np.radians(geocentric_hour - shift)
    sine = math.sin(phi) * np.sin(declination) + math.cos(phi) * np.cos(declination) * np.cos(hour)
    true = np.degrees(np.arcsin(sine))
    north = np.cos(hour) * math.sin(phi) - np.tan(declination) * math.cos(phi)
    azimuth = (np.degrees(np.arctan2(np.sin(hour), north)) % 360.0 + 180.0) % 360.0
    lifted = true_elevation_refraction_deg(true, pressure_hpa=pressure_pa / 100.0, temperature=celsius)
    return SunAngles(*(np.reshape(angle, times.shape) for angle in (90.0 - true, 90.0 - (true + lifted), azimuth)))


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


def find_next_sun_unix_s(unix_s: float, site: Site, *, zenith_deg: float, rising: bool) -> float:
    """Return the first moment from a time on at which the sun stands above a zenith angle, or below it.

    Parameters
    ----------
    unix_s : seconds since 1970-01-01 UTC.
    site : the place and its air.
    zenith_deg : apparent zenith angle, degrees.
    rising : the sun is to stand above it (a smaller zenith angle); False: below it, or at it.

    Returns
    -------
    Seconds since 1970-01-01 UTC, to a second; NaN where that does not happen within 200 days.
    """

    def holds(times: FloatArray) -> BoolArray:
        return np.asarray((sun_angles(times, site).apparent_zenith < zenith_deg) == rising)

    begin_s, length_s, end_s = unix_s, _FIRST_LOOK_S, unix_s + _LONGEST_NIGHT_DAYS * DAY_S
    while begin_s < end_s:
        times = np.arange(begin_s, min(begin_s + length_s, end_s), _STEP_S)
        found = np.flatnonzero(holds(times))
        if found.size:
            break
        begin_s, length_s = begin_s + length_s, 2.0 * length_s
    else:
        return math.nan
    first_s = float(times[found[0]])
    if first_s == unix_s:
        return unix_s
    seconds = first_s - _STEP_S + np.arange(_STEP_S + 1.0)
    return float(seconds[np.argmax(holds(seconds))])


def hour_angle(unix_s: ArrayLike, site: Site) -> FloatArray:
    """Return the sun's local hour angle in radians, -pi to pi, 0 at upper transit, east negative.

    Computed from the true horizontal angles, so that it is exact for the same algorithm.
    """
    angles = sun_angles(unix_s, site)
    direction = direction_from_angles(zenith_deg=angles.zenith, azimuth_deg=angles.azimuth)
    east, north, up = np.moveaxis(direction, -1, 0)
    latitude = math.radians(site.latitude)
    return np.asarray(np.arctan2(-east, up * math.cos(latitude) - north * math.sin(latitude)))
