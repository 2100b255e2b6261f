"""How much air the sun's light comes through."""

from __future__ import annotations

import math

import numpy as np
from numpy.typing import ArrayLike

from sunarc.array_types import FloatArray

CLEAR_OPTICAL_DEPTH = 0.2
"""Vertical optical depth of a clear sky in the visible: Rayleigh scattering 0.1 at 550 nm and as much of aerosol."""


def clear_transmission(apparent_zenith: float) -> float:
    """Return the share of the sun's light that a clear sky lets through, the sun at an apparent zenith (degrees)."""
    return math.exp(-CLEAR_OPTICAL_DEPTH * float(relative_air_mass(apparent_zenith)))


def relative_air_mass(apparent_zenith: ArrayLike) -> FloatArray:
    """Return the air mass relative to the zenith's, (...); 38 at the horizon and below it.

    Parameters
    ----------
    apparent_zenith : (...) degrees.

    References
    ----------
    F. Kasten and A. T. Young, "Revised optical air mass tables and approximation formula", Applied Optics 28 (1989).
    """
    elevation = np.clip(90.0 - np.asarray(apparent_zenith, dtype=np.float64), 0.0, 90.0)
    return np.asarray(1.0 / (np.sin(np.radians(elevation)) + 0.50572 * (elevation + 6.07995) ** -1.6364))
