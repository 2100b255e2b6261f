"""The pose by the direct linear transform (Eqs. 23 to 25)."""

from __future__ import annotations

import math
from dataclasses import replace

import numpy as np

from sunarc.array_types import FloatArray
from sunarc.calibration.initial_guess.candidates import as_far_as_it_rises
from sunarc.calibration.least_squares.problem import Observations
from sunarc.optics.camera import Camera
from sunarc.optics.inverse import unproject
from sunarc.optics.pose import rotation_vector


def direct_linear_pose(camera: Camera, observed: Observations) -> Camera:
    """Return the camera with the pose and translation of the direct linear transform.

    Sun directions of one or two days lie nearly in a plane, and the transform then says next to nothing: that is what
    the paper's procedure does, and why `wahba` is the default.

    Parameters
    ----------
    camera : K0; its own pose does not count.
    observed : sightings of one pose epoch.
    """
    rays = unproject(as_far_as_it_rises(camera), observed.pixels)
    good = np.all(np.isfinite(rays), axis=-1)
    rays, world = rays[good], observed.directions[good]
    # Hartley's normalisation: without it the 12 columns differ by orders of magnitude
    center, spread = world.mean(axis=0), float(np.mean(np.linalg.norm(world - world.mean(axis=0), axis=-1)))
    scale = math.sqrt(3.0) / spread
    normalised = np.concatenate([scale * (world - center), np.ones((world.shape[0], 1))], axis=1)
    blocks = np.einsum("ni,naj->naji", normalised, _left_null_spaces(rays)).reshape(-1, 3, 4)
    solution = np.linalg.svd(blocks.reshape(-1, 12), full_matrices=False)[2][-1].reshape(3, 4)
    undo = np.eye(4)
    undo[:3] *= scale
    undo[:3, 3] = -scale * center
    return _posed(camera, solution @ undo, world, rays)


def _left_null_spaces(rays: FloatArray) -> FloatArray:
    """Return (n, 2, 3): two unit vectors orthogonal to each ray and to each other."""
    helper = np.where(np.abs(rays[:, 2:]) < 0.9, [0.0, 0.0, 1.0], [1.0, 0.0, 0.0])
    first = np.cross(helper, rays)
    first /= np.linalg.norm(first, axis=-1, keepdims=True)
    return np.stack([first, np.cross(rays, first)], axis=1)


def _posed(camera: Camera, matrix: FloatArray, world: FloatArray, rays: FloatArray) -> Camera:
    """Take R and t out of P up to its scale and sign, as the paper does after Eq. 25."""
    toward = np.sum((world @ matrix[:, :3].T + matrix[:, 3]) * rays)
    matrix = matrix * (1.0 if toward >= 0.0 else -1.0)
    left, singular, right = np.linalg.svd(matrix[:, :3])
    # P is known up to its sign: a rotation has the determinant +1
    sign = np.sign(np.linalg.det(left @ right))
    rotation = sign * left @ right
    shift = sign * matrix[:, 3] / float(np.mean(singular))
    return replace(
        camera,
        rotation_cam_enu=rotation_vector(rotation),
        translation=(float(shift[0]), float(shift[1]), float(shift[2])),
    )
