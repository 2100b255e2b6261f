"""How the lens scales the sky locally, and up to which angle it can."""

from __future__ import annotations

import numpy as np
from numpy.typing import ArrayLike

from sunarc.array_types import FloatArray
from sunarc.optics.camera import Camera
from sunarc.optics.forward import project_with_jacobian, radius_slope
from sunarc.optics.projections import angle_limit


def local_stretch(camera: Camera, direction_enu: ArrayLike) -> FloatArray:
    """Return the 2×2 matrix that takes small angles on the sphere to pixels.

    Parameters
    ----------
    camera : the camera.
    direction_enu : (..., 3) unit vectors, east-north-up.

    Returns
    -------
    (..., 2, 2) px per radian, from some orthonormal basis of the tangent plane: a round disc of angular radius a
    lands on the ellipse {a M e, |e| = 1}, whatever the basis. NaN beyond the projection's own limit.
    """
    direction = np.asarray(direction_enu, dtype=np.float64)
    _, _, by_direction = project_with_jacobian(camera, direction)
    return np.asarray(by_direction @ tangent_basis(direction))


def tangent_basis(direction_enu: FloatArray) -> FloatArray:
    """Return (..., 3, 2): two unit vectors orthogonal to each direction and to each other, without a seam."""
    helper = np.where(np.abs(direction_enu[..., 2:]) < 0.9, [0.0, 0.0, 1.0], [1.0, 0.0, 0.0])
    first = np.cross(helper, direction_enu)
    first = first / np.linalg.norm(first, axis=-1, keepdims=True)
    return np.stack([first, np.cross(direction_enu, first)], axis=-1)


def rising_limit(camera: Camera, *, up_to: float) -> float:
    """Return the angle in radians, at most `up_to`, up to which the lens's radius rises with the angle."""
    limit = min(up_to, angle_limit(camera.projection) * (1.0 - 1e-6))
    theta = np.linspace(0.0, limit, 2001)
    falling = np.flatnonzero(radius_slope(camera, theta) <= 0.0)
    return float(theta[falling[0] - 1]) if falling.size and falling[0] > 0 else limit
