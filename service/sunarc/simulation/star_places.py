"""Apparent directions of stars by textbook series, not by `sunarc.sky.night`, which the simulator puts to the test.

References: N. Capitaine, P. Wallace, J. Chapront, "Expressions for IAU 2000 precession quantities", Astronomy and
Astrophysics 412 (2003), as adopted by the IAU in 2006 (precession); J. Meeus, "Astronomical Algorithms" (1998),
chapters 12 (sidereal time), 22 (nutation, four terms: 0.5 arcseconds) and 23 (aberration).
"""

from __future__ import annotations

import math
from typing import NamedTuple

import numpy as np

from sunarc.array_types import FloatArray
from sunarc.sky.directions import direction_from_angles
from sunarc.sky.refraction import apparent_elevation
from sunarc.sky.site import Site

_J2000_UNIX_S = 946_728_000.0
_TT_MINUS_UTC_S = 69.184
_DAY_S, _CENTURY_DAYS = 86_400.0, 36_525.0
_ABERRATION_RAD = math.radians(20.49552 / 3600.0)
_PERIHELION_RAD = math.radians(102.937)


class _Terms(NamedTuple):
    """Obliquity, nutation in longitude and in obliquity, true longitude of the sun, rad; the orbit's eccentricity."""

    obliquity: float
    in_longitude: float
    in_obliquity: float
    sun: float
    eccentricity: float


def star_directions_by_series(places_icrs: FloatArray, unix_s: float, site: Site) -> FloatArray:
    """Return the apparent directions (n, 3), east-north-up, of ICRS unit vectors (n, 3) at one moment.

    With annual aberration, precession, nutation and the refraction of the sun's algorithm; within an arcsecond.
    Proper motion is the caller's.
    """
    days = (unix_s - _J2000_UNIX_S) / _DAY_S
    centuries = (days + _TT_MINUS_UTC_S / _DAY_S) / _CENTURY_DAYS
    terms = _terms(centuries)
    aberrated = places_icrs + _earth_velocity(terms)
    aberrated /= np.linalg.norm(aberrated, axis=-1, keepdims=True)
    of_date = aberrated @ (_nutation(terms) @ _precession(centuries)).T
    sidereal = math.radians(280.46061837 + 360.98564736629 * days + 0.000387933 * centuries**2)
    sidereal += terms.in_longitude * math.cos(terms.obliquity) + math.radians(site.longitude)
    towards_east, latitude = _turn(2, sidereal) @ of_date.T, math.radians(site.latitude)
    south_of_zenith = _turn(1, math.pi / 2.0 - latitude) @ towards_east
    north, east, up = -south_of_zenith[0], south_of_zenith[1], south_of_zenith[2]
    elevation = apparent_elevation(np.degrees(np.arcsin(np.clip(up, -1.0, 1.0))), site)
    azimuth = np.degrees(np.arctan2(east, north))
    return direction_from_angles(zenith_deg=90.0 - elevation, azimuth_deg=azimuth)


def _terms(centuries: float) -> _Terms:
    t = centuries
    node, sun, moon = (
        math.radians(first + rate * t)
        for first, rate in ((125.04452, -1934.136261), (280.46646, 36000.76983), (218.3165, 481267.8813))
    )
    anomaly = math.radians(357.52911 + 35999.05029 * t)
    centre = 1.914602 * math.sin(anomaly) + 0.019993 * math.sin(2.0 * anomaly) + 0.000289 * math.sin(3.0 * anomaly)
    longitude = (
        -17.20 * math.sin(node) - 1.32 * math.sin(2 * sun) - 0.23 * math.sin(2 * moon) + 0.21 * math.sin(2 * node)
    )
    tilt = 9.20 * math.cos(node) + 0.57 * math.cos(2 * sun) + 0.10 * math.cos(2 * moon) - 0.09 * math.cos(2 * node)
    # the velocity is wanted in the frame of J2000, the sun's longitude is of the date
    precessed = math.radians(1.396971 * t)
    return _Terms(
        obliquity=math.radians((84381.406 - 46.836769 * t) / 3600.0),
        in_longitude=math.radians(longitude / 3600.0),
        in_obliquity=math.radians(tilt / 3600.0),
        sun=sun + math.radians(centre) - precessed,
        eccentricity=0.016708634 - 0.000042037 * t,
    )


def _earth_velocity(terms: _Terms) -> FloatArray:
    """Return the Earth's velocity over light's, (3,), in the frame of J2000."""
    along = math.cos(terms.sun) - terms.eccentricity * math.cos(_PERIHELION_RAD)
    across = math.sin(terms.sun) - terms.eccentricity * math.sin(_PERIHELION_RAD)
    obliquity = terms.obliquity
    return _ABERRATION_RAD * np.array([across, -along * math.cos(obliquity), -along * math.sin(obliquity)])


def _precession(t: float) -> FloatArray:
    zeta = 2.650545 + (2306.083227 + (0.2988499 + 0.01801828 * t) * t) * t
    z = -2.650545 + (2306.077181 + (1.0927348 + 0.01826837 * t) * t) * t
    theta = (2004.191903 - (0.4294934 + 0.04182264 * t) * t) * t
    first, second, third = (math.radians(angle / 3600.0) for angle in (-zeta, theta, -z))
    return _turn(2, third) @ _turn(1, second) @ _turn(2, first)


def _nutation(terms: _Terms) -> FloatArray:
    true = terms.obliquity + terms.in_obliquity
    return _turn(0, -true) @ _turn(2, -terms.in_longitude) @ _turn(0, terms.obliquity)


def _turn(axis: int, angle: float) -> FloatArray:
    """Return the matrix (3, 3) that turns the frame about an axis by an angle, rad."""
    c, s = math.cos(angle), math.sin(angle)
    first, second = ((1, 2), (2, 0), (0, 1))[axis]
    matrix = np.eye(3)
    matrix[first, first] = matrix[second, second] = c
    matrix[first, second], matrix[second, first] = s, -s
    return matrix
