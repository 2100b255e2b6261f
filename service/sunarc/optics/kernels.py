"""The lens as compiled loops over many directions and pixels: its one definition, forwards and with derivatives.

Compiled once and kept on disk, without the interpreter's lock (`nogil`), never in parallel by
themselves: who wants two threads starts two.
"""

from __future__ import annotations

import math

import numpy as np

from sunarc.array_types import FloatArray
from sunarc.jit import njit
from sunarc.optics.camera import Param
from sunarc.optics.projections import PROJECTIONS

PROJECTION_CODES = {name: code for code, name in enumerate(PROJECTIONS)}
"""The projections by number, as the kernels know them."""

_RIGHT_ANGLE = math.pi / 2
_ON_AXIS = 1e-12
_SMALL_ANGLE = 1e-3
"""rad; below it the first term left out of the series is 1e-14."""
# plain integers: the compiler indexes faster by them than by members of an enumeration
_FX, _FY, _SKEW = int(Param.FOCAL_LENGTH_X_PX), int(Param.FOCAL_LENGTH_Y_PX), int(Param.SKEW_PX)
_X0, _Y0 = int(Param.PRINCIPAL_POINT_X_PX), int(Param.PRINCIPAL_POINT_Y_PX)
_ROTATION, _TRANSLATION = int(Param.ROTATION_X), int(Param.TRANSLATION_X)
_RADIAL, _RADIALS, _P1, _SIZE = int(Param.K2), int(Param.P1 - Param.K2), int(Param.P1), len(Param)


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
    result = np.empty((directions.shape[0], 2))
    shape = np.empty(11)
    for i in range(directions.shape[0]):
        x, y, z = _in_camera(vector, rotation, directions[i])
        if _shape_at(vector, code, max_angle, x, y, z, shape):
            _write_pixel(vector, mirror, shape, result[i])
        else:
            result[i, 0], result[i, 1] = np.nan, np.nan
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
    n = directions.shape[0]
    pixels = np.empty((n, 2))
    rows = np.zeros((n, 2, _SIZE))
    shape = np.empty(11)
    for i in range(n):
        if not write_pixel_and_rows(
            vector, code, mirror, max_angle, rotation, jacobian, directions[i], shape, pixels[i], rows[i]
        ):
            pixels[i, 0], pixels[i, 1] = np.nan, np.nan
    return pixels, rows


@njit(nogil=True, inline="always")  # called once a sighting: as a call it costs a third more
def write_pixel_and_rows(  # noqa: PLR0917 - compiled functions take positions
    vector: FloatArray,
    code: int,
    mirror: float,
    max_angle: float,
    rotation: FloatArray,
    jacobian: FloatArray,
    direction: FloatArray,
    shape: FloatArray,
    pixel: FloatArray,
    row: FloatArray,
) -> bool:
    """Write one pixel (2,) and its derivatives (2, 23); return False, and write nothing, beyond the largest angle.

    `shape` (11,) is room for what the lens makes of the ray. The other arguments as of `pixels_and_rows_of`.
    """
    x, y, z = _in_camera(vector, rotation, direction)
    if not _shape_at(vector, code, max_angle, x, y, z, shape):
        return False
    _lens_rows(vector, mirror, shape, pixel, row)
    _vector_rows(vector, mirror, shape, x, y, z, row)
    _pose_rows(rotation, jacobian, direction, row)
    return True


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


@njit(nogil=True)
def _in_camera(vector: FloatArray, rotation: FloatArray, direction: FloatArray) -> tuple[float, float, float]:
    """Return R w + t."""
    e, north, up = direction[0], direction[1], direction[2]
    return (
        rotation[0, 0] * e + rotation[0, 1] * north + rotation[0, 2] * up + vector[_TRANSLATION],
        rotation[1, 0] * e + rotation[1, 1] * north + rotation[1, 2] * up + vector[_TRANSLATION + 1],
        rotation[2, 0] * e + rotation[2, 1] * north + rotation[2, 2] * up + vector[_TRANSLATION + 2],
    )


@njit(nogil=True)
def _shape_at(  # noqa: PLR0917 - compiled functions take positions
    vector: FloatArray, code: int, max_angle: float, x: float, y: float, z: float, shape: FloatArray
) -> bool:
    """Write what the lens makes of a ray: θ, r̂, dr̂/dθ, u, v, profile, bracket, d(x̂, ŷ)/dr̂, distance from the axis."""
    across = math.sqrt(x * x + y * y)
    theta = math.atan2(across, z)
    if not theta <= max_angle:
        return False
    radius, slope = radius_and_slope(code, vector[_RADIAL:_P1], theta)
    p1, p2, p3, p4 = vector[_P1], vector[_P1 + 1], vector[_P1 + 2], vector[_P1 + 3]
    u, v = (x / across, y / across) if across > _ON_AXIS else (1.0, 0.0)
    square = radius * radius
    bx, by = decentering_bracket(p1, p2, u, v)
    rise = radius * (2.0 + square * (4.0 * p3 + square * 6.0 * p4))
    shape[0], shape[1], shape[2], shape[3], shape[4] = theta, radius, slope, u, v
    shape[5], shape[6], shape[7] = square * (1.0 + square * (p3 + square * p4)), bx, by
    shape[8], shape[9], shape[10] = u + rise * bx, v + rise * by, across
    return True


@njit(nogil=True)
def _write_pixel(vector: FloatArray, mirror: float, shape: FloatArray, pixel: FloatArray) -> tuple[float, float]:
    """Write the pixel, and return (x̂, ŷ)."""
    x_hat = shape[1] * shape[3] + shape[5] * shape[6]
    y_hat = shape[1] * shape[4] + shape[5] * shape[7]
    column = vector[_FX] * x_hat + vector[_SKEW] * y_hat + vector[_X0]
    pixel[0] = mirror - column if mirror >= 0.0 else column
    pixel[1] = vector[_FY] * y_hat + vector[_Y0]
    return x_hat, y_hat


@njit(nogil=True)
def _lens_rows(vector: FloatArray, mirror: float, shape: FloatArray, pixel: FloatArray, row: FloatArray) -> None:
    """Write the pixel and its derivatives by K, k and p."""
    theta, radius, u, v, profile = shape[0], shape[1], shape[3], shape[4], shape[5]
    bx, by, gx, gy = shape[6], shape[7], shape[8], shape[9]
    sign = -1.0 if mirror >= 0.0 else 1.0
    ax, ay, skew = sign * vector[_FX], vector[_FY], sign * vector[_SKEW]
    x_hat, y_hat = _write_pixel(vector, mirror, shape, pixel)
    row[0, _FX], row[1, _FY], row[0, _SKEW] = sign * x_hat, y_hat, sign * y_hat
    row[0, _X0], row[1, _Y0] = sign, 1.0
    tau = theta / _RIGHT_ANGLE
    power = tau * tau
    for k in range(_RADIALS):
        row[0, _RADIAL + k], row[1, _RADIAL + k] = power * (ax * gx + skew * gy), power * ay * gy
        power *= tau
    both, first, second = profile * 2.0 * u * v, profile * (1.0 + 2.0 * u * u), profile * (1.0 + 2.0 * v * v)
    row[0, _P1], row[1, _P1] = ax * first + skew * both, ay * both
    row[0, _P1 + 1], row[1, _P1 + 1] = ax * both + skew * second, ay * second
    fourth = radius**4
    row[0, _P1 + 2], row[1, _P1 + 2] = fourth * (ax * bx + skew * by), fourth * ay * by
    sixth = fourth * radius * radius
    row[0, _P1 + 3], row[1, _P1 + 3] = sixth * (ax * bx + skew * by), sixth * ay * by


@njit(nogil=True)
def _vector_rows(  # noqa: PLR0917 - compiled functions take positions
    vector: FloatArray, mirror: float, shape: FloatArray, x: float, y: float, z: float, row: FloatArray
) -> None:
    """Write the derivatives by the vector in the camera frame, which are those by the translation."""
    radius, slope, u, v, profile = shape[1], shape[2], shape[3], shape[4], shape[5]
    gx, gy, across = shape[8], shape[9], shape[10]
    sign = -1.0 if mirror >= 0.0 else 1.0
    ax, ay, skew = sign * vector[_FX], vector[_FY], sign * vector[_SKEW]
    p1, p2 = vector[_P1], vector[_P1 + 1]
    on_axis = across <= _ON_AXIS
    norm = x * x + y * y + z * z
    per_norm = slope / z if on_axis else radius / across
    twist = 0.0 if on_axis else profile / across
    sin2, cos2 = 2.0 * u * v, u * u - v * v
    hx = -v * per_norm + twist * (-2.0 * p1 * sin2 + 2.0 * p2 * cos2)
    hy = u * per_norm + twist * (2.0 * p1 * cos2 + 2.0 * p2 * sin2)
    by_x, by_y, by_z = slope * z * u / norm, slope * z * v / norm, -slope * across / norm
    cx, cy, dx, dy = gx * by_x - hx * v, gy * by_x - hy * v, gx * by_y + hx * u, gy * by_y + hy * u
    row[0, _TRANSLATION], row[1, _TRANSLATION] = ax * cx + skew * cy, ay * cy
    row[0, _TRANSLATION + 1], row[1, _TRANSLATION + 1] = ax * dx + skew * dy, ay * dy
    row[0, _TRANSLATION + 2], row[1, _TRANSLATION + 2] = (ax * gx + skew * gy) * by_z, ay * gy * by_z


@njit(nogil=True)
def _pose_rows(rotation: FloatArray, jacobian: FloatArray, direction: FloatArray, row: FloatArray) -> None:
    """Write the derivatives by the rotation vector: d(R w) = R (J dr × w)."""
    e, north, up = direction[0], direction[1], direction[2]
    for c in range(2):
        vx, vy, vz = row[c, _TRANSLATION], row[c, _TRANSLATION + 1], row[c, _TRANSLATION + 2]
        wx = vx * rotation[0, 0] + vy * rotation[1, 0] + vz * rotation[2, 0]
        wy = vx * rotation[0, 1] + vy * rotation[1, 1] + vz * rotation[2, 1]
        wz = vx * rotation[0, 2] + vy * rotation[1, 2] + vz * rotation[2, 2]
        mx, my, mz = north * wz - up * wy, up * wx - e * wz, e * wy - north * wx
        for a in range(3):
            row[c, _ROTATION + a] = mx * jacobian[0, a] + my * jacobian[1, a] + mz * jacobian[2, a]
