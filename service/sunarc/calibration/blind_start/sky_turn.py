"""The sky's turning about the celestial pole."""

from __future__ import annotations

import math

import numpy as np

from sunarc.array_types import FloatArray
from sunarc.sky.site import Site

SIDEREAL_RATE = 2.0 * math.pi / 86_164.0905
"""Radians a second."""
MAX_ANGLE = math.radians(95.0)
"""Off the axis, to which stars are looked for."""


def pole_enu(site: Site) -> FloatArray:
    """Return the direction of the north celestial pole, east-north-up; below the horizon in the south."""
    latitude = math.radians(site.latitude)
    return np.array([0.0, math.cos(latitude), math.sin(latitude)])


def turned(rays: FloatArray, pole: FloatArray, angle: float) -> FloatArray:
    """Return rays (n, 3) turned about poles (..., 3) by an angle in radians, (..., n, 3): Rodrigues' formula."""
    axis = pole[..., None, :]
    along = np.sum(rays * axis, axis=-1, keepdims=True)
    across = np.cross(axis, rays)
    return np.asarray(rays * math.cos(angle) + across * math.sin(angle) + axis * along * (1.0 - math.cos(angle)))
