"""Sums over a block of sightings: weights, loss and the products of all columns, in vector registers."""

from __future__ import annotations

import math

import numpy as np

from sunarc.array_types import FloatArray, IntArray
from sunarc.calibration.robust_loss import CUT, UNSEEN_PX
from sunarc.jit import njit
from sunarc.optics.block_kernels import BLOCK, N_COLUMNS, PIXEL_X, PIXEL_Y, RESIDUAL, WEIGHT

_PAIR = 2 * BLOCK
_ALONG, _ACROSS = RESIDUAL * _PAIR, RESIDUAL * _PAIR + BLOCK


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
            work[k * _PAIR + i] *= root
            work[k * _PAIR + BLOCK + i] *= root
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
    columns = work[: N_COLUMNS * _PAIR].reshape(N_COLUMNS, _PAIR)
    for a in range(0, products.shape[0], 2):
        for b in range(0, a + 1, 2):
            # four at a time: each number that is loaded is used twice
            both, first, second, neither = 0.0, 0.0, 0.0, 0.0
            for i in range(_PAIR):
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
