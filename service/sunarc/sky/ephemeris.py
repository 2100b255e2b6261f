"""The sun's geocentric position by the series of NREL's solar position algorithm, good to 0.0003 degrees.

Reference: I. Reda and A. Andreas, "Solar position algorithm for solar radiation applications", Solar Energy 76 (2004),
its equations by number. Terrestrial time minus UT: F. Espenak and J. Meeus, "Five millennium canon of solar eclipses"
(2006).
"""

from __future__ import annotations

import math
from collections.abc import Sequence
from typing import NamedTuple

import numpy as np

from sunarc.common.array_types import FloatArray
from sunarc.common.utc import DAY_S

SECONDS_PER_JULIAN_YEAR = 31_557_600.0
_JULIAN_DAY_1970 = 2_440_587.5

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

    The series have 260 terms a time; a day of sightings needs them at a dozen times only. Between places three hours
    apart, which the sun passes in 0.0022 rad, a cubic through four of them is off by 3/128 · 0.0022⁴ = 5e-13 rad.

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
    table = _compute_slow_columns(nodes * _STEP_S, delta_t_s)
    first, place = np.searchsorted(nodes, slot - 1.0), unix_s / _STEP_S - slot
    # Lagrange's weights of the values at -1, 0, 1, 2 for places between 0 and 1
    before, after, beyond = place + 1.0, place - 1.0, place - 2.0
    weights = (
        -place * after * beyond / 6.0,
        before * after * beyond / 2.0,
        -before * place * beyond / 2.0,
        before * place * after / 6.0,
    )
    columns = np.zeros((5, unix_s.size))
    for k, weight in enumerate(weights):
        columns += weight * table[:, first + k]
    x, y, z, distance, nutation = columns
    return Geocentric(
        sidereal=(_mean_sidereal_time_deg(unix_s) + nutation) % 360.0,
        right_ascension=np.degrees(np.arctan2(y, x)) % 360.0,
        declination=np.degrees(np.arctan2(z, np.hypot(x, y))),
        distance=distance,
    )


def _compute_slow_columns(unix_s: FloatArray, delta_t_s: float) -> FloatArray:
    """Return (5, n): unit vector to the sun, its distance, and the nutation in right ascension, degrees."""
    at = by_series(unix_s, delta_t_s)
    alpha, delta = np.radians(at.right_ascension), np.radians(at.declination)
    nutation = (at.sidereal - _mean_sidereal_time_deg(unix_s) + 180.0) % 360.0 - 180.0
    across = np.cos(delta)
    return np.stack([across * np.cos(alpha), across * np.sin(alpha), np.sin(delta), at.distance, nutation])


def by_series(unix_s: FloatArray, delta_t_s: float) -> Geocentric:
    """Return the geocentric sun by the series, term by term (equations 4 to 31)."""
    day = unix_s / DAY_S + _JULIAN_DAY_1970
    century = (day + delta_t_s / DAY_S - 2_451_545.0) / 36_525.0
    millennium = century / 10.0
    distance = _evaluate_series(_DISTANCE, millennium)
    longitude_nutation, obliquity_nutation = _compute_nutation(century)
    obliquity = np.radians(_evaluate_polynomial(_OBLIQUITY_ARCSEC, millennium / 10.0) / 3600.0 + obliquity_nutation)
    aberration = -20.4898 / (3600.0 * distance)
    heliocentric = np.degrees(_evaluate_series(_LONGITUDE, millennium)) % 360.0
    longitude = np.radians((heliocentric + 180.0) % 360.0 + longitude_nutation + aberration)
    latitude = np.radians(-np.degrees(_evaluate_series(_LATITUDE, millennium)))
    across = np.sin(longitude) * np.cos(obliquity) - np.tan(latitude) * np.sin(obliquity)
    up = np.sin(latitude) * np.cos(obliquity) + np.cos(latitude) * np.sin(obliquity) * np.sin(longitude)
    return Geocentric(
        sidereal=_mean_sidereal_time_deg(unix_s) + longitude_nutation * np.cos(obliquity),
        right_ascension=np.degrees(np.arctan2(across, np.cos(longitude))) % 360.0,
        declination=np.degrees(np.arcsin(up)),
        distance=distance,
    )


def _mean_sidereal_time_deg(unix_s: FloatArray) -> FloatArray:
    """Return the mean sidereal time at Greenwich in degrees (equation 28)."""
    day = unix_s / DAY_S + _JULIAN_DAY_1970
    century = (day - 2_451_545.0) / 36_525.0
    turned = 280.46061837 + 360.98564736629 * (day - 2_451_545.0)
    return np.asarray((turned + 0.000387933 * century**2 - century**3 / 38_710_000.0) % 360.0)


def _evaluate_series(series: tuple[FloatArray, ...], millennium: FloatArray) -> FloatArray:
    """Return Σ_k x^k Σ_i A cos(B + C x), x in millennia (equations 9 to 11); radians or astronomical units."""
    sums = []
    for terms in series:
        amplitude, phase, rate = terms.T[:, :, None]
        sums.append(np.sum(amplitude * np.cos(phase + rate * millennium), axis=0))
    return _evaluate_polynomial(sums, millennium) / 1e8


def _evaluate_polynomial(coefficients: Sequence[FloatArray | float], x: FloatArray) -> FloatArray:
    total = np.zeros_like(x)
    for k, coefficient in enumerate(coefficients):
        total = total + coefficient * x**k
    return total


def _compute_nutation(century: FloatArray) -> tuple[FloatArray, FloatArray]:
    """Return the nutation in longitude and in obliquity in degrees, of centuries of terrestrial time since 2000."""
    constant, rate, square, cube = _ARGUMENTS.T[:, :, None]
    arguments = constant + rate * century + square * century**2 + century**3 / cube
    angle = np.radians(np.sum(_NUTATION[:, :5, None] * arguments, axis=1))
    sine, sine_rate, cosine, cosine_rate = _NUTATION.T[5:, :, None]
    longitude = np.sum((sine + sine_rate * century) * np.sin(angle), axis=0)
    obliquity = np.sum((cosine + cosine_rate * century) * np.cos(angle), axis=0)
    return longitude / 36_000_000.0, obliquity / 36_000_000.0


def terrestrial_minus_universal_s(unix_s: FloatArray) -> float:
    """Return terrestrial time minus UT at the mean of times, s, by polynomials made in 2005; before 1961 that of 1961.

    By 2026 they are 6 s above what was observed since, which moves the sun by 0.00007 degrees.
    """
    year = max(1970.0 + float(np.mean(unix_s)) / SECONDS_PER_JULIAN_YEAR, 1961.0)
    whole = math.floor(year)
    y = whole + (1.0 + 11.0 * (year - whole) - 0.5) / 12.0  # its month, counted to the middle
    u = (y - 1820.0) / 100.0
    if whole < 1986:
        return 45.45 + 1.067 * (y - 1975.0) - (y - 1975.0) ** 2 / 260.0 - (y - 1975.0) ** 3 / 718.0
    t = y - 2000.0
    if whole < 2005:
        return 63.86 + t * (0.3345 + t * (-0.060374 + t * (0.0017275 + t * (0.000651814 + t * 0.00002373599))))
    if whole < 2050:
        return 62.92 + 0.32217 * t + 0.005589 * t**2
    return -20.0 + 32.0 * u**2 - 0.5628 * max(2150.0 - y, 0.0)


def _parse_terms(text: str, columns: int = 3) -> FloatArray:
    return np.array(text.split(), dtype=np.float64).reshape(-1, columns)


def _parse_series(*texts: str) -> tuple[FloatArray, ...]:
    return tuple(_parse_terms(text) for text in texts)


# The tables A4.2 and A4.3 of the reference: of each power of time A, B, C in turn; of the nutation the multiples of the
# five arguments, then a, b (sines, longitude) and c, d (cosines, obliquity).
_LONGITUDE = _parse_series(
    """
    175347046 0 0   3341656 4.6692568 6283.07585   34894 4.6261 12566.1517   3497 2.7441 5753.3849
    3418 2.8289 3.5231   3136 3.6277 77713.7715   2676 4.4181 7860.4194   2343 6.1352 3930.2097
    1324 0.7425 11506.7698   1273 2.0371 529.691   1199 1.1096 1577.3435   990 5.233 5884.927   902 2.045 26.298
    857 3.508 398.149   780 1.179 5223.694   753 2.533 5507.553   505 4.583 18849.228   492 4.205 775.523
    357 2.92 0.067   317 5.849 11790.629   284 1.899 796.298   271 0.315 10977.079   243 0.345 5486.778
    206 4.806 2544.314   205 1.869 5573.143   202 2.458 6069.777   156 0.833 213.299   132 3.411 2942.463
    126 1.083 20.775   115 0.645 0.98   103 0.636 4694.003   102 0.976 15720.839   102 4.267 7.114   99 6.21 2146.17
    98 0.68 155.42   86 5.98 161000.69   85 1.3 6275.96   85 3.67 71430.7   80 1.81 17260.15   79 3.04 12036.46
    75 1.76 5088.63   74 3.5 3154.69   74 4.68 801.82   70 0.83 9437.76   62 3.98 8827.39   61 1.82 7084.9
    57 2.78 6286.6   56 4.39 14143.5   56 3.47 6279.55   52 0.19 12139.55   52 1.33 1748.02   51 0.28 5856.48
    49 0.49 1194.45   41 5.37 8429.24   41 2.4 19651.05   39 6.17 10447.39   37 6.04 10213.29   37 2.57 1059.38
    36 1.71 2352.87   36 1.78 6812.77   33 0.59 17789.85   30 0.44 83996.85   30 2.74 1349.87   25 3.16 4690.48
    """,
    """
    628331966747 0 0   206059 2.678235 6283.07585   4303 2.6351 12566.1517   425 1.59 3.523   119 5.796 26.298
    109 2.966 1577.344   93 2.59 18849.23   72 1.14 529.69   68 1.87 398.15   67 4.41 5507.55   59 2.89 5223.69
    56 2.17 155.42   45 0.4 796.3   36 0.47 775.52   29 2.65 7.11   21 5.34 0.98   19 1.85 5486.78   19 4.97 213.3
    17 2.99 6275.96   16 0.03 2544.31   16 1.43 2146.17   15 1.21 10977.08   12 2.83 1748.02   12 3.26 5088.63
    12 5.27 1194.45   12 2.08 4694   11 0.77 553.57   10 1.3 6286.6   10 4.24 1349.87   9 2.7 242.73   9 5.64 951.72
    8 5.3 2352.87   6 2.65 9437.76   6 4.67 4690.48
    """,
    """
    52919 0 0   8720 1.0721 6283.0758   309 0.867 12566.152   27 0.05 3.52   16 5.19 26.3   16 3.68 155.42
    10 0.76 18849.23   9 2.06 77713.77   7 0.83 775.52   5 4.66 1577.34   4 1.03 7.11   4 3.44 5573.14
    3 5.14 796.3   3 6.05 5507.55   3 1.19 242.73   3 6.12 529.69   3 0.31 398.15   3 2.28 553.57   2 4.38 5223.69
    2 3.75 0.98
    """,
    """
    289 5.844 6283.076   35 0 0   17 5.49 12566.15   3 5.2 155.42   1 4.72 3.52   1 5.3 18849.23   1 5.97 242.73
    """,
    """
    114 3.142 0   8 4.13 6283.08   1 3.84 12566.15
    """,
    """
    1 3.14 0
    """,
)
_LATITUDE = _parse_series(
    """
    280 3.199 84334.662   102 5.422 5507.553   80 3.88 5223.69   44 3.7 2352.87   32 4 1577.34
    """,
    """
    9 3.9 5507.55   6 1.73 5223.69
    """,
)
_DISTANCE = _parse_series(
    """
    100013989 0 0   1670700 3.0984635 6283.07585   13956 3.05525 12566.1517   3084 5.1985 77713.7715
    1628 1.1739 5753.3849   1576 2.8469 7860.4194   925 5.453 11506.77   542 4.564 3930.21   472 3.661 5884.927
    346 0.964 5507.553   329 5.9 5223.694   307 0.299 5573.143   243 4.273 11790.629   212 5.847 1577.344
    186 5.022 10977.079   175 3.012 18849.228   110 5.055 5486.778   98 0.89 6069.78   86 5.69 15720.84
    86 1.27 161000.69   65 0.27 17260.15   63 0.92 529.69   57 2.01 83996.85   56 5.24 71430.7   49 3.25 2544.31
    47 2.58 775.52   45 5.54 9437.76   43 6.01 6275.96   39 5.36 4694   38 2.39 8827.39   37 0.83 19651.05
    37 4.9 12139.55   36 1.67 12036.46   35 1.84 2942.46   33 0.24 7084.9   32 0.18 5088.63   32 1.78 398.15
    28 1.21 6286.6   28 1.9 6279.55   26 4.59 10447.39
    """,
    """
    103019 1.10749 6283.07585   1721 1.0644 12566.1517   702 3.142 0   32 1.02 18849.23   31 2.84 5507.55
    25 1.32 5223.69   18 1.42 1577.34   10 5.91 10977.08   9 1.42 6275.96   9 0.27 5486.78
    """,
    """
    4359 5.7846 6283.0758   124 5.579 12566.152   12 3.14 0   9 3.63 77713.77   6 1.87 5573.14   3 5.47 18849.23
    """,
    """
    145 4.273 6283.076   7 3.92 12566.15
    """,
    """
    4 2.56 6283.08
    """,
)
_NUTATION = _parse_terms(
    """
    0 0 0 0 1 -171996 -174.2 92025 8.9   -2 0 0 2 2 -13187 -1.6 5736 -3.1   0 0 0 2 2 -2274 -0.2 977 -0.5
    0 0 0 0 2 2062 0.2 -895 0.5   0 1 0 0 0 1426 -3.4 54 -0.1   0 0 1 0 0 712 0.1 -7 0
    -2 1 0 2 2 -517 1.2 224 -0.6   0 0 0 2 1 -386 -0.4 200 0   0 0 1 2 2 -301 0 129 -0.1
    -2 -1 0 2 2 217 -0.5 -95 0.3   -2 0 1 0 0 -158 0 0 0   -2 0 0 2 1 129 0.1 -70 0   0 0 -1 2 2 123 0 -53 0
    2 0 0 0 0 63 0 0 0   0 0 1 0 1 63 0.1 -33 0   2 0 -1 2 2 -59 0 26 0   0 0 -1 0 1 -58 -0.1 32 0
    0 0 1 2 1 -51 0 27 0   -2 0 2 0 0 48 0 0 0   0 0 -2 2 1 46 0 -24 0   2 0 0 2 2 -38 0 16 0   0 0 2 2 2 -31 0 13 0
    0 0 2 0 0 29 0 0 0   -2 0 1 2 2 29 0 -12 0   0 0 0 2 0 26 0 0 0   -2 0 0 2 0 -22 0 0 0   0 0 -1 2 1 21 0 -10 0
    0 2 0 0 0 17 -0.1 0 0   2 0 -1 0 1 16 0 -8 0   -2 2 0 2 2 -16 0.1 7 0   0 1 0 0 1 -15 0 9 0
    -2 0 1 0 1 -13 0 7 0   0 -1 0 0 1 -12 0 6 0   0 0 2 -2 0 11 0 0 0   2 0 -1 2 1 -10 0 5 0   2 0 1 2 2 -8 0 3 0
    0 1 0 2 2 7 0 -3 0   -2 1 1 0 0 -7 0 0 0   0 -1 0 2 2 -7 0 3 0   2 0 0 2 1 -7 0 3 0   2 0 1 0 0 6 0 0 0
    -2 0 2 2 2 6 0 -3 0   -2 0 1 2 1 6 0 -3 0   2 0 -2 0 1 -6 0 3 0   2 0 0 0 1 -6 0 3 0   0 -1 1 0 0 5 0 0 0
    -2 -1 0 2 1 -5 0 3 0   -2 0 0 0 1 -5 0 3 0   0 0 2 2 1 -5 0 3 0   -2 0 2 0 1 4 0 0 0   -2 1 0 2 1 4 0 0 0
    0 0 1 -2 0 4 0 0 0   -1 0 1 0 0 -4 0 0 0   -2 1 0 0 0 -4 0 0 0   1 0 0 0 0 -4 0 0 0   0 0 1 2 0 3 0 0 0
    0 0 -2 2 2 -3 0 0 0   -1 -1 1 0 0 -3 0 0 0   0 1 1 0 0 -3 0 0 0   0 -1 1 2 2 -3 0 0 0   2 -1 -1 2 2 -3 0 0 0
    0 0 3 2 2 -3 0 0 0   2 -1 0 2 2 -3 0 0 0
    """,
    columns=9,
)
_ARGUMENTS = np.array(
    [
        [297.85036, 445267.111480, -0.0019142, 189474.0],
        [357.52772, 35999.050340, -0.0001603, -300000.0],
        [134.96298, 477198.867398, 0.0086972, 56250.0],
        [93.27191, 483202.017538, -0.0036825, 327270.0],
        [125.04452, -1934.136261, 0.0020708, 450000.0],
    ]
)
"""Moon's elongation, the sun's and the moon's anomaly, the moon's argument of latitude and its node, degrees: constant,
factors of T and T², divisor of T³ (equations 15 to 19)."""
_OBLIQUITY_ARCSEC = (84381.448, -4680.93, -1.55, 1999.25, -51.38, -249.67, -39.05, 7.12, 27.87, 5.79, 2.45)
"""Powers of ten thousand Julian years (equation 24)."""
