"""Directions of many pixels from a table of cubic pieces, as a compiled loop; `fast` makes the table."""

from __future__ import annotations

import math
from typing import NamedTuple

import numpy as np

from sunarc.array_types import FloatArray
from sunarc.jit import njit

_BLOCK = 512
"""Pixels taken together, so that the simple loops run in vector registers."""


class InverseConstants(NamedTuple):
    """Numbers of a camera's inverse, as the kernels take them.

    per_fx, per_fy : inverse focal lengths, 1/px. skew, x0, y0 : px. mirror : see `pixels_of`. p1 … p4 : decentering.
    per_radius : pieces of the table per unit of the radius. limit : largest radius. exact_from : radius from which on
    the table is too coarse.
    """

    per_fx: float
    per_fy: float
    skew: float
    x0: float
    y0: float
    mirror: float
    p1: float
    p2: float
    p3: float
    p4: float
    per_radius: float
    limit: float
    exact_from: float


@njit(nogil=True)
def calibrated_of(constants: InverseConstants, x: float, y: float) -> tuple[float, float]:
    """Return (x̂, ŷ) of a pixel: in focal lengths from the axis, the decentering still in it."""
    y_hat = (y - constants.y0) * constants.per_fy
    column = constants.mirror - x if constants.mirror >= 0.0 else x
    return (column - constants.x0 - constants.skew * y_hat) * constants.per_fx, y_hat


@njit(nogil=True, fastmath={"contract", "reassoc", "arcp", "nsz"})
def decentering_of(constants: InverseConstants, x: float, y: float) -> tuple[float, float]:
    """Return the shift of Eq. 12 at a point in focal lengths."""
    xx, yy, xy = x * x, y * y, 2.0 * x * y
    square = xx + yy
    profile = 1.0 + square * (constants.p3 + square * constants.p4)
    p1, p2 = constants.p1, constants.p2
    return profile * (p1 * (square + 2.0 * xx) + p2 * xy), profile * (p1 * xy + p2 * (square + 2.0 * yy))


@njit(nogil=True, fastmath={"contract", "reassoc", "arcp", "nsz"})
def directions_of(  # noqa: PLR0917 - one loop, compiled; functions take positions
    constants: InverseConstants,
    rotation: FloatArray,
    table: FloatArray,
    rounds: int,
    pixels: FloatArray,
    result: FloatArray,
) -> bool:
    """Write the directions (n, 3) that pixels (n, 2) look at, from a table of cubic pieces (see `InverseTable`).

    Infinite where the table is too coarse; returned is whether it is anywhere.
    """
    coarse = False
    last = table.shape[0] - 1.0
    xe, xn, xu = rotation[0, 0], rotation[0, 1], rotation[0, 2]
    ye, yn, yu = rotation[1, 0], rotation[1, 1], rotation[1, 2]
    ze, zn, zu = rotation[2, 0], rotation[2, 1], rotation[2, 2]
    x_hat, y_hat = np.empty(_BLOCK), np.empty(_BLOCK)
    x, y, radius = np.empty(_BLOCK), np.empty(_BLOCK), np.empty(_BLOCK)
    for begin in range(0, pixels.shape[0], _BLOCK):
        size = min(_BLOCK, pixels.shape[0] - begin)
        for k in range(size):
            x_hat[k], y_hat[k] = calibrated_of(constants, pixels[begin + k, 0], pixels[begin + k, 1])
            x[k], y[k] = x_hat[k], y_hat[k]
        for _ in range(rounds):
            for k in range(size):
                shift_x, shift_y = decentering_of(constants, x[k], y[k])
                x[k], y[k] = x_hat[k] - shift_x, y_hat[k] - shift_y
        for k in range(size):
            radius[k] = math.sqrt(x[k] * x[k] + y[k] * y[k])
        for k in range(size):
            i = begin + k
            if not radius[k] <= constants.limit:
                result[i, 0], result[i, 1], result[i, 2] = np.nan, np.nan, np.nan
                continue
            if radius[k] > constants.exact_from:
                result[i, 0], coarse = np.inf, True
                continue
            position = radius[k] * constants.per_radius
            piece = np.uint64(min(position, last))
            s = position - piece
            scale = table[piece, 0] + s * (table[piece, 1] + s * (table[piece, 2] + s * table[piece, 3]))
            z = table[piece, 4] + s * (table[piece, 5] + s * (table[piece, 6] + s * table[piece, 7]))
            result[i, 0] = scale * (xe * x[k] + ye * y[k]) + ze * z
            result[i, 1] = scale * (xn * x[k] + yn * y[k]) + zn * z
            result[i, 2] = scale * (xu * x[k] + yu * y[k]) + zu * z
    return coarse
