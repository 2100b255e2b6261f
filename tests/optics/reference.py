"""The forward model once more: one direction at a time, written from the paper's equations, for the tests alone.

Urquhart et al. 2016, section 2.1.3: Eq. 3 (pose), 8 (ideal projection), 9 (radial polynomial), 12 (decentering),
the calibration matrix. Nothing here is shared with `sunarc.optics` but the camera's values.
"""

from __future__ import annotations

import math
from collections.abc import Callable

import numpy as np
from numpy.typing import NDArray

from sunarc.optics.camera import Camera
from sunarc.optics.pose import PoseAngles, rotation_from_pose_angles
from sunarc.optics.projections import PROJECTIONS, Projection

FloatArray = NDArray[np.float64]

IDEAL: dict[Projection, Callable[[float], float]] = {
    "perspective": math.tan,
    "equidistant": lambda theta: theta,
    "equisolid": lambda theta: 2.0 * math.sin(theta / 2.0),
    "stereographic": lambda theta: 2.0 * math.tan(theta / 2.0),
    "orthographic": math.sin,
}


def strange_camera(projection: Projection, *, mirrored: bool = False) -> Camera:
    """Return a camera with every one of the 23 parameters far from 0, and both focal lengths far apart."""
    return Camera(
        width=1748,
        height=1640,
        projection=projection,
        focal_length_px=(571.0, 613.0),
        skew_px=7.5,
        principal_point_px=(861.25, 803.5),
        rotation_cam_enu=rotation_from_pose_angles(PoseAngles(47.91, 12.46, 140.16)),
        translation=(0.011, -0.007, 0.005),
        radial=(0.021, -0.034, 0.015, 0.012, -0.009, -0.011, 0.005, 0.003),
        decentering=(0.012, -0.007, 0.31, -0.17),
        mirrored=mirrored,
        max_angle=math.radians(75.0),
    )


STRANGE = tuple(strange_camera(name, mirrored=mirrored) for name in PROJECTIONS for mirrored in (False, True))


def rodrigues(vector: FloatArray) -> FloatArray:
    """Return the matrix of a rotation vector by Rodrigues' formula."""
    angle = float(np.linalg.norm(vector))
    if angle == 0.0:
        return np.eye(3)
    x, y, z = vector / angle
    cross = np.array([[0.0, -z, y], [z, 0.0, -x], [-y, x, 0.0]])
    return np.asarray(np.eye(3) + math.sin(angle) * cross + (1.0 - math.cos(angle)) * (cross @ cross))


def pixel_by_hand(camera: Camera, direction: FloatArray) -> tuple[float, float]:
    """Return the pixel of one direction (3,), without a limit of the angle."""
    x, y, z = rodrigues(np.array(camera.rotation_cam_enu)) @ direction + np.array(camera.translation)
    theta, phi = math.atan2(math.hypot(x, y), z), math.atan2(y, x)
    radius = IDEAL[camera.projection](theta)
    for power, coefficient in enumerate(camera.radial, start=2):
        radius += coefficient * (theta / (math.pi / 2.0)) ** power
    p1, p2, p3, p4 = camera.decentering
    profile = radius**2 + p3 * radius**4 + p4 * radius**6
    cosine, sine = math.cos(phi), math.sin(phi)
    x_hat = radius * cosine + profile * (p1 * (1.0 + 2.0 * cosine**2) + 2.0 * p2 * sine * cosine)
    y_hat = radius * sine + profile * (2.0 * p1 * sine * cosine + p2 * (1.0 + 2.0 * sine**2))
    column = camera.focal_length_px[0] * x_hat + camera.skew_px * y_hat + camera.principal_point_px[0]
    row = camera.focal_length_px[1] * y_hat + camera.principal_point_px[1]
    return (camera.width - 1.0 - column if camera.mirrored else column), row


def pixels_by_hand(camera: Camera, directions: FloatArray) -> FloatArray:
    """Return the pixels (n, 2) of directions (n, 3)."""
    return np.array([pixel_by_hand(camera, direction) for direction in directions])


def field_of(camera: Camera, count: int, *, seed: int = 11) -> FloatArray:
    """Return directions (count, 3) over a camera's field, 1 degree and more off the axis."""
    rng = np.random.default_rng(seed)
    theta, phi = rng.uniform(0.02, camera.max_angle - 0.03, count), rng.uniform(-math.pi, math.pi, count)
    rays = np.stack([np.sin(theta) * np.cos(phi), np.sin(theta) * np.sin(phi), np.cos(theta)], axis=-1)
    return np.asarray(rays @ rodrigues(np.array(camera.rotation_cam_enu)))


def parameters_by_differences(camera: Camera, directions: FloatArray) -> FloatArray:
    """Return the derivatives (n, 2, 23) of `pixels_by_hand` by the parameters, by central differences."""
    vector, columns = camera.to_vector(), []
    for i in range(vector.size):
        step = np.zeros_like(vector)
        step[i] = 1e-5 * max(1.0, abs(vector[i]))
        ahead = pixels_by_hand(camera.replace_parameters(vector + step), directions)
        behind = pixels_by_hand(camera.replace_parameters(vector - step), directions)
        columns.append((ahead - behind) / (2.0 * step[i]))
    return np.stack(columns, axis=-1)
