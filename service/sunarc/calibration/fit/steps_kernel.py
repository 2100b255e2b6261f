"""The solve with the field marginalised as one compiled loop: Gauss-Newton with halved steps.

tests/calibration/fit/steps_reference.py is the same in numpy, and the tests compare the two. It runs without the
interpreter's lock (`nogil`).
"""

from __future__ import annotations

import math
from typing import NamedTuple

import numpy as np

from sunarc.array_types import FloatArray
from sunarc.calibration.least_squares.priors import N_LENS
from sunarc.calibration.least_squares.row_kernels import Optics, Sighted, residuals_and_columns_of, vectors_of
from sunarc.cholesky import factored, halved, turned_back
from sunarc.jit import njit


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
def rested(  # noqa: PLR0917 - compiled functions take positions
    optics: Optics, lens: LensBasis, seen: Sighted, weighing: Weighing, start: FloatArray, n_air: int,
    steps: int, halvings: int, rest: float,
) -> tuple[FloatArray, Sums, float]:  # fmt: skip
    """Return the most probable unknowns (p,), the sums there, and what the penalty lost on the way.

    `steps` and `halvings` are the most; a step that promises or brings less than `rest` is the last.
    """
    p = start.size
    at, trial = start.copy(), start.copy()
    here, there = _room(p, weighing.field.shape[0]), _room(p, weighing.field.shape[0])
    work, step = np.empty((p, p)), np.empty(p)
    write_sums(optics, lens, seen, weighing, at, n_air, here)
    begin = here.penalty[0]
    for _ in range(steps):
        if _write_step(here.matrix, here.vector, weighing.ridge, work, step) < rest:
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
        if not gain >= rest:
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
    if math.isnan(factored(work, p, p)):
        return 0.0
    promise = halved(work, step, p)
    turned_back(work, step, p)
    for i in range(p):
        step[i] *= scale[i]
    return float(promise)
