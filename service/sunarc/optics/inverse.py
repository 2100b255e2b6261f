"""From pixels to directions: the exact inverse of the forward model.

The forward model splits in two, so that its inverse is two small Newton iterations: in the plane for the
decentering, then in one dimension for the angle.
"""

from __future__ import annotations

import numpy as np
from numpy.typing import ArrayLike

from sunarc.array_types import FloatArray
from sunarc.optics.camera import Camera
from sunarc.optics.forward import decentering_shift, distorted_radius, radius_slope
from sunarc.optics.pose import rotation_matrix
from sunarc.optics.projections import angle_limit

_ITERATIONS = 30
_TOLERANCE = 1e-14


def unproject(camera: Camera, pixel: ArrayLike) -> FloatArray:
    """Return the directions that pixels look at.

    Parameters
    ----------
    camera : the camera; its translation is taken as 0, for it names no direction.
    pixel : (..., 2) px, inside the image or not.

    Returns
    -------
    (..., 3) unit vectors, east-north-up; NaN where no direction within `max_angle` lands on the pixel.
    """
    place = np.asarray(pixel, dtype=np.float64)
    if camera.displacement is not None:
        place = camera.displacement.taken_out(place.reshape(-1, 2)).reshape(place.shape)
    x_hat, y_hat = calibrated(camera, place)
    x_hat, y_hat = _without_decentering(camera, x_hat, y_hat)
    radius = np.hypot(x_hat, y_hat)
    theta = _angle_of_radius(camera, radius)
    safe = np.where(radius > 0.0, radius, 1.0)
    sine = np.sin(theta)
    ray = np.stack([sine * x_hat / safe, sine * y_hat / safe, np.cos(theta)], axis=-1)
    return np.asarray(ray @ rotation_matrix(camera.rotation_cam_enu))


def calibrated(camera: Camera, pixel: FloatArray) -> tuple[FloatArray, FloatArray]:
    """Return x̂, ŷ (...) of pixels (..., 2): in focal lengths from the axis, the decentering still in it."""
    x, y = pixel[..., 0], pixel[..., 1]
    if camera.mirrored:
        x = camera.width - 1.0 - x
    y_hat = (y - camera.principal_point_px[1]) / camera.focal_length_px[1]
    return (x - camera.principal_point_px[0] - camera.skew_px * y_hat) / camera.focal_length_px[0], y_hat


def _without_decentering(camera: Camera, x_hat: FloatArray, y_hat: FloatArray) -> tuple[FloatArray, FloatArray]:
    """Solve q + shift(q) = (x̂, ŷ) for q by Newton's method with a differenced 2×2 Jacobian."""
    if not any(camera.decentering[:2]):
        return x_hat, y_hat
    x, y = x_hat.copy(), y_hat.copy()
    step = 1e-7
    for _ in range(_ITERATIONS):
        sx, sy = _shift(camera, x, y)
        fx, fy = x + sx - x_hat, y + sy - y_hat
        ax, ay = _shift(camera, x + step, y)
        bx, by = _shift(camera, x, y + step)
        xx, yx = 1.0 + (ax - sx) / step, (ay - sy) / step
        xy, yy = (bx - sx) / step, 1.0 + (by - sy) / step
        determinant = xx * yy - xy * yx
        dx, dy = (yy * fx - xy * fy) / determinant, (xx * fy - yx * fx) / determinant
        x, y = x - dx, y - dy
        if not np.any(np.hypot(dx, dy) > _TOLERANCE):
            break
    return x, y


def _shift(camera: Camera, x: FloatArray, y: FloatArray) -> tuple[FloatArray, FloatArray]:
    radius = np.hypot(x, y)
    safe = np.where(radius > 0.0, radius, 1.0)
    return decentering_shift(camera.decentering, radius, x / safe, y / safe)


def _angle_of_radius(camera: Camera, radius: FloatArray) -> FloatArray:
    """Solve r̂(theta) = radius by Newton's method, kept inside [0, max_angle]; NaN beyond."""
    limit = min(camera.max_angle, angle_limit(camera.projection) * (1.0 - 1e-9))
    grid = np.linspace(0.0, limit, 257)
    theta = np.interp(radius, distorted_radius(camera, grid), grid)
    for _ in range(_ITERATIONS):
        change = (distorted_radius(camera, theta) - radius) / radius_slope(camera, theta)
        next_theta = np.clip(theta - change, 0.0, limit)
        moved = np.abs(next_theta - theta)
        theta = next_theta
        if not np.any(moved > _TOLERANCE):
            break
    beyond = radius > distorted_radius(camera, np.asarray(limit)) * (1.0 + 1e-12)
    return np.where(beyond, np.nan, theta)
