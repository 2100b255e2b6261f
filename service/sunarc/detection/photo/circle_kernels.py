"""Compiled loops of the circle through a rim: on 180 points numpy's cost a call would be most of the time.

Plain loops, which compile in seconds; kept on disk, without the interpreter's lock (docs/decisions/0013-kernels.md).
"""

from __future__ import annotations

import math

import numpy as np

from sunarc.array_types import FloatArray
from sunarc.cholesky import solved
from sunarc.jit import njit
from sunarc.robust_statistics import MAD_TO_SIGMA

_CUT_OUTSIDE, _CUT_INSIDE = 2.5, 4.0  # scales of Tukey's weights: harder outside, where cloud and streaks are
_MOST_ROUNDS = 20
_SETTLED_PX = 1e-3
_HELD = 1e-6  # of x, y and radius: where few points follow, a step stays finite
_SIZE = 5  # x, y, radius, and the cosine and sine of twice the angle
_LEAST_CROSS_PX2 = 1e-6  # three points with less are on a line


@njit(nogil=True)
def _weight(residual: float, scale: float) -> float:
    """Return Tukey's weight of a distance from a circle, outwards positive."""
    ratio = residual / ((_CUT_OUTSIDE if residual > 0.0 else _CUT_INSIDE) * scale)
    inner = 1.0 - ratio * ratio
    return inner * inner if inner > 0.0 else 0.0


@njit(nogil=True)
def _residuals(points: FloatArray, state: FloatArray, residual: FloatArray, design: FloatArray) -> None:
    """Write the distances of points from the rim of a state, outwards positive, and their derivatives."""
    for i in range(points.shape[0]):
        dx, dy = points[i, 0] - state[0], points[i, 1] - state[1]
        length = max(math.sqrt(dx * dx + dy * dy), 1e-6)
        dx, dy = dx / length, dy / length
        design[i, 0], design[i, 1], design[i, 2] = dx, dy, 1.0
        design[i, 3], design[i, 4] = dx * dx - dy * dy, 2.0 * dx * dy
        residual[i] = length - state[2] - design[i, 3] * state[3] - design[i, 4] * state[4]


@njit(nogil=True)
def _step(
    residual: FloatArray, design: FloatArray, state: FloatArray, scale: float, held: float
) -> tuple[FloatArray, int]:
    """Return the step of Gauss and Newton from a state, and how many points have a weight."""
    normal, step, inliers = np.zeros((_SIZE, _SIZE)), np.zeros(_SIZE), 0
    for i in range(residual.size):
        weight = _weight(residual[i], scale)
        if weight > 0.0:
            inliers += 1
            for j in range(_SIZE):
                step[j] += design[i, j] * weight * residual[i]
                for k in range(_SIZE):
                    normal[j, k] += design[i, j] * weight * design[i, k]
    for j in range(3):
        normal[j, j] += _HELD
    for j in range(3, _SIZE):
        normal[j, j] += held
        step[j] -= held * state[j]
    if not solved(normal, step):
        step[:] = 0.0
    return step, inliers


@njit(nogil=True)
def fitted_rim(  # noqa: PLR0917 - compiled functions take positions
    points: FloatArray,
    start: FloatArray,
    scale: float,
    drawn_out: float,
    least_points: int,
    least_scales: tuple[float, float],
) -> tuple[FloatArray, float, FloatArray]:
    """Fit a circle whose radius varies with twice the angle, by Gauss and Newton with one-sided weights.

    Parameters
    ----------
    points : (n, 2), px. start : x, y, radius, px. scale : scatter of the points about that, px.
    drawn_out : 1-sigma of the variation over the radius, about 0.
    least_points : points with a weight below which there is no circle.
    least_scales : of the scatter, px and of the radius.

    Returns
    -------
    State (x, y, radius, cosine and sine of the variation), scatter in px, and the residuals (n,) before the last step.
    The scatter is negative where there is no circle.
    """
    n = points.shape[0]
    state, residual, design = np.zeros(_SIZE), np.zeros(n), np.zeros((n, _SIZE))
    state[:3] = start
    for _ in range(_MOST_ROUNDS):
        _residuals(points, state, residual, design)
        held = (scale / (drawn_out * state[2])) ** 2
        step, inliers = _step(residual, design, state, scale, held)
        most, largest = 0.5 * state[2], 0.0
        for k in range(_SIZE):
            largest = max(largest, abs(step[k]))
            state[k] += min(max(step[k], -most), most)
        if inliers < least_points or state[2] < 1.0:
            return state, -1.0, residual
        absolute, count = np.zeros(inliers), 0
        for i in range(n):
            if _weight(residual[i], scale) > 0.0:
                absolute[count] = abs(residual[i])
                count += 1
        absolute.sort()
        middle = 0.5 * (absolute[(inliers - 1) // 2] + absolute[inliers // 2])
        scale = max(MAD_TO_SIGMA * middle, least_scales[0], least_scales[1] * state[2])
        if largest < _SETTLED_PX:
            break
    return state, scale, residual


@njit(nogil=True)
def circles_through(points: FloatArray) -> FloatArray:
    """Return the circles through triples of neighbours by a sixth to a third of the points, (m, 3): x, y, radius.

    The triples are fixed ones, so that every arc is tried. NaN where three are on a line.
    """
    n = points.shape[0]
    count = (3 * n + 1) // 2
    found = np.empty((count, 3))
    for row in range(count):
        part, first = (3, 4, 6)[2 * row // n], 2 * row % n
        ax, ay = points[first, 0], points[first, 1]
        second, third = (first + n // part) % n, (first + 2 * n // part) % n
        bx, by = points[second, 0] - ax, points[second, 1] - ay
        cx, cy = points[third, 0] - ax, points[third, 1] - ay
        cross = 2.0 * (bx * cy - by * cx)
        if abs(cross) < _LEAST_CROSS_PX2:
            found[row, :] = np.nan
            continue
        b2, c2 = bx * bx + by * by, cx * cx + cy * cy
        dx, dy = (cy * b2 - by * c2) / cross, (bx * c2 - cx * b2) / cross
        found[row, 0], found[row, 1], found[row, 2] = ax + dx, ay + dy, math.sqrt(dx * dx + dy * dy)
    return found


@njit(nogil=True)
def most_followed(points: FloatArray, circles: FloatArray, scale: float) -> int:
    """Return which circle has the largest sum of the points' weights, the first of equals; NaN has none."""
    best, most = 0, 0.0
    for row in range(circles.shape[0]):
        x, y, radius = circles[row, 0], circles[row, 1], circles[row, 2]
        if math.isnan(x):
            continue
        total, left = 0.0, points.shape[0]
        for i in range(points.shape[0]):
            dx, dy = points[i, 0] - x, points[i, 1] - y
            total += _weight(math.sqrt(dx * dx + dy * dy) - radius, scale)
            left -= 1
            if total + left <= most:  # no weight is above 1
                break
        if total > most:
            best, most = row, total
    return best


@njit(nogil=True)
def crossings(light: FloatArray, level: float, lasting: int, radii: FloatArray) -> FloatArray:
    """Return the radius on each ray from which the light stays below a level for some samples, (rays,).

    Parameters
    ----------
    light : (rays, radii), NaN where it is not known. level : of the light. lasting : samples.
    radii : of the samples, px, equidistant.

    NaN where the light does not fall, a ray begins below the level, or is not known before it falls.
    """
    rays, samples = light.shape
    found, step = np.full(rays, np.nan), radii[1] - radii[0]
    for ray in range(rays):
        run = 0
        for k in range(samples):
            value = light[ray, k]
            if math.isnan(value):
                break
            run = run + 1 if value < level else 0
            if run == lasting:
                first = k - lasting + 1
                if first > 0:
                    share = (light[ray, first - 1] - level) / max(light[ray, first - 1] - light[ray, first], 1e-6)
                    found[ray] = radii[first - 1] + min(max(share, 0.0), 1.0) * step
                break
    return found
