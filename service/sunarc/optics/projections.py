"""The five ideal lens projections (paper's Eq. 8): normalised radius g0 as a function of the angle off the axis.

Reference: K. Miyamoto, "Fish eye lens", JOSA 54 (1964).
"""

from __future__ import annotations

import math
from typing import Literal, get_args

import numpy as np
from numpy.typing import ArrayLike

from sunarc.array_types import FloatArray

Projection = Literal["perspective", "equidistant", "equisolid", "stereographic", "orthographic"]
PROJECTIONS: tuple[Projection, ...] = get_args(Projection)

_ANGLE_LIMIT: dict[Projection, float] = {
    "perspective": math.pi / 2,
    "equidistant": math.pi,
    "equisolid": math.pi,
    "stereographic": math.pi,
    "orthographic": math.pi / 2,
}


def angle_limit(projection: Projection) -> float:
    """Return the angle in radians up to which the ideal projection rises."""
    return _ANGLE_LIMIT[projection]


def ideal_radius(projection: Projection, theta: ArrayLike) -> FloatArray:
    """Return g0(theta), in focal lengths; meaningful up to `angle_limit`."""
    angle = np.asarray(theta, dtype=np.float64)
    match projection:
        case "perspective":
            return np.tan(angle)
        case "equidistant":
            return angle.copy()
        case "equisolid":
            return 2.0 * np.sin(angle / 2.0)
        case "stereographic":
            return 2.0 * np.tan(angle / 2.0)
        case "orthographic":
            return np.sin(angle)


def ideal_slope(projection: Projection, theta: ArrayLike) -> FloatArray:
    """Return dg0/dtheta, in focal lengths per radian."""
    angle = np.asarray(theta, dtype=np.float64)
    match projection:
        case "perspective":
            return 1.0 / np.cos(angle) ** 2
        case "equidistant":
            return np.ones_like(angle)
        case "equisolid":
            return np.cos(angle / 2.0)
        case "stereographic":
            return 1.0 / np.cos(angle / 2.0) ** 2
        case "orthographic":
            return np.cos(angle)


def ideal_angle(projection: Projection, radius: ArrayLike) -> FloatArray:
    """Return the angle in radians whose g0 is `radius`; NaN where none has it."""
    r = np.asarray(radius, dtype=np.float64)
    with np.errstate(invalid="ignore"):
        match projection:
            case "perspective":
                return np.arctan(r)
            case "equidistant":
                return np.where(r <= math.pi, r, np.nan)
            case "equisolid":
                return 2.0 * np.arcsin(r / 2.0)
            case "stereographic":
                return 2.0 * np.arctan(r / 2.0)
            case "orthographic":
                return np.arcsin(r)
