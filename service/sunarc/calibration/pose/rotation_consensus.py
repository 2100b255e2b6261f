"""The turn that most sightings agree on, when the camera may look anywhere and many sightings are false.

Every sighting names the smallest turn that explains it, every pair of them a whole rotation; the one that most others
agree with closely is taken, a small one before a large one.
"""

from __future__ import annotations

import itertools

import numpy as np
from scipy.spatial.transform import Rotation

from sunarc.array_types import FloatArray, IntArray
from sunarc.calibration.initial_guess.candidates import as_far_as_it_rises
from sunarc.optics.camera import Camera
from sunarc.optics.inverse import unproject
from sunarc.optics.pose import rotation_matrix

_MAX_SIGHTINGS = 64
_PAIRS = 400
_CLOSE_SIGMAS = 4.0
_SMALL_ROTATION = 0.5
"""How many agreeing sightings a turn ten times as large must bring."""
_LEAST_SEPARATION = 1e-4
"""Radians; two directions that are nearer span no plane that a rotation could be read from."""
_SEED = 20130513


def ransac_rotation(camera: Camera, directions: FloatArray, pixels: FloatArray, sigma_px: FloatArray) -> FloatArray:
    """Return the turn (3,) of a camera about its own axes, radians, that sightings ask for; 0 where they ask for none.

    Parameters
    ----------
    camera : its lens and its pose so far.
    directions, pixels : (n, 3) where the sun was, (n, 2) where it was seen.
    sigma_px : (n,) how far a true sighting may lie off for other reasons.
    """
    rays = unproject(as_far_as_it_rises(camera), pixels)
    world = directions @ rotation_matrix(camera.rotation_cam_enu).T
    good = np.flatnonzero(np.all(np.isfinite(rays), axis=-1))
    if good.size == 0:
        return np.zeros(3)
    thin = good[np.unique(np.linspace(0, good.size - 1, _MAX_SIGHTINGS).astype(int))]
    focal = 0.5 * (camera.focal_length_px[0] + camera.focal_length_px[1])
    turns = np.concatenate([np.zeros((1, 3)), _smallest(world[thin], rays[thin]), _of_pairs(world[thin], rays[thin])])
    matrices = Rotation.from_rotvec(turns).as_matrix()
    separation = np.linalg.norm(np.einsum("kij,nj->kni", matrices, world[thin]) - rays[thin], axis=-1)
    off = separation / (_CLOSE_SIGMAS * sigma_px[thin] / focal)
    # a soft count: 1 for a sighting close by, 1/2 at the limit, nothing far off
    agreed = np.sum(1.0 / (1.0 + off**4), axis=1)
    size = np.log(np.maximum(np.linalg.norm(turns, axis=-1), 1e-4))
    return np.asarray(turns[int(np.argmax(agreed - _SMALL_ROTATION * size / np.log(10.0)))])


def _smallest(world: FloatArray, rays: FloatArray) -> FloatArray:
    """Return (n, 3): the smallest turn that takes each expected ray to the one seen."""
    axis = np.cross(world, rays)
    sine, cosine = np.linalg.norm(axis, axis=-1), np.sum(world * rays, axis=-1)
    angle = np.arctan2(sine, cosine)
    return np.asarray(axis * (angle / np.maximum(sine, 1e-12))[:, None])


def _of_pairs(world: FloatArray, rays: FloatArray) -> FloatArray:
    """Return (k, 3): the rotations that pairs of sightings name."""
    pairs = np.array(list(itertools.combinations(range(world.shape[0]), 2)), dtype=np.int64).reshape(-1, 2)
    if pairs.shape[0] > _PAIRS:
        pairs = np.random.default_rng(_SEED).choice(pairs, _PAIRS, replace=False)
    separation = np.minimum(_distance(world, pairs), _distance(rays, pairs))  # a frozen camera sees one pixel for all
    pairs = pairs[separation > _LEAST_SEPARATION]
    if pairs.shape[0] == 0:
        return np.zeros((0, 3))
    matrix = _triads(rays, pairs) @ np.swapaxes(_triads(world, pairs), -1, -2)
    return np.asarray(Rotation.from_matrix(matrix).as_rotvec())


def _distance(vectors: FloatArray, pairs: IntArray) -> FloatArray:
    return np.asarray(np.linalg.norm(vectors[pairs[:, 0]] - vectors[pairs[:, 1]], axis=-1))


def _triads(vectors: FloatArray, pairs: IntArray) -> FloatArray:
    """Return (k, 3, 3): right-handed axes that each pair spans, its middle first."""
    first, second = vectors[pairs[:, 0]], vectors[pairs[:, 1]]
    middle = first + second
    normal = np.cross(first, second)
    middle = middle / np.maximum(np.linalg.norm(middle, axis=-1, keepdims=True), 1e-12)
    normal = normal / np.maximum(np.linalg.norm(normal, axis=-1, keepdims=True), 1e-12)
    return np.stack([middle, normal, np.cross(middle, normal)], axis=-1)
