"""What every pixel of a camera looks at: computed once, for the direction of a pixel never changes."""

from __future__ import annotations

import math
from functools import lru_cache

import numpy as np
from numpy.typing import NDArray

from sunarc.array_types import BoolArray, FloatArray
from sunarc.optics.camera import Camera
from sunarc.optics.inverse import unproject
from sunarc.optics.pose import rotation_matrix
from sunarc.simulation.options import Obstruction
from sunarc.sky.directions import wrapped_deg

_ROWS_AT_ONCE = 64


@lru_cache(maxsize=1)
def pixel_field(camera: Camera, *, field_deg: float, obstructions: tuple[Obstruction, ...]) -> NDArray[np.float32]:
    """Return (height, width, 4) float32: east, north, up of each pixel, and what it sees.

    The fourth number is the share of sky (0 to 1), minus the share of ground where it sees ground, and 0 outside the
    image circle; edges are soft over one pixel. The last answer is kept (it takes seconds), and not to be written to.
    """
    field = np.zeros((camera.height, camera.width, 4), dtype=np.float32)
    x = np.arange(camera.width, dtype=np.float64)
    axis = rotation_matrix(camera.rotation_cam_enu)[2]
    for first in range(0, camera.height, _ROWS_AT_ONCE):
        rows = np.arange(first, min(first + _ROWS_AT_ONCE, camera.height), dtype=np.float64)
        pixels = np.stack(np.meshgrid(x, rows), axis=-1)
        direction = unproject(camera, pixels)
        block = field[first : first + rows.size]
        inside = np.nan_to_num(_inside_circle(camera, direction @ axis, field_deg))
        direction = np.nan_to_num(direction)
        block[..., :3] = direction
        sky = np.clip(0.5 + direction[..., 2] * camera.focal_length_px[0], 0.0, 1.0)
        sky[is_blocked(direction, obstructions)] = 0.0
        block[..., 3] = inside * np.where(sky > 0.0, sky, -1.0)
    return field


def is_blocked(direction_enu: FloatArray, obstructions: tuple[Obstruction, ...]) -> BoolArray:
    """Return (...) whether directions end on the ground or on an obstruction."""
    east, north, up = np.moveaxis(direction_enu, -1, 0)
    blocked = up <= 0.0
    azimuth = np.degrees(np.arctan2(east, north))
    for thing in obstructions:
        aside = wrapped_deg(azimuth - thing.azimuth_deg)
        blocked |= (np.abs(aside) < 0.5 * thing.width_deg) & (up < math.sin(math.radians(thing.height_deg)))
    return np.asarray(blocked)


def _inside_circle(camera: Camera, cos_theta: FloatArray, field_deg: float) -> FloatArray:
    limit = math.radians(min(field_deg, math.degrees(camera.max_angle)))
    theta = np.arccos(np.clip(cos_theta, -1.0, 1.0))
    return np.asarray(np.clip(0.5 + (limit - theta) * camera.focal_length_px[0], 0.0, 1.0))
