"""The lens as compiled loops over many directions: pixels and their derivatives, a block of directions at a time.

A block's numbers stand in one work array: rows of `BLOCK` numbers, one a direction, so that the compiler sees that
no two of them overlap and the loops run in vector registers: they have no branches and call no function of a
mathematical library. `forward` has the same in numpy, and the tests compare the two.

Compiled once and kept on disk, without the interpreter's lock (`nogil`), never in parallel by themselves: who wants two
threads starts two.
"""

from __future__ import annotations

import math
from typing import NamedTuple

import numpy as np

from sunarc.array_types import FloatArray
from sunarc.jit import njit
from sunarc.optics.camera import Param
from sunarc.optics.projections import PROJECTIONS

BLOCK = 64
"""Directions of a block: their work array stays within the processor's first cache."""
_ON_AXIS = 1e-12
_RIGHT_ANGLE = math.pi / 2
PERSPECTIVE, EQUIDISTANT, EQUISOLID = (PROJECTIONS[name].code for name in ("perspective", "equidistant", "equisolid"))
STEREOGRAPHIC = PROJECTIONS["stereographic"].code
_SHAPES = np.array([lens.shape for lens in sorted(PROJECTIONS.values())])
"""Of the projections, by code."""
_FX, _FY, _SKEW = int(Param.FOCAL_LENGTH_X_PX), int(Param.FOCAL_LENGTH_Y_PX), int(Param.SKEW_PX)
_X0, _Y0 = int(Param.PRINCIPAL_POINT_X_PX), int(Param.PRINCIPAL_POINT_Y_PX)
_TRANSLATION, _RADIAL, _RADIALS, _P1 = int(Param.TRANSLATION_X), int(Param.K2), int(Param.P1 - Param.K2), int(Param.P1)

N_LENS, N_NATIVE, N_COLUMNS = 17, 20, 24
"""Columns of a work array: derivatives by the lens, by the lens and the pose, and all with what stands beside."""
RESIDUAL = N_NATIVE
"""The column that is left for residuals, right after the derivatives by lens and pose."""
PARAMETERS = np.array(
    [
        *range(_FX, _FX + 5),
        *range(_RADIAL, _P1 + 4),
        *range(int(Param.ROTATION_X), _TRANSLATION),
        -1,
        *range(_TRANSLATION, _TRANSLATION + 3),
    ]
)
"""The parameter of each column; -1: the residuals'."""

_PAIR = 2 * BLOCK
"""A column: the block's derivatives of x, then those of y."""
_C_FX, _C_FY, _C_SKEW, _C_X0, _C_Y0 = (k * _PAIR for k in range(5))
_C_RADIAL, _C_P1, _C_POSE, _C_TRANSLATION = 5 * _PAIR, 13 * _PAIR, 17 * _PAIR, 21 * _PAIR
_COLUMNS_END = N_COLUMNS * _PAIR
(
    PIXEL_X, PIXEL_Y, _EAST, _NORTH, _UP, _X, _Y, _Z, _ACROSS, _SQUARE, _HALF, _THETA, _RADIUS, _SLOPE, _U, _V,
    _PROFILE, _BX, _BY, _GX, _GY, _X_HAT, _Y_HAT, WEIGHT,
) = range(_COLUMNS_END, _COLUMNS_END + 24 * BLOCK, BLOCK)  # fmt: skip
WORK = _COLUMNS_END + 24 * BLOCK
"""Numbers in the work array of a block."""


def _arctangent() -> FloatArray:
    """Return coefficients of atan(t) / t by powers of t² up to t = tan(π / 8), to 1e-16."""
    edge = math.tan(math.pi / 8.0) ** 2

    def quotient(square: FloatArray) -> FloatArray:
        root = np.sqrt(np.maximum(square, 1e-30))
        return np.asarray(np.arctan(root) / root)

    fitted = np.polynomial.Chebyshev.interpolate(quotient, 13, domain=[0.0, edge])
    return np.ascontiguousarray(fitted.convert(kind=np.polynomial.Polynomial).coef)


_ARCTANGENT = _arctangent()
_TERMS = _ARCTANGENT.size


class Optics(NamedTuple):
    """What the kernels take of a camera beside its 23 parameters.

    code : of the projection (`projections.PROJECTIONS`). mirror : width - 1 of a mirrored image, negative for one that
    is not. max_angle : angle off the axis up to which it shows anything, radians.
    """

    code: int
    mirror: float
    max_angle: float


@njit(nogil=True)
def require_projection_code(code: int) -> None:
    """Raise ValueError where no projection has this code."""
    if not 0 <= code < _SHAPES.size:
        raise ValueError("no projection has this code")


@njit(nogil=True, error_model="numpy", fastmath={"contract"})
def write_block(  # noqa: PLR0917 - compiled functions take positions
    vector: FloatArray,
    optics: Optics,
    rotation: FloatArray,
    jacobian: FloatArray,
    directions: FloatArray,
    work: FloatArray,
) -> None:
    """Write pixels and derivatives of directions (n, 3), n at most BLOCK, to a work array (WORK,).

    Where the lens shows nothing the pixel is NaN and the derivatives are 0. Places beyond n repeat the last direction.
    The other arguments as of `pixels_and_rows_of`.
    """
    write_pixels(vector, optics, rotation, directions, work)
    _write_lens(vector, optics.mirror, work)
    _write_vector(vector, optics.mirror, work)
    _write_pose(rotation, jacobian, work)
    _blank(work)


@njit(nogil=True, error_model="numpy", fastmath={"contract"})
def write_pixels(
    vector: FloatArray, optics: Optics, rotation: FloatArray, directions: FloatArray, work: FloatArray
) -> None:
    """Write what `write_block` does but for the derivatives."""
    _place(vector, rotation, directions, work)
    _write_angles(work)
    _write_ideal(optics.code, work)
    _distort(vector, work)
    sign, base = (-1.0, optics.mirror) if optics.mirror >= 0.0 else (1.0, 0.0)
    max_angle = optics.max_angle
    ax, ay, skew = sign * vector[_FX], vector[_FY], sign * vector[_SKEW]
    x0, y0 = base + sign * vector[_X0], vector[_Y0]
    for i in range(BLOCK):
        shown = work[_THETA + i] <= max_angle
        x_hat, y_hat = work[_X_HAT + i], work[_Y_HAT + i]
        work[PIXEL_X + i] = ax * x_hat + skew * y_hat + x0 if shown else math.nan
        work[PIXEL_Y + i] = ay * y_hat + y0 if shown else math.nan


@njit(nogil=True, error_model="numpy", fastmath={"contract"})
def _place(vector: FloatArray, rotation: FloatArray, directions: FloatArray, work: FloatArray) -> None:
    """Write the directions and R w + t."""
    last = directions.shape[0] - 1
    for i in range(BLOCK):
        n = min(i, last)
        work[_EAST + i], work[_NORTH + i], work[_UP + i] = directions[n, 0], directions[n, 1], directions[n, 2]
    for row, target in ((0, _X), (1, _Y), (2, _Z)):
        by_e, by_n, by_u = rotation[row, 0], rotation[row, 1], rotation[row, 2]
        shift = vector[_TRANSLATION + row]
        for i in range(BLOCK):
            work[target + i] = by_e * work[_EAST + i] + by_n * work[_NORTH + i] + by_u * work[_UP + i] + shift


@njit(nogil=True, error_model="numpy", fastmath={"contract"})
def _write_angles(work: FloatArray) -> None:
    """Write the angle off the axis, the tangent of its half, and the azimuth's cosine and sine."""
    for i in range(BLOCK):
        x, y, z = work[_X + i], work[_Y + i], work[_Z + i]
        flat = x * x + y * y
        square, across = flat + z * z, math.sqrt(flat)
        acute = across / (math.sqrt(square) + abs(z))
        quarter = acute / (1.0 + math.sqrt(1.0 + acute * acute))
        argument, total = quarter * quarter, 0.0
        for n in range(_TERMS - 1, -1, -1):
            total = total * argument + _ARCTANGENT[n]
        angle = 4.0 * quarter * total
        work[_THETA + i] = angle if z >= 0.0 else math.pi - angle
        work[_HALF + i] = acute if z >= 0.0 else 1.0 / acute
        work[_ACROSS + i], work[_SQUARE + i] = across, square
        off_axis = across > _ON_AXIS
        work[_U + i] = x / across if off_axis else 1.0
        work[_V + i] = y / across if off_axis else 0.0


@njit(nogil=True, error_model="numpy", fastmath={"contract"})
def _write_ideal(code: int, work: FloatArray) -> None:
    """Write the ideal radius, in focal lengths, and its derivative by the angle."""
    require_projection_code(code)
    if code == PERSPECTIVE:
        for i in range(BLOCK):
            work[_RADIUS + i] = work[_ACROSS + i] / work[_Z + i]
            work[_SLOPE + i] = work[_SQUARE + i] / (work[_Z + i] * work[_Z + i])
    elif code == EQUIDISTANT:
        for i in range(BLOCK):
            work[_RADIUS + i], work[_SLOPE + i] = work[_THETA + i], 1.0
    elif code == EQUISOLID:
        for i in range(BLOCK):
            half = work[_HALF + i]
            cosine = 1.0 / math.sqrt(1.0 + half * half)
            work[_RADIUS + i], work[_SLOPE + i] = 2.0 * half * cosine, cosine
    elif code == STEREOGRAPHIC:
        for i in range(BLOCK):
            half = work[_HALF + i]
            work[_RADIUS + i], work[_SLOPE + i] = 2.0 * half, 1.0 + half * half
    else:  # orthographic
        for i in range(BLOCK):
            per_length = 1.0 / math.sqrt(work[_SQUARE + i])
            work[_RADIUS + i], work[_SLOPE + i] = work[_ACROSS + i] * per_length, work[_Z + i] * per_length


@njit(nogil=True, error_model="numpy", fastmath={"contract"})
def _distort(vector: FloatArray, work: FloatArray) -> None:
    """Add the polynomial of Eq. 9, and write the decentering's profile and bracket, x̂, ŷ and their slopes by r̂."""
    k2, k3, k4, k5 = vector[_RADIAL], vector[_RADIAL + 1], vector[_RADIAL + 2], vector[_RADIAL + 3]
    k6, k7, k8, k9 = vector[_RADIAL + 4], vector[_RADIAL + 5], vector[_RADIAL + 6], vector[_RADIAL + 7]
    p1, p2, p3, p4 = vector[_P1], vector[_P1 + 1], vector[_P1 + 2], vector[_P1 + 3]
    for i in range(BLOCK):
        tau = work[_THETA + i] / _RIGHT_ANGLE
        value = k2 + tau * (k3 + tau * (k4 + tau * (k5 + tau * (k6 + tau * (k7 + tau * (k8 + tau * k9))))))
        last = 6.0 * k6 + tau * (7.0 * k7 + tau * (8.0 * k8 + tau * 9.0 * k9))
        rise = 2.0 * k2 + tau * (3.0 * k3 + tau * (4.0 * k4 + tau * (5.0 * k5 + tau * last)))
        radius = work[_RADIUS + i] + tau * tau * value
        work[_RADIUS + i] = radius
        work[_SLOPE + i] += tau * rise / _RIGHT_ANGLE
        u, v, square = work[_U + i], work[_V + i], radius * radius
        bx, by = p1 * (1.0 + 2.0 * u * u) + 2.0 * p2 * u * v, 2.0 * p1 * u * v + p2 * (1.0 + 2.0 * v * v)
        profile = square * (1.0 + square * (p3 + square * p4))
        work[_X_HAT + i], work[_Y_HAT + i] = radius * u + profile * bx, radius * v + profile * by
        growth = radius * (2.0 + square * (4.0 * p3 + square * 6.0 * p4))
        work[_PROFILE + i], work[_BX + i], work[_BY + i] = profile, bx, by
        work[_GX + i], work[_GY + i] = u + growth * bx, v + growth * by


@njit(nogil=True, error_model="numpy", fastmath={"contract"})
def _write_lens(vector: FloatArray, mirror: float, work: FloatArray) -> None:
    """Write the derivatives by K, k and p."""
    sign = -1.0 if mirror >= 0.0 else 1.0
    ax, ay, skew = sign * vector[_FX], vector[_FY], sign * vector[_SKEW]
    for i in range(BLOCK):
        x_hat, y_hat = work[_X_HAT + i], work[_Y_HAT + i]
        work[_C_FX + i], work[_C_FY + BLOCK + i], work[_C_SKEW + i] = sign * x_hat, y_hat, sign * y_hat
        work[_C_X0 + i], work[_C_Y0 + BLOCK + i] = sign, 1.0
        work[_C_FX + BLOCK + i] = work[_C_FY + i] = work[_C_SKEW + BLOCK + i] = 0.0
        work[_C_X0 + BLOCK + i] = work[_C_Y0 + i] = 0.0
    for i in range(BLOCK):
        tau = work[_THETA + i] / _RIGHT_ANGLE
        along = tau * tau * (ax * work[_GX + i] + skew * work[_GY + i])
        down = tau * tau * ay * work[_GY + i]
        for k in range(_RADIALS):
            work[_C_RADIAL + k * _PAIR + i], work[_C_RADIAL + k * _PAIR + BLOCK + i] = along, down
            along *= tau
            down *= tau
    for i in range(BLOCK):
        radius, u, v, profile = work[_RADIUS + i], work[_U + i], work[_V + i], work[_PROFILE + i]
        both, first, second = profile * 2.0 * u * v, profile * (1.0 + 2.0 * u * u), profile * (1.0 + 2.0 * v * v)
        work[_C_P1 + i], work[_C_P1 + BLOCK + i] = ax * first + skew * both, ay * both
        work[_C_P1 + _PAIR + i], work[_C_P1 + _PAIR + BLOCK + i] = ax * both + skew * second, ay * second
        square = radius * radius
        along = square * square * (ax * work[_BX + i] + skew * work[_BY + i])
        down = square * square * ay * work[_BY + i]
        work[_C_P1 + 2 * _PAIR + i], work[_C_P1 + 2 * _PAIR + BLOCK + i] = along, down
        work[_C_P1 + 3 * _PAIR + i], work[_C_P1 + 3 * _PAIR + BLOCK + i] = square * along, square * down


@njit(nogil=True, error_model="numpy", fastmath={"contract"})
def _write_vector(vector: FloatArray, mirror: float, work: FloatArray) -> None:
    """Write the derivatives by the vector in the camera frame, which are those by the translation."""
    sign = -1.0 if mirror >= 0.0 else 1.0
    ax, ay, skew = sign * vector[_FX], vector[_FY], sign * vector[_SKEW]
    p1, p2 = vector[_P1], vector[_P1 + 1]
    for i in range(BLOCK):
        z, across, slope, u, v = work[_Z + i], work[_ACROSS + i], work[_SLOPE + i], work[_U + i], work[_V + i]
        gx, gy = work[_GX + i], work[_GY + i]
        on_axis = across <= _ON_AXIS
        per_norm = slope / z if on_axis else work[_RADIUS + i] / across
        twist = 0.0 if on_axis else work[_PROFILE + i] / across
        sin2, cos2 = 2.0 * u * v, u * u - v * v
        hx = -v * per_norm + twist * (-2.0 * p1 * sin2 + 2.0 * p2 * cos2)
        hy = u * per_norm + twist * (2.0 * p1 * cos2 + 2.0 * p2 * sin2)
        tilt = slope / work[_SQUARE + i]
        by_x, by_y, by_z = tilt * z * u, tilt * z * v, -tilt * across
        cx, cy, dx, dy = gx * by_x - hx * v, gy * by_x - hy * v, gx * by_y + hx * u, gy * by_y + hy * u
        work[_C_TRANSLATION + i] = ax * cx + skew * cy
        work[_C_TRANSLATION + BLOCK + i] = ay * cy
        work[_C_TRANSLATION + _PAIR + i] = ax * dx + skew * dy
        work[_C_TRANSLATION + _PAIR + BLOCK + i] = ay * dy
        work[_C_TRANSLATION + 2 * _PAIR + i] = (ax * gx + skew * gy) * by_z
        work[_C_TRANSLATION + 2 * _PAIR + BLOCK + i] = ay * gy * by_z


@njit(nogil=True, error_model="numpy", fastmath={"contract"})
def _write_pose(rotation: FloatArray, jacobian: FloatArray, work: FloatArray) -> None:
    """Write the derivatives by the rotation vector: d(R w) = R (J dr × w)."""
    r00, r01, r02 = rotation[0, 0], rotation[0, 1], rotation[0, 2]
    r10, r11, r12 = rotation[1, 0], rotation[1, 1], rotation[1, 2]
    r20, r21, r22 = rotation[2, 0], rotation[2, 1], rotation[2, 2]
    j00, j01, j02 = jacobian[0, 0], jacobian[0, 1], jacobian[0, 2]
    j10, j11, j12 = jacobian[1, 0], jacobian[1, 1], jacobian[1, 2]
    j20, j21, j22 = jacobian[2, 0], jacobian[2, 1], jacobian[2, 2]
    for c in range(2):
        for i in range(BLOCK):
            k = c * BLOCK + i
            vx, vy = work[_C_TRANSLATION + k], work[_C_TRANSLATION + _PAIR + k]
            vz = work[_C_TRANSLATION + 2 * _PAIR + k]
            e, north, up = work[_EAST + i], work[_NORTH + i], work[_UP + i]
            wx, wy, wz = vx * r00 + vy * r10 + vz * r20, vx * r01 + vy * r11 + vz * r21, vx * r02 + vy * r12 + vz * r22
            mx, my, mz = north * wz - up * wy, up * wx - e * wz, e * wy - north * wx
            work[_C_POSE + k] = mx * j00 + my * j10 + mz * j20
            work[_C_POSE + _PAIR + k] = mx * j01 + my * j11 + mz * j21
            work[_C_POSE + 2 * _PAIR + k] = mx * j02 + my * j12 + mz * j22


@njit(nogil=True, error_model="numpy", fastmath={"contract"})
def _blank(work: FloatArray) -> None:
    """Write 0 for the derivatives where there is no finite pixel."""
    seen = 0
    for i in range(BLOCK):
        seen += int(abs(work[PIXEL_X + i]) + abs(work[PIXEL_Y + i]) < math.inf)
    if seen == BLOCK:
        return
    for i in range(BLOCK):
        if not abs(work[PIXEL_X + i]) + abs(work[PIXEL_Y + i]) < math.inf:
            for k in range(N_COLUMNS):
                work[k * _PAIR + i], work[k * _PAIR + BLOCK + i] = 0.0, 0.0


_SMALL_ANGLE = 1e-3
"""rad; below it the first term left out of the series is 1e-14."""
_SIZE = len(Param)


@njit(nogil=True)
def radius_and_slope(code: int, radial: FloatArray, theta: float) -> tuple[float, float]:
    """Return the radius of Eq. 9 at an angle, rad, in focal lengths, and its derivative.

    Raises
    ------
    ValueError : no projection has this code.
    """
    require_projection_code(code)
    shape = _SHAPES[code]
    if shape > 0.0:
        ideal, slope = math.tan(shape * theta) / shape, 1.0 / math.cos(shape * theta) ** 2
    elif shape < 0.0:
        ideal, slope = math.sin(shape * theta) / shape, math.cos(shape * theta)
    else:
        ideal, slope = theta, 1.0
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
def pixels_of(vector: FloatArray, optics: Optics, rotation: FloatArray, directions: FloatArray) -> FloatArray:
    """Return (n, 2) pixels of directions (n, 3): `project` for the 23 parameters of `vector`."""
    n, work = directions.shape[0], np.empty(WORK)
    result = np.empty((n, 2))
    for begin in range(0, n, BLOCK):
        write_pixels(vector, optics, rotation, directions[begin : begin + BLOCK], work)
        _take_pixels(work, result[begin : begin + BLOCK])
    return result


@njit(nogil=True)
def pixels_and_rows_of(
    vector: FloatArray, optics: Optics, rotation: FloatArray, jacobian: FloatArray, directions: FloatArray
) -> tuple[FloatArray, FloatArray]:
    """Return pixels (n, 2) and their derivatives by the 23 parameters (n, 2, 23): `project_with_jacobian`.

    `jacobian` is the right Jacobian of the rotation vector. Beyond the largest angle pixels are NaN, derivatives 0.
    """
    n, work = directions.shape[0], np.empty(WORK)
    pixels, rows = np.empty((n, 2)), np.zeros((n, 2, _SIZE))
    for begin in range(0, n, BLOCK):
        size = min(BLOCK, n - begin)
        write_block(vector, optics, rotation, jacobian, directions[begin : begin + BLOCK], work)
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
