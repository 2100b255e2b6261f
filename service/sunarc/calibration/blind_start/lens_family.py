"""One family of lenses with a number for its shape: all five ideal projections, and what lies between them.

r = f tan(k θ) / k for k > 0, f θ for k = 0, f sin(k θ) / k for k < 0: equidistant 0, stereographic 0.5, perspective 1,
equisolid -0.5, orthographic -1. Reference: PTGui's fisheye factor.
"""

from __future__ import annotations

import math

import numpy as np

from sunarc.array_types import FloatArray
from sunarc.calibration.blind_start.sky_turn import MAX_ANGLE
from sunarc.optics.projections import Projection, ideal_radius

_FLAT = 1e-6
_SHAPES: dict[Projection, float] = {
    "orthographic": -1.0, "equisolid": -0.5, "equidistant": 0.0, "stereographic": 0.5, "perspective": 1.0,
}  # fmt: skip
_POWERS = (2, 3, 4, 5)


def angle_of_radius(radius: FloatArray, shape: float) -> FloatArray:
    """Return angles off the axis (rad) of radii in focal lengths; of those beyond the lens's end its largest."""
    if abs(shape) < _FLAT:
        return radius
    if shape > 0.0:
        return np.asarray(np.arctan(shape * radius) / shape)
    return np.asarray(np.arcsin(np.minimum(-shape * radius, 1.0)) / -shape)


def radius_of_angle(angle: FloatArray, shape: float) -> FloatArray:
    """Return radii in focal lengths of angles off the axis (rad)."""
    if abs(shape) < _FLAT:
        return angle
    if shape > 0.0:
        return np.asarray(np.tan(np.minimum(shape * angle, 0.49 * math.pi)) / shape)
    return np.asarray(np.sin(np.minimum(-shape * angle, 0.5 * math.pi)) / -shape)


def nearest_projection(shape: float) -> Projection:
    """Return the ideal projection that is nearest to a shape."""
    return min(_SHAPES, key=lambda name: abs(_SHAPES[name] - shape))


def radial_for(shape: float, projection: Projection) -> tuple[float, ...]:
    """Return k2 … k9 of a camera of an ideal projection that has this shape, by least squares to 90 degrees."""
    angle = np.linspace(0.05, min(MAX_ANGLE, 0.5 * math.pi), 60)
    design = np.stack([(angle / (0.5 * math.pi)) ** power for power in _POWERS], axis=-1)
    difference = radius_of_angle(angle, shape) - ideal_radius(projection, angle)
    found = np.linalg.lstsq(design, difference, rcond=None)[0]
    return (*(float(value) for value in found), *(0.0,) * (8 - len(_POWERS)))
