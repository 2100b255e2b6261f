"""OpenCV's fisheye model (Kannala and Brandt) is our equidistant projection with odd powers alone."""

from __future__ import annotations

import math

import cv2
import numpy as np

from sunarc.optics.camera import Camera
from sunarc.optics.forward import project
from sunarc.optics.inverse import unproject

K = np.array([[601.0, 0.0, 871.5], [0.0, 603.0, 880.25], [0.0, 0.0, 1.0]])
D = np.array([0.02, -0.011, 0.004, -0.0007])
CAMERA = Camera(
    width=1748,
    height=1748,
    projection="equidistant",
    focal_length_px=(601.0, 603.0),
    principal_point_px=(871.5, 880.25),
    rotation_cam_enu=(0.0, 0.0, 0.0),
    radial=tuple(float(D[(n - 3) // 2]) * (math.pi / 2) ** n if n in (3, 5, 7, 9) else 0.0 for n in range(2, 10)),
)


def _rays() -> np.ndarray[tuple[int, int], np.dtype[np.float64]]:
    rng = np.random.default_rng(1)
    theta, phi = rng.uniform(0.0, math.radians(85.0), 500), rng.uniform(-math.pi, math.pi, 500)
    return np.stack([np.sin(theta) * np.cos(phi), np.sin(theta) * np.sin(phi), np.cos(theta)], axis=-1)


def test_projects_as_opencv_does() -> None:
    rays = _rays()
    theirs, _ = cv2.fisheye.projectPoints((rays / rays[:, 2:])[:, None], np.zeros(3), np.zeros(3), K, D)
    np.testing.assert_allclose(project(CAMERA, rays), theirs[:, 0], atol=1e-7)


def test_unprojects_what_opencv_projected() -> None:
    rays = _rays()
    theirs, _ = cv2.fisheye.projectPoints((rays / rays[:, 2:])[:, None], np.zeros(3), np.zeros(3), K, D)
    np.testing.assert_allclose(unproject(CAMERA, theirs[:, 0]), rays, atol=1e-9)
