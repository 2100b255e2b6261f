"""From pixels to directions: the exact inverse of the forward model.

The forward model splits in two, so that its inverse is two small Newton iterations: in the plane for the
decentering, then in one dimension for the angle.
"""

from __future__ import annotations

import numpy as np
from numpy.typing import ArrayLike

from sunarc.array_types import FloatArray
from sunarc.optics.camera import Camera
from sunarc.optics.forward import distorted_radius
from sunarc.optics.inverse_kernels import angles_of, without_decentering
from sunarc.optics.kernels import PROJECTION_CODES
from sunarc.optics.pose import rotation_matrix
from sunarc.optics.projections import angle_limit

_PIECES = 256
"""Of the table that the angle's steps begin at."""


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
    x_hat, y_hat = (np.array(each, dtype=np.float64) for each in calibrated(camera, place))
    if any(camera.decentering[:2]):
        without_decentering(np.array(camera.decentering), x_hat.reshape(-1), y_hat.reshape(-1))
    radius = np.hypot(x_hat, y_hat)
    theta = _angle_of_radius(camera, radius.reshape(-1)).reshape(radius.shape)
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


def _angle_of_radius(camera: Camera, radius: FloatArray) -> FloatArray:
    """Return the angles (n,) in [0, max_angle] whose radius is given, rad; NaN beyond."""
    limit = min(camera.max_angle, angle_limit(camera.projection) * (1.0 - 1e-9))
    grid = np.linspace(0.0, limit, _PIECES + 1)
    found = distorted_radius(camera, grid)
    first = np.interp(np.linspace(0.0, found[-1], _PIECES + 1), found, grid)
    return np.asarray(angles_of(PROJECTION_CODES[camera.projection], np.array(camera.radial), first, limit, radius))
