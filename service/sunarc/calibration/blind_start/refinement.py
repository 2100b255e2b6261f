"""A rough camera made exact by the catalogue's stars: the nearest detections, ever closer ones, and least squares."""

from __future__ import annotations

from collections.abc import Sequence
from typing import NamedTuple

import numpy as np
from scipy.spatial import cKDTree

from sunarc.array_types import FloatArray
from sunarc.calibration.blind_start.values import NightImage
from sunarc.optics.camera import Camera, Param
from sunarc.optics.forward import project_with_jacobian
from sunarc.robust_statistics import biweights, mad_sigma
from sunarc.sky.night import NightSky

_FIT = (
    Param.FOCAL_LENGTH_X_PX, Param.PRINCIPAL_POINT_X_PX, Param.PRINCIPAL_POINT_Y_PX,
    Param.ROTATION_X, Param.ROTATION_Y, Param.ROTATION_Z, Param.K2, Param.K3, Param.K4, Param.K5,
)  # fmt: skip
_SIGMA_LENS = (0.1, 0.08, 0.08, 0.3, 0.3, 0.3, 0.05, 0.05, 0.05, 0.05)
"""1-sigma of the prior about the rough camera: focal length and centre in focal lengths, rotation in radians."""
_ROUNDS = (
    (0.1, 2.0), (0.08, 2.5), (0.06, 3.0), (0.045, 3.0), (0.03, 3.5), (0.02, 3.5),
    (0.012, 4.0), (0.008, 4.5), (0.006, 4.5),
)  # fmt: skip
"""Reach in focal lengths, and V of the faintest stars of each round."""
_STEPS = 3
_PER_STAR = 1.5
_FEWEST = 12
_LEAST_REACH_PX = 2.0


class Refined(NamedTuple):
    """A camera, and the scatter of the stars about it per axis, px."""

    camera: Camera
    scatter_px: float


def refined(camera: Camera, images: Sequence[NightImage]) -> Refined | None:
    """Return the camera by least squares of bright stars of several images; None where too few come near."""
    focal = camera.focal_length_px[0]
    start = camera.to_vector()[list(_FIT)]
    sigma = np.array(_SIGMA_LENS) * np.r_[focal, focal, focal, np.ones(7)]
    scatter = np.nan
    for reach, faintest in _ROUNDS:
        for _ in range(_STEPS):
            radius = max(reach * focal, _LEAST_REACH_PX)
            pairs = _nearest(camera, images, radius, faintest)
            if pairs[0].shape[0] < _FEWEST:
                return None
            camera, scatter = _step(camera, pairs, (start, sigma), radius)
    return Refined(camera, scatter)


def _nearest(
    camera: Camera, images: Sequence[NightImage], radius: float, faintest: float
) -> tuple[FloatArray, FloatArray]:
    """Return directions (n, 3) of stars and pixels (n, 2) of the detections nearest to them, each the other's."""
    directions, pixels = [np.zeros((0, 3))], [np.zeros((0, 2))]
    for image in images:
        sky = _of_image(camera, image.sky.select(image.sky.magnitude <= faintest))
        some = image.stars.pixels[: round(_PER_STAR * len(sky)) + 10]
        if len(sky) == 0 or some.shape[0] == 0:
            continue
        there = project_with_jacobian(camera, sky.directions)[0]
        apart, row = cKDTree(some).query(there)
        back = np.asarray(cKDTree(there).query(some)[1])
        near = (np.asarray(apart) < radius) & (back[np.asarray(row)] == np.arange(len(sky)))
        directions.append(sky.directions[near])
        pixels.append(some[np.asarray(row)[near]])
    return np.concatenate(directions), np.concatenate(pixels)


def _of_image(camera: Camera, sky: NightSky) -> NightSky:
    pixels = project_with_jacobian(camera, sky.directions)[0]
    size = np.array([camera.width, camera.height])
    return sky.select(np.all((pixels > -0.5) & (pixels < size - 0.5), axis=-1))


def _step(
    camera: Camera, pairs: tuple[FloatArray, FloatArray], prior: tuple[FloatArray, FloatArray], radius: float
) -> tuple[Camera, float]:
    """Return the camera after a robust Gauss-Newton step, and the scatter about it before."""
    (directions, pixels), (start, sigma) = pairs, prior
    there, rows, _ = project_with_jacobian(camera, directions)
    seen = np.isfinite(there[:, 0])
    residual, rows = (pixels - there)[seen], rows[seen]
    rows[..., Param.FOCAL_LENGTH_X_PX] += rows[..., Param.FOCAL_LENGTH_Y_PX]  # one focal length
    distance = np.linalg.norm(residual, axis=-1)
    scatter = max(mad_sigma(residual.ravel()), 0.1)
    weight = np.sqrt(np.maximum(biweights(distance / max(6.0 * scatter, 0.1 * radius)), 1e-9))
    design = rows[..., list(_FIT)] * weight[:, None, None] / scatter
    now = camera.to_vector()[list(_FIT)]
    matrix = np.concatenate([design.reshape(-1, len(_FIT)), np.diag(1.0 / sigma)])
    goal = np.r_[(residual * weight[:, None] / scatter).ravel(), (start - now) / sigma]
    change = np.linalg.lstsq(matrix, goal, rcond=None)[0]
    vector = camera.to_vector()
    vector[list(_FIT)] = now + change
    vector[Param.FOCAL_LENGTH_Y_PX] = vector[Param.FOCAL_LENGTH_X_PX]
    return camera.with_parameters(vector), scatter
