"""The sky to which another model is fitted."""

from __future__ import annotations

import math
from dataclasses import dataclass

import numpy as np

from sunarc.array_types import FloatArray
from sunarc.calibration.model.backward import camera_sees
from sunarc.calibration.model.covariance import hemisphere
from sunarc.optics.camera import Camera
from sunarc.optics.forward import project
from sunarc.optics.pose import rotation_matrix
from sunarc.optics.stretch import rising_limit

_COUNT = 4000


@dataclass(frozen=True, slots=True, kw_only=True, eq=False)
class Sky:
    """Directions spread evenly over what the lens sees, and their pixels.

    Attributes
    ----------
    within : radians off the axis that they reach to.
    rays : (n, 3) unit vectors in the camera frame.
    directions : (n, 3) the same, east-north-up.
    pixels : (n, 2) where our model puts them, all in the image.
    """

    within: float
    rays: FloatArray
    directions: FloatArray
    pixels: FloatArray


def sky_of(camera: Camera, *, within: float) -> Sky:
    """Return what a camera sees of the sky, up to an angle in radians off its axis."""
    limit = min(within, rising_limit(camera, up_to=camera.max_angle))
    rays = hemisphere(_COUNT)
    cosine = 1.0 - (1.0 - rays[:, 2]) * (1.0 - math.cos(limit))  # the hemisphere, stretched over the cap
    across = np.sqrt((1.0 - cosine**2) / (1.0 - rays[:, 2] ** 2))
    rays = np.stack([rays[:, 0] * across, rays[:, 1] * across, cosine], axis=-1)
    directions = rays @ rotation_matrix(camera.rotation_cam_enu)
    pixels = project(camera, directions)
    inside = camera_sees(camera, pixels)
    return Sky(within=limit, rays=rays[inside], directions=directions[inside], pixels=pixels[inside])
