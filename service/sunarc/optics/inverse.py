"""From pixels to directions: the exact inverse of the forward model."""

from __future__ import annotations

import numpy as np
from numpy.typing import ArrayLike

from sunarc import _kernels
from sunarc.common.array_types import FloatArray
from sunarc.optics.camera import Camera
from sunarc.optics.forward import kernel_optics
from sunarc.optics.pose import rotation_matrix
from sunarc.optics.projections import angle_limit


def unproject(camera: Camera, pixel: ArrayLike) -> FloatArray:
    """Return the directions of pixels.

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
        place = camera.displacement.inverse(place.reshape(-1, 2)).reshape(place.shape)
    optics = kernel_optics(camera)
    result = _kernels.directions_of(
        optics.code,
        optics.mirror,
        largest_angle(camera),
        np.array([*camera.focal_length_px, camera.skew_px, *camera.principal_point_px]),
        np.array(camera.radial),
        np.array(camera.decentering),
        rotation_matrix(camera.rotation_cam_enu),
        np.ascontiguousarray(place.reshape(-1, 2)),
    )
    return result.reshape(*place.shape[:-1], 3)


def calibrated(camera: Camera, pixel: FloatArray) -> tuple[FloatArray, FloatArray]:
    """Return x̂, ŷ (...) of pixels (..., 2): in focal lengths from the axis, the decentering still in it."""
    x, y = pixel[..., 0], pixel[..., 1]
    if camera.mirrored:
        x = camera.width - 1.0 - x
    y_hat = (y - camera.principal_point_px[1]) / camera.focal_length_px[1]
    return (x - camera.principal_point_px[0] - camera.skew_px * y_hat) / camera.focal_length_px[0], y_hat


def largest_angle(camera: Camera) -> float:
    """Return the angle off the axis, rad, up to which the inverse is looked for."""
    return min(camera.max_angle, angle_limit(camera.projection) * (1.0 - 1e-9))
