"""What is computed for each of some hundred plausible choices of scales, as compiled loops.

tests/calibration/fit/test_choices_kernel.py and test_hyperparameter_marginalisation.py have the same in numpy, and
compare the two. They release the interpreter's lock.
"""

from __future__ import annotations

import math

import numpy as np

from sunarc.array_types import FloatArray
from sunarc.jit import njit

_FAR = 40.0
"""exp(-40) is 4e-18: nothing beside 1."""
_SQUARINGS = 6
_TAYLOR = np.array([(-1.0) ** n / math.factorial(n) for n in range(13)])
"""Of exp(-t) to t = 40 / 2⁶: what is left out is 4e-13."""
_TERMS = _TAYLOR.size


@njit(nogil=True, error_model="numpy", fastmath={"contract", "reassoc"})
def write_inverses(matrix: FloatArray, diagonals: FloatArray, ridge: float, result: FloatArray) -> bool:
    """Write the inverses (k, p, p) of a matrix (p, p) plus diagonals (k, p); return False where one is not positive.

    By Cholesky's factorisation, the diagonals brought to 1 and a ridge added to them first.
    """
    p = matrix.shape[0]
    upper, inverse, scale = np.zeros((p, p)), np.zeros((p, p)), np.empty(p)
    for number in range(diagonals.shape[0]):
        for i in range(p):
            scale[i] = 1.0 / math.sqrt(matrix[i, i] + diagonals[number, i])
        for i in range(p):
            for j in range(i + 1, p):
                upper[i, j] = matrix[i, j] * scale[i] * scale[j]
            upper[i, i] = 1.0 + ridge
        if not _factor(upper):
            return False
        _invert(upper, inverse)
        _square(inverse, scale, result[number])
    return True


@njit(nogil=True, error_model="numpy", fastmath={"contract", "reassoc"})
def _factor(upper: FloatArray) -> bool:
    """Replace the upper half of a matrix by U with U' U that matrix, row by row; False where it is not positive."""
    p = upper.shape[0]
    for j in range(p):
        if not upper[j, j] > 0.0:
            return False
        scale = 1.0 / math.sqrt(upper[j, j])
        row = upper[j]
        for c in range(j, p):
            row[c] *= scale
        for i in range(j + 1, p):
            below, share = upper[i], row[i]
            for c in range(i, p):
                below[c] -= share * row[c]
    return True


@njit(nogil=True, error_model="numpy", fastmath={"contract", "reassoc"})
def _invert(upper: FloatArray, inverse: FloatArray) -> None:
    """Write the inverse of an upper matrix (p, p), itself upper."""
    p = upper.shape[0]
    for i in range(p - 1, -1, -1):
        row = inverse[i]
        row[i:] = 0.0
        row[i] = 1.0
        for k in range(i + 1, p):
            below, share = inverse[k], upper[i, k]
            for c in range(k, p):
                row[c] -= share * below[c]
        scale = 1.0 / upper[i, i]
        for c in range(i, p):
            row[c] *= scale


@njit(nogil=True, error_model="numpy", fastmath={"contract", "reassoc"})
def _square(inverse: FloatArray, scale: FloatArray, result: FloatArray) -> None:
    """Write V V' of an upper matrix V (p, p), its rows and columns scaled."""
    p = scale.size
    for i in range(p):
        for j in range(i + 1):
            first, second, total = inverse[i], inverse[j], 0.0
            for c in range(i, p):
                total += first[c] * second[c]
            result[i, j] = result[j, i] = scale[i] * scale[j] * total


@njit(nogil=True, error_model="numpy", fastmath={"contract", "reassoc"})
def add_moments(left: FloatArray, right: FloatArray, covariances: FloatArray, result: FloatArray) -> None:
    """Add L' C R made symmetric, xx, xy and yy at n places, to (k, 3, n): L and R (p, 2 n), x before y, C (k, p, p)."""
    p, n = left.shape[0], result.shape[2]
    through = np.empty_like(left)
    for number in range(covariances.shape[0]):
        np.dot(covariances[number], left, through)
        xx, xy, yy = result[number, 0], result[number, 1], result[number, 2]
        for i in range(p):
            x, y, by_x, by_y = through[i, :n], through[i, n:], right[i, :n], right[i, n:]
            for k in range(n):
                xx[k] += x[k] * by_x[k]
                xy[k] += 0.5 * (x[k] * by_y[k] + y[k] * by_x[k])
                yy[k] += y[k] * by_y[k]


@njit(nogil=True, error_model="numpy", fastmath={"contract", "reassoc"})
def write_coverage(
    moments: FloatArray, stated: FloatArray, ellipse: float, cosines: FloatArray, result: FloatArray
) -> None:
    """Write (k,): the shares of Gaussians (k, 3, n) within ellipses of stated covariances (3, n).

    As half of the eigenvalues' sum and of their difference make them, see `hyperparameter_marginalisation`.

    Parameters
    ----------
    ellipse : square of the Mahalanobis distance of the ellipses.
    cosines : (m,) of twice the angles round a quarter of an ellipse.
    """
    n = stated.shape[1]
    half, gap, outside = np.empty(n), np.empty(n), np.empty(n)
    for number in range(moments.shape[0]):
        xx, xy, yy = moments[number, 0], moments[number, 1], moments[number, 2]
        a, b, d = stated[0], stated[1], stated[2]
        for k in range(n):
            determinant = 1.0 / (a[k] * d[k] - b[k] * b[k])
            half[k] = 0.5 * determinant * (d[k] * xx[k] - 2.0 * b[k] * xy[k] + a[k] * yy[k])
            gap[k] = math.sqrt(max(half[k] * half[k] - determinant * (xx[k] * yy[k] - xy[k] * xy[k]), 0.0))
            outside[k] = 0.0
        for cosine in cosines:
            for k in range(n):
                square = half[k] + gap[k] * cosine
                outside[k] += _exponential(min(0.5 * ellipse / max(square, 1e-12), _FAR))
        result[number] = 1.0 - outside.sum() / (n * cosines.size)


@njit(nogil=True, error_model="numpy", fastmath={"contract"}, inline="always")
def _exponential(x: float) -> float:
    """Return exp(-x) for x from 0 to 40, to 3e-11, in a form that loops over many take in vector registers."""
    t, value = x / 2.0**_SQUARINGS, 0.0
    for n in range(_TERMS - 1, -1, -1):
        value = value * t + _TAYLOR[n]
    for _ in range(_SQUARINGS):
        value *= value
    return value
