"""The determinants and squares of the evidence under many prior precisions of a few unknowns, as a compiled loop.

Most unknowns have one prior precision; those of the radial distortion and the decentering are tried at many. The former
are eliminated once (the Schur complement), and each choice costs a factorisation of the few: of those rows of it that
the choice before does not share.
"""

from __future__ import annotations

import math

import numpy as np

from sunarc.array_types import FloatArray, IntArray
from sunarc.cholesky import factored, halved
from sunarc.jit import njit


@njit(nogil=True)
def evidence_terms(  # noqa: PLR0917 - compiled functions take positions
    matrices: FloatArray,
    vectors: FloatArray,
    at: FloatArray,
    fixed: FloatArray,
    varied: FloatArray,
    first: int,
    ridge: float,
    result: FloatArray,
) -> None:
    """Write v' M⁻¹ v - log |M| of M = matrix + precision, v = vector - precision · at; (n, k) of n matrices, k choices.

    Parameters
    ----------
    matrices, vectors : (n, p, p), (n, p).
    at : (p,).
    fixed : (p,) prior precisions; not looked at where they vary.
    varied : (k, q) those of unknowns `first` … `first` + q - 1.
    ridge : share of the diagonal added to it, for the poorest data.
    """
    p, q = at.size, varied.shape[1]
    others = np.array([i for i in range(p) if i < first or i >= first + q])
    o = others.size
    work, scale, vector = np.empty((p, p)), np.empty(p), np.empty(p)
    small, tried, pull, sums = np.empty((q, q)), np.empty((q, q)), np.empty(q), np.zeros((2, q + 1))
    sums[1, 0] = 1.0
    for n in range(matrices.shape[0]):
        matrix = matrices[n]
        for i in range(o):
            precision = fixed[others[i]]
            scale[i] = 1.0 / math.sqrt(matrix[others[i], others[i]] + precision)
            vector[i] = scale[i] * (vectors[n, others[i]] - precision * at[others[i]])
        _write_scaled(matrix, others, scale, first, ridge, work)
        alone = -factored(work, o, p) + halved(work, vector, o)
        for i in range(o):
            alone += 2.0 * math.log(scale[i])
        _eliminate(matrix, vectors[n], first, work, vector, small, pull)
        few = math.nan
        for choice in range(varied.shape[0]):
            begin = 0 if math.isnan(few) else _shared(varied[choice - 1], varied[choice])
            few = _terms_of_few(
                small, pull, matrix, at, varied[choice], first, ridge, begin, tried, vector[o:], scale[o:], sums
            )
            result[n, choice] = alone + few


@njit(nogil=True)
def _shared(before: FloatArray, now: FloatArray) -> int:
    """Return how many precisions, counted from the first one, are the same."""
    count = 0
    while count < now.size and before[count] == now[count]:
        count += 1
    return count


@njit(nogil=True)
def _write_scaled(  # noqa: PLR0917 - compiled functions take positions
    matrix: FloatArray, others: IntArray, scale: FloatArray, first: int, ridge: float, work: FloatArray
) -> None:
    """Write the matrix of the others, its diagonal brought to 1, and below it the rows of those that vary."""
    o = others.size
    for i in range(o):
        for j in range(i):
            work[i, j] = scale[i] * scale[j] * matrix[others[i], others[j]]
        work[i, i] = 1.0 + ridge
    for i in range(matrix.shape[0] - o):
        for j in range(o):
            work[o + i, j] = matrix[first + i, others[j]] * scale[j]


@njit(nogil=True)
def _eliminate(  # noqa: PLR0917 - compiled functions take positions
    matrix: FloatArray,
    vector: FloatArray,
    first: int,
    factor: FloatArray,
    half: FloatArray,
    small: FloatArray,
    pull: FloatArray,
) -> None:
    """Write the Schur complement (q, q) of those that vary and their pull (q,), from the others' factor and half."""
    q = pull.size
    o = matrix.shape[0] - q
    for i in range(q):
        pull[i] = vector[first + i]
        for k in range(o):
            pull[i] -= factor[o + i, k] * half[k]
        for j in range(i + 1):
            small[i, j] = matrix[first + i, first + j]
            for k in range(o):
                small[i, j] -= factor[o + i, k] * factor[o + j, k]


@njit(nogil=True)
def _terms_of_few(  # noqa: PLR0917 - compiled functions take positions
    small: FloatArray,
    pull: FloatArray,
    matrix: FloatArray,
    at: FloatArray,
    precision: FloatArray,
    first: int,
    ridge: float,
    begin: int,
    tried: FloatArray,
    vector: FloatArray,
    scale: FloatArray,
    sums: FloatArray,
) -> float:
    """Return the terms of the q unknowns whose precision varies, the others eliminated; NaN where nothing is positive.

    Row by row: those before `begin` are the same as of the choice before, and stay. `tried` holds the factor with the
    inverse of its diagonal; `sums` (2, q + 1) the squares so far, and the product of scale over diagonal: one logarithm
    at the end, and no division by the diagonal, halve the cost.
    """
    for i in range(begin, precision.size):
        scale[i] = 1.0 / math.sqrt(matrix[first + i, first + i] + precision[i])
        vector[i] = scale[i] * (pull[i] - precision[i] * at[first + i])
        for j in range(i + 1):
            total = scale[i] * scale[j] * small[i, j]
            if i == j:
                total += scale[i] * scale[i] * precision[i] + ridge
            for k in range(j):
                total -= tried[i, k] * tried[j, k]
            if i > j:
                tried[i, j] = total * tried[j, j]
                vector[i] -= tried[i, j] * vector[j]
            elif total > 0.0:
                tried[i, i] = 1.0 / math.sqrt(total)
            else:
                return math.nan
        vector[i] *= tried[i, i]
        sums[0, i + 1] = sums[0, i] + vector[i] * vector[i]
        sums[1, i + 1] = sums[1, i] * scale[i] * tried[i, i]
    return float(sums[0, precision.size] + 2.0 * math.log(sums[1, precision.size]))
