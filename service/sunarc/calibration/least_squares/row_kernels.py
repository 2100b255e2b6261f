"""Residuals and their derivatives by the unknowns, as one compiled loop over the sightings.

tests/calibration/least_squares/test_row_kernels.py has the same in numpy, and compares the two.
"""

from __future__ import annotations

import math
from typing import NamedTuple

import numpy as np

from sunarc.array_types import FloatArray, IntArray
from sunarc.calibration.least_squares.priors import LENS, N_LENS
from sunarc.calibration.robust_loss import UNSEEN_PX
from sunarc.jit import njit
from sunarc.optics import Param
from sunarc.optics.kernels import pixels_of, write_pixel_and_rows, write_rotation

_SIZE = len(Param)
_LENS = np.ascontiguousarray(LENS)
_POSE, _TRANSLATION = int(Param.ROTATION_X), int(Param.TRANSLATION_X)


class Optics(NamedTuple):
    """The kernels' numbers of a camera: projection, mirror and largest angle, see `pixels_of`."""

    code: int
    mirror: float
    max_angle: float


class Sighted(NamedTuple):
    """Sightings: directions (n, 3), pixels (n, 2), 1-sigma of the refraction (n, k), rad, epoch (n,); contiguous.

    systematic_px (n, 2, s): displacements by errors that many share, each at its 1-sigma.
    """

    directions: FloatArray
    pixels: FloatArray
    refraction_sd: FloatArray
    epoch: IntArray
    systematic_px: FloatArray


@njit(nogil=True)
def residuals_of(optics: Optics, vector: FloatArray, seen: Sighted, air: FloatArray) -> FloatArray:
    """Return observed minus predicted pixels (n, 2) of one epoch, `UNSEEN_PX` where the lens shows nothing.

    Parameters
    ----------
    vector : (23,) the epoch's camera.
    air : (k,) departures of the refraction in units of its 1-sigma; (0,): it is as it is assumed.
    """
    rotation, jacobian = np.empty((3, 3)), np.empty((3, 3))
    write_rotation(vector[_POSE : _POSE + 3], rotation, jacobian)
    directions = seen.directions
    if air.size:
        directions, up = np.empty_like(seen.directions), np.empty(3)
        for n in range(directions.shape[0]):
            _write_raised(seen.directions[n], _departure(seen.refraction_sd[n], air), directions[n], up)
    result: FloatArray = pixels_of(vector, optics.code, optics.mirror, optics.max_angle, rotation, directions)
    for n in range(result.shape[0]):
        for c in range(2):
            residual = seen.pixels[n, c] - result[n, c]
            result[n, c] = residual if math.isfinite(residual) else UNSEEN_PX
    return result


@njit(nogil=True)
def residuals_and_rows_of(  # noqa: PLR0917 - compiled functions take positions
    optics: Optics, vectors: FloatArray, seen: Sighted, sizes: FloatArray, air: FloatArray, basis: FloatArray
) -> tuple[FloatArray, FloatArray]:
    """Return the residuals as `residuals_of`, and derivatives of the prediction by the unknowns (n, 2, size).

    Parameters
    ----------
    vectors : (epochs, 23) their cameras.
    sizes : (s,) of the systematic errors.
    basis : (17, 17) of the prior: what a unit of the lens's unknowns does to its parameters.
    """
    count, epochs, k = seen.directions.shape[0], vectors.shape[0], air.size
    s = sizes.size
    size = N_LENS + 3 * epochs + s + k
    residual, rows = np.empty((count, 2)), np.zeros((count, 2, size))
    rotation, jacobian = np.empty((epochs, 3, 3)), np.empty((epochs, 3, 3))
    for e in range(epochs):
        write_rotation(vectors[e, _POSE : _POSE + 3], rotation[e], jacobian[e])
    shape, pixel, row = np.empty(11), np.empty(2), np.zeros((2, _SIZE))
    direction, up, reach = np.empty(3), np.empty(3), _reach_of(basis)
    for n in range(count):
        e = seen.epoch[n]
        _write_raised(seen.directions[n], _departure(seen.refraction_sd[n], air), direction, up)
        shown = write_pixel_and_rows(
            vectors[e], optics.code, optics.mirror, optics.max_angle, rotation[e], jacobian[e], direction,
            shape, pixel, row,
        )  # fmt: skip
        for c in range(2):
            difference = seen.pixels[n, c] - pixel[c] - np.dot(seen.systematic_px[n, c], sizes)
            residual[n, c] = difference if shown and math.isfinite(difference) else UNSEEN_PX
        if not shown:
            continue
        for c in range(2):
            _add_unknowns(row[c], basis, reach, N_LENS + 3 * e, rows[n, c])
            rows[n, c, size - k - s : size - k] = seen.systematic_px[n, c]
            if k:
                _write_air(row[c], rotation[e], up, seen.refraction_sd[n], rows[n, c, size - k :])
    return residual, rows


@njit(nogil=True)
def _add_unknowns(row: FloatArray, basis: FloatArray, reach: IntArray, pose: int, target: FloatArray) -> None:
    """Add the derivatives of one coordinate by the lens's unknowns and by a pose to a row of zeros."""
    for i in range(N_LENS):
        share = row[_LENS[i]]
        if share != 0.0:
            for j in range(reach[i, 0], reach[i, 1]):
                target[j] += share * basis[i, j]
    for a in range(3):
        target[pose + a] = row[_POSE + a]


@njit(nogil=True)
def vectors_of(mean: FloatArray, basis: FloatArray, unknowns: FloatArray, epochs: int) -> FloatArray:
    """Return the cameras (epochs, 23) of some unknowns: lens = mean + basis · its part of them."""
    vectors = np.zeros((epochs, _SIZE))
    for i in range(N_LENS):
        value = mean[i]
        for j in range(N_LENS):
            value += basis[i, j] * unknowns[j]
        vectors[:, _LENS[i]] = value
    for e in range(epochs):
        for a in range(3):
            vectors[e, _POSE + a] = unknowns[N_LENS + 3 * e + a]
    return vectors


@njit(nogil=True)
def _reach_of(basis: FloatArray) -> IntArray:
    """Return (p, 2): the first column of each row that is not 0, and the one after the last: most of a basis is 0."""
    reach = np.zeros((basis.shape[0], 2), dtype=np.int64)
    for i in range(basis.shape[0]):
        for j in range(basis.shape[1]):
            if basis[i, j] != 0.0:
                reach[i, 1] = j + 1
        while reach[i, 0] < reach[i, 1] and basis[i, reach[i, 0]] == 0.0:
            reach[i, 0] += 1
    return reach


@njit(nogil=True)
def _departure(refraction_sd: FloatArray, air: FloatArray) -> float:
    """Return by how much a direction is raised, rad."""
    total = 0.0
    for i in range(air.size):
        total += refraction_sd[i] * air[i]
    return total


@njit(nogil=True)
def _write_raised(direction: FloatArray, angle: float, result: FloatArray, up: FloatArray) -> None:
    """Write a direction turned towards the zenith (3,), and the tangent there (3,): `raised` and `upward`."""
    _write_upward(direction, up)
    cosine, sine = (math.cos(angle), math.sin(angle)) if angle != 0.0 else (1.0, 0.0)
    for i in range(3):
        result[i] = cosine * direction[i] + sine * up[i]
    if angle != 0.0:
        _write_upward(result, up)


@njit(nogil=True)
def _write_upward(direction: FloatArray, up: FloatArray) -> None:
    across = math.sqrt(direction[0] ** 2 + direction[1] ** 2)
    length = across * math.sqrt(across * across + direction[2] ** 2)
    up[0] = -direction[2] * direction[0] / length if length > 0.0 else 0.0
    up[1] = -direction[2] * direction[1] / length if length > 0.0 else 0.0
    up[2] = across * across / length if length > 0.0 else 0.0


@njit(nogil=True)
def _write_air(
    row: FloatArray, rotation: FloatArray, up: FloatArray, refraction_sd: FloatArray, target: FloatArray
) -> None:
    """Write the derivatives of one coordinate by the departures of the refraction (k,)."""
    along = 0.0
    for i in range(3):
        turned = rotation[i, 0] * up[0] + rotation[i, 1] * up[1] + rotation[i, 2] * up[2]
        along += row[_TRANSLATION + i] * turned
    for i in range(target.size):
        target[i] = along * refraction_sd[i]
