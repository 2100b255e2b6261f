"""The fisheye model of OpenCV, ROS and COLMAP: a polynomial of the angle off the axis (Kannala and Brandt's).

COLMAP's THIN_PRISM_FISHEYE has decentering and a thin prism besides; without them it is OpenCV's `cv2.fisheye`.
References: J. Kannala and S. Brandt, PAMI 28 (2006) 1335; COLMAP's documentation of its camera models.
"""

from __future__ import annotations

import math
from dataclasses import dataclass
from enum import IntEnum

import numpy as np

from sunarc.array_types import BoolArray, FloatArray
from sunarc.exports.sky import sky_of
from sunarc.exports.view import View, lens_view
from sunarc.optics.camera import Camera
from sunarc.optics.pose import rotation_matrix

WITHIN_DEG = 89.5
"""Off the axis; readers divide by z, so that they have nothing at 90 degrees and beyond."""

_TURN = slice(12, 15)
_SCALE = np.r_[np.ones(4), np.full(11, 1e-3)]
"""Pixels, distortion and radians differ by three orders: without scales the solver stops early."""
_ANGLES = 2001


class Fisheye(IntEnum):
    """Place of each parameter, in COLMAP's order; (fx, fy, cx, cy) in px."""

    FX = 0
    FY = 1
    CX = 2
    CY = 3
    K1 = 4
    K2 = 5
    P1 = 6
    P2 = 7
    K3 = 8
    K4 = 9
    SX1 = 10
    SY1 = 11


RADIAL = (Fisheye.K1, Fisheye.K2, Fisheye.K3, Fisheye.K4)
PRISM = (Fisheye.P1, Fisheye.P2, Fisheye.SX1, Fisheye.SY1)


@dataclass(frozen=True, slots=True, kw_only=True, eq=False)
class FisheyeModel:
    """A fisheye camera.

    Attributes
    ----------
    parameters : (12,) in the order of `Fisheye`; the centre of the top-left pixel is (0, 0); FX is negative for a
        mirrored image.
    rotation : (3, 3) from east-north-up to the camera; the identity where a file has none.
    """

    parameters: FloatArray
    rotation: FloatArray

    @property
    def matrix(self) -> FloatArray:
        """K (3, 3) px."""
        fx, fy, cx, cy = self.parameters[:4]
        return np.array([[fx, 0.0, cx], [0.0, fy, cy], [0.0, 0.0, 1.0]])

    @property
    def distortion(self) -> FloatArray:
        """D (4,), k1 … k4."""
        return self.parameters[list(RADIAL)]


def fisheye_model(camera: Camera, *, prism: bool = False) -> FisheyeModel:
    """Return the fisheye model that is closest to a camera; `prism`: with decentering and thin prism."""
    sky = sky_of(camera, within=math.radians(WITHIN_DEG))
    sign = -1.0 if camera.mirrored else 1.0
    x0, y0 = camera.principal_point_px
    start = np.zeros(15)
    start[:4] = sign * camera.focal_length_px[0], camera.focal_length_px[1], x0, y0
    if camera.mirrored:
        start[Fisheye.CX] = camera.width - 1.0 - x0
    free = np.ones(15, dtype=bool)
    free[list(PRISM)] = prism

    def parameters_of(moving: FloatArray) -> FloatArray:
        parameters = start.copy()
        parameters[free] = moving
        return parameters

    def misfit(moving: FloatArray) -> FloatArray:
        parameters = parameters_of(moving)
        rays = sky.rays @ rotation_matrix(parameters[_TURN]).T
        return np.asarray(pixels_of_rays(parameters, rays) - sky.pixels).ravel()

    from scipy.optimize import least_squares  # noqa: PLC0415 - the service starts sooner without it

    found = parameters_of(least_squares(misfit, start[free], x_scale=_SCALE[free], method="lm").x)
    rotation = rotation_matrix(found[_TURN]) @ rotation_matrix(camera.rotation_cam_enu)
    return FisheyeModel(parameters=found[: len(Fisheye)], rotation=rotation)


def fisheye_view(form: str, model: FisheyeModel, *, size: tuple[int, int], has_pose: bool = True) -> View:
    """Return the view of a model, up to `WITHIN_DEG` and to where its radius stops rising."""
    limit = _rising_limit(model.parameters)

    def shown(rays: FloatArray) -> FloatArray:
        return np.where(_within(rays, limit)[:, None], pixels_of_rays(model.parameters, rays), np.nan)

    fx, fy, cx, cy = model.parameters[:4]
    return lens_view(
        form,
        size=size,
        rotation=model.rotation,
        pixels_of_rays=shown,
        center=np.array([cx, cy]),
        focal=np.array([fx, fy]),
        has_pose=has_pose,
    )


def pixels_of_rays(parameters: FloatArray, rays: FloatArray) -> FloatArray:
    """Return pixels (n, 2) of rays (n, 3) in the camera frame."""
    across = np.hypot(rays[:, 0], rays[:, 1])
    safe = np.where(across > 0.0, across, 1.0)
    u, v = (rays[:, :2] * (np.arctan2(across, rays[:, 2]) / safe)[:, None]).T
    k1, k2, p1, p2, k3, k4, sx, sy = parameters[4 : len(Fisheye)]
    square = u * u + v * v
    radial = 1.0 + square * (k1 + square * (k2 + square * (k3 + square * k4)))
    x = u * radial + 2.0 * p1 * u * v + p2 * (square + 2.0 * u * u) + sx * square
    y = v * radial + 2.0 * p2 * u * v + p1 * (square + 2.0 * v * v) + sy * square
    return np.stack([x, y], axis=-1) * parameters[:2] + parameters[2:4]


def _within(rays: FloatArray, limit: float) -> BoolArray:
    return np.asarray(np.arctan2(np.hypot(rays[:, 0], rays[:, 1]), rays[:, 2]) <= limit)


def _rising_limit(parameters: FloatArray) -> float:
    theta = np.linspace(0.0, math.radians(WITHIN_DEG), _ANGLES)
    coefficients = np.zeros(10)
    coefficients[1::2] = 1.0, *parameters[list(RADIAL)]
    falls = np.diff(np.polynomial.polynomial.polyval(theta, coefficients)) <= 0.0
    return float(theta[np.argmax(falls)] if np.any(falls) else theta[-1])
