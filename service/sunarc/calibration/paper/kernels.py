"""The paper's fit (Eq. 26) as one compiled loop: residuals, penalties and normal equations without arrays of rows.

`Penalties.values_and_slopes` and `stages.equations` are the same in numpy, and the tests compare the two. It runs
without the interpreter's lock (`nogil`).
"""

from __future__ import annotations

import math
from typing import NamedTuple

import numpy as np

from sunarc.array_types import FloatArray, IntArray
from sunarc.calibration.least_squares.block_sums import add_products, weigh
from sunarc.calibration.least_squares.kernels import (
    LARGEST_DAMPING,
    SMALLEST_DAMPING,
    Seen,
    damped_step_of,
)
from sunarc.jit import njit
from sunarc.optics.block_kernels import BLOCK, N_COLUMNS, PARAMETERS, WORK, write_block
from sunarc.optics.camera import Param
from sunarc.optics.kernels import decentering_bracket, write_rotation

_SIZE = len(Param)
_FX, _FY, _SKEW = int(Param.FOCAL_LENGTH_X_PX), int(Param.FOCAL_LENGTH_Y_PX), int(Param.SKEW_PX)
_RADIAL, _RADIALS, _P1, _POSE = int(Param.K2), int(Param.P1 - Param.K2), int(Param.P1), int(Param.ROTATION_X)


class Weighed(NamedTuple):
    """The penalties c1, c2, c3 as numbers, see `Penalties`; the weights are in them, those of c2 and c3 over √n.

    orthogonality (8,); circularity, edge_radius, edge_powers (8,), cosine and sine (24,) of the edge, and whether its
    shape contains the decentering; monotony, ideal_slope (181,) and slope_by_radial (181, 8).
    """

    orthogonality: FloatArray
    circularity: float
    edge_radius: float
    edge_powers: FloatArray
    cosine: FloatArray
    sine: FloatArray
    with_decentering: bool
    monotony: float
    ideal_slope: FloatArray
    slope_by_radial: FloatArray


class Optics(NamedTuple):
    """The kernels' numbers of a camera: projection, mirror and largest angle, see `pixels_of`."""

    code: int
    mirror: float
    max_angle: float


class Limits(NamedTuple):
    """When the steps end: how many at most, the share of the cost that a step must gain; and their first damping."""

    most_steps: int
    gain: float
    first_damping: float


@njit(nogil=True)
def minimised(  # noqa: PLR0917 - compiled functions take positions
    optics: Optics, seen: Seen, weighed: Weighed, start: FloatArray, moving: IntArray, limits: Limits
) -> FloatArray:
    """Return the parameters (23,) where Levenberg-Marquardt rests: where a step gains less than a share of the cost.

    `moving` (f,) are the places of the parameters that may change.
    """
    vector, trial, f = start.copy(), start.copy(), moving.size
    normal, next_normal = np.empty((_SIZE, _SIZE)), np.empty((_SIZE, _SIZE))
    gradient, next_gradient = np.empty(_SIZE), np.empty(_SIZE)
    work, step, damping = np.empty((f, f)), np.empty(f), limits.first_damping
    cost = equations(optics, seen, weighed, vector, normal, gradient)
    for _ in range(limits.most_steps):
        damped_step_of(normal, gradient, moving, damping, work, step)
        trial[:] = vector
        for i in range(f):
            trial[moving[i]] += step[i]
        next_cost = equations(optics, seen, weighed, trial, next_normal, next_gradient)
        if not next_cost <= cost:
            damping *= 10.0
            if damping > LARGEST_DAMPING:
                break
            continue
        gained, cost = cost - next_cost, next_cost
        vector[:] = trial
        normal, next_normal = next_normal, normal
        gradient, next_gradient = next_gradient, gradient
        damping = max(damping * 0.1, SMALLEST_DAMPING)
        if gained <= limits.gain * cost:
            break
    return vector


@njit(nogil=True)
def equations(  # noqa: PLR0917 - compiled functions take positions
    optics: Optics, seen: Seen, weighed: Weighed, vector: FloatArray, normal: FloatArray, gradient: FloatArray
) -> float:
    """Write the normal equations (23, 23) and the pull (23,) of Eq. 26 at some parameters; return its squares."""
    normal[:] = 0.0
    gradient[:] = 0.0
    rotation, jacobian = np.empty((3, 3)), np.empty((3, 3))
    write_rotation(vector[_POSE : _POSE + 3], rotation, jacobian)
    work, products = np.empty(WORK), np.zeros((N_COLUMNS, N_COLUMNS))
    cost, n = 0.0, seen.directions.shape[0]
    for begin in range(0, n, BLOCK):
        size = min(BLOCK, n - begin)
        write_block(
            vector, optics.code, optics.mirror, optics.max_angle, rotation, jacobian, seen.directions, begin, size, work
        )
        cost += 2.0 * weigh(work, seen.pixels, seen.information, begin, size, 0.0)
        add_products(work, products)
    _by_parameters(products, normal, gradient)
    cost += _orthogonality(weighed, vector, normal, gradient) + _circularity(weighed, vector, normal, gradient)
    cost += _monotony(weighed, vector, normal, gradient)
    for i in range(_SIZE):
        for j in range(i):
            normal[j, i] = normal[i, j]
    return cost if math.isfinite(cost) else math.inf


@njit(nogil=True)
def _by_parameters(products: FloatArray, normal: FloatArray, gradient: FloatArray) -> None:
    """Write the products (24, 24; lower half) of a block's columns in the order of the parameters."""
    for a in range(N_COLUMNS):
        for b in range(a + 1):
            i, j = max(PARAMETERS[a], PARAMETERS[b]), min(PARAMETERS[a], PARAMETERS[b])
            if j >= 0:
                normal[i, j] = products[a, b]
            elif i >= 0:
                gradient[i] = products[a, b]


@njit(nogil=True)
def _orthogonality(weighed: Weighed, vector: FloatArray, normal: FloatArray, gradient: FloatArray) -> float:
    """Add c1, and return its square."""
    row, value = np.zeros(_SIZE), 0.0
    for k in range(_RADIALS):
        row[_RADIAL + k] = weighed.orthogonality[k]
        value += weighed.orthogonality[k] * vector[_RADIAL + k]
    return float(_add(row, value, normal, gradient))


@njit(nogil=True)
def _circularity(weighed: Weighed, vector: FloatArray, normal: FloatArray, gradient: FloatArray) -> float:
    """Add c2, and return its square: the deviations of the edge's distance from its mean."""
    count = weighed.cosine.size
    rows, distances = np.zeros((count, _SIZE)), np.empty(count)
    radius = weighed.edge_radius
    for k in range(_RADIALS):
        radius += weighed.edge_powers[k] * vector[_RADIAL + k]
    for i in range(count):
        distances[i] = _edge_row(weighed, vector, radius, weighed.cosine[i], weighed.sine[i], rows[i])
    mean, mean_row, cost = distances.mean(), np.zeros(_SIZE), 0.0
    for i in range(count):
        mean_row += rows[i] / count
    for i in range(count):
        row = weighed.circularity * (rows[i] - mean_row)
        cost += _add(row, weighed.circularity * (distances[i] - mean), normal, gradient)
    return cost


@njit(nogil=True)
def _edge_row(  # noqa: PLR0917 - compiled functions take positions
    weighed: Weighed, vector: FloatArray, radius: float, u: float, v: float, row: FloatArray
) -> float:
    """Return the distance of the edge's image from the principal point, px, and write its derivatives (23,)."""
    fx, fy, skew = vector[_FX], vector[_FY], vector[_SKEW]
    gx, gy, x_hat, y_hat = u, v, radius * u, radius * v
    bx, by, square = 0.0, 0.0, radius * radius
    profile = 0.0
    if weighed.with_decentering:
        p1, p2, p3, p4 = vector[_P1], vector[_P1 + 1], vector[_P1 + 2], vector[_P1 + 3]
        bx, by = decentering_bracket(p1, p2, u, v)
        profile = square * (1.0 + square * (p3 + square * p4))
        rise = radius * (2.0 + square * (4.0 * p3 + square * 6.0 * p4))
        gx, gy, x_hat, y_hat = u + rise * bx, v + rise * by, x_hat + profile * bx, y_hat + profile * by
    x, y = fx * x_hat + skew * y_hat, fy * y_hat
    distance = math.hypot(x, y)
    # by x̂ and ŷ
    ax, ay = x / distance * fx, (x * skew + y * fy) / distance
    row[_FX], row[_FY], row[_SKEW] = x / distance * x_hat, y / distance * y_hat, x / distance * y_hat
    for k in range(_RADIALS):
        row[_RADIAL + k] = (ax * gx + ay * gy) * weighed.edge_powers[k]
    if weighed.with_decentering:
        both = 2.0 * u * v
        row[_P1] = profile * (ax * (1.0 + 2.0 * u * u) + ay * both)
        row[_P1 + 1] = profile * (ax * both + ay * (1.0 + 2.0 * v * v))
        row[_P1 + 2] = square * square * (ax * bx + ay * by)
        row[_P1 + 3] = square * square * square * (ax * bx + ay * by)
    return distance


@njit(nogil=True)
def _monotony(weighed: Weighed, vector: FloatArray, normal: FloatArray, gradient: FloatArray) -> float:
    """Add c3, and return its square: the radius's slope where it falls."""
    row, cost = np.zeros(_SIZE), 0.0
    for i in range(weighed.ideal_slope.size):
        slope = weighed.ideal_slope[i]
        for k in range(_RADIALS):
            slope += weighed.slope_by_radial[i, k] * vector[_RADIAL + k]
        if slope < 0.0:
            for k in range(_RADIALS):
                row[_RADIAL + k] = weighed.monotony * weighed.slope_by_radial[i, k]
            cost += _add(row, weighed.monotony * slope, normal, gradient)
    return cost


@njit(nogil=True)
def _add(row: FloatArray, value: float, normal: FloatArray, gradient: FloatArray) -> float:
    """Add one penalty's row (23,) and value to the lower half of the equations, and return its square."""
    for i in range(_SIZE):
        if row[i] == 0.0:
            continue
        gradient[i] -= row[i] * value
        for j in range(i + 1):
            normal[i, j] += row[i] * row[j]
    return value * value
