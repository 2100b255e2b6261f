"""The lens as compiled loops over many directions: pixels and their derivatives, see `block_kernels`.

Compiled once and kept on disk, without the interpreter's lock (`nogil`), never in parallel by
themselves: who wants two threads starts two.
"""

from __future__ import annotations

import math

import numpy as np

from sunarc.array_types import FloatArray
from sunarc.jit import njit
from sunarc.optics.block_kernels import (
    BLOCK,
    N_COLUMNS,
    PARAMETERS,
    PIXEL_X,
    PIXEL_Y,
    RESIDUAL,
    WORK,
    write_block,
    write_pixels,
)
from sunarc.optics.camera import Param
from sunarc.optics.projections import PROJECTIONS

PROJECTION_CODES = {name: code for code, name in enumerate(PROJECTIONS)}
"""The projections by number, as the kernels know them."""

_RIGHT_ANGLE = math.pi / 2
_SMALL_ANGLE = 1e-3
"""rad; below it the first term left out of the series is 1e-14."""
_SIZE = len(Param)


@njit(nogil=True)
def radius_and_slope(code: int, radial: FloatArray, theta: float) -> tuple[float, float]:
    """Return the radius of Eq. 9 at an angle, rad, in focal lengths, and its derivative."""
    if code == 0:
        ideal, slope = math.tan(theta), 1.0 / math.cos(theta) ** 2
    elif code == 1:
        ideal, slope = theta, 1.0
    elif code == 2:
        ideal, slope = 2.0 * math.sin(0.5 * theta), math.cos(0.5 * theta)
    elif code == 3:
        ideal, slope = 2.0 * math.tan(0.5 * theta), 1.0 / math.cos(0.5 * theta) ** 2
    else:
        ideal, slope = math.sin(theta), math.cos(theta)
    distortion, rise = distortion_and_slope(radial, theta)
    return ideal + distortion, slope + rise


@njit(nogil=True, inline="always")
def distortion_and_slope(radial: FloatArray, theta: float) -> tuple[float, float]:
    """Return the polynomial of Eq. 9 at an angle, rad, in focal lengths, and its derivative."""
    tau = theta / _RIGHT_ANGLE
    value, derivative = 0.0, 0.0
    for i in range(7, -1, -1):
        derivative = derivative * tau + value
        value = value * tau + radial[i]
    # value = Σ k_n tau^(n-2): the distortion is tau² value, its slope 2 tau value + tau² derivative
    return tau * tau * value, (2.0 * tau * value + tau * tau * derivative) / _RIGHT_ANGLE


@njit(nogil=True)
def decentering_bracket(p1: float, p2: float, u: float, v: float) -> tuple[float, float]:
    """Return the bracket of Eq. 12 in the direction (u, v): the shift over its radial profile."""
    return p1 * (1.0 + 2.0 * u * u) + 2.0 * p2 * u * v, 2.0 * p1 * u * v + p2 * (1.0 + 2.0 * v * v)


@njit(nogil=True)
def pixels_of(  # noqa: PLR0917 - compiled functions take positions
    vector: FloatArray, code: int, mirror: float, max_angle: float, rotation: FloatArray, directions: FloatArray
) -> FloatArray:
    """Return (n, 2) pixels of directions (n, 3): `project` for the 23 parameters of `vector`.

    `mirror` is width - 1 for a mirrored image, negative for one that is not.
    """
    n, work = directions.shape[0], np.empty(WORK)
    result = np.empty((n, 2))
    for begin in range(0, n, BLOCK):
        size = min(BLOCK, n - begin)
        write_pixels(vector, code, mirror, max_angle, rotation, directions, begin, size, work)
        _take_pixels(work, result[begin : begin + size])
    return result


@njit(nogil=True)
def pixels_and_rows_of(  # noqa: PLR0917 - compiled functions take positions
    vector: FloatArray,
    code: int,
    mirror: float,
    max_angle: float,
    rotation: FloatArray,
    jacobian: FloatArray,
    directions: FloatArray,
) -> tuple[FloatArray, FloatArray]:
    """Return pixels (n, 2) and their derivatives by the 23 parameters (n, 2, 23): `project_with_jacobian`.

    `jacobian` is the right Jacobian of the rotation vector. Beyond the largest angle pixels are NaN, derivatives 0.
    """
    n, work = directions.shape[0], np.empty(WORK)
    pixels, rows = np.empty((n, 2)), np.zeros((n, 2, _SIZE))
    for begin in range(0, n, BLOCK):
        size = min(BLOCK, n - begin)
        write_block(vector, code, mirror, max_angle, rotation, jacobian, directions, begin, size, work)
        _take_pixels(work, pixels[begin : begin + size])
        for k in range(N_COLUMNS):
            if k != RESIDUAL:
                for i in range(size):
                    for c in range(2):
                        rows[begin + i, c, PARAMETERS[k]] = work[(2 * k + c) * BLOCK + i]
    return pixels, rows


@njit(nogil=True)
def _take_pixels(work: FloatArray, result: FloatArray) -> None:
    """Write the pixels (n, 2) of a block."""
    for i in range(result.shape[0]):
        result[i, 0], result[i, 1] = work[PIXEL_X + i], work[PIXEL_Y + i]


@njit(nogil=True)
def write_rotation(w: FloatArray, rotation: FloatArray, jacobian: FloatArray) -> None:
    """Write `rotation_matrix` (3, 3) and `right_jacobian` (3, 3) of a rotation vector (3,)."""
    square = w[0] * w[0] + w[1] * w[1] + w[2] * w[2]
    angle = math.sqrt(square)
    if angle < _SMALL_ANGLE:  # series: the quotients lose their digits near 0
        first, second, third = 1.0 - square / 6.0, 0.5 - square / 24.0, 1.0 / 6.0 - square / 120.0
    else:
        first, second = math.sin(angle) / angle, (1.0 - math.cos(angle)) / square
        third = (1.0 - first) / square
    for i in range(3):
        for j in range(3):
            same = 1.0 if i == j else 0.0
            twice = w[i] * w[j] - same * square  # the square of the skew matrix
            rotation[i, j] = same + second * twice
            jacobian[i, j] = same + third * twice
    for i, j, k in ((0, 1, 2), (1, 2, 0), (2, 0, 1)):
        rotation[i, j] -= first * w[k]
        rotation[j, i] += first * w[k]
        jacobian[i, j] += second * w[k]
        jacobian[j, i] -= second * w[k]
