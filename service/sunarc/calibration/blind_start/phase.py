"""The angle about the pole of a camera whose lens and pole are known: by the bright catalogue at the stated times."""

from __future__ import annotations

import math
from collections.abc import Sequence

import numpy as np

from sunarc.array_types import FloatArray
from sunarc.calibration.blind_start.lens_family import nearest_projection, radial_for
from sunarc.calibration.blind_start.sky_turn import MAX_ANGLE, pole_enu
from sunarc.calibration.blind_start.turning import Turning, unmirrored
from sunarc.calibration.blind_start.turning_kernel import Turns, count_on_detections
from sunarc.calibration.blind_start.values import NightImage
from sunarc.optics.camera import Camera
from sunarc.optics.pose import rotation_matrix, rotation_vector
from sunarc.sky.site import Site

_STEP_DEG = 1.0
_REACH = 0.035
"""Focal lengths: 2 degrees, for a lens and a pole that the turning alone found."""
_BRIGHT = 3.2
"""V of the faintest; 40 to 80 stars above a horizon."""
_PER_STAR = 2
"""Detections for each of these stars: planets, and what is no star."""
_KEPT = 3
_APART_DEG = 6.0


def phases(
    turning: Turning, images: Sequence[NightImage], site: Site, *, image_size: tuple[int, int]
) -> list[tuple[float, Camera]]:
    """Return the best angles about the pole as cameras, each with its share of bright stars on detections."""
    pole = pole_enu(site)
    first = _any_rotation(pole, turning.pole)
    angles = np.radians(np.arange(0.0, 360.0, _STEP_DEG))
    share = np.zeros(angles.size)
    for image in images:
        share += _shares(turning, image, first, angles)
    share /= len(images)
    found: list[tuple[float, Camera]] = []
    taken: list[float] = []
    for row in np.argsort(-share, kind="stable").tolist():
        apart = [abs((row * _STEP_DEG - other + 180.0) % 360.0 - 180.0) for other in taken]
        if min(apart, default=360.0) > _APART_DEG:
            taken.append(row * _STEP_DEG)
            turn = rotation_matrix(angles[row] * turning.pole)
            found.append((float(share[row]), _camera(turning, turn @ first, image_size)))
        if len(found) == _KEPT:
            break
    return found


def _shares(turning: Turning, image: NightImage, first: FloatArray, angles: FloatArray) -> FloatArray:
    stars = image.sky.directions[image.sky.magnitude <= _BRIGHT]
    centre, focal = turning.centre, turning.focal_px
    pixels = image.stars.pixels[: _PER_STAR * stars.shape[0]]
    if min(stars.shape[0], pixels.shape[0]) < 3:
        return np.zeros(angles.size)
    pixels = unmirrored(pixels, turning.width, mirrored=turning.mirrored)
    poles = np.broadcast_to(turning.pole, (angles.size, 3))
    onto = (pixels - centre) / focal
    rays, turns = stars @ first.T, Turns(poles, angles)
    return count_on_detections(rays, onto, turns, shape=turning.shape, reach=_REACH, largest=MAX_ANGLE)


def _any_rotation(pole: FloatArray, pole_camera: FloatArray) -> FloatArray:
    """Return a rotation (3, 3) that takes the pole, east-north-up, to its place in the camera's frame."""
    return _frame(pole_camera).T @ _frame(pole)


def _frame(axis: FloatArray) -> FloatArray:
    """Return (3, 3): rows are a right-handed frame whose last is the axis."""
    other = np.eye(3)[int(np.argmin(np.abs(axis)))]
    first = np.cross(other, axis)
    first /= np.linalg.norm(first)
    return np.stack([first, np.cross(axis, first), axis])


def _camera(turning: Turning, rotation: FloatArray, image_size: tuple[int, int]) -> Camera:
    projection = nearest_projection(turning.shape)
    x, y = turning.centre.tolist()
    return Camera(
        width=image_size[0],
        height=image_size[1],
        projection=projection,
        focal_length_px=(turning.focal_px, turning.focal_px),
        principal_point_px=(x, y),
        rotation_cam_enu=rotation_vector(rotation),
        radial=radial_for(turning.shape, projection),
        mirrored=turning.mirrored,
        max_angle=math.radians(100.0),
    )
