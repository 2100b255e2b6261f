"""Residuals and their derivatives by the unknowns, and the sums over them, as compiled loops over the sightings.

tests/calibration/least_squares/test_row_kernels.py has the same in numpy, and compares the two.
"""

from __future__ import annotations

import math
from typing import NamedTuple

import numpy as np

from sunarc.array_types import FloatArray, IntArray
from sunarc.calibration.robust_loss import CUT, UNSEEN_PX
from sunarc.calibration.solve.priors import LENS, N_LENS
from sunarc.jit import njit
from sunarc.optics.camera import Param
from sunarc.optics.kernels import (
    BLOCK,
    N_COLUMNS,
    N_NATIVE,
    PIXEL_X,
    PIXEL_Y,
    RESIDUAL,
    WEIGHT,
    WORK,
    Optics,
    pixels_of,
    write_block,
    write_rotation,
)

_PAIR_SIZE = 2 * BLOCK
_ALONG, _ACROSS = RESIDUAL * _PAIR_SIZE, RESIDUAL * _PAIR_SIZE + BLOCK


@njit(nogil=True)
def block_size(epoch: IntArray, begin: int) -> int:
    """Return how many sightings from one on share its epoch, at most a block."""
    size, most = 1, min(BLOCK, epoch.size - begin)
    while size < most and epoch[begin + size] == epoch[begin]:
        size += 1
    return size


@njit(nogil=True, error_model="numpy", fastmath={"contract", "reassoc"})
def weigh(  # noqa: PLR0917 - compiled functions take positions
    work: FloatArray, pixels: FloatArray, information: FloatArray, begin: int, size: int, sigma: float
) -> float:
    """Write the residuals, multiply all columns by the roots of the sightings' weights, and return the loss.

    Parameters
    ----------
    work : of a block, see `write_block`.
    pixels, information : (n, 2), (n,) of all sightings, of which the block has `size` from `begin` on.
    sigma : px, scale of Tukey's loss; 0 takes half the plain squares.
    """
    _write_residuals(work, pixels, information, begin, size)
    loss = float(_write_roots(work, sigma))
    for i in range(BLOCK):
        root = work[WEIGHT + i]
        for k in range(N_COLUMNS):
            work[k * _PAIR_SIZE + i] *= root
            work[k * _PAIR_SIZE + BLOCK + i] *= root
    return loss


@njit(nogil=True)
def _write_residuals(work: FloatArray, pixels: FloatArray, information: FloatArray, begin: int, size: int) -> None:
    """Write observed minus predicted pixels and the information; 0 in the places beyond the size."""
    for i in range(size):
        work[_ALONG + i] = pixels[begin + i, 0] - work[PIXEL_X + i]
        work[_ACROSS + i] = pixels[begin + i, 1] - work[PIXEL_Y + i]
        work[WEIGHT + i] = information[begin + i]
    for i in range(size, BLOCK):
        work[_ALONG + i], work[_ACROSS + i], work[WEIGHT + i] = 0.0, 0.0, 0.0


@njit(nogil=True, error_model="numpy", fastmath={"contract", "reassoc"})
def _write_roots(work: FloatArray, sigma: float) -> float:
    """Write the roots of the weights in place of the information; return the loss."""
    plain = sigma <= 0.0
    cut, inverse = (0.0, 1.0) if plain else (1.0 / (CUT * sigma) ** 2, 1.0 / sigma)
    squares, losses = 0.0, 0.0
    for i in range(BLOCK):
        dx, dy, weight = work[_ALONG + i], work[_ACROSS + i], work[WEIGHT + i]
        shown = abs(dx) + abs(dy) < math.inf
        dx, dy = dx if shown else UNSEEN_PX, dy if shown else UNSEEN_PX
        square = (dx * dx + dy * dy) * weight
        left = 1.0 - min(square * cut, 1.0)
        squares += square
        losses += 1.0 - left * left * left
        work[_ALONG + i], work[_ACROSS + i] = dx, dy
        work[WEIGHT + i] = inverse * left * math.sqrt(weight) if shown else 0.0
    return 0.5 * squares if plain else CUT * CUT / 6.0 * losses


@njit(nogil=True, error_model="numpy", fastmath={"contract", "reassoc"})
def add_products(work: FloatArray, products: FloatArray) -> None:
    """Add the scalar products of the first c columns with one another: the lower half of (c, c), c even."""
    columns = work[: N_COLUMNS * _PAIR_SIZE].reshape(N_COLUMNS, _PAIR_SIZE)
    for a in range(0, products.shape[0], 2):
        for b in range(0, a + 1, 2):
            # four at a time: each number that is loaded is used twice
            both, first, second, neither = 0.0, 0.0, 0.0, 0.0
            for i in range(_PAIR_SIZE):
                even, odd = columns[a, i], columns[a + 1, i]
                left, right = columns[b, i], columns[b + 1, i]
                both += even * left
                first += even * right
                second += odd * left
                neither += odd * right
            products[a, b] += both
            products[a, b + 1] += first
            products[a + 1, b] += second
            products[a + 1, b + 1] += neither


@njit(nogil=True)
def reach_of(basis: FloatArray) -> IntArray:
    """Return (p, 2): the first column of each row that is not 0, and the one after the last: most of a basis is 0."""
    reach = np.zeros((basis.shape[0], 2), dtype=np.int64)
    for i in range(basis.shape[0]):
        for j in range(basis.shape[1]):
            if basis[i, j] != 0.0:
                reach[i, 1] = j + 1
        while reach[i, 0] < reach[i, 1] and basis[i, reach[i, 0]] == 0.0:
            reach[i, 0] += 1
    return reach


_SIZE = len(Param)
_LENS = np.ascontiguousarray(LENS)
_POSE = int(Param.ROTATION_X)
# Sums over a block of sightings: weights, loss and the products of all columns, in vector registers.

_PAIR = 2 * BLOCK


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
    directions, _ = _in_air(seen, air)
    result: FloatArray = pixels_of(vector, optics, rotation, directions)
    for n in range(result.shape[0]):
        for c in range(2):
            residual = seen.pixels[n, c] - result[n, c]
            result[n, c] = residual if math.isfinite(residual) else UNSEEN_PX
    return result


@njit(nogil=True)
def residuals_and_columns_of(  # noqa: PLR0917 - compiled functions take positions
    optics: Optics, vectors: FloatArray, seen: Sighted, sizes: FloatArray, air: FloatArray, basis: FloatArray
) -> tuple[FloatArray, FloatArray]:
    """Return the residuals (2, n) as of `residuals_of`, and derivatives of the prediction by the unknowns (2, size, n).

    Parameters
    ----------
    vectors : (epochs, 23) their cameras.
    sizes : (s,) of the systematic errors.
    basis : (17, 17) of the prior: what a unit of the lens's unknowns does to its parameters.
    """
    count, epochs, k = seen.directions.shape[0], vectors.shape[0], air.size
    size = N_LENS + 3 * epochs + sizes.size + k
    residual, columns = np.empty((2, count)), np.zeros((2, size, count))
    rotation, jacobian = np.empty((epochs, 3, 3)), np.empty((epochs, 3, 3))
    for e in range(epochs):
        write_rotation(vectors[e, _POSE : _POSE + 3], rotation[e], jacobian[e])
    directions, up = _in_air(seen, air)
    work, own, reach = np.empty(WORK), np.empty((N_NATIVE, _PAIR)), reach_of(basis)
    begin = 0
    while begin < count:
        e, n = seen.epoch[begin], block_size(seen.epoch, begin)
        write_block(vectors[e], optics, rotation[e], jacobian[e], directions[begin : begin + n], work)
        _write_lens_unknowns(work, basis, reach, own)
        for c in range(2):
            for j in range(N_NATIVE):
                place = j if j < N_LENS else j + 3 * e
                columns[c, place, begin : begin + n] = own[j, c * BLOCK : c * BLOCK + n]
        for i in range(begin, begin + n):
            shown = math.isfinite(work[PIXEL_X + i - begin])
            for c in range(2):
                difference = seen.pixels[i, c] - work[PIXEL_X + c * BLOCK + i - begin]
                difference -= np.dot(seen.systematic_px[i, c], sizes)
                residual[c, i] = difference if shown and math.isfinite(difference) else UNSEEN_PX
                if shown:
                    columns[c, size - k - sizes.size : size - k, i] = seen.systematic_px[i, c]
                if shown and k:
                    by_air = _along(work, c * BLOCK + i - begin, rotation[e], up[i])
                    for a in range(k):
                        columns[c, size - k + a, i] = by_air * seen.refraction_sd[i, a]
        begin += n
    return residual, columns


@njit(nogil=True, error_model="numpy", fastmath={"contract"})
def _write_lens_unknowns(work: FloatArray, basis: FloatArray, reach: IntArray, own: FloatArray) -> None:
    """Write the derivatives of a block by the lens's unknowns and by its pose (20, 2 BLOCK)."""
    own[:N_LENS] = 0.0
    for i in range(N_LENS):
        column = work[i * _PAIR : (i + 1) * _PAIR]
        for j in range(reach[i, 0], reach[i, 1]):
            target, share = own[j], basis[i, j]
            for n in range(_PAIR):
                target[n] += share * column[n]
    for i in range(N_LENS, N_NATIVE):
        own[i] = work[i * _PAIR : (i + 1) * _PAIR]


@njit(nogil=True)
def _along(work: FloatArray, place: int, rotation: FloatArray, up: FloatArray) -> float:
    """Return the derivative of one coordinate by the elevation of its direction; `up` (3,) is the tangent there."""
    total = 0.0
    for i in range(3):
        turned = rotation[i, 0] * up[0] + rotation[i, 1] * up[1] + rotation[i, 2] * up[2]
        total += work[(RESIDUAL + 1 + i) * _PAIR + place] * turned
    return total


@njit(nogil=True)
def _in_air(seen: Sighted, air: FloatArray) -> tuple[FloatArray, FloatArray]:
    """Return the directions in air that departs from the assumed one, and the tangents to the zenith there (n, 3)."""
    if air.size == 0:
        return seen.directions, seen.directions
    directions, up = np.empty_like(seen.directions), np.empty_like(seen.directions)
    for n in range(directions.shape[0]):
        _write_raised(seen.directions[n], _departure(seen.refraction_sd[n], air), directions[n], up[n])
    return directions, up


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
