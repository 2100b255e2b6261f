"""Astronomical refraction: how large it is, how well it is known, and directions in other air.

References: G. Bennett, "The calculation of astronomical refraction in marine navigation", Journal of Navigation 35
(1982); pressure and temperature enter as in the solar position algorithm (I. Reda and A. Andreas 2004).
"""

from __future__ import annotations

import numpy as np
from numpy.typing import ArrayLike

from sunarc.common.array_types import FloatArray
from sunarc.sky.site import PA_PER_HPA, Site

ASSUMED_AIR_SD = 0.04
"""1-sigma of the refraction of a record, as a share of it, where the air is the site's annual mean: 10 K of temperature
(the season, the hours of sun, a mean that is not the site's) are 10 / 285 = 3.5 %, 1.5 % is the pressure's."""
MEASURED_AIR_SD = 0.01
"""The same where temperature or pressure were measured: 2 K (a sensor in the sun) are 0.7 %, the rest is the formula's
own error at moderate elevations."""
DAILY_AIR_SD = 0.015
"""1-sigma of the refraction of one day against the others of a record, as a share, where it was not measured: 4 K and
0.6 % of pressure."""

_LOWEST_REFRACTED_DEG = -(0.26667 + 0.5667)
"""True elevation of the sun's centre with its upper limb on the horizon, by the sun's algorithm; none below it."""
_ZERO_C_IN_K = 273.0
_REFERENCE_PA = 101_000.0
_REFERENCE_K = 283.0


def refraction_rad(directions: ArrayLike, site: Site) -> FloatArray:
    """Return the refraction at apparent directions, (...) radians; that of the horizon below it.

    Parameters
    ----------
    directions : (..., 3) apparent unit vectors, east-north-up.
    site : gives pressure and temperature.
    """
    up = np.asarray(directions, dtype=np.float64)[..., 2]
    elevation = np.degrees(np.arcsin(np.clip(up, 0.0, 1.0)))
    arcminutes = 1.0 / np.tan(np.radians(elevation + 7.31 / (elevation + 4.4)))
    density = site.pressure_pa / _REFERENCE_PA * _REFERENCE_K / (_ZERO_C_IN_K + site.temperature)
    return np.asarray(np.radians(np.maximum(arcminutes, 0.0) / 60.0) * density)


def apparent_elevation(elevation_deg: ArrayLike, site: Site) -> FloatArray:
    """Return the apparent elevations of true ones, (...) degrees, by the refraction of the sun's algorithm.

    Below -0.83 degrees it fades to 0, as there.
    """
    elevation = np.asarray(elevation_deg, dtype=np.float64)
    pressure_hpa = site.pressure_pa / PA_PER_HPA
    lifted = true_elevation_refraction_deg(elevation, pressure_hpa=pressure_hpa, temperature=site.temperature)
    return np.asarray(elevation + lifted)


def true_elevation_refraction_deg(
    elevation_deg: FloatArray, *, pressure_hpa: FloatArray | float, temperature: FloatArray | float
) -> FloatArray:
    """Return the refraction at true elevations, (...) degrees, by the sun's algorithm (Saemundsson's formula).

    Parameters
    ----------
    elevation_deg : (...) true elevations; below -0.83 degrees there is no refraction.
    pressure_hpa, temperature : (...) of the air, hPa and °C.
    """
    density = (pressure_hpa / 1010.0) * (283.0 / (273.0 + temperature))
    arcminutes = 1.02 / np.tan(np.radians(elevation_deg + 10.3 / (elevation_deg + 5.11)))
    return np.asarray(density * arcminutes / 60.0 * (elevation_deg >= _LOWEST_REFRACTED_DEG))


def upward(directions: ArrayLike) -> FloatArray:
    """Return the unit tangents towards the zenith at directions (..., 3); (..., 3), 0 at the zenith itself."""
    direction = np.asarray(directions, dtype=np.float64)
    tangent = np.array([0.0, 0.0, 1.0]) - direction[..., 2:] * direction
    length = np.linalg.norm(tangent, axis=-1, keepdims=True)
    return np.asarray(np.where(length > 0.0, tangent / np.where(length > 0.0, length, 1.0), 0.0))


def raised(directions: ArrayLike, angle_rad: ArrayLike) -> FloatArray:
    """Return directions (..., 3) turned towards the zenith by small angles (...), radians."""
    direction, angle = np.asarray(directions, dtype=np.float64), np.asarray(angle_rad, dtype=np.float64)[..., None]
    return np.asarray(np.cos(angle) * direction + np.sin(angle) * upward(direction))
