"""The sun's geocentric place at many times, from a few of them: it moves so slowly that a cubic between hours is exact.

The series of the solar position algorithm (Reda and Andreas, 2004) have 200 terms a time; a day of sightings needs them
at a dozen times only. Between places three hours apart, which the sun passes in 0.0022 rad, a cubic through four of
them is off by 3/128 · 0.0022⁴ = 5e-13 rad; the tests compare with the series themselves.
"""

from __future__ import annotations

from typing import NamedTuple

import numpy as np

from sunarc.array_types import FloatArray
from sunarc.sky.algorithm import load_spa

_SPA = load_spa()
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
        return _by_series(unix_s, delta_t_s)
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
    at = _by_series(unix_s, delta_t_s)
    alpha, delta = np.radians(at.right_ascension), np.radians(at.declination)
    nutation = (at.sidereal - _mean_sidereal(unix_s) + 180.0) % 360.0 - 180.0
    across = np.cos(delta)
    return np.stack([across * np.cos(alpha), across * np.sin(alpha), np.sin(delta), at.distance, nutation], axis=-1)


def _mean_sidereal(unix_s: FloatArray) -> FloatArray:
    day = _SPA.julian_day(unix_s)
    return np.asarray(_SPA.mean_sidereal_time(day, _SPA.julian_century(day)))


def _by_series(unix_s: FloatArray, delta_t_s: float) -> Geocentric:
    distance = _SPA.heliocentric_radius_vector
    day = _SPA.julian_ephemeris_day(_SPA.julian_day(unix_s), delta_t_s)
    millennium = _SPA.julian_ephemeris_millennium(_SPA.julian_ephemeris_century(day))
    # latitude, altitude and air have no part in what is geocentric
    sidereal, alpha, delta = _SPA.solar_position(unix_s, 0.0, 0.0, 0.0, 0.0, 0.0, delta_t_s, 0.0, sst=True)
    return Geocentric(sidereal, alpha, delta, distance(millennium))
