"""OpenCV's fisheye model (Kannala and Brandt's): K, D and R, as `cv2.FileStorage` reads them."""

from __future__ import annotations

import math
from dataclasses import dataclass

import cv2
import numpy as np

from sunarc.array_types import FloatArray
from sunarc.exports.sky import FitError, Sky, fit_error, sky_of
from sunarc.optics import Camera, rotation_matrix

_WITHIN = math.radians(89.5)


@dataclass(frozen=True, slots=True, kw_only=True, eq=False)
class FisheyeModel:
    """OpenCV's fisheye camera.

    Attributes
    ----------
    matrix : K (3, 3) px; its first element is negative for a mirrored image.
    distortion : D (4,), k1 … k4.
    rotation : R (3, 3) from east-north-up to the camera.
    error : how far it is from ours; it divides by z, so that it has no pixel at 90 degrees off the axis and beyond.
    """

    matrix: FloatArray
    distortion: FloatArray
    rotation: FloatArray
    error: FitError


def fisheye_model(camera: Camera) -> FisheyeModel:
    """Return OpenCV's fisheye model that is closest to a camera."""
    sky = sky_of(camera, within=_WITHIN)
    sign = -1.0 if camera.mirrored else 1.0
    x0, y0 = camera.principal_point_px
    start = np.array(
        [
            sign * camera.focal_length_px[0],
            camera.focal_length_px[1],
            camera.width - 1.0 - x0 if camera.mirrored else x0,
            y0,
            *(0.0,) * 4,
            *(0.0,) * 3,
        ]
    )
    # Pixels, distortion and radians differ by three orders: without scales the solver stops early.
    scale = np.r_[np.full(4, 1.0), np.full(4, 1e-3), np.full(3, 1e-3)]

    def misfit(parameters: FloatArray) -> FloatArray:
        return np.asarray(_projected(parameters, sky) - sky.pixels).ravel()

    from scipy.optimize import least_squares  # noqa: PLC0415 - the service starts sooner without it

    found = least_squares(misfit, start, x_scale=scale, method="lm").x
    fx, fy, cx, cy = found[:4]
    return FisheyeModel(
        matrix=np.array([[fx, 0.0, cx], [0.0, fy, cy], [0.0, 0.0, 1.0]]),
        distortion=found[4:8],
        rotation=rotation_matrix(found[8:]) @ rotation_matrix(camera.rotation_cam_enu),
        error=fit_error(camera, sky, _projected(found, sky)),
    )


def opencv_yaml(model: FisheyeModel, *, width: int, height: int, notes: dict[str, str]) -> bytes:
    """Return the file of a model, with its notes."""
    storage = cv2.FileStorage(".yml", cv2.FILE_STORAGE_WRITE | cv2.FILE_STORAGE_MEMORY)
    for name, text in notes.items():
        storage.write(name, text)
    for name, size in (("image_width", width), ("image_height", height)):
        storage.write(name, size)
    storage.write("camera_matrix", model.matrix)
    storage.write("distortion_coefficients", model.distortion[:, None])
    storage.write("rotation_cam_enu", model.rotation)
    text = str(storage.releaseAndGetString())
    return text.replace("\\'", "'").encode()  # OpenCV escapes an apostrophe, which YAML does not know


def _projected(parameters: FloatArray, sky: Sky) -> FloatArray:
    ray = sky.rays @ rotation_matrix(parameters[8:]).T
    across = np.hypot(ray[:, 0], ray[:, 1])
    theta = np.arctan2(across, ray[:, 2])
    square = theta**2
    k1, k2, k3, k4 = parameters[4:8]
    radius = theta * (1.0 + square * (k1 + square * (k2 + square * (k3 + square * k4))))
    return np.asarray(ray[:, :2] * (radius / across)[:, None] * parameters[:2] + parameters[2:4])
