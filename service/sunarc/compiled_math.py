"""Mathematics for the compiled loops: Cholesky's factorisation of small matrices, sine and cosine."""

from __future__ import annotations

import math

import numpy as np

from sunarc.array_types import FloatArray
from sunarc.jit import njit


@njit(nogil=True)
def forward_substitution(factor: FloatArray, vector: FloatArray, size: int) -> float:
    """Replace a vector (size,) by L⁻¹ v, and return the square of that: v' M⁻¹ v."""
    square = 0.0
    for i in range(size):
        total = vector[i]
        for k in range(i):
            total -= factor[i, k] * vector[k]
        vector[i] = total / factor[i, i]
        square += vector[i] * vector[i]
    return square


@njit(nogil=True)
def back_substitution(factor: FloatArray, vector: FloatArray, size: int) -> None:
    """Replace a vector (size,) by L'⁻¹ v: after `forward_substitution` it is M⁻¹ v."""
    for i in range(size - 1, -1, -1):
        total = vector[i]
        for k in range(i + 1, size):
            total -= factor[k, i] * vector[k]
        vector[i] = total / factor[i, i]


@njit(nogil=True)
def cholesky_factor(matrix: FloatArray, size: int, rows: int) -> float:
    """Factor the lower half of a matrix in place (Cholesky), further rows with it; return its log determinant.

    NaN where the matrix is not positive.
    """
    determinant = 0.0
    for j in range(size):
        total = matrix[j, j]
        for k in range(j):
            total -= matrix[j, k] * matrix[j, k]
        if not total > 0.0:
            return math.nan
        matrix[j, j] = math.sqrt(total)
        determinant += math.log(total)
        for i in range(j + 1, rows):
            total = matrix[i, j]
            for k in range(j):
                total -= matrix[i, k] * matrix[j, k]
            matrix[i, j] = total / matrix[j, j]
    return float(determinant)


@njit(nogil=True)
def cholesky_solve(matrix: FloatArray, vector: FloatArray) -> bool:
    """Replace a vector (f,) by the solution; return False where a matrix (f, f; lower half) is not positive.

    The factor stands in place of the matrix afterwards.
    """
    f = vector.size
    if math.isnan(cholesky_factor(matrix, f, f)):
        return False
    forward_substitution(matrix, vector, f)
    back_substitution(matrix, vector, f)
    return True


_QUARTER, _ROOT_HALF = math.pi / 4, math.sqrt(0.5)
_SINE = np.array([(-1.0) ** n / math.factorial(2 * n + 1) for n in range(9)])
_COSINE = np.array([(-1.0) ** n / math.factorial(2 * n) for n in range(9)])
"""Taylor's series: to pi / 4 what they leave out is 5e-17."""


@njit(nogil=True, inline="always")
def sine_and_cosine_of_half(theta: float) -> tuple[float, float]:
    """Return the sine and cosine of half an angle from 0 to π, to 2e-16, by series about its quarter."""
    a = 0.5 * theta - _QUARTER
    square = a * a
    sine, cosine = 0.0, 0.0
    for n in range(8, -1, -1):
        sine = sine * square + _SINE[n]
        cosine = cosine * square + _COSINE[n]
    sine *= a
    return _ROOT_HALF * (cosine + sine), _ROOT_HALF * (cosine - sine)
