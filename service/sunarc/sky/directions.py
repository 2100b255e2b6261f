"""Directions are unit vectors, east-north-up; zenith and azimuth are their names at the edges."""

from __future__ import annotations

import numpy as np
from numpy.typing import ArrayLike

from sunarc.common.array_types import FloatArray


def direction_from_angles(*, zenith_deg: ArrayLike, azimuth_deg: ArrayLike) -> FloatArray:
    """Return unit vectors for zenith angles and azimuths.

    Parameters
    ----------
    zenith_deg : (...) degrees from the vertical.
    azimuth_deg : (...) degrees clockwise from north.

    Returns
    -------
    (..., 3) unit vectors, east-north-up; NaN where an angle is NaN.
    """
    zenith, azimuth = np.broadcast_arrays(np.radians(zenith_deg), np.radians(azimuth_deg))
    horizontal = np.sin(zenith)
    return np.stack([horizontal * np.sin(azimuth), horizontal * np.cos(azimuth), np.cos(zenith)], axis=-1)


def angles_from_direction(direction_enu: ArrayLike) -> tuple[FloatArray, FloatArray]:
    """Return zenith angle and azimuth of directions.

    Parameters
    ----------
    direction_enu : (..., 3) vectors of any length, east-north-up.

    Returns
    -------
    zenith_deg : (...) 0 to 180.
    azimuth_deg : (...) clockwise from north, 0 <= azimuth < 360; 0 at the zenith itself.
    """
    east, north, up = np.moveaxis(np.asarray(direction_enu, dtype=np.float64), -1, 0)
    zenith = np.degrees(np.arctan2(np.hypot(east, north), up))
    azimuth = np.degrees(np.arctan2(east, north)) % 360.0
    return zenith, np.where(azimuth >= 360.0, 0.0, azimuth)  # -1e-17 % 360 rounds up to 360


def unit_vectors(vectors: ArrayLike) -> FloatArray:
    """Return the unit vectors (..., 3) of vectors of any length, in their precision; NaN of a vector of length 0."""
    given = np.asarray(vectors)
    with np.errstate(all="ignore"):
        scaled = given / np.max(np.abs(given), axis=-1, keepdims=True)  # squares of tiny or huge ones would fail
        return np.asarray(scaled / np.linalg.norm(scaled, axis=-1, keepdims=True))


def wrapped_deg(angle_deg: ArrayLike) -> FloatArray:
    """Return angles, or their differences, (...) in degrees as -180 <= angle < 180."""
    return np.asarray((np.asarray(angle_deg, dtype=np.float64) + 180.0) % 360.0 - 180.0)


def angular_distance(a: ArrayLike, b: ArrayLike) -> FloatArray:
    """Return the angle between vectors in radians, accurate at all sizes (Kahan's formula).

    Parameters
    ----------
    a, b : (..., 3) unit vectors, broadcast against each other.
    """
    first, second = np.asarray(a, dtype=np.float64), np.asarray(b, dtype=np.float64)
    difference = np.linalg.norm(first - second, axis=-1)
    total = np.linalg.norm(first + second, axis=-1)
    return np.asarray(2.0 * np.arctan2(difference, total))
