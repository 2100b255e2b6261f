"""Cholesky's factorisation and what is solved with it, for the compiled loops: matrices of twenty, without a call."""

from __future__ import annotations

import math

from sunarc.array_types import FloatArray
from sunarc.jit import njit


@njit(nogil=True)
def halved(factor: FloatArray, vector: FloatArray, size: int) -> float:
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
def turned_back(factor: FloatArray, vector: FloatArray, size: int) -> None:
    """Replace a vector (size,) by L'⁻¹ v: after `halved` it is M⁻¹ v."""
    for i in range(size - 1, -1, -1):
        total = vector[i]
        for k in range(i + 1, size):
            total -= factor[k, i] * vector[k]
        vector[i] = total / factor[i, i]


@njit(nogil=True)
def factored(matrix: FloatArray, size: int, rows: int) -> float:
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
def solved(matrix: FloatArray, vector: FloatArray) -> bool:
    """Replace a vector (f,) by the solution; return False where a matrix (f, f; lower half) is not positive.

    The factor stands in place of the matrix afterwards.
    """
    f = vector.size
    if math.isnan(factored(matrix, f, f)):
        return False
    halved(matrix, vector, f)
    turned_back(matrix, vector, f)
    return True
