"""The sun's position: NREL's solar position algorithm as pvlib computes it.

Reference: I. Reda and A. Andreas, "Solar position algorithm for solar radiation applications", Solar Energy 76 (2004).
"""

from __future__ import annotations

import math
from typing import NamedTuple

import numpy as np
from numpy.typing import ArrayLike

from sunarc.array_types import FloatArray
from sunarc.sky.directions import direction_from_angles
from sunarc.sky.refraction import REFRACTION_AT_HORIZON_DEG, load_spa
from sunarc.sky.site import Site

# The sun's geocentric place at many times, from a few of them: it moves so slowly that a cubic between hours is exact.
#
# The series of the solar position algorithm (Reda and Andreas, 2004) have 200 terms a time; a day of sightings needs
# them
# at a dozen times only. Between places three hours apart, which the sun passes in 0.0022 rad, a cubic through four of
# them is off by 3/128 · 0.0022⁴ = 5e-13 rad; the tests compare with the series themselves.

_STEP_S = 10_800.0
"""Seconds between the places that the cubics go through."""
_WORTH_WHILE = 4
"""Times for each such place from which on it is worth while."""


class Geocentric(NamedTuple):
    """Of the sun, each (n,): sidereal time, right ascension, declination, degrees; distance, astronomical units."""

    sidereal: FloatArray
    right_ascension: FloatArray
    declination: FloatArray
    distance: FloatArray


def geocentric(unix_s: FloatArray, delta_t_s: float) -> Geocentric:
    """Return the sun's geocentric place.

    Parameters
    ----------
    unix_s : (n,) seconds since 1970-01-01 UTC.
    delta_t_s : terrestrial time minus UT, s.
    """
    slot = np.floor(unix_s / _STEP_S)
    slots = np.unique(slot)
    nodes = np.unique(np.add.outer(slots, np.arange(-1.0, 3.0)))
    if unix_s.size < _WORTH_WHILE * nodes.size:
        return by_series(unix_s, delta_t_s)
    table = _slow_columns(nodes * _STEP_S, delta_t_s)
    first = np.searchsorted(nodes, slot - 1.0)
    columns = np.sum(_cubic(unix_s / _STEP_S - slot)[:, :, None] * table[first[:, None] + np.arange(4)], axis=1)
    x, y, z, distance, nutation = columns.T
    return Geocentric(
        sidereal=(_mean_sidereal(unix_s) + nutation) % 360.0,
        right_ascension=np.degrees(np.arctan2(y, x)) % 360.0,
        declination=np.degrees(np.arctan2(z, np.hypot(x, y))),
        distance=distance,
    )


def _cubic(s: FloatArray) -> FloatArray:
    """Return (n, 4): Lagrange's weights of the values at -1, 0, 1, 2 for places s between 0 and 1."""
    before, after, beyond = s + 1.0, s - 1.0, s - 2.0
    weights = (
        -s * after * beyond / 6.0,
        before * after * beyond / 2.0,
        -before * s * beyond / 2.0,
        before * s * after / 6.0,
    )
    return np.stack(weights, axis=-1)


def _slow_columns(unix_s: FloatArray, delta_t_s: float) -> FloatArray:
    """Return (n, 5): unit vector to the sun, its distance, and the nutation in right ascension, degrees."""
    at = by_series(unix_s, delta_t_s)
    alpha, delta = np.radians(at.right_ascension), np.radians(at.declination)
    nutation = (at.sidereal - _mean_sidereal(unix_s) + 180.0) % 360.0 - 180.0
    across = np.cos(delta)
    return np.stack([across * np.cos(alpha), across * np.sin(alpha), np.sin(delta), at.distance, nutation], axis=-1)


def _mean_sidereal(unix_s: FloatArray) -> FloatArray:
    day = _SPA.julian_day(unix_s)
    return np.asarray(_SPA.mean_sidereal_time(day, _SPA.julian_century(day)))


def by_series(unix_s: FloatArray, delta_t_s: float) -> Geocentric:
    """Return the geocentric sun by the series of the solar position algorithm, term by term."""
    distance = _SPA.heliocentric_radius_vector
    day = _SPA.julian_ephemeris_day(_SPA.julian_day(unix_s), delta_t_s)
    millennium = _SPA.julian_ephemeris_millennium(_SPA.julian_ephemeris_century(day))
    # latitude, altitude and air have no part in what is geocentric
    sidereal, alpha, delta = _SPA.solar_position(unix_s, 0.0, 0.0, 0.0, 0.0, 0.0, delta_t_s, 0.0, sst=True)
    return Geocentric(sidereal, alpha, delta, distance(millennium))


SOLAR_RADIUS = math.radians(0.2666)
"""The sun's mean angular radius, radians (959.63 arcseconds at one astronomical unit)."""

_SPA = load_spa()
SECONDS_PER_JULIAN_YEAR = 31_557_600.0


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
        geocentric(flat, terrestrial_minus_universal_s(flat)),
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


def terrestrial_minus_universal_s(unix_s: FloatArray) -> float:
    """Terrestrial time minus UT in seconds; a decade's drift of it moves the sun by less than 0.0003 degrees."""
    year = 1970.0 + float(np.mean(unix_s)) / SECONDS_PER_JULIAN_YEAR
    whole_year = math.floor(year)
    return float(_SPA.calculate_deltat(whole_year, 1 + 11 * (year - whole_year)))
