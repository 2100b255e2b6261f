"""The exact inverse of the lens as compiled loops: Newton's method in the plane, then for the angle, pixel by pixel.

They release the interpreter's lock; `inverse` says what they solve.
"""

from __future__ import annotations

import math

import numpy as np

from sunarc.array_types import FloatArray
from sunarc.jit import njit
from sunarc.optics.kernels import radius_and_slope

_ITERATIONS = 30
_TOLERANCE = 1e-14
_LAST_STEP = 1e-10
"""A step of Newton's method this small leaves an error of its square."""


@njit(nogil=True, error_model="numpy")
def without_decentering(decentering: FloatArray, x_hat: FloatArray, y_hat: FloatArray) -> None:
    """Replace points (n,), in focal lengths, by those q with q + shift(q) at them: Eq. 12 taken out."""
    p1, p2, p3, p4 = decentering[0], decentering[1], decentering[2], decentering[3]
    for i in range(x_hat.size):
        x, y = x_hat[i], y_hat[i]
        for _ in range(_ITERATIONS):
            xx, yy, xy = x * x, y * y, 2.0 * x * y
            square = xx + yy
            profile, rise = 1.0 + square * (p3 + square * p4), 2.0 * (p3 + 2.0 * square * p4)
            a, b = p1 * (square + 2.0 * xx) + p2 * xy, p1 * xy + p2 * (square + 2.0 * yy)
            both = 2.0 * (p1 * y + p2 * x)
            jxx = 1.0 + rise * x * a + profile * (6.0 * p1 * x + 2.0 * p2 * y)
            jyy = 1.0 + rise * y * b + profile * (2.0 * p1 * x + 6.0 * p2 * y)
            jxy, jyx = rise * y * a + profile * both, rise * x * b + profile * both
            fx, fy = x + profile * a - x_hat[i], y + profile * b - y_hat[i]
            determinant = jxx * jyy - jxy * jyx
            dx, dy = (jyy * fx - jxy * fy) / determinant, (jxx * fy - jyx * fx) / determinant
            x, y = x - dx, y - dy
            if not abs(dx) + abs(dy) > _TOLERANCE:
                break
        x_hat[i], y_hat[i] = x, y


@njit(nogil=True, error_model="numpy")
def angles_of(code: int, radial: FloatArray, first: FloatArray, limit: float, radius: FloatArray) -> FloatArray:
    """Return the angles (n,) off the axis, rad, that radii (n,) in focal lengths are imaged from; NaN beyond a limit.

    Parameters
    ----------
    code : number of the projection.
    radial : k2 … k9.
    first : (m,) angles at radii spread evenly from 0 to that of the limit: where the steps begin.
    limit : largest angle, rad.
    radius : NaN where there is none.
    """
    result = np.empty(radius.size)
    edge = radius_and_slope(code, radial, limit)[0]
    last = first.size - 1
    for i in range(radius.size):
        if not radius[i] <= edge * (1.0 + 1e-12):
            result[i] = math.nan
            continue
        position = min(max(radius[i] / edge, 0.0), 1.0) * last
        piece = min(int(position), last - 1)
        theta = first[piece] + (position - piece) * (first[piece + 1] - first[piece])
        for _ in range(_ITERATIONS):
            found, slope = radius_and_slope(code, radial, theta)
            following = min(max(theta - (found - radius[i]) / slope, 0.0), limit)
            moved = abs(following - theta)
            theta = following
            if not moved > _LAST_STEP:
                break
        result[i] = theta
    return result
