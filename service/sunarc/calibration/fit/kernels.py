"""The compiled loops of the fit: its steps, the evidence under many scales, what each choice of scales says.

Most unknowns have one prior precision; those of the radial distortion and the decentering are tried at many. The former
are eliminated once (the Schur complement), and each choice costs a factorisation of the few: of those rows of it that
the choice before does not share.
"""

from __future__ import annotations

import math
from typing import NamedTuple

import numpy as np

from sunarc.array_types import FloatArray, IntArray
from sunarc.calibration.solve.priors import N_LENS
from sunarc.calibration.solve.row_kernels import Sighted, residuals_and_columns_of, vectors_of
from sunarc.compiled_math import back_substitution, cholesky_factor, forward_substitution
from sunarc.jit import njit
from sunarc.optics.kernels import Optics


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
        alone = -cholesky_factor(work, o, p) + forward_substitution(work, vector, o)
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


# What is computed for each of some hundred plausible choices of scales, as compiled loops.
#
# tests/calibration/fit/test_choices_kernel.py and test_hyperparameter_marginalisation.py have the same in numpy, and
# compare the two. They release the interpreter's lock.

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
                outside[k] += exponential(min(0.5 * ellipse / max(square, 1e-12), _FAR))
        result[number] = 1.0 - outside.sum() / (n * cosines.size)


@njit(nogil=True, error_model="numpy", fastmath={"contract"}, inline="always")
def exponential(x: float) -> float:
    """Return exp(-x) for x from 0 to 40, to 3e-11, in a form that loops over many take in vector registers."""
    t, value = x / 2.0**_SQUARINGS, 0.0
    for n in range(_TERMS - 1, -1, -1):
        value = value * t + _TAYLOR[n]
    for _ in range(_SQUARINGS):
        value *= value
    return value


# The solve with the field marginalised as one compiled loop: Gauss-Newton with halved steps.
#
# tests/calibration/fit/steps_reference.py is the same in numpy, and the tests compare the two. It runs without the
# interpreter's lock (`nogil`).


class LensBasis(NamedTuple):
    """Lens = mean (17,) + basis (17, 17) · its unknowns."""

    mean: FloatArray
    basis: FloatArray


class Weighing(NamedTuple):
    """How the bins count.

    root (b,): of their information, 1/px. field (r, b): the field's basis functions in its axes, each bin times its
    root, each axis times the root of its shrinkage: what such products have, the field takes from the sightings.
    precision (p,): of the prior. rounding, ridge: shares of the diagonal, see `posterior_covariances`.
    """

    root: FloatArray
    field: FloatArray
    precision: FloatArray
    rounding: float
    ridge: float


class Sums(NamedTuple):
    """The equations about some unknowns, the field integrated out.

    matrix (p, p), vector (p,): information on the unknowns, prior and rounding in it, and pull. rows (2, r, p), left
    (2, r): products of the weighed field with derivatives and residuals. penalty (1,): twice the negative log
    posterior.
    """

    matrix: FloatArray
    vector: FloatArray
    rows: FloatArray
    left: FloatArray
    penalty: FloatArray


@njit(nogil=True)
def gauss_newton(  # noqa: PLR0917 - compiled functions take positions
    optics: Optics, lens: LensBasis, seen: Sighted, weighing: Weighing, start: FloatArray, n_air: int,
    steps: int, halvings: int, least_gain: float,
) -> tuple[FloatArray, Sums, float]:  # fmt: skip
    """Return the most probable unknowns (p,), the sums there, and what the penalty lost on the way.

    `steps` and `halvings` are the most; a step that promises or brings less than `least_gain` is the last.
    """
    p = start.size
    at, trial = start.copy(), start.copy()
    here, there = _room(p, weighing.field.shape[0]), _room(p, weighing.field.shape[0])
    work, step = np.empty((p, p)), np.empty(p)
    write_sums(optics, lens, seen, weighing, at, n_air, here)
    begin = here.penalty[0]
    for _ in range(steps):
        if _write_step(here.matrix, here.vector, weighing.ridge, work, step) < least_gain:
            break
        gain, part = 0.0, 1.0
        # Gauss-Newton may overshoot where the lens bends: half a step still gains if the direction is right
        for _ in range(halvings):
            for i in range(p):
                trial[i] = at[i] + part * step[i]
            write_sums(optics, lens, seen, weighing, trial, n_air, there)
            gain = here.penalty[0] - there.penalty[0]
            if gain > 0.0:
                break
            part *= 0.5
        if gain > 0.0:
            at[:] = trial
            here, there = there, here
        if not gain >= least_gain:
            break
    return at, here, begin - here.penalty[0]


@njit(nogil=True)
def _room(p: int, r: int) -> Sums:
    return Sums(np.empty((p, p)), np.empty(p), np.empty((2, r, p)), np.empty((2, r)), np.empty(1))


@njit(nogil=True)
def write_sums(  # noqa: PLR0917 - compiled functions take positions
    optics: Optics, lens: LensBasis, seen: Sighted, weighing: Weighing, at: FloatArray, n_air: int, sums: Sums
) -> None:
    """Write the sums about some unknowns (p,)."""
    p, shared = at.size, seen.systematic_px.shape[2]
    vectors = vectors_of(lens.mean, lens.basis, at, (p - N_LENS - shared - n_air) // 3)
    sizes, air = at[p - shared - n_air : p - n_air], at[p - n_air :]
    residual, columns = residuals_and_columns_of(optics, vectors, seen, sizes, air, lens.basis)
    diagonal = np.zeros(p)
    sums.matrix[:] = 0.0
    sums.vector[:] = 0.0
    square = 0.0
    for c in range(2):
        left, weighted = residual[c], columns[c]
        left *= weighing.root
        for i in range(p):
            weighted[i] *= weighing.root
        own = np.dot(weighted, weighted.T)
        sums.rows[c] = np.dot(weighing.field, weighted.T)
        sums.left[c] = np.dot(weighing.field, left)
        sums.matrix[:] += own - np.dot(sums.rows[c].T, sums.rows[c])
        sums.vector[:] += np.dot(weighted, left) - np.dot(sums.rows[c].T, sums.left[c])
        square += np.dot(left, left) - np.dot(sums.left[c], sums.left[c])
        diagonal += np.diag(own)
    for i in range(p):
        sums.matrix[i, i] += weighing.precision[i] + weighing.rounding * diagonal[i]
        sums.vector[i] -= weighing.precision[i] * at[i]
        square += weighing.precision[i] * at[i] * at[i]
    sums.penalty[0] = square


@njit(nogil=True)
def _write_step(matrix: FloatArray, vector: FloatArray, ridge: float, work: FloatArray, step: FloatArray) -> float:
    """Write the step (p,) and return what it promises; 0 where the equations cannot be solved."""
    p = vector.size
    scale = np.empty(p)
    for i in range(p):
        scale[i] = 1.0 / math.sqrt(max(matrix[i, i], 1e-300))
        step[i] = scale[i] * vector[i]
        for j in range(i + 1):
            work[i, j] = scale[i] * scale[j] * matrix[i, j]
        work[i, i] += ridge
    if math.isnan(cholesky_factor(work, p, p)):
        return 0.0
    promise = forward_substitution(work, step, p)
    back_substitution(work, step, p)
    for i in range(p):
        step[i] *= scale[i]
    return float(promise)
