"""The five ideal lens projections (paper's Eq. 8): the normalised radius g0 as a function of the angle off the axis.

All are of one family with a number k for the shape: g0 is tan(k θ) / k for k > 0, θ for k = 0, sin(k θ) / k for k < 0.

References: K. Miyamoto, "Fish eye lens", JOSA 54 (1964); PTGui's fisheye factor is k.
"""

from __future__ import annotations

import math
from collections.abc import Mapping
from types import MappingProxyType
from typing import Literal, NamedTuple

import numpy as np
from numpy.typing import ArrayLike

from sunarc.common.array_types import FloatArray

Projection = Literal["perspective", "equidistant", "equisolid", "stereographic", "orthographic"]

_LINEAR = 1e-6
"""Shapes this near to 0 are taken as 0."""


class IdealLens(NamedTuple):
    """One projection.

    code : its number in the compiled kernels, which refuse any other.
    shape : k of the family.
    """

    code: int
    shape: float

    @property
    def largest_angle(self) -> float:
        """Return the angle in radians up to which the radius rises."""
        return min(math.pi, 0.5 * math.pi / abs(self.shape)) if self.shape else math.pi


PROJECTIONS: Mapping[Projection, IdealLens] = MappingProxyType(
    {
        "perspective": IdealLens(code=0, shape=1.0),
        "equidistant": IdealLens(code=1, shape=0.0),
        "equisolid": IdealLens(code=2, shape=-0.5),
        "stereographic": IdealLens(code=3, shape=0.5),
        "orthographic": IdealLens(code=4, shape=-1.0),
    }
)
"""The table that everything else reads or is tested against, the kernels and the client among it."""


def angle_limit(projection: Projection) -> float:
    """Return the angle in radians up to which the ideal projection rises."""
    return PROJECTIONS[projection].largest_angle


def ideal_radius(projection: Projection, theta: ArrayLike) -> FloatArray:
    """Return g0(theta), in focal lengths; meaningful up to `angle_limit`."""
    return shape_radius(PROJECTIONS[projection].shape, theta)


def ideal_slope(projection: Projection, theta: ArrayLike) -> FloatArray:
    """Return dg0/dtheta, in focal lengths per radian."""
    shape, angle = PROJECTIONS[projection].shape, np.asarray(theta, dtype=np.float64)
    if shape == 0.0:
        return np.ones_like(angle)
    return np.asarray(1.0 / np.cos(shape * angle) ** 2 if shape > 0.0 else np.cos(shape * angle))


def ideal_angle(projection: Projection, radius: ArrayLike) -> FloatArray:
    """Return the angle in radians whose g0 is `radius`; NaN where none has it."""
    angle = shape_angle(PROJECTIONS[projection].shape, radius)
    return np.where(angle <= math.pi, angle, np.nan)


def shape_radius(shape: float, theta: ArrayLike) -> FloatArray:
    """Return the radius, in focal lengths, at angles off the axis (rad) of a lens of any shape."""
    angle = np.asarray(theta, dtype=np.float64)
    if abs(shape) < _LINEAR:
        return angle.copy()
    return np.asarray((np.tan if shape > 0.0 else np.sin)(shape * angle) / shape)


def shape_angle(shape: float, radius: ArrayLike) -> FloatArray:
    """Return the angle off the axis (rad) at radii in focal lengths of a lens of any shape; NaN beyond its end."""
    r = np.asarray(radius, dtype=np.float64)
    if abs(shape) < _LINEAR:
        return r.copy()
    with np.errstate(invalid="ignore"):
        return np.asarray((np.arctan if shape > 0.0 else np.arcsin)(shape * r) / shape)
